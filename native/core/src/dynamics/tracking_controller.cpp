#include "alula/dynamics/tracking_controller.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

using geometry::e3;
using geometry::hat;
using geometry::multiply;

constexpr double kLeastForce = 0.05;      // of the weight
constexpr double kLeastSine = 0.05;       // of the angle between thrust and heading
constexpr double kHeightFraction = 0.95;  // of the largest force; the rest is reserved for horizontal motion

// The error, shortened to a length of at most `limit`.
VectorJet shortened(const VectorJet& error, double limit) {
  if (!(geometry::norm(error.value) > limit)) return error;
  return limit * unit(error);
}

bool has_limits(const TrackingGains& gains) {
  return std::isfinite(gains.max_tilt_rad) || std::isfinite(gains.max_thrust_share);
}

VectorJet limited(const Quadrotor& quadrotor, const TrackingGains& gains, const VectorJet& force) {
  if (!has_limits(gains)) return force;
  const double most = gains.max_thrust_share * quadrotor.max_thrust();
  const double least_height = kLeastForce * quadrotor.hover_thrust();
  Jet height{force.value.z, force.rate.z, force.acceleration.z};
  if (height.value > kHeightFraction * most) height = {kHeightFraction * most};
  if (height.value < least_height) height = {least_height};
  VectorJet sideways = force;
  sideways.value.z = sideways.rate.z = sideways.acceleration.z = 0;
  const double length = geometry::norm(sideways.value);
  const double by_tilt =
      gains.max_tilt_rad < 1.57 ? std::tan(gains.max_tilt_rad) : std::numeric_limits<double>::infinity();
  const double by_thrust = std::sqrt(most * most - height.value * height.value);
  if (length > std::min(by_tilt * height.value, by_thrust)) {
    const Jet cap =
        by_tilt * height.value <= by_thrust ? Jet{by_tilt} * height : sqrt(Jet{most * most} - height * height);
    sideways = cap * unit(sideways);
  }
  sideways.value.z = height.value, sideways.rate.z = height.rate, sideways.acceleration.z = height.acceleration;
  return sideways;
}

// b = C e3 of a rotating body: b' = C (omega x e3), b'' = C (omega x (omega x e3) + omega' x e3).
VectorJet thrust_axis(const Mat3& body_to_inertial, Vec3 omega, Vec3 omega_rate = {}) {
  const Vec3 turn = cross(omega, e3);
  return {body_to_inertial * e3, body_to_inertial * turn,
          body_to_inertial * (cross(omega, turn) + cross(omega_rate, e3))};
}

// e = (cos yaw, sin yaw, 0): e' = yaw' n, e'' = yaw'' n - yaw'^2 e.
VectorJet heading_of(const ReferencePoint& r) {
  const Vec3 e{std::cos(r.yaw), std::sin(r.yaw), 0}, n = cross(e3, e);
  return {e, r.yaw_rate * n, r.yaw_acceleration * n - r.yaw_rate * r.yaw_rate * e};
}

Mat3 columns(Vec3 a, Vec3 b, Vec3 c) { return {{{a.x, b.x, c.x}, {a.y, b.y, c.y}, {a.z, b.z, c.z}}}; }

// From body to inertial components, with its derivatives.
struct Frame {
  Mat3 value, rate, acceleration;
};

Frame frame_along(const VectorJet& b3, const ReferencePoint& reference) {
  const VectorJet heading = heading_of(reference), side = cross(b3, heading),
                  left = cross(VectorJet{e3, {}, {}}, heading);
  const bool has_heading = geometry::norm(side.value) > kLeastSine;
  const VectorJet b2 = unit(has_heading ? side : left - dot(left, b3) * b3), b1 = cross(b2, b3);
  return {columns(b1.value, b2.value, b3.value), columns(b1.rate, b2.rate, b3.rate),
          columns(b1.acceleration, b2.acceleration, b3.acceleration)};
}

double longest_error(const TrackingGains& gains) { return gains.catch_up_m_s * gains.kv / gains.kp; }

// f_c before its limits, for the nominal acceleration.
VectorJet demand_of(const Quadrotor& quadrotor, const TrackingGains& gains, const ReferencePoint& r,
                    const Nominal& nominal, const VectorJet& b, double applied_thrust) {
  const double m = quadrotor.mass(), longest = longest_error(gains);
  VectorJet error{nominal.position_error, nominal.velocity_error, {}};
  VectorJet demand{m * (nominal.acceleration + quadrotor.gravity() * e3), {}, {}};

  // The limits apply to the thrust computed from the force, and to all that follows from it.
  const auto thrust_of = [&](const VectorJet& force) { return dot(limited(quadrotor, gains, force), b); };
  Vec3 e_a{}, e_j{};
  const bool is_own = !std::isfinite(applied_thrust);
  double thrust = 0;
  if (gains.uses_acceleration) {
    thrust = is_own ? thrust_of(demand).value : applied_thrust;
    e_a = -quadrotor.gravity() * e3 + (thrust / m) * b.value - r.a;
  }
  demand.rate = m * (r.j - gains.kp * shortened(error, longest).rate - gains.kv * e_a);
  if (gains.uses_acceleration) {
    const double thrust_rate = thrust_of(demand).rate;
    e_j = 1 / m * (thrust_rate * b.value + thrust * b.rate) - r.j;
  }
  error.acceleration = e_a;
  demand.acceleration = m * (r.s - gains.kp * shortened(error, longest).acceleration - gains.kv * e_j);
  return demand;
}

