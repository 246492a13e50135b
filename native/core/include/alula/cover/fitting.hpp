// Covers of outer polytopes, and how many hulls of how many planes are best at equal cost.
#pragma once

#include <vector>

#include "alula/cover/merge.hpp"
#include "alula/cover/retighten.hpp"
#include "alula/cover/union_volume.hpp"

namespace alula {

// The cover as it was after the first `merges` of a run of merge() on `sets`; without curve and history.
Cover replay(const Occupancy& occupancy, const VoxelSets& sets, const Cover& whole, std::size_t merges, unsigned jobs,
             Control& control);

// Gives the hulls of a cover their outer polytopes: k-DOPs, or at most budget.form.facet_cap planes
// each (0: no cap) and no more in all than the budget allows, which must allow six for each hull. With `tighten`,
// each polytope is first rebuilt from the voxels that no other one contains, the one with most excess first, and kept
// where that encloses less; those without such voxels are dropped. Then the members partition the voxels.
//
// Guarantee: every voxel is a member of a polytope that contains it; its vertices are those of the
// hull of its members, which all its planes support.
void make_outer(const Occupancy& occupancy, Cover& cover, const Budget& budget, bool tighten, unsigned jobs,
                Control& control);

// Half-planes of polytopes in all.
std::size_t planes_of(const std::vector<LatticePolytope>& hulls);

// A cover that was measured: what is written of it, and Vol(union \ occupied) [voxels].
struct Measured {
  std::size_t hulls, planes;
  UnionVolume volume;
};

// The least union within a budget over covers of one merge history. Fewer planes per hull buy more
// hulls: from about eight planes per hull on, goes to more or fewer as long as that is better.
// max_hulls = 0 is no limit. Returns the cover with its history and the curve of all merges, where
// within_budget tells whether there is any, and appends what was measured.
Cover fit(const Occupancy& occupancy, const VoxelSets& sets, MergeOptions options, unsigned jobs, Control& control,
          std::vector<Measured>& measured, EvaluationLog* journal = nullptr);

}  // namespace alula
