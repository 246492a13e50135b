// Local clusters of occupied voxels, and a subset of the clusters with small weight that covers all voxels.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/occupancy.hpp"

namespace alula {

// Sets of voxels as ascending voxel numbers, row-compressed.
struct VoxelSets {
  std::vector<std::uint32_t> member;
  std::vector<std::size_t> start{0};

  std::size_t size() const { return start.size() - 1; }
  std::span<const std::uint32_t> operator[](std::size_t i) const {
    return std::span(member).subspan(start[i], start[i + 1] - start[i]);
  }
  void close() { start.push_back(member.size()); }  // ends the set being written
};

// Greedy weighted set cover of all voxels by clusters.
//
// The cluster of voxel v is C_v = {occupied v' : |v' - v|_inf <= block}; its weight is
// W(C_v) = Vol(Hull(C_v) \ occupied). Repeatedly chooses the cluster of minimum weight per newly
// covered voxel; ties go to the cluster that covers more, then to the lower voxel. With block 1 the
// weight depends only on the 26 neighbours and is computed once per pattern of neighbours.
// A chosen cluster becomes a set of all its voxels. With `is_disjoint` it becomes a set of those that no set before
// it has, and tiles of consecutive voxels are covered each by itself, in parallel. Time O(M (2 block + 1)^3) and a
// few hull evaluations per distinct pattern. Source: Hong et al. 2026 (arXiv 2606.16232), eqs. 10-11; Chvatal 1979.
VoxelSets subcover(const Occupancy& occupancy, int block, bool is_disjoint, unsigned jobs, Control& control);

}  // namespace alula
