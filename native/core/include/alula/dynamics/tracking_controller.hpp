// Geometric tracking on SE(3) with analytic feed-forward (differential flatness): no numerical derivative.
//
//   f_c = m (a_r + g e3) - K_p e_p - K_v e_v,  T = f_c . b,  b = R^T e3,  a = -g e3 + (T/m) b
//   f_c' = m j_r - K_p e_v - K_v e_a,  T' = f_c' . b + f_c . b',  j = (T' b + T b') / m
//   f_c'' = m s_r - K_p e_a - K_v e_j,  T'' = f_c'' . b + 2 f_c' . b' + f_c . b''
//   C_d = [b1 b2 b3] with b3 along f_c and b1 towards the heading; omega_d and omega_d' from C_d', C_d''
//   e_R = vee(C_d^T C - C^T C_d) / 2,  E = C^T C_d,  e_omega = omega - E omega_d
//   tau = -K_R e_R - K_omega e_omega + omega x J omega - J (hat(omega) E omega_d - E omega_d')
//
// Where |f_c| is below a twentieth of the weight its direction is undefined, and the thrust axis is held;
// where f_c is along the heading, b2 points to the left of the heading as far as f_c allows.
// Source: Lee, Leok and McClamroch 2010; Mellinger and Kumar 2011.
#pragma once

#include <limits>

#include "alula/base/jet.hpp"
#include "alula/dynamics/quadrotor.hpp"
#include "alula/filters/safety_filter.hpp"
#include "alula/planning/reference_curve.hpp"

namespace alula::flight {

struct TrackingGains {
  double kp = 3, kv = 2;              // K_p = kp m, K_v = kv m [1/s^2, 1/s]
  Vec3 k_r{0.35, 0.35, 0.12};         // K_R [N m]
  Vec3 k_omega{0.025, 0.025, 0.012};  // K_omega [N m s]

  // Limits of the response to large errors; unlimited by default. e_p is shortened so that
  // kp |e_p| / kv <= catch_up_m_s: a vehicle held up by an obstacle does not command an ever higher speed.
  // f_c is at most this fraction of the rotors' thrust and at most this angle from the vertical. Height has
  // priority, with up to 0.95 of that fraction. The derivatives of f_c are those of the limited f_c.
  double catch_up_m_s = std::numeric_limits<double>::infinity();
  double max_tilt_rad = std::numeric_limits<double>::infinity();
  double max_thrust_share = std::numeric_limits<double>::infinity();

  // True if e_a and e_j, computed from the thrust, enter f_c' and f_c''.
  bool uses_acceleration = true;
};

// Throws std::invalid_argument for gains or limits that are not positive.
void check(const TrackingGains& gains);

// Value of `applied_thrust` for the controller's own thrust.
inline constexpr double own_thrust = std::numeric_limits<double>::quiet_NaN();

struct Tracking {
  Nominal nominal;
  VectorJet force;  // f_c and its derivatives [N, N/s, N/s^2]
  Vec3 omega_d, omega_d_rate, e_r, e_omega;
};

// The controller with its intermediate results. `applied_thrust` is the thrust that the vehicle applies
// if it differs from the controller's [N]; e_a and e_j are computed from it.
Tracking track_in_detail(const Quadrotor& quadrotor, const TrackingGains& gains, const State& x,
                         const ReferencePoint& reference, double applied_thrust = own_thrust);

inline Nominal track(const Quadrotor& quadrotor, const TrackingGains& gains, const State& x,
                     const ReferencePoint& reference, double applied_thrust = own_thrust) {
  return track_in_detail(quadrotor, gains, x, reference, applied_thrust).nominal;
}

// The same for a point with its acceleration as input, a_r - kp e_p - kv e_v: only that and the errors.
Nominal track_point(const TrackingGains& gains, const State& x, const ReferencePoint& reference);

// The wrench for an acceleration that a filter returned: f_c = m (a_cmd + g e3) through the same
// attitude loop, with the nominal f_c' and f_c'' (the filter's correction counts as constant).
// `nominal.acceleration` gives `nominal.wrench`, bit by bit.
Wrench realise(const Quadrotor& quadrotor, const TrackingGains& gains, const State& x,
               const ReferencePoint& reference, const Nominal& nominal, Vec3 acceleration,
               double applied_thrust = own_thrust);

// The body rates to command to a rate loop: omega' = J^-1 (tau - omega x J omega) over the time `lead` of each axis
// by one RK4 step with tau held, each component clipped to +-max_rate [rad/s].
// Zero where a number is not finite.
Vec3 body_rates(const Quadrotor& quadrotor, const State& x, const Wrench& u, Vec3 lead, Vec3 max_rate);

}  // namespace alula::flight
