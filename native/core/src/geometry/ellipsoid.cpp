#include "alula/geometry/ellipsoid.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <stdexcept>
#include <string>

namespace alula {

void check_splats(const Splats& splats, const Level& level, double voxel_size) {
  const std::size_t n = splats.size();
  if (splats.mean.size() != 3 * n || splats.scale.size() != 3 * n || splats.quat_wxyz.size() != 4 * n)
    throw std::invalid_argument("mean, scale and quat_wxyz do not have the same number of rows");
  if (!splats.loss.empty() && splats.loss.size() != 3 * n)
    throw std::invalid_argument("mean and loss do not have the same number of rows");
  if (n >= std::numeric_limits<std::uint32_t>::max())
    throw std::invalid_argument("more ellipsoids than 32 bits can count");
  const auto finite_positive = [](double v) { return std::isfinite(v) && v > 0; };
  if (!finite_positive(level.sigma)) throw std::invalid_argument("sigma is not a positive number");
  if (!std::isfinite(level.inflation) || level.inflation < 0)
    throw std::invalid_argument("inflation is not a number of at least 0");
  if (!finite_positive(voxel_size)) throw std::invalid_argument("voxel_size is not a positive number");
  for (std::size_t i = 0; i < n; ++i) {
    bool good = true;
    for (std::size_t a = 0; a < 3; ++a)
      good &= std::isfinite(splats.mean[3 * i + a]) && finite_positive(splats.scale[3 * i + a]);
    double norm = 0;
    for (std::size_t a = 0; a < 4; ++a) norm += double(splats.quat_wxyz[4 * i + a]) * splats.quat_wxyz[4 * i + a];
    if (!good || !finite_positive(norm))
      throw std::invalid_argument("row " + std::to_string(i) + " is not an ellipsoid");
  }
  for (std::size_t j = 0; j < splats.loss.size(); ++j)
    if (!std::isfinite(splats.loss[j]) || splats.loss[j] < 0)
      throw std::invalid_argument("the loss of row " + std::to_string(j / 3) + " is not a number of at least 0");
}

double Ellipsoid::extent(double g) const {
  return std::max({std::abs(centre[0]), std::abs(centre[1]), std::abs(centre[2])}) + reach + g;
}

double Ellipsoid::least_voxels(double g) const {
  const auto cross = [&](std::size_t a, std::size_t b) {
    return Triple{row[a][1] * row[b][2] - row[a][2] * row[b][1], row[a][2] * row[b][0] - row[a][0] * row[b][2],
                  row[a][0] * row[b][1] - row[a][1] * row[b][0]};
  };
  const Triple xy = cross(0, 1), yz = cross(1, 2), zx = cross(2, 0);
  const auto length = [](const Triple& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); };
  const double volume = std::abs(xy[0] * row[2][0] + xy[1] * row[2][1] + xy[2] * row[2][2]);
  const double area = std::max({length(xy), length(yz), length(zx)});
  return std::numbers::pi * std::max(4.0 / 3.0 * volume / (g * g * g), area / (g * g));
}

namespace {

// a + b - c - d of four exact squares, to one rounding: the rounding errors of the sums are added at the end.
double balance(double a, double b, double c, double d) {
  const auto lost = [](double x, double y, double sum) {
    const double other = sum - x;
    return (x - (sum - other)) + (y - other);
  };
  const double first = a - c, second = b - d, sum = first + second;
  return sum + (lost(a, -c, first) + lost(b, -d, second) + lost(first, second, sum));
}

}  // namespace

Level level_of(const Splats& splats, std::size_t i, const Level& level) {
  if (splats.loss.empty()) return level;
  const float* loss = &splats.loss[3 * i];
  const auto [shortest, longest] = std::minmax_element(&splats.scale[3 * i], &splats.scale[3 * i] + 3);
  constexpr double kUp = 1 + 4 * kEps;
  const double sigma = level.sigma * (1 + double(loss[1])) * kUp;
  const double turned = double(loss[2]) * sigma * (double(*longest) - double(*shortest));
  return {sigma, (level.inflation + loss[0] + turned) * kUp};
}

