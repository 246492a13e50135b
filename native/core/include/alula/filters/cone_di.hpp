// Collision cone filter of a double integrator, p' = v, v' = a.
#pragma once

#include <limits>
#include <vector>

#include "alula/filters/acceleration_program.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/pruning.hpp"

namespace alula::flight {

// Returns the acceleration nearest to the nominal one that satisfies, for every candidate ellipsoid,
//   outside, |v| >= min_speed:  w . a >= -alpha h           status as usual
//   outside, |v| <  min_speed:  gamma'' + 2 k gamma' + k^2 gamma >= 0    h has no meaning without a direction
//   inside (gamma < 0):         the same row, which leads out; the status is `recovering`
// and the box of max_acceleration. `margin` is the minimum of h, or of gamma where the gamma row is used.
//
// An ellipsoid may enter the gate with h < 0. Then h' = -alpha h is too slow for the remaining time t_c to contact.
// So alpha of all rows of the tick is raised to recovery / max(t_c - 0.1 s, 0.05 s): h reaches 0 a tenth of a second
// before contact, and for recovery >= 2 with a bounded acceleration.
//
// A path with h = 0 touches the ellipsoid, and held inputs follow it with a small error. Therefore rows, h and gamma
// above use ellipsoids a little larger than those of the index; the status is `recovering` only inside those of the
// index.
//
// The rows on h alone are always feasible: a = -alpha/2 v satisfies all of them with equality, as h is quadratic in
// v. With a box or rows on gamma there may be no solution. Then `infeasible` is reported and the vehicle brakes along
// its path, a = -v min(alpha/2, max_braking / |v|) within the box, which keeps the direction of v. The status is
// `filtered` if this satisfies all rows and `recovering` if not. Inputs that are not finite are refused, with a = 0.
//
// Head-on, where w is along -v up to a sideways part of 0.02, the rows only brake. There a nominal input that breaks
// such a row first gets a bias perpendicular to v, horizontal unless v is vertical. The bias points to the side that
// w leans to, or to the right.
//
// The tracking row (off by default) is soft: V = 1/2 e^T P e with A^T P + P A = -I for A = [0, 1; -kp, -kv] and
// e = (e_p, e_v) demands V' <= -c V + xi. The undisturbed tracking law satisfies it for c <= 1 / lambda_max(P), 0.73
// for the default gains, so it acts only where a cone does. Source: FastBridge (arXiv 2607.01200), eq. 9-11; the rows
// on gamma are alula's own.
// Where the motion contradicts the model, the radius of each ellipsoid grows by `way_before_reaction`
// (disturbance.hpp) of the state's bound, or by the largest half, quarter or eighth of that from which the vehicle is
// still a second away: a growing ellipsoid is no reason for a violent turn.
class ConeDi final : public SafetyFilter {
 public:
  // `solver` solves the program. Throws std::invalid_argument for invalid options.
  ConeDi(std::shared_ptr<const EllipsoidIndex> index, const ConeDiOptions& options, QpSolver solver = {});

  CommandKind kind() const override { return CommandKind::acceleration; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { pruner_.reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<ConeDi>(*this); }
  const ConeDiOptions& options() const { return options_; }

 private:
  Cone cone(std::uint32_t item, Vec3 p, Vec3 v, double more) const;  // cone of the enlarged ellipsoid
  Cone cone_of(const GrownEllipsoid& e, Vec3 p, Vec3 v) const;
  void add_tracking_row(const Nominal& nominal);
  Vec3 bias(Vec3 v) const;

  ConeDiOptions options_;
  Pruner pruner_;
  AccelerationProgram program_;
  std::vector<Cone> cones_;  // of the candidates of a tick
};

}  // namespace alula::flight
