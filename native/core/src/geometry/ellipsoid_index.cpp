#include "alula/geometry/ellipsoid_index.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "alula/base/parallel.hpp"

namespace alula {
namespace {

using geometry::Box;
using geometry::cross;
using geometry::dot;
using geometry::Mat3;
using geometry::norm;
using Shape = geometry::EllipsoidTree::Shape;

constexpr std::size_t kEllipsoids = 4096;
constexpr std::size_t kTogether = 4;  // ellipsoids that are measured at once

// A = R diag(1 / a_j^2) R^T, symmetric to the bit and slightly smaller, so rounding leaves no point of the Minkowski
// sum outside.
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

std::array<float, 6> upper_half(const Mat3& m) {
  const auto f = [&](int row, int column) { return static_cast<float>(m[row][column]); };
  return {f(0, 0), f(0, 1), f(0, 2), f(1, 1), f(1, 2), f(2, 2)};
}

// The slots found by the last query, up to a fixed capacity.
class Guesses {
 public:
  Guesses(const std::vector<Found>& found, const std::vector<std::uint32_t>& slot) {
    table_.fill(kNone);
    for (const Found& f : found) {
      if (size_ == slots_.size()) return;
      if (f.item >= slot.size()) continue;
      std::uint32_t& place = place_of(slot[f.item]);
      if (place == kNone) place = slots_[size_++] = slot[f.item];
    }
  }
  std::span<const std::uint32_t> slots() const { return {slots_.data(), size_}; }
  bool has(std::uint32_t slot) { return place_of(slot) == slot; }

 private:
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::uint32_t& place_of(std::uint32_t slot) {  // its entry, or the free entry for it
    std::size_t at = slot % table_.size();
    while (table_[at] != kNone && table_[at] != slot) at = (at + 1) % table_.size();
    return table_[at];
  }

  std::array<std::uint32_t, 128> slots_;
  std::array<std::uint32_t, 512> table_;
  std::size_t size_ = 0;
};

}  // namespace

EllipsoidIndex::EllipsoidIndex(const Splats& splats, double sigma, double radius) : radius_(radius) {
  if (!(radius > 0)) throw std::invalid_argument("the radius is not a positive number");
  check_splats(splats, {sigma, radius}, 1);
  const std::size_t n = splats.size();
  const Level all{sigma, 0};
  grown_.resize(n), slot_.resize(n), row_.resize(n);
  std::vector<Box> boxes(n);
  Control control;
  parallel_chunks(n, kEllipsoids, 0, control, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      const Level level = level_of(splats, i, all);
      boxes[i] = geometry::bounds(geometry::gaussian_ellipsoid(&splats.mean[3 * i], &splats.scale[3 * i],
                                                               &splats.quat_wxyz[4 * i], level.sigma));
      const geometry::Vec3 ball{level.inflation, level.inflation, level.inflation};
      boxes[i].lower = boxes[i].lower - ball, boxes[i].upper = boxes[i].upper + ball;
    }
  });
  halves_ = geometry::Bvh(
      static_cast<std::uint32_t>(n), [&](std::uint32_t i) { return boxes[i]; }, [](const Box&) { return 0.0; }, 8);
  if (splats.loss.empty()) {
    level_ = {all};
  } else {
    level_.resize(n);
  }
  item_ = halves_.order();
  std::vector<Shape> shape(n);
  std::vector<geometry::EllipsoidTree::Ball> ball(n);
  parallel_chunks(n, kEllipsoids, 0, control, [&](std::size_t first, std::size_t last) {
    for (std::size_t slot = first; slot < last; ++slot) {
      const std::size_t i = item_[slot];
      slot_[i] = static_cast<std::uint32_t>(slot);
      std::copy_n(&splats.mean[3 * i], 3, row_[slot].mean);
      std::copy_n(&splats.scale[3 * i], 3, row_[slot].scale);
      std::copy_n(&splats.quat_wxyz[4 * i], 4, row_[slot].quat_wxyz);
      if (!splats.loss.empty()) level_[slot] = level_of(splats, i, all);
      const float* scale = row_[slot].scale;
      const Level level = this->level(static_cast<std::uint32_t>(slot));
      const Ellipsoid outer = bounds_of(splats, i, {sigma, radius}).first;
      grown_[slot] = {{outer.centre[0], outer.centre[1], outer.centre[2]}, shape_matrix(outer)};
      const geometry::Ellipsoid inner = at_slot(static_cast<std::uint32_t>(slot));
      Mat3 spread;
      for (int j = 0; j < 3; ++j)
        spread = spread + geometry::outer(inner.semi[j] * inner.axis[j], inner.semi[j] * inner.axis[j]);
      ball[slot] = {{splats.mean[3 * i], splats.mean[3 * i + 1], splats.mean[3 * i + 2]},
                    level.sigma * std::max({scale[0], scale[1], scale[2]}) + level.inflation,
                    level.inflation,
                    upper_half(spread),
                    upper_half(grown_[slot].a)};
      // With k, the ratio of the extreme eigenvalues of A, the angle between x and A x is at most asin((k - 1)/(k +
      // 1)).
      const auto [shortest, longest] = std::minmax_element(outer.axis.begin(), outer.axis.end());
      const double ratio = (*longest / *shortest) * (*longest / *shortest);
      shape[slot] = {static_cast<float>(*longest * 1.00001), static_cast<float>((ratio - 1) / (ratio + 1) + 1e-5),
                     static_cast<float>(level.inflation * 1.00001)};
    }
  });
  shape_ = halves_.summary<Shape>([&](std::uint32_t slot) { return shape[slot]; },
                                  [](const Shape& a, const Shape& b) {
                                    return Shape{std::max(a.longest, b.longest), std::max(a.skew, b.skew),
                                                 std::max(a.ball, b.ball)};
                                  });
  tree_ = geometry::EllipsoidTree(halves_, ball, shape_);
}

