// Improves a cover without changing its number of hulls.
#pragma once

#include <cstddef>

#include "alula/base/control.hpp"
#include "alula/cover/merge.hpp"

namespace alula {

// Limit of evaluations that takes about as long as merging at most.
std::size_t refine_evaluations(std::size_t voxels);

// Repeats two exchanges as long as the sum of W decreases:
// - the voxels of two hulls with touching boxes are divided anew, by the plane across an axis that gives two hulls
//   with the smallest sum of W;
// - one hull is divided in that way, and two others are merged, where that saves more than it costs.
//
// In each round the exchanges of the hulls that changed in the round before are measured, in the order of what it
// would cost to join the two, and the best of them that share no hull are made. The number of measured hulls is
// limited by about `max_evaluations`, and the total number of planes by the budget.
//
// `members` must be disjoint; otherwise the cover is left as it is. Guarantee: the members of the new sets are those
// of the old ones, and each hull is the convex hull of its members. Deterministic for any number of threads.
void refine(const Occupancy& occupancy, Cover& cover, const Budget& budget, std::size_t max_evaluations,
            unsigned jobs, Control& control);

}  // namespace alula
