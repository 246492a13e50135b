// Collision cone of one ellipsoid, its derivatives along a flight, and the rows made of them.
//
// The obstacle is E = {y : (y - mu)^T A (y - mu) <= 1} at rest, r = mu - p points from the vehicle to it, and
//
//   beta = v^T A v,   gamma = r^T A r - 1,   delta = r^T A v,   h = beta gamma - delta^2.
//
// From outside (gamma > 0) the ray p + t v, t >= 0, meets E if and only if h <= 0 and delta >= 0. Inside E and for
// v = 0, h has no meaning: inside, h <= 0 for all v; for v = 0, h = 0 without a gradient. The rows on gamma do not
// use v. Units: A in 1/m^2, so gamma has none, beta is in 1/s^2, delta in 1/s, h in 1/s^2.
//
// A row is a half-space of inputs, row . u >= bound. Positive multiples of a row are equivalent; rows here are not
// normalised. Source: FastBridge (arXiv 2607.01200), eq. 9-16.
#pragma once

#include <array>
#include <cmath>
#include <limits>

#include "alula/dynamics/quadrotor.hpp"
#include "alula/filters/safety_filter.hpp"
#include "alula/geometry/ellipsoid_index.hpp"

namespace alula::flight {

// The barrier at a position and a velocity.
struct Cone {
  Vec3 r, v, ar, av;  // mu - p [m], velocity [m/s], A r, A v
  double beta = 0, gamma = 0, delta = 0, h = 0;
  Vec3 w;  // grad_v h = 2 A (gamma v - delta r); h' = w . v', as h is constant along straight flight

