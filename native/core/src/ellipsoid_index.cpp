#include "alula/ellipsoid_index.hpp"

#include <cmath>
#include <stdexcept>

#include "alula/parallel.hpp"

namespace alula {
namespace {

using geometry::Box;
using geometry::Mat3;

constexpr std::size_t kChunk = 4096;

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
      const Ellipsoid outer = bounds_of(splats, i, {sigma, radius}).first;
      grown_[i] = {{outer.centre[0], outer.centre[1], outer.centre[2]}, shape_matrix(outer)};
      const Level level = level_of(splats, i, all);
      boxes[i] = geometry::bounds(geometry::gaussian_ellipsoid(&splats.mean[3 * i], &splats.scale[3 * i],
                                                               &splats.quat_wxyz[4 * i], level.sigma));
      const geometry::Vec3 ball{level.inflation, level.inflation, level.inflation};
      boxes[i].lower = boxes[i].lower - ball, boxes[i].upper = boxes[i].upper + ball;
      const geometry::Vec3 size = boxes[i].upper - boxes[i].lower;
      depth[i] = 0.5 * (1 + 1e-12) * std::min({size.x, size.y, size.z});  // nothing is deeper inside
    }
  });
  tree_ = geometry::Bvh(boxes, depth);
  if (splats.loss.empty()) {
    level_ = {all};
  } else {
    level_.resize(n);
  }
  const std::vector<std::uint32_t>& order = tree_.order();
  for (std::uint32_t slot = 0; slot < n; ++slot) {
    const std::size_t i = order[slot];
    slot_[i] = slot;
    std::copy_n(&splats.mean[3 * i], 3, row_[slot].mean);
    std::copy_n(&splats.scale[3 * i], 3, row_[slot].scale);
    std::copy_n(&splats.quat_wxyz[4 * i], 4, row_[slot].quat_wxyz);
    if (!splats.loss.empty()) level_[slot] = level_of(splats, i, all);
  }
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
