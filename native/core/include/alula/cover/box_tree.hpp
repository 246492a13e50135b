// A dynamic tree of axis-aligned lattice boxes, for queries of touching and nearest boxes.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/cover/lattice_hull.hpp"

namespace alula {

// Items are numbered by the caller, each at most once in the tree. Results depend on the set of
// boxes only, not on the order of insertions.
class BoxTree {
 public:
  void insert(std::uint32_t item, const LatticeBox& box);
  void remove(std::uint32_t item);
  const LatticeBox& box(std::uint32_t item) const { return node_[static_cast<std::size_t>(leaf_[item])].box; }

  // Items whose closed boxes touch `box`, in increasing order.
  void touching(const LatticeBox& box, std::vector<std::uint32_t>& items) const;

  struct Neighbour {
    std::int64_t squared_distance;  // between closed boxes
    std::uint32_t item;             // the lowest number among equally near ones
  };
  static constexpr std::uint32_t kNone = UINT32_MAX;

  // The item nearest to `item`, itself excluded; kNone when it is alone.
  Neighbour nearest(std::uint32_t item) const;

 private:
  struct Node {
    LatticeBox box;
    std::int32_t parent, left, right;  // left < 0: a leaf
    std::uint32_t item;
  };
  std::int32_t allocate();
  void refit(std::int32_t node);

  std::vector<Node> node_;
  std::vector<std::int32_t> free_, leaf_;
  std::int32_t root_ = -1;
};

// 0 .. count - 1 in a fixed order without spatial pattern: a tree built in it stays shallow.
std::vector<std::uint32_t> scattered(std::size_t count);

}  // namespace alula