template <class Accept>
QueryCost EllipsoidIndex::search(const geometry::EllipsoidTree::Sight& sight, std::size_t count,
                                 std::vector<Found>& found, Accept&& accept) const {
  const double reach = sight.around;
  const geometry::Vec3 a = sight.a, d = sight.d;
  Guesses guesses(found, slot_);
  found.clear();
  QueryCost cost;
  if (count == 0 || !(reach > -kInfinity)) return cost;
  const bool is_point = d.x == 0 && d.y == 0 && d.z == 0;
  double within = reach;  // bound on the distance of the results
  const auto judge = [&](std::uint32_t slot, double distance) {
    if (distance > within) return;
    if (!is_point && (distance <= 0 || !centre_is_nearer(slot, a, reach))) {
      const double of_a = distance_of(slot, a, reach);
      if (!(of_a < reach)) return;
      if (distance <= 0) distance = of_a - reach;  // sorts before all others, ordered by the distance to a
    }
    const std::uint32_t item = item_[slot];
    const bool is_full = found.size() == count;
    if (!(distance < reach) || (is_full && !nearer_found({item, distance}, found.front()))) return;
    if (is_full) {
      std::pop_heap(found.begin(), found.end(), nearer_found);
      found.back() = {item, distance};
      std::push_heap(found.begin(), found.end(), nearer_found);
    } else {
      found.push_back({item, distance});
      if (found.size() < count) return;
      std::make_heap(found.begin(), found.end(), nearer_found);
    }
    within = is_point ? found.front().distance : std::max(0.0, found.front().distance);
  };
  // Candidates are measured several at a time, after a short wait.
  std::array<std::uint32_t, kTogether> waiting;
  std::size_t waits = 0;
  const auto measure = [&] {
    std::array<geometry::Sighted, kTogether> each;
    std::array<double, kTogether> distance;
    for (std::size_t i = 0; i < waits; ++i) each[i] = sighted(waiting[i], a, d, within + level(waiting[i]).inflation);
    geometry::distances_below({each.data(), waits}, {distance.data(), waits});
    for (std::size_t i = 0; i < waits; ++i) judge(waiting[i], distance[i] - level(waiting[i]).inflation);
    waits = 0;
  };
  const auto look_at = [&](std::uint32_t slot) {
    if (!accept(grown_[slot])) return;
    waiting[waits++] = slot;
    if (waits == kTogether) measure();
  };
  for (const std::uint32_t slot : guesses.slots()) look_at(slot);
  if (waits > 0) measure();
  const auto seen = tree_.visit(sight, within, [&](std::uint32_t slot) {
    if (!guesses.has(slot)) look_at(slot);
  });
  if (waits > 0) measure();
  cost.nodes = seen.nodes, cost.items = seen.items;
  std::sort(found.begin(), found.end(), nearer_found);
  if (!is_point)
    for (Found& f : found) f.distance = std::max(0.0, f.distance);
  return cost;
}

