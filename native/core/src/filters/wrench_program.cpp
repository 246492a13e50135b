#include "alula/filters/wrench_program.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

using geometry::dot;

constexpr double kAligned = 0.999;          // minimum cosine of the angle between r and v in the metric of A
constexpr double kExactTolerance = 1e-9;    // of scaled rows, for the result of the exact solver
constexpr double kBackendTolerance = 1e-6;  // the same for a backend's solution, which comes without a guarantee

double dot4(const double* a, const Vec4& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]; }

}  // namespace

WrenchProgram::WrenchProgram(const Quadrotor& vehicle, std::size_t rows, QpSolver solver)
    : vehicle_(vehicle), solver_(std::move(solver)) {
  solver_.reserve(rows + 16);
  for (std::size_t j = 0; j < 4; ++j)
    for (std::size_t i = 0; i < 4; ++i)
      wrench_range_[j] +=
          std::abs(vehicle.allocation()[j][i]) * (vehicle.rotors().f_max[i] - vehicle.rotors().f_min[i]);
  row_.reserve(4 * (rows + 16)), bound_.reserve(rows + 16), dense_.reserve(5 * (rows + 16)), item_.reserve(rows + 16);
}

void WrenchProgram::start(const Vec4& nominal, double thrust_at_zero, double per_unit, double range) {
  nominal_ = nominal, zero_ = thrust_at_zero, unit_ = per_unit;
  range_ = wrench_range_;
  if (range > 0) range_[0] = range;
  weight_ = 0, barriers_ = 0, impossible_ = false;
  row_.clear(), bound_.clear(), item_.clear();
  const Mat4& inverse = vehicle_.inverse_allocation();
  for (std::size_t i = 0; i < 4; ++i) {
    const Vec4& g = inverse[i];
    const Vec4 row{g[0] * unit_, g[1], g[2], g[3]};
    add_limit({row, vehicle_.rotors().f_min[i] - g[0] * zero_});
    add_limit({{-row[0], -row[1], -row[2], -row[3]}, g[0] * zero_ - vehicle_.rotors().f_max[i]});
  }
}

void WrenchProgram::push(const Vec4& row, double bound, double soft) {
  Vec4 scaled;
  double largest = 0;
  for (std::size_t j = 0; j < 4; ++j)
    scaled[j] = row[j] * range_[j], largest = std::max(largest, std::abs(scaled[j]));
  if (scaled == Vec4{} && bound <= 0) return;  // false for NaN
  double square = 0;
  for (double& value : scaled) value /= largest, square += value * value;
  const double length = std::sqrt(square);
  bound = bound / largest / length;
  if (!std::isfinite(bound) || !std::isfinite(length) || largest == 0) {
    impossible_ = impossible_ || bound != -kInfinity;
    return;
  }
  for (const double value : scaled) row_.push_back(value / length);
  bound_.push_back(bound);
  if (soft > 0) weight_ = soft * largest * length * largest * length;  // of the slack in scaled units
}

void WrenchProgram::add(const WrenchRow& row, std::uint32_t item) {
  push(row.row, row.bound, 0);
  if (bound_.size() > item_.size()) item_.push_back(item), ++barriers_;
}

void WrenchProgram::add_limit(const WrenchRow& row) {
  push(row.row, row.bound, 0);
  if (bound_.size() > item_.size()) item_.push_back(-1);
}

void WrenchProgram::track(const TrackingRow& tracking, const Nominal& nominal, Vec3 axis, double gravity) {
  if (!(tracking.weight > 0)) return;
  const Vec3 ep = nominal.position_error, ev = nominal.velocity_error;
  const double p12 = 1 / (2 * tracking.kp), p22 = (1 + 2 * p12) / (2 * tracking.kv);
  const double p11 = tracking.kv * p12 + tracking.kp * p22;
  const Vec3 y = p12 * ep + p22 * ev;
  const double v = 0.5 * (p11 * dot(ep, ep) + 2 * p12 * dot(ep, ev) + p22 * dot(ev, ev));
  const double per_thrust = dot(y, axis) / vehicle_.mass();
  const double held =
      -gravity * y.z - dot(y, nominal.reference_acceleration) + dot(ev, p11 * ep + p12 * ev) + tracking.rate * v;
  if (per_thrust == 0) return;
  push({-per_thrust * unit_, 0, 0, 0}, held + per_thrust * zero_, tracking.weight);
}

