// Shrinks the hulls of a cover to the voxels that no other hull contains.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/merge.hpp"

namespace alula {

// The numbers of the voxels inside a polytope, ascending, computed in integers:
// normal . v + sum max(normal, 0) <= offset. The box of its vertices must be that of its planes.
void voxels_inside(const Occupancy& occupancy, const LatticePolytope& hull, std::vector<std::uint32_t>& inside);

// Counts of the hulls that contain each voxel, and the order in which hulls are shrunk.
struct Containment {
  std::vector<std::uint32_t> holders;              // number of hulls that contain each voxel
  std::vector<double> excess;                      // W of each hull [voxels]
  std::vector<std::vector<std::uint32_t>> inside;  // the voxels in each hull, ascending
  std::vector<std::size_t> order;                  // the hulls, largest excess first; the lower number among equals
};

Containment containment(const Occupancy& occupancy, std::span<const LatticePolytope> hulls, unsigned jobs,
                        Control& control);

// Replaces each hull, in order of decreasing excess, by the hull of the voxels that no other hull
// contains, and drops hulls without such voxels; hulls only shrink and the union never grows. Afterwards
// the members partition the voxels. A hull is kept when its replacement would raise the written cover
// above the budget. Returns the numbers of the hulls that remain.
std::vector<std::size_t> retighten(const Occupancy& occupancy, Cover& cover, const Budget& budget, unsigned jobs,
                                   Control& control);

}  // namespace alula
