// Covering voxels with a given number of convex polytopes by greedy merging.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/budget.hpp"
#include "alula/cover/evaluation_log.hpp"
#include "alula/cover/subcover.hpp"

namespace alula {

// Which pair merges next. With W(C) = Vol(Hull(C) \ occupied):
enum class MergeRule {
  kPaper,     // least W(i u j) among pairs whose boxes touch; the nearest boxes when none do
  kIncrease,  // least W(i u j) - W(i) - W(j); a polytope that touches none is paired with its nearest
};

struct MergeOptions {
  MergeRule rule = MergeRule::kIncrease;
  std::size_t max_hulls = 0;  // 0: no limit
  Budget budget;              // of what is written in the end
  double max_growth = 0;      // limit of 1 + sum W / voxels; 0: no limit
};

struct Merge {
  std::uint32_t left, right;  // start sets are 0 .. N - 1, the k-th merge makes N + k
  double weight;              // W of the result [voxels]
};

struct CurvePoint {
  std::size_t hulls;
  double excess;       // sum of W [voxels], at least the excess of the union
  std::size_t planes;  // as they are written
};

struct Cover {
  std::vector<LatticePolytope> hull;
  VoxelSets members;  // Hull(members) has the vertices of the hull, and its planes unless those are outer ones
  std::vector<Merge> history;
  std::vector<CurvePoint> curve;  // after each merge, the start first
  bool within_budget = true;      // false: max_growth, or n = 1, was reached before the others held
};

// Merges pairs of sets until at most max_hulls polytopes remain and what is written of them is
// within the budget. Without either limit, merges as long as max_growth allows.
//
// Guarantee: every voxel of `sets` stays a member of a hull that contains it; weights only rank.
// Deterministic: results depend neither on the number of threads nor on `log`, if given, which supplies
// weights known from an earlier run and takes the others. Pairs wait under what their key is expected to
// be and are evaluated only when that is the best of the heap. By kPaper it is exact: a merged hull
// contains the hulls of all pairs it came from, so W(i u j u k) is at least W(i u j), W(i u k) and
// W(j u k). By kIncrease it is that no pair of a merged element has a lower key than those of its parts:
// where that fails, the pair merges later than by the rule, and a quarter of the evaluations are spared.
// Time O(n log n) queue operations for n sets with a bounded number of neighbours.
// Source: Hong et al. 2026 (arXiv 2606.16232), eqs. 11-15.
Cover merge(const Occupancy& occupancy, const VoxelSets& sets, const MergeOptions& options, unsigned jobs,
            Control& control, EvaluationLog* log = nullptr);

// The voxels of the elements that no merge of the history took, by ascending number of the element.
VoxelSets merged_sets(const VoxelSets& sets, std::span<const Merge> history);

// Orders hulls by their members, lexicographically.
void sort_hulls(Cover& cover);

}  // namespace alula
