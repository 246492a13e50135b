// What a merge in progress is made of: elements, their neighbours and the pairs that may merge.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "alula/cover/lattice_hull.hpp"

namespace alula {

inline constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

struct Link {
  std::uint32_t other;
  double key;  // of the pair in the queue: what is expected, and exact once evaluated
};

// A union that is built before its turn.
struct Ready {
  std::uint32_t left, right;
  LatticePolytope hull;
  HullMesh mesh;
};

struct Element {
  LatticePolytope hull;
  HullMesh mesh;  // of the same hull
  double weight = 0;
  bool alive = true;
  std::vector<Link> links;
  std::vector<Link> waiting;     // those with lower numbers that were not in the queue yet, the best one last
  std::unique_ptr<Ready> ready;  // of this element, as the lower number, and another
};

struct Candidate {
  double key;
  double weight;                                  // W of the union, kUnknown when it was not measured yet
  std::uint32_t left, right;                      // left < right
  bool evaluated;                                 // key is that of weight
  bool is_nearest;                                // paired because `left` or `right` touches nothing
  bool operator<(const Candidate& other) const {  // the best is the top of a heap
    if (key != other.key) return key > other.key;
    if (left != other.left) return left > other.left;
    return right > other.right;
  }
};

struct Gap {
  std::int64_t squared_distance;
  std::uint32_t item, nearest;
  bool operator<(const Gap& other) const {
    if (squared_distance != other.squared_distance) return squared_distance > other.squared_distance;
    if (item != other.item) return item > other.item;
    return nearest > other.nearest;
  }
};

}  // namespace alula
