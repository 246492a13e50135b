// The rigid body of a quadrotor on SE(3), its rotors, and fixed-step RK4.
//
// Inertial frame z up, gravity -g e3; body frame x forward, y left, z up, rotors push along +z.
#pragma once

#include <array>

#include "alula/dynamics/attitude.hpp"

namespace alula::flight {

// x = (p, sigma, v, omega): position and velocity inertial [m, m/s], attitude, body rates [rad/s].
struct State {
  Vec3 p, sigma, v, omega;
};

inline State operator+(const State& a, const State& b) {
  return {a.p + b.p, a.sigma + b.sigma, a.v + b.v, a.omega + b.omega};
}
inline State operator*(double s, const State& a) { return {s * a.p, s * a.sigma, s * a.v, s * a.omega}; }
inline bool is_finite(const State& x) {
  return geometry::is_finite(x.p) && geometry::is_finite(x.sigma) && geometry::is_finite(x.v) &&
         geometry::is_finite(x.omega);
}

// u = (T, tau): collective thrust [N] and body torque [N m].
struct Wrench {
  double thrust = 0;
  Vec3 torque;
};

inline bool is_finite(const Wrench& u) { return std::isfinite(u.thrust) && geometry::is_finite(u.torque); }

// One classical Runge-Kutta step of dt from x; f(t, x) is the derivative, t in [0, dt] since the start of the step.
template <class X, class F>
X rk4_step(const X& x, double dt, F&& f) {
  const X k1 = f(0.0, x);
  const X k2 = f(dt / 2, x + dt / 2 * k1);
  const X k3 = f(dt / 2, x + dt / 2 * k2);
  const X k4 = f(dt, x + dt * k3);
  return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
}

using Vec4 = std::array<double, 4>;
using Mat4 = std::array<std::array<double, 4>, 4>;

// u = G f of the rotors' thrusts f: T = sum f_i, tau = (sum y_i f_i, -sum x_i f_i, c_q sum s_i f_i), with
// s_i = -1 for a rotor that turns counter-clockwise seen from above.
struct RotorLayout {
  Vec4 x{}, y{}, spin{};    // [m], [m], -1 or 1
  double torque_ratio = 0;  // c_q: drag torque over thrust [m]
  Vec4 f_min{}, f_max{};    // thrust limits of a rotor [N]
};

// A body with its allocation. Throws std::invalid_argument when the rotors cannot produce every wrench, cannot
// produce thrust without torque within their limits, or mass, inertia or limits are out of range.
class Quadrotor {
 public:
  Quadrotor(double mass, Vec3 inertia, const RotorLayout& rotors, double gravity = 9.81);

  double mass() const { return mass_; }
  double gravity() const { return gravity_; }
  Vec3 inertia() const { return inertia_; }  // principal, along the body's axes [kg m^2]
  const RotorLayout& rotors() const { return rotors_; }
  const Mat4& allocation() const { return allocation_; }                  // G
  const Mat4& inverse_allocation() const { return inverse_allocation_; }  // G^-1
  double hover_thrust() const { return mass_ * gravity_; }
  double max_thrust() const;

  Wrench wrench(const Vec4& rotor_thrust) const;                   // G f
  Vec4 rotor_thrust(const Wrench& u) const;                        // G^-1 u
  bool admissible(const Wrench& u, double tolerance_n = 0) const;  // f_min <= G^-1 u <= f_max

  // The admissible wrench for a commanded u: u itself, bit by bit, when it is admissible. Otherwise, in this order:
  // the largest fraction of the torque about x and y for which some thrust is admissible, the largest fraction of
  // the torque about z beside it, and the admissible thrust nearest to the commanded one. A wrench that is not
  // finite counts as hovering. The result is admissible up to rounding.
  Wrench limited(const Wrench& u) const;

  // The wrench when each rotor is clipped at its own limits; u itself when it is admissible.
  Wrench saturated(const Wrench& u) const;

  // x' = f(x) + g(x) u:  p' = v, sigma' = Z omega, v' = -g e3 + (T/m) R^T e3 + a_ext,
  // omega' = J^-1 (tau - omega x J omega).
  Vec3 angular_acceleration(Vec3 omega, Vec3 torque) const;
  State derivative(const State& x, const Wrench& u, Vec3 external_acceleration = {}) const;

  // One RK4 step of dt [s] with u held; no shadow switch.
  State step(const State& x, const Wrench& u, double dt) const;

 private:
  double mass_, gravity_;
  Vec3 inertia_;
  RotorLayout rotors_;
  Mat4 allocation_{}, inverse_allocation_{};
  Vec4 pure_thrust_{};  // rotor thrusts for a unit of thrust without torque
};

}  // namespace alula::flight
