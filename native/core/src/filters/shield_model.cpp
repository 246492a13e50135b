// The model of the vehicle in a shield: a tick of a wrench, whether its loop settles, and what counts as rest.
#include <algorithm>
#include <array>
#include <cmath>

#include "alula/base/constants.hpp"
#include "alula/dynamics/actuators.hpp"
#include "alula/dynamics/tracking_controller.hpp"
#include "alula/filters/shield.hpp"

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::dot;
using geometry::multiply;
using geometry::norm;

constexpr double kStep = 0.01;  // maximum RK4 step [s]
constexpr double kTurn = 0.1;   // maximum turn in a step [rad]

// Body and rotors, for a rate loop with lag.
struct Driven {
  State x;
  Vec4 f;
};

Vec4 operator*(double s, const Vec4& f) { return {s * f[0], s * f[1], s * f[2], s * f[3]}; }
Vec4 plus(const Vec4& f, const Vec4& g) { return {f[0] + g[0], f[1] + g[1], f[2] + g[2], f[3] + g[3]}; }
Driven operator+(const Driven& a, const Driven& b) { return {a.x + b.x, plus(a.f, b.f)}; }
Driven operator*(double s, const Driven& a) { return {s * a.x, s * a.f}; }

// Steps for a tick of rotation; `shortest` is the step that the fastest part allows [s].
int steps_of(const ShieldOptions& o, const State& x, double shortest) {
  const double needed =
      std::max({o.tick_s / kStep * (1 - 1e-9), norm(x.omega) * o.tick_s / kTurn, o.tick_s / shortest * (1 - 1e-9)});
  return std::max(o.substeps, static_cast<int>(std::ceil(std::min(needed, 100.0))));
}

}  // namespace

// One tick of the vehicle's rate loop: the rates that the torque of u leads to are commanded for the tick, with the
// thrust of u, or with lag the one that leads to it. Its torques are held for a period, so on average they belong to
// the rates of half a period before; without lag, those of a shorter time constant.
State Shield::following_rates(const State& x, Vec4& rotors, const Wrench& u) const {
  const Quadrotor& body = policy_.vehicle();
  const ShieldOptions& o = options_;
  const double lag = o.motor_time_constant_s;
  const Vec3 rates = body_rates(body, x, u, rate_lead_s(o.rate_time_constant_s, o.tick_s), o.max_rate_rad_s);
  const double thrust = lags() ? leading_thrust(body, lag, rotors, u.thrust, o.tick_s) : u.thrust;
  const Vec3 constant = o.rate_time_constant_s;
  Vec3 held, without;  // half a period, and the time constant without it
  for (int i = 0; i < 3; ++i) {
    held[i] = std::min(kRateLoopPeriod, constant[i]) / 2;
    without[i] = constant[i] - held[i];
  }
  const auto commanded = [&](Vec3 omega, Vec3 time_constant) {
    return body.limited({thrust, rate_loop_torque(body, omega, rates, time_constant)});
  };
  const double turning = std::min({constant.x, constant.y, constant.z});
  const double fastest = lags() ? std::min(lag, turning) : turning;
  const int steps = steps_of(o, x, fastest / 2);
  const double h = o.tick_s / steps;
  Driven y{x, rotors};
  for (int i = 0; i < steps; ++i) {
    if (!lags()) {
      y.x = rk4_step(y.x, h,
                     [&](double, const State& at) { return body.derivative(at, commanded(at.omega, without)); });
      continue;
    }
    y = rk4_step(y, h, [&](double, const Driven& at) {
      const State change = body.derivative(at.x, body.wrench(at.f));
      const Vec4 goal = body.rotor_thrust(commanded(at.x.omega - multiply(held, change.omega), constant));
      return Driven{change, 1 / lag * plus(goal, -1.0 * at.f)};
    });
    for (std::size_t r = 0; r < 4; ++r) y.f[r] = std::clamp(y.f[r], body.rotors().f_min[r], body.rotors().f_max[r]);
  }
  rotors = y.f;
  y.x.sigma = shadowed(y.x.sigma);
  return y.x;
}

