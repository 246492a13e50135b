// Feedback that brings a quadrotor to rest from any state within the limits of its rotors.
//
// A policy maps (sigma, v, omega) to a wrench that is admissible for every finite state, is C^2 in it, and has
// hover, at any position and (but for `hover`) heading, as its only stable equilibrium. With R = R(sigma),
// b = R^T e3, c = R e3, S = -hat(e3), caps c_k > 0 and sat(y, c) = c tanh(y / c):
//
//   hover              T = m g + sat(-kappa m k_vz v_z, c_T)
//                      tau = sat(kappa (-K_sigma sigma - K_omega omega + k_vh S R v), c_tau)
//   heading-invariant  the same T;  tau~ = (K_sigma / 4) (e3 x c) - K_omega omega + k_vh S R v
//   brake              u = v - v_d,  n = e3 - tan(tilt) u_h / sqrt(v_0^2 + |u_h|^2),
//                      tau~ = K_R (e3 x R n) - K_omega omega,
//                      T~ = m (g - k_z u_z) l(R_33),  l(y) = (1 + eps) y / (y^2 + eps) ~ 1 / y
//
// `hover` has a spring on yaw and jumps at a shadow switch; the other two depend on the attitude through R alone.
// `brake` tilts towards n, so its steady tilt stays below `tilt`. It holds its height while tilted, and has
// different caps for upward and downward thrust. v_d is the velocity that it regulates to.
//
// Source: Tscholl, Nakka, Gunter 2026 (FastBridge), eq. 17-19, for `hover`; the others are alula's own.
#pragma once

#include <array>
#include <cstdint>

#include "alula/dynamics/quadrotor.hpp"
#include "alula/filters/options.hpp"

namespace alula::flight {

// d(T, tau) / d(sigma, v, omega); d tau / d omega is diagonal and dT / d omega zero.
struct PolicyJacobian {
  Vec3 thrust_sigma, thrust_v;
  Mat3 torque_sigma, torque_v;
  Vec3 torque_omega;
};

class BackupPolicy {
 public:
  // Throws std::invalid_argument when a gain is invalid, hover is not inside the rotors' limits, or the linear
  // braking loop J s^3 + K_omega s^2 + K_R s + g k_vh = 0 is not Hurwitz, i.e. unless K_omega K_R > J g k_vh
  // for roll and pitch (with K_R = K_sigma / 4, gains times kappa; K_R tan(tilt) / v_0 for k_vh in `brake`).
  BackupPolicy(const Quadrotor& vehicle, BackupKind kind, const BackupGains& gains = {});

  BackupKind kind() const { return kind_; }
  const Quadrotor& vehicle() const { return vehicle_; }
  const BackupGains& gains() const { return gains_; }

  bool brakes() const { return kind_ == BackupKind::brake || kind_ == BackupKind::cone_escape; }
  bool escapes() const { return kind_ == BackupKind::cone_escape; }

  // Rotor i gets f_hov,i + (G^-1 Delta)_i with Delta_T in [-down, up] and |Delta_tau| <= torque_cap, so in every
  // state it stays within eta_frac of its margins about hover.
  double cap_up() const { return up_; }
  double cap_down() const { return down_; }
  Vec3 torque_cap() const { return torque_cap_; }
  double fastest_rate() const;  // fastest rate of the attitude loop [1/s], to choose an integration step

  // True if the linear loop about hover, with wrenches held for a tick, is asymptotically stable (Jury's criterion).
  // Gains that are stable in continuous time can be unstable here when the vehicle is light or the tick long.
  bool settles(double tick_s) const;

  // The wrench before saturation, and the policy itself. `hold` is v_d of `brake`; the other policies ignore it.
  Wrench raw(const State& x, Vec3 hold = {}) const;
  Wrench operator()(const State& x, Vec3 hold = {}) const;

  // The policy with the rotors' full range, torque before thrust, for states where no gentle manoeuvre is safe. For
  // `brake` the thrust is the component of the commanded force along the axis, and minimal while the axis points
  // ahead: it never speeds the vehicle up to hold its height. Near hover it equals the policy itself.
  Wrench urgent(const State& x, Vec3 hold = {}) const;
  Wrench linearised(const State& x, Vec3 hold,
                    PolicyJacobian& jacobian) const;  // bitwise equal to the policy; also its Jacobian

  // Distance that the linear loop about hover would still move before it rests [m]: the time integral of its
  // velocity.
  Vec3 drift(const State& x) const;

  // Approximate maximum distance that it moves before it rests [m]. The parts of the drift may cancel in a state that
  // swings out and back, so their lengths are added.
  double excursion(const State& x) const;
  // The same for slow states: the parts of `brake` have decayed before their cancellation matters.
  double sway(const State& x) const;
  bool sways_at_most(const State& x, double limit) const;  // sway(x) <= limit, usually at a lower cost

 private:
  Vec3 tilt_target(Vec3 v, Vec3 hold) const;
  double lift(double cosine) const;
  std::array<Vec3, 3> drifts(const State& x) const;  // horizontal, from speed, tilt and rate
  Wrench saturated(const Wrench& raw) const;

  Quadrotor vehicle_;
  BackupKind kind_;
  BackupGains gains_;
  double up_ = 0, down_ = 0;
  Vec3 torque_cap_;
  Vec3 k_tilt_, k_omega_;  // K_R (0 about yaw) and K_omega
  double lean_ = 0;        // k_vh / K_R, or tan(tilt) / v_0
  double k_z_ = 0, kappa_ = 1;
};

// A manoeuvre: `brake` about `hold` for `ticks` ticks or steps, then to rest; or `urgent`.
struct Manoeuvre {
  Vec3 hold;      // [m/s]
  int ticks = 0;  // 0: to rest at once
  bool is_urgent = false;

  Vec3 at(int tick) const { return tick < ticks ? hold : Vec3{}; }
};

// f_cl = f + g pi_b, and its Jacobian by blocks; the rows of p are (0, 0, I, 0).
struct ClosedLoopJacobian {
  Mat3 sigma_sigma, sigma_omega, v_sigma, v_v, omega_sigma, omega_v, omega_omega;
};
State closed_loop(const BackupPolicy& policy, const State& x, Vec3 hold = {});
State closed_loop(const BackupPolicy& policy, const State& x, Vec3 hold, ClosedLoopJacobian& jacobian);

}  // namespace alula::flight
