// The distance filter of SAFER-Splat, a baseline: a double integrator among ellipsoids.
#pragma once

#include <limits>

#include "alula/acceleration_program.hpp"
#include "alula/pruning.hpp"

namespace alula::flight {

enum class SaferHessian : std::uint8_t {
  correct,   // in the world's frame
  published  // in the ellipsoid's own, semi-axes descending and the point in the positive octant, as it was published
};

struct SaferSplatOptions {
  double alpha = 5, beta = 1;  // poles of h'' + (alpha + beta) h' + alpha beta h >= 0 [1/s]
  SaferHessian hessian = SaferHessian::correct;
  bool brute = false;      // measure every ellipsoid instead of asking the index
  double max_braking = 6;  // of the fallback [m/s^2]
  double max_acceleration = std::numeric_limits<double>::infinity();  // of each axis [m/s^2]
  Pruning pruning;
};

// With the signed distance d of the vehicle's centre x to an ellipsoid, its closest point y and phi = sign(d),
//   h = phi d^2 - r^2,   grad h = 2 phi (x - y),   row:  grad h . a + v^T H v + (alpha + beta) grad h . v + alpha
//   beta h >= 0,
// H the Hessian of phi d^2; r is the index's radius and what the losses of the row add to it. The acceleration is the
// one nearest to the nominal one that holds the rows of all candidates; `margin` is the least h [m^2], and the
// status is `recovering` where that is negative. The gate of approach and the sweep are not part of it and are
// ignored; gate = false with brute = true is what was published. As h bends with d, the vehicle brakes from
// |v| <= alpha beta / (2 (alpha + beta)) d or so whatever it could do.
//
// Without a solution `infeasible` is reported and the vehicle brakes, a = -v min(alpha/2, max_braking / |v|)
// within the box, `filtered` if that is checked to hold all rows and `recovering` if not; the published filter flies
// the nominal input there. What is not finite is refused, with a = 0.
// Source: SAFER-Splat (arXiv 2409.09868), its public implementation for the published Hessian.
class SaferSplat final : public SplatFilter {
 public:
  // Throws std::invalid_argument for options that mean nothing.
  SaferSplat(std::shared_ptr<const EllipsoidIndex> index, const SaferSplatOptions& options);

  InputKind kind() const override { return InputKind::acceleration; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  std::unique_ptr<SplatFilter> clone() const override { return std::make_unique<SaferSplat>(*this); }
  const SaferSplatOptions& options() const { return options_; }
  const EllipsoidIndex& index() const { return pruner_.index(); }

  // The barrier of one ellipsoid and its row, as the filter makes them.
  struct Barrier {
    double h = 0;
    AccelerationRow row;
  };
  Barrier barrier(std::uint32_t item, Vec3 p, Vec3 v) const;

 private:
  SaferSplatOptions options_;
  Pruner pruner_;
  AccelerationProgram program_;
};

}  // namespace alula::flight
