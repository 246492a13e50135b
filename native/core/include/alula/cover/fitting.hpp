// Covers of outer polytopes, and the search for the best number of hulls and planes within a budget.
#pragma once

#include <vector>

#include "alula/cover/merge.hpp"
#include "alula/cover/retighten.hpp"
#include "alula/cover/union_volume.hpp"

namespace alula {

// Rebuilds the cover after the first `merges` of a run of merge() on `sets`, without curve and history.
Cover replay(const Occupancy& occupancy, const VoxelSets& sets, const Cover& whole, std::size_t merges, unsigned jobs,
             Control& control);

// Replaces the hulls of a cover by their outer polytopes: k-DOPs, or at most budget.form.facet_cap planes
// each (0: no cap) and in total at most the planes of the budget, which must allow six for each hull. With
// `tighten`, each polytope is first rebuilt from the voxels that no other one contains, in order of decreasing
// excess, and replaced where the new one encloses less; polytopes without such voxels are dropped. Then the members
// partition the voxels.
//
// Guarantee: every voxel is a member of a polytope that contains it; its vertices are those of the
// hull of its members, which all its planes support.
void make_outer(const Occupancy& occupancy, Cover& cover, const Budget& budget, bool tighten, unsigned jobs,
                Control& control);

// Total number of half-planes.
std::size_t planes_of(const std::vector<LatticePolytope>& hulls);

// A measured cover: its written size, and Vol(union \ occupied) [voxels].
struct Measured {
  std::size_t hulls, planes;
  UnionVolume volume;
};

// Finds the cover with the smallest union within a budget among the covers of one merge history. Fewer planes per
// hull allow more hulls: starting at about eight planes per hull, tries more or fewer as long as the union shrinks.
// max_hulls = 0: no limit. Returns the cover with its history and the curve of all merges; within_budget is false if
// no cover fits. Appends the measured covers.
Cover fit(const Occupancy& occupancy, const VoxelSets& sets, MergeOptions options, unsigned jobs, Control& control,
          std::vector<Measured>& measured, EvaluationLog* journal = nullptr);

}  // namespace alula
