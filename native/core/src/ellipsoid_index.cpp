#include "alula/ellipsoid_index.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/parallel.hpp"

namespace alula {
namespace {

using geometry::Box;
using geometry::Mat3;

constexpr std::size_t kChunk = 4096;

bool nearer(const Found& a, const Found& b) {
  return a.distance != b.distance ? a.distance < b.distance : a.item < b.item;
}

// A = R diag(1 / a_j^2) R^T, both halves the same bits; a little smaller than that, so that rounding leaves no
// point of the sum outside.
Mat3 shape_matrix(const Ellipsoid& e) {
  Mat3 a;
  double weight[3];
  for (std::size_t j = 0; j < 3; ++j) weight[j] = (1 - 64 * kEps) / (e.axis[j] * e.axis[j]);
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t column = 0; column <= row; ++column) {
      double sum = 0;
      for (std::size_t j = 0; j < 3; ++j) sum += e.rotation[row][j] * e.rotation[column][j] * weight[j];
      a.m[row][column] = a.m[column][row] = sum;
    }
  }
  return a;
}

}  // namespace

EllipsoidIndex::EllipsoidIndex(const Splats& splats, double sigma, double radius) : radius_(radius) {
  if (!(radius > 0)) throw std::invalid_argument("the radius is not a positive number");
  check_splats(splats, {sigma, radius}, 1);
  const std::size_t n = splats.size();
  const Level all{sigma, 0};
  grown_.resize(n), slot_.resize(n), row_.resize(n);
  std::vector<Box> boxes(n);
  std::vector<double> depth(n);
  Control control;
  parallel_chunks(n, kChunk, 0, control, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      const Level level = level_of(splats, i, all);
      boxes[i] = geometry::bounds(geometry::gaussian_ellipsoid(&splats.mean[3 * i], &splats.scale[3 * i],
                                                               &splats.quat_wxyz[4 * i], level.sigma));
      const geometry::Vec3 ball{level.inflation, level.inflation, level.inflation};
      boxes[i].lower = boxes[i].lower - ball, boxes[i].upper = boxes[i].upper + ball;
      const geometry::Vec3 size = boxes[i].upper - boxes[i].lower;
      depth[i] = 0.5 * (1 + 1e-12) * std::min({size.x, size.y, size.z});  // nothing is deeper inside
    }
  });
  tree_ = geometry::Bvh(boxes, depth, 8);
  if (splats.loss.empty()) {
    level_ = {all};
  } else {
    level_.resize(n);
  }
  const std::vector<std::uint32_t>& order = tree_.order();
  std::vector<Shape> shape(n);
  parallel_chunks(n, kChunk, 0, control, [&](std::size_t first, std::size_t last) {
    for (std::size_t slot = first; slot < last; ++slot) {
      const std::size_t i = order[slot];
      slot_[i] = static_cast<std::uint32_t>(slot);
      std::copy_n(&splats.mean[3 * i], 3, row_[slot].mean);
      std::copy_n(&splats.scale[3 * i], 3, row_[slot].scale);
      std::copy_n(&splats.quat_wxyz[4 * i], 4, row_[slot].quat_wxyz);
      if (!splats.loss.empty()) level_[slot] = level_of(splats, i, all);
      const Ellipsoid outer = bounds_of(splats, i, {sigma, radius}).first;
      grown_[slot] = {{outer.centre[0], outer.centre[1], outer.centre[2]}, shape_matrix(outer)};
      // With the ratio k of the extreme eigenvalues of A the angle between x and A x is at most asin((k - 1)/(k +
      // 1)).
      const auto [least, most] = std::minmax_element(outer.axis.begin(), outer.axis.end());
      const double ratio = (*most / *least) * (*most / *least);
      shape[slot] = {static_cast<float>(*most * 1.00001), static_cast<float>((ratio - 1) / (ratio + 1) + 1e-5),
                     static_cast<float>(level(static_cast<std::uint32_t>(slot)).inflation * 1.00001)};
    }
  });
  shape_ = tree_.summary<Shape>([&](std::uint32_t slot) { return shape[slot]; },
                                [](const Shape& a, const Shape& b) {
                                  return Shape{std::max(a.longest, b.longest), std::max(a.skew, b.skew),
                                               std::max(a.ball, b.ball)};
                                });
}

