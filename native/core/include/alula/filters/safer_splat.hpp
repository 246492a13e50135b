// The distance filter of SAFER-Splat, a baseline: a double integrator among ellipsoids.
#pragma once

#include <limits>

#include "alula/filters/acceleration_program.hpp"
#include "alula/filters/distance_rows.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/pruning.hpp"

namespace alula::flight {

// The acceleration nearest to the nominal one that holds the rows of `distance_barrier`; `margin` is the minimum h of
// those [m^2], and the status is `recovering` where that is negative. As h bends with d, the vehicle
// brakes from |v| <= alpha beta / (2 (alpha + beta)) d or so whatever it could do: without the rows of what is far
// away that is too late, and from rest a double integrator keeps its distance only with those of all ellipsoids.
//
// SaferRows::all solves the program with the rows of all ellipsoids, to the tolerance of `AccelerationProgram`, by
// few of them: solve with those known, measure in the index what its answer may violate (`DistanceRowBound`), add the
// most violated and repeat until none is. What is optimal for some rows and holds the others is optimal for all; what
// is infeasible with some is with all. With `brute` every ellipsoid is measured first and the same rounds go over
// those rows. `margin` is that of the map. A tick remembers nothing of those before. Should the rounds not end, it
// counts as infeasible. `candidates` are the ellipsoids measured, `rows` those of the last program.
//
// SaferRows::nearest hands the rows of the pruning's candidates to the program at once; gates of approach and sweep
// are ignored. With gate = false and brute = true that is the published computation.
//
// Without a solution `infeasible` is reported and the vehicle brakes, a = -v min(alpha/2, max_braking / |v|)
// within the box, `filtered` if that is checked to hold all rows and `recovering` if not; the published filter flies
// the nominal input there. What is not finite is refused, with a = 0.
class SaferSplat final : public SplatFilter {
 public:
  // Throws std::invalid_argument for invalid options.
  SaferSplat(std::shared_ptr<const EllipsoidIndex> index, const SaferSplatOptions& options);

  InputKind kind() const override { return InputKind::acceleration; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  std::unique_ptr<SplatFilter> clone() const override { return std::make_unique<SaferSplat>(*this); }
  const SaferSplatOptions& options() const { return options_; }
  const EllipsoidIndex& index() const { return pruner_.index(); }
  const DistanceLaw& law() const { return rows_.law(); }

 private:
  void add_nearest(Vec3 p, Vec3 v, FilterReport& report);
  bool solve_for_all(FilterReport& report, bool unsafe);

  SaferSplatOptions options_;
  Pruner pruner_;
  DistanceRows rows_;
  AccelerationProgram program_;
};

}  // namespace alula::flight
