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
// must be inside a hull. Space is divided into at most about a thousand parts. If one of them needs
// more than `most_cuts` cuts, of about a microsecond each, the function sums exact z-intervals over a regular grid
// of at most `most_lines` lines instead, of about thirty half-planes each (a line of a hull with over a
// thousand half-planes counts as several). A hull is the set that its planes
// bound. Deterministic for any number of threads.
UnionVolume union_excess(const Occupancy& occupancy, const std::vector<LatticePolytope>& hulls, unsigned jobs,
                         Control& control, std::size_t most_cuts = 100'000, double most_lines = 2e7);

}  // namespace alula
