#include "alula/cover/box_tree.hpp"

#include <algorithm>

namespace alula {

namespace {

double half_area(const LatticeBox& b) {
  const double x = b.upper[0] - b.lower[0], y = b.upper[1] - b.lower[1], z = b.upper[2] - b.lower[2];
  return x * y + y * z + z * x;
}

LatticeBox joined(LatticeBox a, const LatticeBox& b) {
  a.add(b);
  return a;
}

std::int64_t squared_gap(const LatticeBox& a, const LatticeBox& b) {
  std::int64_t sum = 0;
  for (int i = 0; i < 3; ++i) {
    const std::int64_t gap = std::max({0, a.lower[i] - b.upper[i], b.lower[i] - a.upper[i]});
    sum += gap * gap;
  }
  return sum;
}

}  // namespace

std::int32_t BoxTree::allocate() {
  if (free_.empty()) {
    node_.emplace_back();
    return static_cast<std::int32_t>(node_.size() - 1);
  }
  const std::int32_t n = free_.back();
  free_.pop_back();
  return n;
}

void BoxTree::refit(std::int32_t n) {
  for (; n >= 0; n = node_[n].parent) node_[n].box = joined(node_[node_[n].left].box, node_[node_[n].right].box);
}

void BoxTree::insert(std::uint32_t item, const LatticeBox& box) {
  const std::int32_t leaf = allocate();
  node_[leaf] = {box, -1, -1, -1, item};
  if (leaf_.size() <= item) leaf_.resize(item + 1, -1);
  leaf_[item] = leaf;
  if (root_ < 0) {
    root_ = leaf;
    return;
  }
  std::int32_t sibling = root_;  // descends where the surface area grows by the minimum
  while (node_[sibling].left >= 0) {
    const Node& node = node_[sibling];
    const double whole = half_area(joined(node.box, box));
    const double pushed = whole - half_area(node.box);
    double cost[2];
    const std::int32_t child[2] = {node.left, node.right};
    for (int c = 0; c < 2; ++c) {
      const Node& candidate = node_[child[c]];
      cost[c] = pushed + half_area(joined(candidate.box, box)) - (candidate.left >= 0 ? half_area(candidate.box) : 0);
    }
    if (whole < cost[0] && whole < cost[1]) break;
    sibling = child[cost[1] < cost[0] ? 1 : 0];
  }
  const std::int32_t parent = allocate(), above = node_[sibling].parent;
  node_[parent] = {box, above, sibling, leaf, 0};
  node_[sibling].parent = parent;
  node_[leaf].parent = parent;
  if (above < 0) {
    root_ = parent;
  } else {
    (node_[above].left == sibling ? node_[above].left : node_[above].right) = parent;
  }
  refit(parent);
}

void BoxTree::remove(std::uint32_t item) {
  const std::int32_t leaf = leaf_[item];
  leaf_[item] = -1;
  free_.push_back(leaf);
  const std::int32_t parent = node_[leaf].parent;
  if (parent < 0) {
    root_ = -1;
    return;
  }
  const std::int32_t sibling = node_[parent].left == leaf ? node_[parent].right : node_[parent].left;
  const std::int32_t above = node_[parent].parent;
  node_[sibling].parent = above;
  free_.push_back(parent);
  if (above < 0) {
    root_ = sibling;
  } else {
    (node_[above].left == parent ? node_[above].left : node_[above].right) = sibling;
    refit(above);
  }
}

void BoxTree::touching(const LatticeBox& box, std::vector<std::uint32_t>& items) const {
  items.clear();
  if (root_ < 0) return;
  std::vector<std::int32_t> stack{root_};
  while (!stack.empty()) {
    const Node& node = node_[stack.back()];
    stack.pop_back();
    if (!node.box.touches(box)) continue;
    if (node.left < 0) {
      items.push_back(node.item);
    } else {
      stack.push_back(node.left), stack.push_back(node.right);
    }
  }
  std::sort(items.begin(), items.end());
}

BoxTree::Neighbour BoxTree::nearest(std::uint32_t item) const {
  Neighbour best{INT64_MAX, kNone};
  const LatticeBox& box = node_[leaf_[item]].box;
  std::vector<std::pair<std::int64_t, std::int32_t>> stack{{0, root_}};
  while (!stack.empty()) {
    const auto [gap, n] = stack.back();
    stack.pop_back();
    if (gap > best.squared_distance) continue;
    const Node& node = node_[n];
    if (node.left < 0) {
      if (node.item == item) continue;
      if (gap < best.squared_distance || node.item < best.item) best = {gap, node.item};
      continue;
    }
    std::pair<std::int64_t, std::int32_t> near{squared_gap(box, node_[node.left].box), node.left};
    std::pair<std::int64_t, std::int32_t> far{squared_gap(box, node_[node.right].box), node.right};
    if (far.first < near.first) std::swap(near, far);
    stack.push_back(far), stack.push_back(near);
  }
  return best;
}

std::vector<std::uint32_t> scattered(std::size_t count) {
  std::vector<std::uint32_t> order(count);
  for (std::uint32_t i = 0; i < count; ++i) order[i] = i;
  std::uint64_t state = 1;
  for (std::size_t i = count; i > 1; --i) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    std::swap(order[i - 1], order[(state >> 33) % i]);
  }
  return order;
}

}  // namespace alula
