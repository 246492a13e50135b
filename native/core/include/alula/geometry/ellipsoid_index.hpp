// Ellipsoids of a splat, found by distance: a tick costs by what is near, not by what exists.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "alula/geometry/clearance.hpp"
#include "alula/geometry/ellipsoid.hpp"
#include "alula/geometry/ellipsoid_tree.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula {

// {y : (y - centre)^T A (y - centre) <= 1}: the obstacle of a barrier, grown by the vehicle.
struct GrownEllipsoid {
  geometry::Vec3 centre;
  geometry::Mat3 a;  // symmetric positive definite [1/m^2]
};

// An ellipsoid that was found, and how far its ungrown set is from what was asked about [m].
struct Found {
  std::uint32_t item;
  double distance;
};

// What a query looked at.
struct QueryCost {
  std::uint32_t nodes = 0, items = 0;
};

// Built once per map, shared by threads; queries are const and allocate only in `found`.
class EllipsoidIndex {
 public:
  // The ellipsoids of `splats` at the level `sigma`, each with its losses (`level_of`), and as obstacle the
  // ellipsoid that contains its Minkowski sum with a ball of `radius` [m]:
  //   Sigma' = (1 + 1/p) Sigma + (1 + p) r^2 I,   p = sqrt(tr Sigma / (3 r^2)),   Sigma with sigma^2 in it.
  // Throws std::invalid_argument as `check_splats` does, or for a radius that is not finite and positive.
  EllipsoidIndex(const Splats& splats, double sigma, double radius);

  std::size_t size() const { return grown_.size(); }
  double radius() const { return radius_; }
  const GrownEllipsoid& grown(std::uint32_t item) const { return grown_[slot_[item]]; }

  // The ungrown set of an item: an ellipsoid, and the radius of the ball that its losses add to it [m].
  geometry::Ellipsoid ellipsoid(std::uint32_t item) const { return at_slot(slot_[item]); }
  double ball(std::uint32_t item) const { return level(slot_[item]).inflation; }

  // The at most `count` ellipsoids nearest to the segment a..b of those nearer than `reach` to it, by distance, ties
  // by number. The distance is that of the ungrown set: of a point (a == b) exact and negative inside, of a segment
  // exact to 1e-9 of the reach. Those that a segment meets are at distance 0 and ordered by that of a, those not
  // nearer than `reach` to a are left out. `found` is replaced; what it holds before is looked at first, which makes
  // a query fast that is much like the last one and cannot change its result.
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                    std::vector<Found>& found) const;

  // The same among those that a vehicle at `a` with the velocity v approaches, r^T A v >= 0, or is in, r^T A r < 1,
  // with r from a to the centre and A of the grown ellipsoid.
  QueryCost nearest_ahead(geometry::Vec3 a, geometry::Vec3 b, geometry::Vec3 v, double reach, std::size_t count,
                          std::vector<Found>& found) const;

  // Calls visit(item) for every ungrown set that may have bound(box, ball) below `limit`, roughly the least first:
  // `bound` holds for all sets in the box with losses of at most `ball`, and does not fall as either shrinks. `visit`
  // may lower the limit, `heap` is room to work in.
  template <class Bound, class Visit>
  void visit_least(std::vector<geometry::Bvh::Pending>& heap, const double& limit, Bound&& bound,
                   Visit&& visit) const {
    halves_.visit_least(
        heap, limit,
        [&](std::uint32_t node, const geometry::Box& box) { return bound(box, double{shape_[node].ball}); },
        [&](std::uint32_t slot, std::uint32_t item) {
          if (!(bound(around(slot), level(slot).inflation) >= limit)) visit(item);
        });
  }

  // Whether some ungrown set is nearer than `reach` to the segment a..b; exact to 1e-9 of the reach.
  bool is_near(geometry::Vec3 a, geometry::Vec3 b, double reach) const;

  // Signed distance of a point to the nearest ungrown set, at most `cap`. `hint` is a guess that is updated; it
  // cannot change the result.
  double clearance(geometry::Vec3 point, double cap, std::uint32_t& hint) const;

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  // What a search reads of an ellipsoid, in the order of the tree's leaves.
  struct Row {
    float mean[3], scale[3], quat_wxyz[4];
  };

  template <class Accept>
  QueryCost search(const geometry::EllipsoidTree::Sight& sight, std::size_t count, std::vector<Found>& found,
                   Accept&& accept) const;
  // The ungrown ellipsoid and the segment a + t d along its axes, to be measured up to `enough`.
  geometry::Sighted sighted(std::uint32_t slot, geometry::Vec3 a, geometry::Vec3 d, double enough) const;
  Level level(std::uint32_t slot) const { return level_.size() == 1 ? level_[0] : level_[slot]; }
  geometry::Ellipsoid at_slot(std::uint32_t slot) const;

  // A box around the set without the ball of its losses, cheaper than the tightest.
  geometry::Box around(std::uint32_t slot) const {
    const Row& row = row_[slot];
    const double half =
        (1 + 1e-12) * level(slot).sigma * double{std::max({row.scale[0], row.scale[1], row.scale[2]})};
    geometry::Box box;
    for (int i = 0; i < 3; ++i) {
      const double reach = half + 1e-15 * std::abs(double{row.mean[i]});
      box.lower[i] = row.mean[i] - reach, box.upper[i] = row.mean[i] + reach;
    }
    return box;
  }

  bool centre_is_nearer(std::uint32_t slot, geometry::Vec3 a, double reach) const {
    const float* mean = row_[slot].mean;
    const geometry::Vec3 to{mean[0] - a.x, mean[1] - a.y, mean[2] - a.z};
    return reach > 0 && geometry::dot(to, to) < reach * reach * (1 - 1e-12);
  }

  // Of the ungrown set to a; anything above `enough` stands for one above it.
  double distance_of(std::uint32_t slot, geometry::Vec3 a, double enough) const;

  geometry::Bvh halves_;
  std::vector<geometry::EllipsoidTree::Shape> shape_;  // of a node of halves_
  geometry::EllipsoidTree tree_;                       // the same, for searches by distance
  std::vector<GrownEllipsoid> grown_;                  // of a slot
  std::vector<std::uint32_t> slot_;                    // of an item
  std::vector<std::uint32_t> item_;                    // of a slot
  std::vector<Row> row_;                               // of a slot
  std::vector<Level> level_;                           // of a slot, or one for all
  double radius_;
};

}  // namespace alula