QueryCost EllipsoidIndex::nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                                  std::vector<Found>& found) const {
  return search({a, b - a, reach}, count, found, [](const GrownEllipsoid&) { return true; });
}

QueryCost EllipsoidIndex::nearest_ahead(geometry::Vec3 a, geometry::Vec3 b, geometry::Vec3 v, double reach,
                                        std::size_t count, std::vector<Found>& found) const {
  return search({a, b - a, reach, true, v}, count, found, [&](const GrownEllipsoid& e) {
    const geometry::Vec3 r = e.centre - a, ar = e.a * r;
    return dot(ar, v) >= 0 || dot(ar, r) < 1;
  });
}

geometry::Ellipsoid EllipsoidIndex::at_slot(std::uint32_t slot) const {
  const Row& row = row_[slot];
  return geometry::gaussian_ellipsoid(row.mean, row.scale, row.quat_wxyz, level(slot).sigma);
}

GrownEllipsoid EllipsoidIndex::grown(std::uint32_t item, double more_m) const {
  const geometry::Ellipsoid e = ellipsoid(item);
  const geometry::Vec3 s = e.semi;
  const Sum sum = outer_sum(s.x * s.x + s.y * s.y + s.z * s.z, radius_ + more_m + ball(item));
  GrownEllipsoid grown{e.centre, {}};
  for (int j = 0; j < 3; ++j) {
    const geometry::Vec3 axis = e.axis[j];
    grown.a = grown.a + (1 - 64 * kEps) / (sum.scale * s[j] * s[j] + sum.add) * geometry::outer(axis, axis);
  }
  return grown;
}

geometry::Sighted EllipsoidIndex::sighted(std::uint32_t slot, geometry::Vec3 a, geometry::Vec3 d,
                                          double enough) const {
  const Row& row = row_[slot];
  const double sigma = level(slot).sigma;
  const geometry::Vec3 to{row.mean[0] - a.x, row.mean[1] - a.y, row.mean[2] - a.z};
  // R^T x = x + 2 / |q|^2 (u x (u x x) - w u x x), with q = (w, u).
  const geometry::Vec3 u{row.quat_wxyz[1], row.quat_wxyz[2], row.quat_wxyz[3]};
  const double w = row.quat_wxyz[0], twice = 2 / (w * w + dot(u, u));
  const auto along_axes = [&](geometry::Vec3 x) {
    const geometry::Vec3 turn = geometry::cross(u, x);
    return x + twice * (geometry::cross(u, turn) - w * turn);
  };
  return {{sigma * row.scale[0], sigma * row.scale[1], sigma * row.scale[2]}, along_axes(-to), along_axes(d), enough};
}

double EllipsoidIndex::distance_of(std::uint32_t slot, geometry::Vec3 a, double enough) const {
  const double ball = level(slot).inflation;
  const geometry::Sighted e = sighted(slot, a, {}, enough + ball);
  return geometry::distance_below(e.semi, e.start, e.enough) - ball;
}

