// A bounding-volume hierarchy for branch-and-bound minimisation over many obstacles.
#pragma once

#include <algorithm>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <numeric>
#include <vector>

#include "alula/geometry/vec3.hpp"

namespace alula::geometry {

// Binary tree over boxes, split at the median of the centres along the longest side; O(n log n)
// to build, 2 n / leaf nodes. The tree depends on the boxes alone.
class Bvh {
 public:
  struct Node {
    Box box;
    double depth;
    std::uint32_t first;  // of the items of a leaf, or the right child; the left child follows its parent
    std::uint32_t count;  // 0 for an inner node
  };

  Bvh() = default;

  // box_of(i) is the box of obstacle i, computed twice so that boxes need no memory beside the tree; depth_of(box)
  // bounds the depth of a point inside an obstacle with that box (0 when that does not matter). A leaf has at most
  // `leaf` obstacles; larger leaves suit obstacles that are cheap to evaluate. Memory: 28 bytes an obstacle while
  // they are ordered, then 4 and the nodes.
  template <class BoxOf, class DepthOf>
  Bvh(std::uint32_t size, const BoxOf& box_of, const DepthOf& depth_of, std::uint32_t leaf = 4)
      : order_(size), leaf_(leaf) {
    if (size == 0) return;
    std::iota(order_.begin(), order_.end(), 0u);
    {
      std::vector<Vec3> centres(size);  // twice the centres
      for (std::uint32_t i = 0; i < size; ++i) {
        const Box box = box_of(i);
        centres[i] = box.lower + box.upper;
      }
      sort(centres, 0, size);
    }
    nodes_.reserve(nodes_over(size));
    build(box_of, depth_of, 0, size);
  }

  // A node that a search by bounds has not visited yet.
  struct Pending {
    double bound;
    std::uint32_t node;

    auto operator<=>(const Pending&) const = default;
  };

  const std::vector<std::uint32_t>& order() const { return order_; }
  const std::vector<Node>& nodes() const { return nodes_; }  // the root first, parents before their children
  const Box* bounds() const { return nodes_.empty() ? nullptr : &nodes_[0].box; }

  // Minimum of `best` and value(i, best) over all obstacles i, for a signed distance of the
  // segment a + t d, 0 <= t <= 1. value(i, best) may return any value >= best if the exact value is not below
  // `best`. `nearest` is evaluated first and becomes the minimiser.
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
  // `order` does, so obstacles of one leaf have consecutive slots. Returns the number of boxes measured.
  template <class Visit>
  std::uint32_t visit_near(Vec3 a, Vec3 d, const double& reach, Visit&& visit) const {
    return nodes_.empty() ? 0 : visit_near(0, Sight(a, d), reach, visit);
  }

  // Calls visit(slot, item) for the obstacles of every leaf with bound(node, box) below `limit`, smallest bound
  // first. A bound holds for everything in the box; NaN is no bound. `visit` may lower the limit; `heap` is scratch
  // memory.
  template <class Bound, class Visit>
  void visit_least(std::vector<Pending>& heap, const double& limit, Bound&& bound, Visit&& visit) const {
    heap.clear();
    const auto push = [&](std::uint32_t node) {
      const double lowest = bound(node, nodes_[node].box);
      if (lowest >= limit) return;
      heap.push_back({lowest == lowest ? lowest : -std::numeric_limits<double>::infinity(), node});
      std::push_heap(heap.begin(), heap.end(), std::greater<>());
    };
    if (!nodes_.empty()) push(0);
    while (!heap.empty()) {
      std::pop_heap(heap.begin(), heap.end(), std::greater<>());
      const Pending next = heap.back();
      heap.pop_back();
      if (next.bound >= limit) return;
      const Node& node = nodes_[next.node];
      if (node.count > 0) {
        for (std::uint32_t i = 0; i < node.count; ++i) visit(node.first + i, order_[node.first + i]);
      } else {
        push(next.node + 1), push(node.first);
      }
    }
  }

