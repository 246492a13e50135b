// The nodes of OctoMap's files: trees of depth 16 over 2^16 voxels along each axis, in depth-first order.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace alula {

enum class LeafState : std::uint8_t { kUnknown = 0, kFree = 1, kOccupied = 2 };

// Cubes that partition the tree: leaves, and those that no node describes.
struct OctreeLeaves {
  std::vector<std::int32_t> lower;  // (N, 3) lowest voxel, from -2^15
  std::vector<std::int32_t> edge;   // (N) [voxels]
  std::vector<std::uint8_t> state;  // (N) LeafState
  std::size_t nodes = 0;            // of the tree, leaves included
};

// Reads the nodes of a tree. A binary one (.bt) has two bits for each child of an inner node: 0 unknown, 1 free,
// 2 occupied, 3 an inner node. A full one (.ot) has for each node the log-odds of its occupancy, 32-bit, `payload`
// further bytes, and one bit for each child; a leaf of log-odds 0 or more is occupied.
// Throws std::invalid_argument, with the cause, if the bytes are no such tree.
OctreeLeaves octree_leaves(std::span<const std::uint8_t> body, bool is_binary, std::size_t payload);

}  // namespace alula
