#include "alula/geometry/ellipsoid_tree.hpp"

#include <cmath>
#include <limits>

namespace alula::geometry {
namespace {

constexpr float kBeyond = std::numeric_limits<float>::infinity();

float above(double x) {
  const auto f = static_cast<float>(x);
  return f >= x ? f : std::nextafter(f, kBeyond);
}
float below(double x) { return -above(-x); }

}  // namespace

EllipsoidTree::EllipsoidTree(const Bvh& binary, const std::vector<Ball>& balls, const std::vector<Shape>& shapes) {
  if (binary.nodes().empty()) return;
  nodes_.reserve(binary.nodes().size() / 4 + 2), leaves_.reserve(binary.nodes().size() / 2 + 1);
  forms_.reserve(binary.nodes().size() / 2 + 1);
  first_.reserve(binary.nodes().size() / 2 + 2);
  build(binary, 0, balls, shapes);
  first_.push_back(static_cast<std::uint32_t>(balls.size()));
}

// Builds the node of `at`; a leaf gets a node with that leaf alone.
std::uint32_t EllipsoidTree::build(const Bvh& binary, std::uint32_t at, const std::vector<Ball>& balls,
                                   const std::vector<Shape>& shapes) {
  const std::vector<Bvh::Node>& nodes = binary.nodes();
  std::array<std::uint32_t, 4> child;
  std::size_t count = 0;
  const auto is_leaf = [&](std::uint32_t i) { return nodes[i].count > 0; };
  if (is_leaf(at)) {
    child[count++] = at;
  } else {
    for (const std::uint32_t half : {at + 1, nodes[at].first}) {
      if (is_leaf(half)) {
        child[count++] = half;
      } else {
        child[count++] = half + 1, child[count++] = nodes[half].first;
      }
    }
  }
  const auto index = static_cast<std::uint32_t>(nodes_.size());
  Node node{};
  for (std::size_t i = 0; i < 4; ++i) {
    const bool is_there = i < count;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const int j = static_cast<int>(axis);
      node.lower[axis][i] = is_there ? below(nodes[child[i]].box.lower[j]) : kFar;
      node.upper[axis][i] = is_there ? above(nodes[child[i]].box.upper[j]) : kFar;
    }
    node.longest[i] = is_there ? shapes[child[i]].longest * 1.0001F : kFar;
    node.skew[i] = is_there ? shapes[child[i]].skew + 2e-5F : 1;
    node.child[i] = kNone;
  }
  nodes_.push_back(node);
  for (std::size_t i = 0; i < count; ++i) {
    std::uint32_t made = 0;
    const Bvh::Node& half = nodes[child[i]];
    if (is_leaf(child[i])) {
      made = kLeaf | static_cast<std::uint32_t>(leaves_.size());
      Leaf leaf{};
      Forms forms{};
      for (std::uint32_t k = 0; k < 8; ++k) {
        const bool is_there = k < half.count;
        const Ball ball = is_there ? balls[half.first + k] : Ball{{kFar, kFar, kFar}, 0, 0, {}, {}};
        // The rounding error of the centre is added to the radius.
        const auto x = static_cast<float>(ball.centre.x), y = static_cast<float>(ball.centre.y),
                   z = static_cast<float>(ball.centre.z);
        const Vec3 moved = Vec3{x, y, z} - ball.centre;
        leaf.x[k / 4][k % 4] = x, leaf.y[k / 4][k % 4] = y, leaf.z[k / 4][k % 4] = z;
        leaf.radius[k / 4][k % 4] = above((ball.radius + norm(moved)) * (1 + 0x1p-15));
        for (std::size_t j = 0; j < 6; ++j)
          forms.s[j][k / 4][k % 4] = ball.s[j], forms.a[j][k / 4][k % 4] = ball.a[j];
        forms.loss[k / 4][k % 4] = above(ball.loss);
      }
      forms_.push_back(forms), leaves_.push_back(leaf), first_.push_back(half.first);
    } else {
      made = build(binary, child[i], balls, shapes);
    }
    nodes_[index].child[i] = made;
  }
  return index;
}

}  // namespace alula::geometry