  // Combines the values of the obstacles of every node: combine(x, y) over the slots below the node.
  template <class T, class Value, class Combine>
  std::vector<T> summary(Value&& value, Combine&& combine) const {
    std::vector<T> result(nodes_.size());
    for (std::size_t at = nodes_.size(); at-- > 0;) {  // children come after their parent
      const Node& node = nodes_[at];
      if (node.count == 0) {
        result[at] = combine(result[at + 1], result[node.first]);
        continue;
      }
      result[at] = value(node.first);
      for (std::uint32_t i = 1; i < node.count; ++i) result[at] = combine(result[at], value(node.first + i));
    }
    return result;
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
  static constexpr double kSlack = 1e-12;  // more than the rounding error of a bound

  // The segment that distances are measured from.
  struct Sight {
    Vec3 a, d;
    Box box;
    bool is_point;

    Sight(Vec3 from, Vec3 along) : a(from), d(along), is_point(d.x == 0 && d.y == 0 && d.z == 0) {
      box.include(a), box.include(a + d);
    }
    // A lower bound on the squared distance of a box, tight where it may be below the reach.
    double squared_bound(const Node& node, double reach) const {
      const double squared = squared_distance(node.box, box);
      if (is_point || (squared > 0 && !(reach > 0 && squared < reach * reach))) return squared;
      return std::max(squared, squared_distance_bound(node.box, a, d));
    }
  };

  static bool may_be_below(const Node& node, double squared, double reach) {
    return reach > 0 ? squared * (1 - kSlack) < reach * reach : squared == 0 && -node.depth < reach;
  }

  template <class Visit>
  std::uint32_t visit_near(std::uint32_t root, const Sight& sight, const double& reach, Visit&& visit) const {
    struct Entry {
      std::uint32_t node;
      double squared;
    };
    Entry stack[64];
    int top = 0;
    std::uint32_t measured = 1;
    const auto push = [&](std::uint32_t node, double squared) {
      if (may_be_below(nodes_[node], squared, reach)) stack[top++] = {node, squared};
    };
    push(root, sight.squared_bound(nodes_[root], reach));
    while (top > 0) {
      const Entry entry = stack[--top];
      const Node& node = nodes_[entry.node];
      if (!may_be_below(node, entry.squared, reach)) continue;
      if (node.count > 0) {
        for (std::uint32_t i = 0; i < node.count; ++i) visit(node.first + i, order_[node.first + i]);
        continue;
      }
      const std::uint32_t left = entry.node + 1, right = node.first;
      const double at_left = sight.squared_bound(nodes_[left], reach);
      const double at_right = sight.squared_bound(nodes_[right], reach);
      measured += 2;
      if (at_left <= at_right) {
        push(right, at_right), push(left, at_left);
      } else {
        push(left, at_left), push(right, at_right);
      }
    }
    return measured;
  }

  static std::uint32_t half(std::uint32_t count) { return count / 2; }  // of the obstacles are left of the median

  std::size_t nodes_over(std::uint32_t count) const {
    return count <= leaf_ ? 1 : 1 + nodes_over(half(count)) + nodes_over(count - half(count));
  }

  // Orders the obstacles as the leaves need them.
  void sort(const std::vector<Vec3>& centres, std::uint32_t begin, std::uint32_t end) {
    if (end - begin <= leaf_) return;
    Box around;
    for (std::uint32_t i = begin; i < end; ++i) around.include(centres[order_[i]]);
    const Vec3 size = around.upper - around.lower;
    const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
    const std::uint32_t middle = begin + half(end - begin);
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](std::uint32_t i, std::uint32_t j) {
                       const double at_i = centres[i][axis], at_j = centres[j][axis];
                       return at_i != at_j ? at_i < at_j : i < j;
                     });
    sort(centres, begin, middle);
    sort(centres, middle, end);
  }

  template <class BoxOf, class DepthOf>
  std::uint32_t build(const BoxOf& box_of, const DepthOf& depth_of, std::uint32_t begin, std::uint32_t end) {
    const auto index = static_cast<std::uint32_t>(nodes_.size());
    nodes_.push_back({{}, 0, begin, end - begin});
    const auto include = [&](const Box& box, double depth) {
      nodes_[index].box.include(box);
      nodes_[index].depth = std::max(nodes_[index].depth, depth);
    };
    if (end - begin <= leaf_) {
      for (std::uint32_t i = begin; i < end; ++i) {
        const Box box = box_of(order_[i]);
        include(box, depth_of(box));
      }
      return index;
    }
    const std::uint32_t middle = begin + half(end - begin);
    const std::uint32_t left = build(box_of, depth_of, begin, middle);
    const std::uint32_t right = build(box_of, depth_of, middle, end);
    for (const std::uint32_t child : {left, right}) include(nodes_[child].box, nodes_[child].depth);
    nodes_[index].first = right;
    nodes_[index].count = 0;
    return index;
  }

  std::vector<std::uint32_t> order_;
  std::uint32_t leaf_ = 4;
  std::vector<Node> nodes_;
};

}  // namespace alula::geometry
