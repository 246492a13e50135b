// Distance filter of SAFER-Splat, a baseline: a double integrator among ellipsoids.
#pragma once

#include <limits>

#include "alula/filters/acceleration_program.hpp"
#include "alula/filters/distance_rows.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/pruning.hpp"

namespace alula::flight {

// Returns the acceleration nearest to the nominal one that satisfies the rows of `distance_barrier`. `margin` is
// their minimum h [m^2], and the status is `recovering` where it is negative. Because h is quadratic in d, the
// vehicle brakes from about |v| <= alpha beta / (2 (alpha + beta)) d, regardless of its braking limit. Without the
// rows of distant ellipsoids that is too late, and from rest a double integrator keeps its distance only with the
// rows of all ellipsoids.
//
// SaferRows::all solves the program with the rows of all ellipsoids, to the tolerance of `AccelerationProgram`, by
// adding rows on demand: solve with the current rows, measure in the index the ellipsoids whose rows the solution may
// violate (`DistanceRowBound`), add the most violated rows and repeat until none is violated. A solution that is
// optimal for some rows and satisfies the others is optimal for all; a program that is infeasible with some rows is
// infeasible with all. With `brute` every ellipsoid is measured first and the same rounds use those rows. `margin` is
// the minimum over the map. Ticks are independent of each other. If the rounds reach their limit, the tick counts as
// infeasible. `candidates` are the ellipsoids measured, `rows` those of the last program.
//
// SaferRows::nearest does the same for the ellipsoids within the gate. With a maximum number of rows, candidates kept
// for several calls, no gate or `brute` it passes the rows of the pruning's candidates to the program in one round;
// gates of approach and sweep are ignored. With gate = false and brute = true that is the published computation.
//
// Without a solution `infeasible` is reported and the vehicle brakes, a = -v min(alpha/2, max_braking / |v|)
// within the box. The status is `filtered` if this satisfies all rows and `recovering` if not; the published filter
// flies the nominal input there. Inputs that are not finite are refused, with a = 0.
// Where the motion contradicts the model, the radius of the rows grows by `way_before_reaction` (disturbance.hpp) of
// the state's bound, as far as there is room (`DistanceLaw::more_m`).
class SaferSplat final : public SafetyFilter {
 public:
  // Rows are also of the obstacles of `others`, if it has a map: those of `contact_barrier`, for its radius. Throws
  // std::invalid_argument for invalid options.
  SaferSplat(std::shared_ptr<const EllipsoidIndex> index, const SaferSplatOptions& options, Surroundings others = {});

  CommandKind kind() const override { return CommandKind::acceleration; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { pruner_.reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<SaferSplat>(*this); }
  const SaferSplatOptions& options() const { return options_; }
  const EllipsoidIndex& index() const { return pruner_.index(); }
  const DistanceLaw& law() const { return rows_.law(); }

 private:
  void add_nearest(Vec3 p, Vec3 v, double more, FilterReport& report);
  bool solve_on_demand(FilterReport& report, bool unsafe);

  SaferSplatOptions options_;
  Pruner pruner_;
  DistanceRows rows_;
  AccelerationProgram program_;
};

}  // namespace alula::flight