namespace {

// The set with the same centre and rotation and other semi-axes.
void shape(Ellipsoid& e, const Triple& axis) {
  const double floor = kEps * (axis[0] + axis[1] + axis[2]);
  for (std::size_t j = 0; j < 3; ++j) e.axis[j] = std::max(axis[j], floor);
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t j = 0; j < 3; ++j) e.row[a][j] = e.rotation[a][j] * e.axis[j];
    e.half[a] = std::sqrt(e.row[a][0] * e.row[a][0] + e.row[a][1] * e.row[a][1] + e.row[a][2] * e.row[a][2]);
  }
  e.reach = e.axis[0] + e.axis[1] + e.axis[2];
}

}  // namespace

Bounds bounds_of(const Splats& splats, std::size_t i, const Level& all) {
  const Level level = level_of(splats, i, all);
  Bounds bounds;
  Ellipsoid& e = bounds.first;
  Triple axis;
  for (std::size_t a = 0; a < 3; ++a) {
    e.centre[a] = splats.mean[3 * i + a];
    axis[a] = level.sigma * splats.scale[3 * i + a];
  }
  const float* q = &splats.quat_wxyz[4 * i];
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  const double ww = w * w, xx = x * x, yy = y * y, zz = z * z;
  const double inverse = 1 / (ww + xx + yy + zz), twice = 2 * inverse;
  e.rotation = {Triple{balance(ww, xx, yy, zz) * inverse, (x * y - w * z) * twice, (x * z + w * y) * twice},
                Triple{(x * y + w * z) * twice, balance(ww, yy, xx, zz) * inverse, (y * z - w * x) * twice},
                Triple{(x * z - w * y) * twice, (y * z + w * x) * twice, balance(ww, zz, xx, yy) * inverse}};
  shape(e, axis);
  bounds.half = e.half;
  bounds.inner = e.axis;
  const double r = level.inflation;
  if (r == 0) return bounds;

  for (double& h : bounds.half) h += r;
  const Sum sum = outer_sum(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2], r);
  Triple loose, tight;
  for (std::size_t j = 0; j < 3; ++j) {
    const double square = axis[j] * axis[j];
    bounds.inner[j] = axis[j] + r;
    loose[j] = std::sqrt(sum.scale * square + sum.add);
    tight[j] = std::sqrt(3 * square + 1.5 * r * r);
    bounds.excess = std::max(bounds.excess, loose[j] - bounds.inner[j]);
  }
  if (sum.add > 2 * r * r) shape(bounds.second.emplace(e), tight);
  shape(e, loose);
  return bounds;
}

double Bounds::least_voxels(double g) const {
  Ellipsoid within = first;
  shape(within, inner);
  return within.least_voxels(g);
}

namespace {

// The rotation of two columns that turns (a, b) into (length, 0).
struct Rotation {
  double c = 1, s = 0;
  Rotation(double a, double b) {
    const double length = std::sqrt(a * a + b * b);
    if (length > 0) c = a / length, s = b / length;
  }
  void operator()(double& a, double& b) const {
    const double kept = c * a + s * b;
    b = c * b - s * a;
    a = kept;
  }
};

}  // namespace

Factor lower_factor(const Triple& first, const Triple& second, const Triple& third, double floor) {
  Triple p = first, q = second, r = third;
  for (const std::size_t j : {1u, 2u}) {
    const Rotation turn(p[0], p[j]);
    turn(p[0], p[j]);
    turn(q[0], q[j]);
    turn(r[0], r[j]);
  }
  const Rotation turn(q[1], q[2]);
  turn(q[1], q[2]);
  turn(r[1], r[2]);
  return {std::max(p[0], floor), q[0], std::max(q[1], floor), r[0], r[1], std::max(std::abs(r[2]), floor)};
}

}  // namespace alula
