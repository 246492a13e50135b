#include "alula/dynamics/pendulum.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/base/dual.hpp"
#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

namespace {

template <class S>
struct Swing {
  S angle, rate;
};

template <class S>
Swing<S> operator+(const Swing<S>& a, const Swing<S>& b) {
  return {a.angle + b.angle, a.rate + b.rate};
}
template <class S>
Swing<S> operator*(double s, const Swing<S>& a) {
  return {S(s) * a.angle, S(s) * a.rate};
}

// k (r - theta'): the acceleration under u_B, which cancels sin theta.
template <class S>
S backup_acceleration(const PendulumOptions& o, const Swing<S>& x) {
  const bool left = x.angle < S(0.0);
  const S out = left ? -x.angle : x.angle;
  const S in = cut<S>(S(o.push_gain) * (S(o.largest_angle - o.push_distance) - out), -o.push_rate, 0.0);
  return S(o.k) * ((left ? -in : in) - x.rate);
}

template <class S, class Visit>
void flow(const PendulumOptions& o, Swing<S> x, Visit&& visit) {
  const double dt = o.horizon_s / o.steps;
  const auto f = [&o](const Swing<S>& y) { return Swing<S>{y.rate, backup_acceleration(o, y)}; };
  visit(0, x);
  for (int k = 1; k <= o.steps; ++k) {
    x = x + dt * f(x + dt / 2 * f(x));
    visit(k, x);
  }
}

}  // namespace

void check(const PendulumOptions& o) {
  const auto positive = [](double x) { return std::isfinite(x) && x > 0; };
  if (!positive(o.largest_angle) || !positive(o.end_rate) || !positive(o.k) || !positive(o.horizon_s) ||
      !positive(o.beta) || !positive(o.alpha) || !positive(o.largest_input) || o.steps < 1 || o.steps > 100000) {
    throw std::invalid_argument("the numbers of a pendulum's filter must be positive");
  }
  for (const double x : {o.push_distance, o.push_gain, o.push_rate}) {
    if (!(x >= 0) || !std::isfinite(x)) throw std::invalid_argument("a pendulum's push must not be negative");
  }
}

PendulumFilter::PendulumFilter(PendulumRule rule, const PendulumOptions& options) : rule_(rule), options_(options) {
  check(options);
}

double PendulumFilter::backup(const PendulumState& x) const {
  return backup_acceleration(options_, Swing<double>{x.angle, x.rate}) - std::sin(x.angle);
}

PendulumReport PendulumFilter::filter(const PendulumState& x, double u_des) {
  if (!std::isfinite(x.angle) || !std::isfinite(x.rate) || !std::isfinite(u_des)) {
    throw std::invalid_argument("a pendulum's state and input must be finite");
  }
  u_des = std::clamp(u_des, -options_.largest_input, options_.largest_input);
  return rule_ == PendulumRule::regulation ? regulate(x, u_des) : program(x, u_des);
}

PendulumReport PendulumFilter::regulate(const PendulumState& x, double u_des) const {
  PendulumReport report;
  report.h_i = options_.largest_angle - std::abs(x.angle);
  flow(options_, Swing<double>{x.angle, x.rate}, [&](int k, const Swing<double>& y) {
    report.h_i = std::min(report.h_i, options_.largest_angle - std::abs(y.angle));
    if (k == options_.steps) report.h_i = std::min(report.h_i, options_.end_rate - std::abs(y.rate));
  });
  report.lambda = 1 - std::exp(-options_.beta * std::max(report.h_i, 0.0));
  report.u = report.lambda == 1 ? u_des : report.lambda * u_des + (1 - report.lambda) * backup(x);
  return report;
}

PendulumReport PendulumFilter::program(const PendulumState& x, double u_des) {
  using S = Dual<2>;  // along the drift and the input
  PendulumReport report;
  report.h_i = options_.largest_angle - std::abs(x.angle);
  rows_.begin({-options_.largest_input}, {options_.largest_input});
  const auto add = [&](double h, double slope, const S& of) {
    report.h_i = std::min(report.h_i, h);
    rows_.add(h, slope * of.d[0], {slope * of.d[1]}, options_.alpha);
  };
  const Swing<S> start{{x.angle, {x.rate, 0}}, {x.rate, {std::sin(x.angle), 1}}};
  flow(options_, start, [&](int k, const Swing<S>& y) {
    add(options_.largest_angle - y.angle.value, -1, y.angle);
    add(options_.largest_angle + y.angle.value, 1, y.angle);
    if (k < options_.steps) return;
    add(options_.end_rate - y.rate.value, -1, y.rate);
    add(options_.end_rate + y.rate.value, 1, y.rate);
  });
  const QpResult found = rows_.nearest({u_des}, {1});
  report.rows = rows_.size();
  report.is_infeasible = found.status != QpStatus::optimal;
  report.u = report.is_infeasible ? backup(x) : found.x[0];
  return report;
}

PendulumState step_pendulum(const PendulumState& x, double u, double dt) {
  const auto f = [u](double, const Swing<double>& y) { return Swing<double>{y.rate, std::sin(y.angle) + u}; };
  const Swing<double> after = rk4_step(Swing<double>{x.angle, x.rate}, dt, f);
  return {after.angle, after.rate};
}

}  // namespace alula::flight
