// Which ellipsoids of a map become rows of a tick.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "alula/filters/splat_filter.hpp"

namespace alula::flight {

// The distance gate at a speed, from the vehicle's centre to an ungrown ellipsoid [m]: what it takes to react and
// to brake to rest, and the vehicle's radius, but no less than the floor. Part of what "safe" means: without it the
// cones of a room close almost every direction, and with less the vehicle cannot stop for what it has not seen.
double gate_distance(const Pruning& pruning, double speed, double radius);

// Finds the candidates of a tick, in this order: the distance gate about the vehicle; the approach gate
// r^T A v >= 0, which a vehicle inside an ellipsoid (gamma < 0) passes anyway; of those the `count` nearest, to
// the straight path along which it would react and brake with `sweep`, else to the vehicle. An ellipsoid that
// turns from receding to approaching does so with delta = 0 and h = beta gamma > 0, so a first-order row starts
// inside its safe set; a row of higher order has to look at its own psi_1, psi_2.
class Pruner {
 public:
  // Throws std::invalid_argument for invalid options.
  Pruner(std::shared_ptr<const EllipsoidIndex> index, const Pruning& pruning);

  const EllipsoidIndex& index() const { return *index_; }
  const std::shared_ptr<const EllipsoidIndex>& shared_index() const { return index_; }
  const Pruning& pruning() const { return pruning_; }

  std::size_t most() const;  // candidates of a tick, at most

  // Valid until the next call; nearest first, by number when the gate is off. `approach` can switch the approach
  // gate off where v has no direction. Sets gate_m, candidates and capped.
  std::span<const Found> near(Vec3 p, Vec3 v, bool approach, FilterReport& report);

  // The same ellipsoids for approach = sweep = false by measuring every one of them, without the tree.
  std::span<const Found> near_by_scan(Vec3 p, Vec3 v, FilterReport& report);

 private:
  std::span<const Found> capped(FilterReport& report);

  std::shared_ptr<const EllipsoidIndex> index_;
  Pruning pruning_;
  std::vector<Found> found_;
};

}  // namespace alula::flight
