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

// Rule that selects the next pair. With W(C) = Vol(Hull(C) \ occupied):
enum class MergeRule {
  kPaper,     // minimum W(i u j) among pairs with boxes that touch; the nearest boxes when none do
  kIncrease,  // minimum W(i u j) - W(i) - W(j); a polytope that touches none is paired with its nearest
};

struct MergeOptions {
  MergeRule rule = MergeRule::kIncrease;
  std::size_t max_hulls = 0;     // 0: no limit
  Budget budget;                 // of the written cover
  double max_growth = 0;         // limit of 1 + sum W / voxels; 0: no limit
  std::size_t finest_hulls = 0;  // covers of up to this many hulls will be replayed from the history
  // A union that was not measured yet is expected to add this fraction of what its bounding box adds to those of its
  // parts. Zero examines pairs in the order of lower bounds, which measures more of them.
  double expected_growth = 0;
};

struct Merge {
  std::uint32_t left, right;  // start sets are 0 .. N - 1, the k-th merge makes N + k
  double weight;              // W of the result [voxels]
};

struct CurvePoint {
  std::size_t hulls;
  double excess;       // sum of W [voxels], at least the excess of the union
  std::size_t planes;  // of the written cover
};

struct Cover {
  std::vector<LatticePolytope> hull;
  VoxelSets members;  // Hull(members) has the vertices of the hull, and its planes unless those are outer ones
  std::vector<Merge> history;
  std::vector<CurvePoint> curve;  // after each merge, the start first
  bool within_budget = true;      // false: max_growth, or n = 1, was reached before the other limits held
};

// Merges pairs of sets until at most max_hulls polytopes remain and the written cover is
// within the budget. Without either limit, merges as long as max_growth allows.
//
// Guarantee: every voxel of `sets` stays a member of a hull that contains it; weights only rank.
// Deterministic: results depend neither on the number of threads nor on `log`, if given, which supplies
// weights known from an earlier run and records the others. Pairs wait in a heap under their expected key and are
// evaluated only when they are at its top. For kPaper this lazy evaluation is exact: a merged hull
// contains the hulls of all pairs it came from, so W(i u j u k) is at least W(i u j), W(i u k) and
// W(j u k). For kIncrease it assumes that no pair of a merged element has a lower key than the pairs of its parts.
// Where that fails, the pair merges later than by the rule; the assumption saves a quarter of the evaluations.
// Time O(n log n) queue operations for n sets with a bounded number of neighbours.
// Source: Hong et al. 2026 (arXiv 2606.16232), eqs. 11-15.
Cover merge(const Occupancy& occupancy, const VoxelSets& sets, const MergeOptions& options, unsigned jobs,
            Control& control, EvaluationLog* log = nullptr);

// The voxels of the elements that remain after the merges of the history, by ascending number of the element.
VoxelSets merged_sets(const VoxelSets& sets, std::span<const Merge> history);

// The convex hulls of the members.
std::vector<LatticePolytope> hulls_of(const Occupancy& occupancy, const VoxelSets& members, unsigned jobs,
                                      Control& control);

// Orders hulls by their members, lexicographically.
void sort_hulls(Cover& cover);

}  // namespace alula