  Vec3 grad_p() const { return -2 * beta * ar + 2 * delta * av; }  // gradient of h by p, perpendicular to v
  Vec3 gamma_grad_p() const { return -2 * ar; }
  bool is_inside() const { return gamma < 0; }
  bool is_met() const { return h <= 0 && delta >= 0; }  // the ray along v meets E, from outside
  // Time to contact [s]: the smaller root of |p + t v - mu|_A = 1. Infinite if the ray misses E, and inside.
  double contact_time() const {
    return is_met() && gamma >= 0 && delta > 0 ? gamma / (delta + std::sqrt(-h))
                                               : std::numeric_limits<double>::infinity();
  }
};

inline Cone collision_cone(const GrownEllipsoid& e, Vec3 p, Vec3 v) {
  using geometry::dot;
  Cone c;
  c.r = e.centre - p, c.v = v;
  c.ar = e.a * c.r, c.av = e.a * v;
  c.beta = dot(v, c.av), c.gamma = dot(c.r, c.ar) - 1, c.delta = dot(c.r, c.av);
  c.h = c.beta * c.gamma - c.delta * c.delta;
  c.w = 2 * c.gamma * c.av - 2 * c.delta * c.ar;
  return c;
}

// The derivatives of h and gamma along a flight with acceleration a and jerk j. The third of h and the fourth
// of gamma are affine in the snap s: h''' = w . s + phi,  gamma'''' = gamma_grad_p . s + gamma_phi.
struct ConeRates {
  double delta1 = 0, delta2 = 0;  // delta', delta''
  Vec3 w1, w2;                    // w', w''
  double h1 = 0, h2 = 0, phi = 0;
  double gamma1 = 0, gamma2 = 0, gamma3 = 0, gamma_phi = 0;
};

inline ConeRates cone_rates(const GrownEllipsoid& e, const Cone& c, Vec3 a, Vec3 j) {
  using geometry::dot;
  const Vec3 aa = e.a * a, aj = e.a * j;
  const double v_aa = dot(c.v, aa), a_aa = dot(a, aa), v_aj = dot(c.v, aj);
  ConeRates d;
  d.delta1 = -c.beta + dot(c.r, aa);
  d.delta2 = -3 * v_aa + dot(c.r, aj);
  d.w1 = 2 * (c.gamma * aa - c.delta * c.av - d.delta1 * c.ar);
  d.w2 = 2 * (c.gamma * aj - 3 * c.delta * aa - d.delta2 * c.ar);
  d.h1 = dot(c.w, a);
  d.h2 = dot(c.w, j) + dot(d.w1, a);
  d.phi = 2 * dot(d.w1, j) + dot(d.w2, a);
  d.gamma1 = -2 * c.delta;
  d.gamma2 = -2 * d.delta1;
  d.gamma3 = -2 * d.delta2;
  d.gamma_phi = 6 * a_aa + 8 * v_aj;
  return d;
}

// Rows over the acceleration (h has relative degree 1), and over (u_T'', tau) with u_T = T / m (relative degree 3).
struct AccelerationRow {
  Vec3 row;
  double bound = 0;
};
struct SnapRow {
  std::array<double, 4> row{};
  double bound = 0;
};

// h' + alpha h >= 0, the CBF condition of forward invariance. With a = 0 it holds by exactly alpha h.
inline AccelerationRow cone_row(const Cone& c, double alpha) { return {c.w, -alpha * c.h}; }

// For a vehicle inside (gamma < 0), where h >= 0 is impossible: gamma is of second order in a, and
// gamma'' + 2 k gamma' + k^2 gamma >= 0 drives it to zero from below with a double pole at -k.
inline AccelerationRow escape_row(const Cone& c, double k) {
  return {c.gamma_grad_p(), -2 * c.beta + 4 * k * c.delta - k * k * c.gamma};
}

// Maps the input to the position. Dynamic extension: u_T = T / m and its rate are states, u_T'' is the input,
//   p'''' = drift + per_thrust u_T'' + per_torque tau.
struct SnapMap {
  Vec3 acceleration, jerk;  // [m/s^2, m/s^3]
  Vec3 drift;               // F_p
  Vec3 per_thrust;          // G_T = b, the thrust axis
  Mat3 per_torque;          // G_tau = -u_T C hat(e3) J^-1: a yaw torque does not move the position
};

inline SnapMap snap_map(const Quadrotor& body, const FlightState& state) {
  using geometry::cross, geometry::e3, geometry::transposed_times;
  const Mat3 r = body_from_inertial(state.x.sigma);
  const Vec3 omega = state.x.omega, j = body.inertia();
  const double u = state.thrust / body.mass(), u1 = state.thrust_rate / body.mass();
  const Vec3 turn = cross(omega, e3);  // b' in body components
  const Vec3 gyration = geometry::divide(cross(omega, geometry::multiply(j, omega)), j);
  SnapMap m;
  m.per_thrust = transposed_times(r, e3);
  m.acceleration = u * m.per_thrust - body.gravity() * e3;
  m.jerk = transposed_times(r, u1 * e3 + u * turn);
  m.drift = transposed_times(r, 2 * u1 * turn + u * (cross(omega, turn) + cross(e3, gyration)));
  m.per_torque =
      -u * (geometry::transpose(r) * geometry::hat(e3) * geometry::diagonal(geometry::divide(Vec3{1, 1, 1}, j)));
  return m;
}

// Feedback linearisation: the torque about x and y, and u_T'', for a snap and `torque_z`; requires nonzero thrust.
inline std::array<double, 4> snap_input(const Quadrotor& body, const FlightState& state, const SnapMap& map,
                                        Vec3 snap, double torque_z) {
  const Vec3 snap_body = body_from_inertial(state.x.sigma) * (snap - map.drift), j = body.inertia();
  const double u = state.thrust / body.mass();
  return {snap_body.z, -j.x * snap_body.y / u, j.y * snap_body.x / u, torque_z};
}

// The expression direction . p'''' as a row: direction . p'''' + drift >= 0.
inline SnapRow snap_row(const SnapMap& m, Vec3 direction, double drift) {
  const Vec3 torque = geometry::transposed_times(m.per_torque, direction);
  return {{geometry::dot(direction, m.per_thrust), torque.x, torque.y, torque.z},
          -(geometry::dot(direction, m.drift) + drift)};
}

// psi_0 = h and psi_i = psi_{i-1}' + lambda psi_{i-1}: the exponential barrier keeps h >= 0 from where all are >= 0.
inline std::array<double, 3> ecbf_psi(const Cone& c, const ConeRates& d, double lambda) {
  return {c.h, d.h1 + lambda * c.h, d.h2 + 2 * lambda * d.h1 + lambda * lambda * c.h};
}

// h''' + 3 l h'' + 3 l^2 h' + l^3 h >= 0: pole placement, a triple pole at -l = -lambda [1/s].
inline SnapRow ecbf_row(const Cone& c, const ConeRates& d, const SnapMap& m, double lambda) {
  return snap_row(m, c.w, d.phi + lambda * (3 * d.h2 + lambda * (3 * d.h1 + lambda * c.h)));
}

// (d/dt + k)^4 gamma >= 0: the escape from inside, a quadruple pole at -k [1/s].
inline SnapRow snap_escape_row(const Cone& c, const ConeRates& d, const SnapMap& m, double k) {
  return snap_row(m, c.gamma_grad_p(),
                  d.gamma_phi + k * (4 * d.gamma3 + k * (6 * d.gamma2 + k * (4 * d.gamma1 + k * c.gamma))));
}

}  // namespace alula::flight
