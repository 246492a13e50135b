// Improves a cover without changing its number of hulls.
#pragma once

#include <cstddef>

#include "alula/base/control.hpp"
#include "alula/cover/merge.hpp"

namespace alula {

// Limit of the work: up to 100,000 voxels as much as is useful, which may take longer than merging; for many voxels
// what takes a sixth of the time of merging.
std::size_t refine_work(std::size_t voxels);

// Repeats three changes as long as the sum of W decreases:
// - the voxels of two hulls with touching boxes are divided anew, by the plane across an axis that gives two hulls
//   with the smallest sum of W;
// - one hull is divided in that way, and two others are merged, where that saves more than it costs;
// - the voxels at an extreme point of a hull go to another hull, where that saves more than it costs.
//
// In each round the changes of the hulls that changed in the round before are measured, and the best of them are
// made. The work is limited by about `work`, in units of HullMoves::work, and the total number of planes by the
// budget.
//
// `members` must be disjoint; otherwise the cover is left as it is. Guarantee: the members of the new sets are those
// of the old ones, and each hull is the convex hull of its members. Deterministic for any number of threads.
void refine(const Occupancy& occupancy, Cover& cover, const Budget& budget, std::size_t work, unsigned jobs,
            Control& control);

}  // namespace alula