// One tick of rotors, or of a rate loop, that are commanded to reach u.
State Shield::following(const State& x, Vec4& rotors, const Wrench& u) const {
  if (has_rate_loop()) return following_rates(x, rotors, u);
  const double tick = options_.tick_s, lag = options_.motor_time_constant_s;
  const double needed = std::max({tick / kStep * (1 - 1e-9), norm(x.omega) * tick / kTurn, 2 * tick / lag});
  const int steps = std::max(options_.substeps, static_cast<int>(std::ceil(std::min(needed, 100.0))));
  const auto derivative = [&](const State& at, const Wrench& made) { return policy_.vehicle().derivative(at, made); };
  const Wrench command = leading(policy_.vehicle(), lag, rotors, u, tick);
  State y = x;
  for (int i = 0; i < steps; ++i)
    y = following_step(policy_.vehicle(), lag, y, rotors, command, tick / steps, derivative);
  y.sigma = shadowed(y.sigma);
  return y;
}

// A tick of the policy near hover, without the position and, unless it has a spring, the heading.
Shield::Linear Shield::linearised() const {
  constexpr double kChange = 1e-5;
  const double unit = policy_.vehicle().hover_thrust() / 4;  // unit of the rotor states [N]
  struct Change {
    Row row;
    Vec3 p;
  };
  const auto after_a_tick = [&](std::size_t i, double change) {
    Row row{};
    row[i] = change;
    State x{{}, geometry::from_rows(&row[3]), geometry::from_rows(&row[0]), geometry::from_rows(&row[6])};
    Vec4 rotors = rotors_;
    for (std::size_t r = 0; r < 4; ++r) rotors[r] += row[9 + r] * unit;
    x = following(x, rotors, flown(x, {}, 0));
    if (policy_.kind() != BackupKind::hover) x.sigma.z = 0;
    if (!lags()) rotors = rotors_;
    return Change{{x.v.x, x.v.y, x.v.z, x.sigma.x, x.sigma.y, x.sigma.z, x.omega.x, x.omega.y, x.omega.z,
                   rotors[0] / unit, rotors[1] / unit, rotors[2] / unit, rotors[3] / unit},
                  x.p};
  };
  Linear result{};
  for (std::size_t i = 0; i < kSize; ++i) {
    const Change above = after_a_tick(i, kChange), below = after_a_tick(i, -kChange);
    for (std::size_t j = 0; j < kSize; ++j) result.next[j][i] = (above.row[j] - below.row[j]) / (2 * kChange);
    for (std::size_t j = 0; j < 3; ++j)
      result.moved[j][i] = (above.p[static_cast<int>(j)] - below.p[static_cast<int>(j)]) / (2 * kChange);
  }
  return result;
}

// True if hovering is asymptotically stable with lag and rate loop, except for position and, without a spring,
// heading: powers of the Jacobian of a tick vanish. Also sums the drift until rest, moved (1 + next + next^2 + ...).
bool Shield::settles() {
  constexpr double kVanished = 1e-3;
  const Linear tick = linearised();
  std::array<Row, kSize> power = tick.next;
  drift_ = tick.moved;
  double largest = kInfinity;
  for (int doubled = 0; doubled < 14 && largest > kVanished; ++doubled) {
    std::array<Row, 3> later{};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < kSize; ++j)
        for (std::size_t k = 0; k < kSize; ++k) later[i][j] += drift_[i][k] * power[k][j];
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < kSize; ++j) drift_[i][j] += later[i][j];
    std::array<Row, kSize> next{};
    largest = 0;
    for (std::size_t i = 0; i < kSize; ++i)
      for (std::size_t j = 0; j < kSize; ++j) {
        for (std::size_t k = 0; k < kSize; ++k) next[i][j] += power[i][k] * power[k][j];
        largest = std::max(largest, std::abs(next[i][j]));
      }
    if (!(largest < 1e100)) return false;
    power = next;
  }
  return largest <= kVanished;
}

