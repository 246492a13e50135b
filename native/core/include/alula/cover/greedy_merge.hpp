// The greedy merging of sets of voxels, as a list of its steps.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/cover/merge.hpp"

namespace alula {

// One merge and its effect on the sums over all elements.
struct MergeStep {
  Merge merge;
  double key;             // by which the rule chose the pair
  double excess;          // added to the sum of W [voxels]
  std::ptrdiff_t planes;  // added to the planes of the written cover
};

struct MergeSteps {
  CurvePoint start;  // the elements before the first merge
  std::vector<MergeStep> step;
  bool within_budget = true;
};

// Merges the sets with the given numbers until `options` hold; see merge(). In the result their elements are numbered
// 0, 1, ... in the given order, and the k-th merge makes the element of number count + k. In `log`, which may be
// null, numbers start at `log_base`.
MergeSteps greedy_merge(const Occupancy& occupancy, const VoxelSets& sets, std::span<const std::uint32_t> numbers,
                        const MergeOptions& options, unsigned jobs, Control& control, EvaluationLog* log,
                        std::uint32_t log_base);

}  // namespace alula