bool EllipsoidIndex::is_near(geometry::Vec3 a, geometry::Vec3 b, double reach) const {
  double within = reach;  // ends the search once one is found
  std::array<geometry::Sighted, kTogether> each;
  std::array<std::uint32_t, kTogether> of;
  std::array<double, kTogether> distance;
  std::size_t waits = 0;
  const auto measure = [&] {
    geometry::distances_below({each.data(), waits}, {distance.data(), waits});
    for (std::size_t i = 0; i < waits; ++i)
      if (distance[i] - level(of[i]).inflation < reach) within = -kInfinity;
    waits = 0;
  };
  const auto look_at = [&](std::uint32_t slot) {
    of[waits] = slot, each[waits++] = sighted(slot, a, b - a, reach + level(slot).inflation);
    if (waits == kTogether) measure();
  };
  tree_.visit({a, b - a, kInfinity}, within, look_at);
  if (waits > 0) measure();
  return within < reach;
}

double EllipsoidIndex::clearance(geometry::Vec3 point, double cap, std::uint32_t& hint) const {
  double best = cap;
  const auto judge = [&](std::uint32_t slot, double distance) {
    if (distance < best) best = distance, hint = item_[slot];
  };
  if (hint < size()) judge(slot_[hint], distance_of(slot_[hint], point, best));
  std::array<std::uint32_t, kTogether> waiting;
  std::size_t waits = 0;
  const auto measure = [&] {
    std::array<geometry::Sighted, kTogether> each;
    std::array<double, kTogether> distance;
    for (std::size_t i = 0; i < waits; ++i)
      each[i] = sighted(waiting[i], point, {}, best + level(waiting[i]).inflation);
    geometry::distances_below({each.data(), waits}, {distance.data(), waits});
    for (std::size_t i = 0; i < waits; ++i) judge(waiting[i], distance[i] - level(waiting[i]).inflation);
    waits = 0;
  };
  tree_.visit({point, {}, kInfinity}, best, [&](std::uint32_t slot) {
    waiting[waits++] = slot;
    if (waits == kTogether) measure();
  });
  if (waits > 0) measure();
  return best;
}

double least_gamma(const EllipsoidIndex& index, std::span<const double> points) {
  constexpr std::size_t kPoints = 64;
  const auto point = [&](std::size_t i) {
    return geometry::Vec3{points[3 * i], points[3 * i + 1], points[3 * i + 2]};
  };
  const std::size_t count = points.size() / 3;
  std::vector<double> axis(index.size());  // bound on the longest semi-axis: its square is below tr A^-1
  for (std::size_t k = 0; k < axis.size(); ++k) {
    const Mat3& a = index.grown(static_cast<std::uint32_t>(k)).a;
    const geometry::Vec3 x = a.row(0), y = a.row(1), z = a.row(2);
    const geometry::Vec3 minors{dot(cross(y, z), {1, 0, 0}), dot(cross(z, x), {0, 1, 0}),
                                dot(cross(x, y), {0, 0, 1})};
    axis[k] = std::sqrt((minors.x + minors.y + minors.z) / dot(x, cross(y, z))) * (1 + 1e-6);
  }
  double smallest = std::numeric_limits<double>::infinity();  // of r^T A r
  for (std::size_t begin = 0; begin < count; begin += kPoints) {
    const std::size_t end = std::min(count, begin + kPoints);
    const geometry::Vec3 middle = point((begin + end) / 2);
    double around = 0;
    for (std::size_t i = begin; i < end; ++i) around = std::max(around, norm(point(i) - middle));
    for (std::size_t k = 0; k < axis.size(); ++k) {
      const GrownEllipsoid& item = index.grown(static_cast<std::uint32_t>(k));
      const double away = norm(item.centre - middle) - around;  // r^T A r >= (|r| / longest semi-axis)^2
      if (away > 0 && away * away >= smallest * axis[k] * axis[k]) continue;
      for (std::size_t i = begin; i < end; ++i) {
        const geometry::Vec3 r = item.centre - point(i);
        smallest = std::min(smallest, dot(r, item.a * r));
      }
    }
  }
  return smallest - 1;
}

}  // namespace alula
