// A bounding-volume hierarchy for branch-and-bound minimisation over many obstacles.
#pragma once

#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

#include "alula/vec3.hpp"

namespace alula::geometry {

// Binary tree over boxes, split at the median of the centres along the longest side; O(n log n)
// to build, 2 n / kLeaf nodes. The tree depends on the boxes alone.
class Bvh {
 public:
  Bvh() = default;

  // depth[i] bounds how far inside obstacle i a point can be (0 when that does not matter).
  Bvh(const std::vector<Box>& boxes, const std::vector<double>& depth) : order_(boxes.size()) {
    std::iota(order_.begin(), order_.end(), 0u);
    if (boxes.empty()) return;
    nodes_.reserve(2 * boxes.size() / kLeaf + 2);
    build(boxes, depth, 0, static_cast<std::uint32_t>(boxes.size()));
  }

  const std::vector<std::uint32_t>& order() const { return order_; }
  const Box* bounds() const { return nodes_.empty() ? nullptr : &nodes_[0].box; }

  // Minimum of `best` and value(i, best) over all obstacles i, for a signed distance of the
  // segment a + t d, 0 <= t <= 1. value(i, best) may return anything >= best once it knows that
  // the exact value is not below `best`. `nearest` is tried first and becomes the minimiser.
  template <class Value>
  double minimum(Vec3 a, Vec3 d, double best, std::uint32_t& nearest, Value&& value) const {
    if (nodes_.empty()) return best;
    const auto try_one = [&](std::uint32_t item) {
      const double v = value(item, best);
      if (v < best) best = v, nearest = item;
    };
    if (nearest < order_.size()) try_one(nearest);
    visit_near(a, d, best, [&](std::uint32_t, std::uint32_t item) { try_one(item); });
    return best;
  }

  // Calls visit(slot, item) for the obstacles of every leaf whose distance to the segment a + t d, 0 <= t <= 1,
  // may be below `reach`, nearer halves first. `visit` may lower the reach. Slots number the obstacles as
  // `order` does, so that those of a leaf are neighbours. Returns how many boxes were measured.
  template <class Visit>
  std::uint32_t visit_near(Vec3 a, Vec3 d, const double& reach, Visit&& visit) const {
    if (nodes_.empty()) return 0;
    Box segment;
    segment.include(a), segment.include(a + d);
    struct Entry {
      std::uint32_t node;
      double bound;
    };
    Entry stack[64];
    int top = 0;
    std::uint32_t measured = 1;
    const auto push = [&](std::uint32_t node, double bound) {
      if (bound < reach) stack[top++] = {node, bound};
    };
    push(0, bound_of(nodes_[0], segment, a, d, reach));
    while (top > 0) {
      const Entry entry = stack[--top];
      if (entry.bound >= reach) continue;
      const Node& node = nodes_[entry.node];
      if (node.count > 0) {
        for (std::uint32_t i = 0; i < node.count; ++i) visit(node.first + i, order_[node.first + i]);
        continue;
      }
      const std::uint32_t left = entry.node + 1, right = node.first;
      const double at_left = bound_of(nodes_[left], segment, a, d, reach);
      const double at_right = bound_of(nodes_[right], segment, a, d, reach);
      measured += 2;
      if (at_left <= at_right) {
        push(right, at_right), push(left, at_left);
      } else {
        push(left, at_left), push(right, at_right);
      }
    }
    return measured;
  }

  // Calls visit(i) for every obstacle whose box may be closer to `box` than `reach`.
  template <class Visit>
  void near(const Box& box, double reach, Visit&& visit) const {
    if (nodes_.empty()) return;
    std::uint32_t stack[64];
    int top = 0;
    stack[top++] = 0;
    while (top > 0) {
      const std::uint32_t at = stack[--top];
      const Node& node = nodes_[at];
      if (squared_distance(node.box, box) > reach * reach * (1 + kSlack)) continue;
      if (node.count > 0) {
        for (std::uint32_t i = 0; i < node.count; ++i) visit(order_[node.first + i]);
      } else {
        stack[top++] = node.first;
        stack[top++] = at + 1;
      }
    }
  }

 private:
  static constexpr std::uint32_t kLeaf = 4;
  static constexpr double kSlack = 1e-12;  // more than the roundings of a bound

  struct Node {
    Box box;
    double depth;
    std::uint32_t first;  // of the items of a leaf, or the right child; the left child follows its parent
    std::uint32_t count;  // 0 for an inner node
  };

  static double bound_of(const Node& node, const Box& segment, Vec3 a, Vec3 d, double best) {
    double squared = squared_distance(node.box, segment);
    const bool is_point = d.x == 0 && d.y == 0 && d.z == 0;
    if (!is_point && (squared == 0 || (best > 0 && squared < best * best))) {
      squared = std::max(squared, squared_distance_bound(node.box, a, d));
    }
    return squared > 0 ? std::sqrt(squared) * (1 - kSlack) : -node.depth;
  }

  std::uint32_t build(const std::vector<Box>& boxes, const std::vector<double>& depth, std::uint32_t begin,
                      std::uint32_t end) {
    const auto index = static_cast<std::uint32_t>(nodes_.size());
    Box box, centres;
    double deepest = 0;
    for (std::uint32_t i = begin; i < end; ++i) {
      const Box& item = boxes[order_[i]];
      box.include(item);
      centres.include(item.lower + item.upper);
      deepest = std::max(deepest, depth[order_[i]]);
    }
    nodes_.push_back({box, deepest, begin, end - begin});
    if (end - begin <= kLeaf) return index;
    const Vec3 size = centres.upper - centres.lower;
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const std::uint32_t middle = begin + (end - begin) / 2;
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](std::uint32_t i, std::uint32_t j) {
                       const double at_i = boxes[i].lower[axis] + boxes[i].upper[axis];
                       const double at_j = boxes[j].lower[axis] + boxes[j].upper[axis];
                       return at_i != at_j ? at_i < at_j : i < j;
                     });
    build(boxes, depth, begin, middle);
    const std::uint32_t right = build(boxes, depth, middle, end);
    nodes_[index].first = right;
    nodes_[index].count = 0;
    return index;
  }

  std::vector<std::uint32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace alula::geometry