// From the force to the wrench.
Tracking attitude_loop(const Quadrotor& quadrotor, const TrackingGains& gains, const State& x,
                       const ReferencePoint& reference, const VectorJet& force, const Mat3& C) {
  Tracking result;
  result.force = limited(quadrotor, gains, force);
  const bool has_direction =
      !(geometry::norm(result.force.value) < kLeastForce * quadrotor.hover_thrust());  // true for NaN, which persists
  Frame desired;
  if (has_direction)
    desired = frame_along(unit(result.force), reference);
  else
    desired = {C, {}, {}};
  const Mat3 to_desired = geometry::transpose(desired.value);
  const Vec3 omega_d = geometry::vee(to_desired * desired.rate);
  result.omega_d = omega_d;
  result.omega_d_rate = geometry::vee(to_desired * desired.acceleration - hat(omega_d) * hat(omega_d));
  result.e_r = 0.5 * geometry::vee(to_desired * C - geometry::transpose(C) * desired.value);
  const Mat3 E = geometry::transpose(C) * desired.value;
  result.e_omega = x.omega - E * omega_d;
  const Vec3 J = quadrotor.inertia(), omega = x.omega;
  Wrench& u = result.nominal.wrench;
  u.torque = -multiply(gains.k_r, result.e_r) - multiply(gains.k_omega, result.e_omega) +
             cross(omega, multiply(J, omega)) - multiply(J, cross(omega, E * omega_d) - E * result.omega_d_rate);
  const Jet thrust = dot(result.force, thrust_axis(C, omega, quadrotor.angular_acceleration(omega, u.torque)));
  u.thrust = thrust.value;
  result.nominal.thrust_rate = thrust.rate;
  result.nominal.thrust_acceleration = thrust.acceleration;
  return result;
}

}  // namespace

void check(const TrackingGains& gains) {
  bool good = gains.kp > 0 && gains.kv > 0 && std::isfinite(gains.kp) && std::isfinite(gains.kv) &&
              gains.catch_up_m_s > 0 && gains.max_tilt_rad > 0 && gains.max_thrust_share > 0 &&
              geometry::is_finite(gains.k_r) && geometry::is_finite(gains.k_omega);
  for (int i = 0; i < 3; ++i) good = good && gains.k_r[i] >= 0 && gains.k_omega[i] >= 0;
  if (!good) throw std::invalid_argument("gains of a controller and its limits must be positive");
}

Nominal track_point(const TrackingGains& gains, const State& x, const ReferencePoint& reference) {
  Nominal nominal;
  nominal.position_error = x.p - reference.p;
  nominal.velocity_error = x.v - reference.v;
  nominal.reference_acceleration = reference.a;
  const Vec3 pulled = shortened({nominal.position_error, {}, {}}, longest_error(gains)).value;
  nominal.acceleration = reference.a - gains.kp * pulled - gains.kv * nominal.velocity_error;
  return nominal;
}

Tracking track_in_detail(const Quadrotor& quadrotor, const TrackingGains& gains, const State& x,
                         const ReferencePoint& reference, double applied_thrust) {
  const Mat3 C = geometry::transpose(body_from_inertial(x.sigma));
  Nominal nominal = track_point(gains, x, reference);
  const VectorJet force = demand_of(quadrotor, gains, reference, nominal, thrust_axis(C, x.omega), applied_thrust);
  Tracking result = attitude_loop(quadrotor, gains, x, reference, force, C);
  if (has_limits(gains)) nominal.acceleration = 1 / quadrotor.mass() * result.force.value - quadrotor.gravity() * e3;
  nominal.wrench = result.nominal.wrench;
  nominal.thrust_rate = result.nominal.thrust_rate;
  nominal.thrust_acceleration = result.nominal.thrust_acceleration;
  result.nominal = nominal;
  return result;
}

Wrench realise(const Quadrotor& quadrotor, const TrackingGains& gains, const State& x,
               const ReferencePoint& reference, const Nominal& nominal, Vec3 acceleration, double applied_thrust) {
  const Vec3 a = nominal.acceleration;
  if (acceleration.x == a.x && acceleration.y == a.y && acceleration.z == a.z) return nominal.wrench;
  const Mat3 C = geometry::transpose(body_from_inertial(x.sigma));
  VectorJet force = limited(quadrotor, gains,
                            demand_of(quadrotor, gains, reference, track_point(gains, x, reference),
                                      thrust_axis(C, x.omega), applied_thrust));
  force.value = quadrotor.mass() * (acceleration + quadrotor.gravity() * e3);
  return attitude_loop(quadrotor, gains, x, reference, force, C).nominal.wrench;
}

Vec3 body_rates(const Quadrotor& quadrotor, const State& x, const Wrench& u, Vec3 lead, Vec3 max_rate) {
  const auto after = [&](double t) {
    return rk4_step(x.omega, t, [&](double, Vec3 omega) { return quadrotor.angular_acceleration(omega, u.torque); });
  };
  Vec3 rate = after(lead.x);
  for (int i = 1; i < 3; ++i)
    if (lead[i] != lead.x) rate[i] = after(lead[i])[i];
  if (!geometry::is_finite(rate)) return {};
  for (int i = 0; i < 3; ++i) rate[i] = std::max(-max_rate[i], std::min(max_rate[i], rate[i]));
  return rate;
}

}  // namespace alula::flight
