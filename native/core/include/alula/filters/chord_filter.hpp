// A filter of velocities for a vehicle that follows its commanded velocity with a lag.
//
// A velocity filter assumes a point whose velocity is its input. A vehicle follows a command u with a lag; to first
// order dv/dt = (u - v) / tau. Its lead point
//
//   q = p + tau v,     dq/dt = v + tau dv/dt = u,
//
// is such a point. Since p + tau dp/dt = q, p is a low-pass of q, dp/dt = (q - p) / tau, whatever the vehicle does.
// While u = 0, p comes to rest along the chord from p to q. Therefore the whole chord must be clear. It is not
// sufficient to keep p clear, because p alone does not contain the speed, nor to keep q clear, because p follows q
// around corners by a shorter path. With psi_k(s) = max_l a_kl(s) for hull k and a_kl(s) = n_kl . s - d_kl, let
//
//   D_k = min over s on the chord of psi_k(s),   attained at s* = p + theta (q - p).
//
// By the minimax theorem (a linear program and its dual) there are facet weights lambda_l >= 0 of sum 1 such that
// a = sum lambda_l a_kl is at least D_k on the whole chord and equals D_k at s*. Let n be the gradient of a. Then
// n . (q - p) is zero for 0 < theta < 1, not negative for theta = 0, and not positive for theta = 1. At the ends of
// the chord
//
//   da(p)/dt = n . (q - p) / tau   and   da(q)/dt = n . u.
//
// The former is not negative where it matters (theta < 1), so n . u >= -beta (D_k - r) implies
// dD_k/dt >= -beta (D_k - r): a chord with distance r to the hull keeps it, and so does its end p. This is the
// condition of the filter itself, at s* instead of p. It is evaluated at p and at points of the chord up to q. The
// velocity u passes through the filter at each point in turn, at most three times, the point nearest to a hull last,
// until no point changes it; if they do not agree it is shortened until they do. The step from a point to the next is
// half of psi - r there, or a twelfth of the chord (0.02 to 0.2 m) if that is more. Along a step of the first kind
// psi - r stays at least half of its value, because it changes by at most 1 m per m.
//
// Where the chord has entered the margin of a hull, q is driven back behind the point of entry, towards p. The
// shortest path out of the hull is not taken, because it may lead through a thin wall.
//
// If the vehicle is not of first order, dv/dt = (u - v) / tau + e, q moves with u + tau e, and the guarantee is
// D >= r - tau max|e| / beta. Too large a tau is safe; too small a tau is not. With a true lag tau_0 and q at a
// distance h from a wall, dh/dt = v + (tau / tau_0) (u - v) and u = -beta h have real poles, and do not oscillate,
// unless 1 + beta tau < 2 sqrt(beta tau_0). Near a wall at a distance h_p the speed is then about
// h_p / (1 / beta + tau), and the deceleration at most the speed divided by that time. A vehicle that cannot
// decelerate as fast requires a larger tau or a lower speed.
//
// Wind and whatever else contradicts a first-order response of at most the lag tau are such an e. It is estimated as
// d^ with a bound r on the rest (response.hpp: the residual of an interval of responses, so a vehicle that is merely
// faster has none). The filter is then evaluated for the velocity u + tau d^ with which q moves, and what it returns
// is reduced by tau d^ again. The rest moves q by at most
//
//   m = tau int |e - d^| dt <= tau r t,
//
// t the time until it is estimated and countered (`way_before_reaction`), and p comes to rest within the chord to the
// moved q. So m is how many metres a residual of r moves the vehicle before it rests: the margin grows by m, and a
// chord that keeps r + m before the residual keeps r after it. (For a residual that stays, m is the loss tau r / beta
// above at beta = 1 / t.) Where a hull is nearer than the grown margin, D_k may not decrease. The grown margin drives
// nothing out of hulls, because a velocity away from one hull leads to another.
//
// With a lag of its own for each axis, T = diag(tau_i), q = p + T v still moves with u, but p comes to rest along the
// curve c(t) = p + T (1 - E) v, E = diag(exp(-t / tau_i)). Its points move with dc/dt = E v + (1 - E) u, and E v is
// the tangent of the curve. So the condition at the point nearest to a hull is n . (1 - E) u >= -beta (D_k - r). With
// M = (1 - E) / max_i (1 - E_i), the filter is evaluated there for the velocity M u, and what it returns is divided
// by M: n . M u >= -beta (D_k - r) is sufficient, because the maximum is at most 1. With equal lags the curve is the
// chord and M is 1.
//
// Source: the chord and its condition are new here; input-to-state safety: Kolathaya and Ames 2019.
#pragma once

#include <memory>
#include <vector>

#include "alula/filters/safety_filter.hpp"

namespace alula::flight {

// A filter of velocities, evaluated on the chord from p to p + lag_s v, or on the curve to it. Its answer must depend
// on its arguments alone; it is evaluated several times a tick. With a lag of 0 it is evaluated at p alone.
//
// A velocity above `max_speed` would reach the vehicle before anything can react to it, so it counts as a failure of
// the filter, like a number that is not finite: `filter` throws std::invalid_argument.
class ChordFilter final : public SafetyFilter {
 public:
  // Throws std::invalid_argument for another kind of filter, and for a lag or speed [m/s] out of range. Either all
  // axes lag or none does.
  ChordFilter(const SafetyFilter& filter, geometry::PerAxis lag_s, double max_speed);
  ChordFilter(const ChordFilter& other) : ChordFilter(*other.filter_, other.lag_, other.max_speed_) {}
  ChordFilter& operator=(const ChordFilter&) = delete;

  CommandKind kind() const override { return CommandKind::velocity; }
  // `margin` and `active` are those of the point of the chord nearest to an obstacle.
  // Throws like the filter. The velocity returned may exceed `max_speed` by the counter of a disturbance.
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { filter_->reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<ChordFilter>(*this); }
  bool shares_state() const override { return filter_->shares_state(); }

 private:
  struct Evaluated {
    Vec3 x;
    Vec3 share;  // diagonal of M
    FilterReport report;
  };

  FilterReport filter_moved(Vec3 u);
  FilterReport evaluate(Vec3 x, Vec3 share, Vec3 u);
  Evaluated point_at(double theta, Vec3 p, Vec3 chord, Vec3 u);
  void go_along(Vec3 p, Vec3 chord, Vec3 u);
  FilterReport agreed(const FilterReport& worst, Vec3 u);
  FilterReport driven_out(Vec3 clear, Evaluated blocked, Vec3 p, Vec3 chord, Vec3 u);

  std::unique_ptr<SafetyFilter> filter_;
  geometry::PerAxis lag_;
  double max_speed_;
  FlightState at_;  // of this tick, with the position of a point
  Nominal wanted_;  // of this tick, with the velocity to evaluate
  std::vector<Evaluated> points_;
};

}  // namespace alula::flight