double WrenchProgram::slack(std::size_t i, const Vec4& u) const {
  const Vec4 scaled{u[0] / range_[0], u[1] / range_[1], u[2] / range_[2], u[3] / range_[3]};
  return dot4(&row_[4 * i], scaled) - bound_[i];
}

bool WrenchProgram::holds(const Vec4& u, double tolerance) const {
  if (impossible_) return false;
  for (std::size_t i = 0; i < item_.size(); ++i)
    if (!(slack(i, u) >= -tolerance)) return false;
  return true;
}

bool WrenchProgram::clears(const Vec4& u) const {
  for (std::size_t i = 0; i < item_.size(); ++i)
    if (item_[i] >= 0 && !(slack(i, u) >= 0)) return false;
  return true;
}

bool WrenchProgram::tracks(const Vec4& u) const {
  for (std::size_t i = item_.size(); i < bound_.size(); ++i)
    if (!(slack(i, u) >= 0)) return false;
  return true;
}

bool WrenchProgram::solve(const Vec4& target, Vec4& u, FilterReport& report) {
  const bool is_soft = bound_.size() > item_.size();
  const std::size_t n = is_soft ? 5 : 4;
  std::span<const double> rows = row_;
  if (is_soft) {
    dense_.clear();
    for (std::size_t i = 0; i < bound_.size(); ++i) {
      dense_.insert(dense_.end(), row_.begin() + static_cast<std::ptrdiff_t>(4 * i),
                    row_.begin() + static_cast<std::ptrdiff_t>(4 * i + 4));
      dense_.push_back(i >= item_.size() ? 1 : 0);
    }
    rows = dense_;
  }
  std::array<double, 25> hessian{};
  std::array<double, 5> gradient{};
  for (std::size_t j = 0; j < 4; ++j) hessian[(n + 1) * j] = 1, gradient[j] = -target[j] / range_[j];
  if (is_soft) hessian[24] = weight_;
  QpResult result;
  if (!impossible_) result = solver_.solve({n, {hessian.data(), n * n}, {gradient.data(), n}, rows, bound_});
  report.iterations = static_cast<std::uint32_t>(std::max(0, result.iterations));
  for (std::size_t j = 0; j < 4; ++j) u[j] = result.x[j] * range_[j];
  if (result.status != QpStatus::optimal || !holds(u, solver_.has_backend() ? kBackendTolerance : kExactTolerance)) {
    report.infeasible = true;
    return false;
  }
  double largest = 0;
  for (std::size_t i = 0; i < result.active_count; ++i) {
    const std::size_t row = result.active[i];
    if (row >= item_.size() || item_[row] < 0 || !(result.multiplier[i] > largest)) continue;
    largest = result.multiplier[i], report.active = item_[row];
  }
  return true;
}

bool WrenchProgram::interpolate(const Vec4& base, Vec4& u, FilterReport& report) {
  double low = 0, high = 1;
  std::int64_t active = -1;
  for (std::size_t i = 0; i < item_.size(); ++i) {
    const double at_base = slack(i, base), along = slack(i, nominal_) - at_base;
    if (along < 0) {
      const double fraction = at_base / -along;  // holds up to here
      if (fraction < high) high = fraction, active = item_[i];
    } else if (at_base < 0) {
      low = along > 0 ? std::max(low, -at_base / along) : kInfinity;  // holds from here on
    }
  }
  report.active = active;
  if (impossible_ || !(low <= high)) {
    report.infeasible = true;
    return false;
  }
  for (std::size_t j = 0; j < 4; ++j) u[j] = base[j] + high * (nominal_[j] - base[j]);
  return true;
}

Vec3 tilting_torque(const WrenchProgram& program, const State& x, Vec3 direction, double fraction) {
  const Vec3 body = body_from_inertial(x.sigma) * direction;
  const double flat = std::hypot(body.x, body.y);
  if (!(flat > 1e-9)) return {};
  return fraction / 2 / flat * Vec3{-body.y * program.range(1), body.x * program.range(2), 0};
}

Vec3 side_of(Vec3 v) {
  const double flat = std::hypot(v.x, v.y);
  return flat > 1e-6 * geometry::norm(v) ? Vec3{-v.y / flat, v.x / flat, 0} : Vec3{0, 1, 0};
}

bool is_head_on(const Cone& cone) {
  return cone.is_met() && cone.delta * cone.delta > kAligned * kAligned * cone.beta * (cone.gamma + 1);
}

}  // namespace alula::flight