template <class Accept, class Skip>
QueryCost EllipsoidIndex::search(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                                 std::vector<Found>& found, Accept&& accept, Skip&& skip) const {
  found.clear();
  QueryCost cost;
  if (count == 0 || !(reach > -kInfinity)) return cost;
  const geometry::Vec3 d = b - a;
  const bool is_point = d.x == 0 && d.y == 0 && d.z == 0;
  double within = reach;  // what is farther than that cannot be among them
  const auto visit = [&](std::uint32_t slot, std::uint32_t item) {
    ++cost.items;
    if (!accept(grown_[slot])) return;
    double of_a = -kInfinity;  // it is nearer than the reach, for all we need to know
    if (!is_point && !centre_is_nearer(slot, a, reach) && !((of_a = distance_of(slot, a, {}, reach)) < reach)) return;
    double distance = distance_of(slot, a, d, within);
    if (distance > within) return;
    if (!is_point && distance <= 0)  // before all others, and still in order
      distance = (of_a > -kInfinity ? of_a : distance_of(slot, a, {}, reach)) - reach;
    const bool is_full = found.size() == count;
    if (!(distance < reach) || (is_full && !nearer({item, distance}, found.front()))) return;
    if (is_full) {
      std::pop_heap(found.begin(), found.end(), nearer);
      found.back() = {item, distance};
      std::push_heap(found.begin(), found.end(), nearer);
    } else {
      found.push_back({item, distance});
      if (found.size() < count) return;
      std::make_heap(found.begin(), found.end(), nearer);
    }
    within = is_point ? found.front().distance : std::max(0.0, found.front().distance);
  };
  const Box start{a, a};
  cost.nodes = tree_.visit_in_order(a, d, within, visit, [&](std::uint32_t node, const Box& box) {
    if (!is_point && reach > 0 && squared_distance(box, start) > reach * reach * (1 + 1e-12)) return true;
    return skip(node, box);
  });
  std::sort(found.begin(), found.end(), nearer);
  if (!is_point)
    for (Found& f : found) f.distance = std::max(0.0, f.distance);
  return cost;
}

QueryCost EllipsoidIndex::nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                                  std::vector<Found>& found) const {
  return search(
      a, b, reach, count, found, [](const GrownEllipsoid&) { return true; },
      [](std::uint32_t, const Box&) { return false; });
}

QueryCost EllipsoidIndex::nearest_ahead(geometry::Vec3 a, geometry::Vec3 b, geometry::Vec3 v, double reach,
                                        std::size_t count, std::vector<Found>& found) const {
  const double speed = norm(v);
  const auto accept = [&](const GrownEllipsoid& e) {
    const geometry::Vec3 r = e.centre - a, ar = e.a * r;
    return dot(ar, v) >= 0 || dot(ar, r) < 1;
  };
  // All centres of the box are farther than any semi-axis, so none is around a; and so far behind that A x, which
  // is within the skew's angle of x, points backward for all of them.
  const auto skip = [&](std::uint32_t node, const Box& box) {
    double near2 = 0, far2 = 0, ahead = 0;
    for (int i = 0; i < 3; ++i) {
      const double low = box.lower[i] - a[i], high = box.upper[i] - a[i];
      const double gap = std::max(0.0, std::max(low, -high)), far = std::max(high, -low);
      near2 += gap * gap, far2 += far * far;
      ahead += std::max(low * v[i], high * v[i]);
    }
    const Shape& shape = shape_[node];
    return ahead < 0 && near2 > double(shape.longest) * shape.longest &&
           ahead * ahead > double(shape.skew) * shape.skew * far2 * speed * speed;
  };
  return search(a, b, reach, count, found, accept, skip);
}

geometry::Ellipsoid EllipsoidIndex::at_slot(std::uint32_t slot) const {
  const Row& row = row_[slot];
  return geometry::gaussian_ellipsoid(row.mean, row.scale, row.quat_wxyz, level(slot).sigma);
}

double EllipsoidIndex::distance_of(std::uint32_t slot, geometry::Vec3 a, geometry::Vec3 d, double enough) const {
  const Row& row = row_[slot];
  const Level level = this->level(slot);
  // A ball around it is enough to discard most.
  const double most = level.sigma * std::max({row.scale[0], row.scale[1], row.scale[2]}) + level.inflation + enough;
  const geometry::Vec3 to{row.mean[0] - a.x, row.mean[1] - a.y, row.mean[2] - a.z};
  const double along = dot(to, d), length2 = dot(d, d);
  const double t = along <= 0 ? 0 : along >= length2 ? 1 : along / length2;
  const geometry::Vec3 gap = to - t * d;
  if (most > 0 && dot(gap, gap) > most * most * (1 + 1e-12)) return kInfinity;
  // R^T x = x + 2 / |q|^2 (u x (u x x) - w u x x), with q = (w, u).
  const geometry::Vec3 u{row.quat_wxyz[1], row.quat_wxyz[2], row.quat_wxyz[3]};
  const double w = row.quat_wxyz[0], twice = 2 / (w * w + dot(u, u));
  const auto along_axes = [&](geometry::Vec3 x) {
    const geometry::Vec3 turn = geometry::cross(u, x);
    return x + twice * (geometry::cross(u, turn) - w * turn);
  };
  const geometry::Vec3 semi{level.sigma * row.scale[0], level.sigma * row.scale[1], level.sigma * row.scale[2]};
  const geometry::Vec3 start = along_axes(-to);
  const double limit = enough + level.inflation;
  return (length2 > 0 ? geometry::distance_below(semi, start, along_axes(d), limit)
                      : geometry::distance_below(semi, start, limit)) -
         level.inflation;
}

double EllipsoidIndex::clearance(geometry::Vec3 point, double cap, std::uint32_t& hint) const {
  double best = cap;
  const auto try_one = [&](std::uint32_t slot, std::uint32_t item) {
    const double distance = distance_of(slot, point, {}, best);
    if (distance < best) best = distance, hint = item;
  };
  if (hint < size()) try_one(slot_[hint], hint);
  tree_.visit_near(point, {}, best, try_one);
  return best;
}

}  // namespace alula
