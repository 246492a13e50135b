// The collision cone filter of a double integrator, p' = v, v' = a.
#pragma once

#include <limits>
#include <vector>

#include "alula/filters/acceleration_program.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/pruning.hpp"

namespace alula::flight {

// The acceleration nearest to the nominal one with, for every candidate ellipsoid,
//   outside, |v| >= min_speed:  w . a >= -alpha h           status as usual
//   outside, |v| <  min_speed:  gamma'' + 2 k gamma' + k^2 gamma >= 0    h has no meaning without a direction
//   inside (gamma < 0):         the same row, which leads out; the status is `recovering`
// and within the box of max_acceleration. `margin` is the minimum of h, or of gamma where its row is used.
//
// An ellipsoid may come within the gate with h < 0, and then h' = -alpha h is too slow for the time t_c to contact
// that is left. So alpha, of all rows of the tick, is raised to recovery / max(t_c - 0.1 s, 0.05 s): h is gone a
// tenth of a second before contact would be, and for recovery >= 2 with a bounded acceleration.
//
// A path with h = 0 touches the ellipsoid, and held inputs do not follow it to the last digit: the rows, h and gamma
// above are of ellipsoids that are a little larger than those of the index, whose inside alone is `recovering`.
//
// The rows on h alone can always be had: a = -alpha/2 v meets all of them with equality, as h is of second degree in
// v. With a box or rows on gamma there may be no solution: then `infeasible` is reported and the vehicle brakes
// along its path, a = -v min(alpha/2, max_braking / |v|) within the box, which turns no cone; the status says
// `filtered` if that is checked to hold all rows and `recovering` if not. What is not finite is refused, with a = 0.
//
// Head-on, where w is along -v but for a fiftieth, the rows only brake: a nominal input that breaks such a row gets
// a bias at right angles to v first, horizontal unless v is vertical, to the side that w leans to, or to the right.
//
// The tracking row (off by default) is soft: V = 1/2 e^T P e with A^T P + P A = -I for A = [0, 1; -kp, -kv] and
// e = (e_p, e_v) demands V' <= -c V + xi. The undisturbed tracking law satisfies it for c <= 1 / lambda_max(P), 0.73
// for the default gains, so it acts only where a cone does. Source: FastBridge (arXiv 2607.01200), eq. 9-11; the rows
// on gamma are ours.
class ConeDi final : public SplatFilter {
 public:
  // `solver` solves the program. Throws std::invalid_argument for invalid options.
  ConeDi(std::shared_ptr<const EllipsoidIndex> index, const ConeDiOptions& options, QpSolver solver = {});

  InputKind kind() const override { return InputKind::acceleration; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  std::unique_ptr<SplatFilter> clone() const override { return std::make_unique<ConeDi>(*this); }
  const ConeDiOptions& options() const { return options_; }

 private:
  Cone cone(std::uint32_t item, Vec3 p, Vec3 v) const;  // of the swollen ellipsoid
  void add_tracking_row(const Nominal& nominal);
  Vec3 bias(Vec3 v) const;

  ConeDiOptions options_;
  Pruner pruner_;
  AccelerationProgram program_;
  std::vector<Cone> cones_;  // of the candidates of a tick
};

}  // namespace alula::flight
