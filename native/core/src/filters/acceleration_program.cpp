#include "alula/filters/acceleration_program.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "alula/base/constants.hpp"

namespace alula::flight {
AccelerationRow normalised(const AccelerationRow& row) {
  const double largest = std::max({std::abs(row.row.x), std::abs(row.row.y), std::abs(row.row.z)});
  if (largest == 0 && row.bound <= 0) return {{}, -kInfinity};
  const Vec3 scaled = 1 / largest * row.row;
  const double length = geometry::norm(scaled), bound = row.bound / largest / length;
  if (geometry::is_finite(scaled) && std::isfinite(bound)) return {1 / length * scaled, bound};
  return {{}, bound == -kInfinity ? -kInfinity : kInfinity};
}

AccelerationProgram::AccelerationProgram(std::size_t rows, QpSolver solver) : solver_(std::move(solver)) {
  solver_.reserve(rows + 7);
  row_.reserve(rows + 7), bound_.reserve(rows + 7), item_.reserve(rows), dense_.reserve(4 * (rows + 7));
}

void AccelerationProgram::start(Vec3 nominal) {
  nominal_ = nominal;
  impossible_ = false;
  limit_ = kInfinity, weight_ = 0;
  row_.clear(), bound_.clear(), item_.clear();
}

void AccelerationProgram::add(const AccelerationRow& row, std::uint32_t item) {
  const AccelerationRow unit = normalised(row);
  if (std::isfinite(unit.bound)) {
    row_.push_back(unit.row), bound_.push_back(unit.bound), item_.push_back(item);
  } else {
    impossible_ = impossible_ || unit.bound > 0;
  }
}

void AccelerationProgram::limit(double each_axis) { limit_ = each_axis; }

void AccelerationProgram::add_soft(const AccelerationRow& row, double weight) {
  row_.push_back(row.row), bound_.push_back(row.bound);
  weight_ = weight;
}

bool AccelerationProgram::holds(Vec3 a, double tolerance, bool with_soft) const {
  if (impossible_ || !geometry::is_finite(a)) return false;
  const std::size_t count = with_soft ? row_.size() : item_.size();
  for (std::size_t i = 0; i < count; ++i)
    if (!(slack(i, a) >= -tolerance)) return false;
  for (int axis = 0; axis < 3; ++axis)
    if (!(std::abs(a[axis]) <= limit_ + tolerance)) return false;
  return true;
}

bool AccelerationProgram::accept(FilterReport& report, bool unsafe) const {
  if (!holds(nominal_, 0, true)) return false;
  report.acceleration = nominal_;
  report.status = unsafe ? SafetyStatus::recovering : SafetyStatus::ok;
  return true;
}

bool AccelerationProgram::solve(FilterReport& report, bool unsafe) {
  const bool is_soft = weight_ > 0;
  const std::size_t n = is_soft ? 4 : 3;
  dense_.clear();
  const std::size_t with_rows = bound_.size();
  for (std::size_t i = 0; i < with_rows; ++i) {
    for (int axis = 0; axis < 3; ++axis) dense_.push_back(row_[i][axis]);
    if (is_soft) dense_.push_back(i >= item_.size() ? 1 : 0);
  }
  if (limit_ < kInfinity) {
    for (std::size_t side = 0; side < 6; ++side) {
      for (std::size_t axis = 0; axis < n; ++axis) dense_.push_back(axis != side / 2 ? 0 : side % 2 == 0 ? 1 : -1);
      bound_.push_back(-limit_);
    }
  }
  std::array<double, 16> hessian{};
  for (std::size_t i = 0; i < n; ++i) hessian[(n + 1) * i] = i < 3 ? 1 : weight_;
  const std::array<double, 4> gradient{-nominal_.x, -nominal_.y, -nominal_.z, 0};
  const QpResult result = solver_.solve({n, {hessian.data(), n * n}, {gradient.data(), n}, dense_, bound_});
  bound_.resize(with_rows);
  report.iterations = static_cast<std::uint32_t>(std::max(0, result.iterations));
  const Vec3 a{result.x[0], result.x[1], result.x[2]};
  const double tolerance = solver_.has_backend() ? kBackendTolerance : kTolerance;
  if (result.status != QpStatus::optimal || !holds(a, tolerance * (1 + geometry::norm(a)), false)) {
    report.infeasible = true;
    return false;
  }
  report.acceleration = a;
  report.status = unsafe ? SafetyStatus::recovering : SafetyStatus::filtered;
  double largest = 0;
  for (std::size_t i = 0; i < result.active_count; ++i) {
    if (result.active[i] >= item_.size() || !(result.multiplier[i] > largest)) continue;
    largest = result.multiplier[i];
    report.active = item_[result.active[i]];
  }
  return true;
}

void AccelerationProgram::brake(FilterReport& report, Vec3 v, double rate, double limit) const {
  const double speed = geometry::norm(v);
  double braking_rate = rate;
  if (braking_rate * speed > limit) braking_rate = limit / speed;
  for (int axis = 0; axis < 3; ++axis)
    if (braking_rate * std::abs(v[axis]) > limit_) braking_rate = limit_ / std::abs(v[axis]);
  report.acceleration = -braking_rate * v;
  const bool good = holds(report.acceleration, kTolerance * (1 + braking_rate * speed), false);
  report.status = good ? SafetyStatus::filtered : SafetyStatus::recovering;
}

}  // namespace alula::flight
