// The volume that the hulls of a cover enclose beyond the voxels.
#pragma once

#include <cstddef>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/occupancy.hpp"

namespace alula {

struct UnionVolume {
  double excess;      // Vol(union of hulls \ occupied) [voxels]
  double error;       // bound on its rounding error [voxels]; 0 when it was not exact
  int lines, stride;  // lines x lines per sampled voxel column, every stride-th column per axis; 0: exact
};

// Volume of the union outside the voxels, exact up to rounding (see union_measure.hpp); every voxel
// must be inside a hull. Space is divided into at most about a thousand parts; where one of them takes
// more than `most_cuts`, at about a microsecond each, exact z-intervals over a regular grid of at most
// `most_lines` lines, at about thirty half-planes each, are summed instead. A hull is what its planes
// bound. Deterministic for any number of threads.
UnionVolume union_excess(const Occupancy& occupancy, const std::vector<LatticePolytope>& hulls, unsigned jobs,
                         Control& control, std::size_t most_cuts = 100'000, double most_lines = 2e7);

}  // namespace alula