// The wrench of a manoeuvre in a tick.
Wrench Shield::flown(const State& x, const Manoeuvre& manoeuvre, int tick) const {
  return manoeuvre.is_urgent ? policy_.urgent(x, manoeuvre.at(tick)) : policy_(x, manoeuvre.at(tick));
}

State Shield::after(const State& x, const Wrench& u) const {
  if (!acts_at_once()) {
    Vec4 rotors = rotors_;
    return following(x, rotors, u);
  }
  State y = x;
  const double needed = std::max(options_.tick_s / kStep * (1 - 1e-9), norm(x.omega) * options_.tick_s / kTurn);
  const int steps = std::max(options_.substeps, static_cast<int>(std::ceil(std::min(needed, 100.0))));
  const double h = options_.tick_s / steps;
  for (int i = 0; i < steps; ++i) y = policy_.vehicle().step(y, u, h);
  y.sigma = shadowed(y.sigma);
  return y;
}

bool Shield::is_slow(const State& x) const {
  const ShieldOptions& o = options_;
  if (dot(x.v, x.v) > o.rest_speed_m_s * o.rest_speed_m_s) return false;
  if (dot(x.omega, x.omega) > o.rest_rate_rad_s * o.rest_rate_rad_s) return false;
  const Vec3 b = thrust_axis(x.sigma);
  if (!(b.z > 0) || b.x * b.x + b.y * b.y > o.rest_tilt_rad * o.rest_tilt_rad) return false;
  // With a spring on the heading, the only rest is at the heading that it pulls to.
  return policy_.kind() != BackupKind::hover || 4 * std::abs(x.sigma.z) <= o.rest_tilt_rad;
}

bool Shield::resting(const State& x) const { return is_slow(x) && policy_.sways_at_most(x, rest_drift_); }

// True if the linear loop about hover still moves by at most `limit`. Turned to the body's heading, the state is that
// of the loop: c = R e3 is (4 sigma_y, -4 sigma_x, 1) turned by a right angle, up to second order.
bool Shield::drifts_at_most(const State& x, const Vec4& rotors, double limit) const {
  const Mat3 r = body_from_inertial(x.sigma);
  const Vec3 v = r * x.v, c = r.column(2);
  const double unit = policy_.vehicle().hover_thrust() / 4;
  Row row{v.x, v.y, v.z, c.y / 4, -c.x / 4, 0, x.omega.x, x.omega.y, x.omega.z};
  for (std::size_t i = 0; lags() && i < 4; ++i) row[9 + i] = (rotors[i] - hovering_[i]) / unit;
  const auto part = [&](std::size_t from, std::size_t to) {
    Vec3 moved;
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = from; j < to; ++j) moved[static_cast<int>(i)] += drift_[i][j] * row[j];
    return moved;
  };
  // As in `BackupPolicy::sway`: the parts cancel in the loop of `brake` only.
  if (policy_.brakes()) return norm(part(0, kSize)) <= limit;
  return norm(part(0, 3)) + norm(part(3, 6)) + norm(part(6, 9)) + norm(part(9, kSize)) <= limit;
}

// The same with rotors that have not settled. Left alone, the rotors would still add the momentum that is computed
// here; under command they add a part of it. A linear loop ends where a loop without lag ends from the state with
// that part, which lies between the two.
bool Shield::resting(const State& x, const Vec4& rotors) const {
  if (has_rate_loop()) return is_slow(x) && drifts_at_most(x, rotors, rest_drift_);
  if (!resting(x)) return false;
  if (!lags()) return true;
  const Wrench u = policy_.vehicle().wrench(rotors);
  State y = x;
  y.v.z += options_.motor_time_constant_s * (u.thrust / policy_.vehicle().mass() - policy_.vehicle().gravity());
  y.omega += options_.motor_time_constant_s * divide(u.torque, policy_.vehicle().inertia());
  return resting(y);
}

}  // namespace alula::flight
