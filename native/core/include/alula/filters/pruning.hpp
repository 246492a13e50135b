// Selection of the map's ellipsoids that become rows of a tick.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "alula/filters/safety_filter.hpp"

namespace alula::flight {

// The distance gate at a speed, from the vehicle's centre to an ungrown ellipsoid [m]: the distance to react and
// brake to rest plus the vehicle's radius, but no less than the floor. The gate is part of the definition of "safe":
// without it the cones of a room close almost every direction; with a shorter one the vehicle cannot stop for
// obstacles beyond it.
double gate_distance(const Pruning& pruning, double speed, double radius);

// Finds the candidates of a tick, in this order: the distance gate about the vehicle; the approach gate
// r^T A v >= 0, which an ellipsoid that contains the vehicle (gamma < 0) always passes; of these the `count` nearest,
// to the straight path along which the vehicle would react and brake with `sweep`, else to the vehicle. An ellipsoid
// that turns from receding to approaching does so with delta = 0 and h = beta gamma > 0, so a first-order row starts
// inside its safe set; for a row of higher order the filter must check psi_1 and psi_2. With `hold` above 1 the
// candidates of a call serve the next calls too, as of a slower thread, and the gate does not see what has come
// nearer.
class Pruner {
 public:
  // Throws std::invalid_argument for invalid options.
  Pruner(std::shared_ptr<const EllipsoidIndex> index, const Pruning& pruning);

  const EllipsoidIndex& index() const { return *index_; }
  const std::shared_ptr<const EllipsoidIndex>& shared_index() const { return index_; }
  const Pruning& pruning() const { return pruning_; }

  std::size_t most() const;  // maximum number of candidates of a tick

  // Forgets kept candidates; before another flight.
  void reset() { age_ = 0; }

  // Valid until the next call; nearest first, or by number when the gate is off. `approach` = false disables the
  // approach gate where v has no direction. Sets gate_m, candidates and capped.
  std::span<const Found> near(Vec3 p, Vec3 v, bool approach, FilterReport& report);

  // Computes the same ellipsoids for approach = sweep = false by measuring every ellipsoid, without the tree.
  std::span<const Found> near_by_scan(Vec3 p, Vec3 v, FilterReport& report);

 private:
  std::span<const Found> capped(FilterReport& report);
  bool is_kept();
  std::span<const Found> kept(FilterReport& report) const;

  std::shared_ptr<const EllipsoidIndex> index_;
  Pruning pruning_;
  std::vector<Found> found_;
  std::uint32_t age_ = 0;  // calls since the candidates were found
  double kept_gate_m_ = 0;
  bool is_kept_capped_ = false;
};

}  // namespace alula::flight
