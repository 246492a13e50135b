// Selection of the ellipsoids that become rows of a tick, and of local balls for the obstacles of another map.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "alula/filters/safety_filter.hpp"
#include "alula/filters/shield.hpp"

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
//
// The obstacles of a second map, such as the hulls of a cover or a fence, are candidates too: those within the gate,
// by their distance to the vehicle. For the rows of cones each is replaced by a local ball, which touches the surface
// of the obstacle from inside at the point nearest to the vehicle, grown by a radius. The ball moves with the vehicle
// and the rows do not see that, nor does it contain the obstacle: these rows steer, and certify nothing. The shield
// keeps the distance to the obstacle itself. Of 100 blocked pairs in the built-in room as many reach their goals with
// balls of 0.1 m as with balls of 1 m, so the radius is no parameter.
class Pruner {
 public:
  // `others`: the second map, and the radius by which its balls are grown. Throws std::invalid_argument for invalid
  // options.
  Pruner(std::shared_ptr<const EllipsoidIndex> index, const Pruning& pruning, Surroundings others = {});

  const EllipsoidIndex& index() const { return *index_; }
  const std::shared_ptr<const EllipsoidIndex>& shared_index() const { return index_; }
  const Pruning& pruning() const { return pruning_; }

  std::size_t most() const;  // maximum number of ellipsoids among the candidates of a tick

  // Candidates from the size of the index on are obstacles of the second map, until the next call.
  bool is_local(std::uint32_t item) const { return item >= index_->size(); }
  const Contact& contact(std::uint32_t item) const { return contact_[item - index_->size()]; }
  const GrownEllipsoid& ball(std::uint32_t item) const { return ball_[item - index_->size()]; }
  double radius_of_others() const { return others_.radius_m; }
  // For reports: the number of an ellipsoid, or the size of the index plus the number of the obstacle in its map.
  std::uint32_t number(std::uint32_t item) const {
    return is_local(item) ? static_cast<std::uint32_t>(index_->size()) + contact(item).index : item;
  }

  // Forgets kept candidates; before another flight.
  void reset() { age_ = 0; }

  // Valid until the next call; nearest first, or by number when the gate is off. `approach` = false disables the
  // approach gate where v has no direction. Sets gate_m, candidates and capped.
  std::span<const Found> near(Vec3 p, Vec3 v, bool approach, FilterReport& report);

  // Computes the same ellipsoids for approach = sweep = false by measuring every ellipsoid, without the tree.
  std::span<const Found> near_by_scan(Vec3 p, Vec3 v, FilterReport& report);

 private:
  void add_others(Vec3 p, Vec3 v, bool approach, const FilterReport& report);
  std::span<const Found> capped(FilterReport& report);
  bool is_kept();
  std::span<const Found> kept(FilterReport& report) const;

  std::shared_ptr<const EllipsoidIndex> index_;
  Pruning pruning_;
  Surroundings others_;
  MapMemory memory_;
  std::vector<Contact> contact_;
  std::vector<GrownEllipsoid> ball_;  // of a contact
  std::vector<Found> found_;
  std::uint32_t age_ = 0;  // calls since the candidates were found
  double kept_gate_m_ = 0;
  bool is_kept_capped_ = false;
};

}  // namespace alula::flight
