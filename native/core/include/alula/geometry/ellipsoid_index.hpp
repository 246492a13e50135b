// Spatial index of the ellipsoids of a splat: the cost of a query depends on the number of near ellipsoids, not on
// the size of the map.
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

// {y : (y - centre)^T A (y - centre) <= 1}: the obstacle of a barrier, grown by the vehicle's radius.
struct GrownEllipsoid {
  geometry::Vec3 centre;
  geometry::Mat3 a;  // symmetric positive definite [1/m^2]
};

// An ellipsoid found by a query, and the distance of its ungrown set from the queried point or segment [m].
struct Found {
  std::uint32_t item;
  double distance;
};

inline constexpr auto nearer_found = [](const Found& a, const Found& b) {
  return a.distance != b.distance ? a.distance < b.distance : a.item < b.item;
};

// Work of a query: what it visited.
struct QueryCost {
  std::uint32_t nodes = 0, items = 0;
};

// Built once per map, shared by threads; queries are const and allocate only in `found`.
class EllipsoidIndex {
 public:
  // Builds the ellipsoids of `splats` at the level `sigma`, each with its losses (`level_of`). The obstacle of each
  // is the ellipsoid that contains its Minkowski sum with a ball of `radius` [m]:
  //   Sigma' = (1 + 1/p) Sigma + (1 + p) r^2 I,   p = sqrt(tr Sigma / (3 r^2)),   Sigma with sigma^2 in it.
  // Throws std::invalid_argument as `check_splats` does, or for a radius that is not finite and positive.
  EllipsoidIndex(const Splats& splats, double sigma, double radius);

  std::size_t size() const { return grown_.size(); }
  double radius() const { return radius_; }
  const GrownEllipsoid& grown(std::uint32_t item) const { return grown_[slot_[item]]; }
  GrownEllipsoid grown(std::uint32_t item, double more_m) const;  // of a radius that is so much larger

  // The ungrown set of an item: an ellipsoid, and the radius of the ball that its losses add to it [m].
  geometry::Ellipsoid ellipsoid(std::uint32_t item) const { return at_slot(slot_[item]); }
  double ball(std::uint32_t item) const { return level(slot_[item]).inflation; }

  // Finds the at most `count` ellipsoids nearest to the segment a..b and nearer to it than `reach`, by distance, ties
  // by number. The distance is that of the ungrown set: of a point (a == b) exact and negative inside, of a segment
  // exact to 1e-9 of the reach. Ellipsoids that a segment meets are at distance 0 and ordered by their distance to a;
  // those not nearer than `reach` to a are left out. `found` is replaced; its previous entries are evaluated first,
  // which speeds up a query similar to the last one and does not change its result.
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                    std::vector<Found>& found) const;

  // The same among ellipsoids that a vehicle at `a` with velocity v approaches, r^T A v >= 0, or is inside of,
  // r^T A r < 1, with r from a to the centre and A of the grown ellipsoid.
  QueryCost nearest_ahead(geometry::Vec3 a, geometry::Vec3 b, geometry::Vec3 v, double reach, std::size_t count,
                          std::vector<Found>& found) const;

  // Calls visit(item) for every ungrown set that may have bound(box, ball) below `limit`, roughly the smallest first.
  // `bound` must hold for all sets in the box with losses of at most `ball`, and must not decrease as either shrinks.
  // `visit` may lower the limit; `heap` is scratch memory.
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

  // True if some ungrown set is nearer than `reach` to the segment a..b; exact to 1e-9 of the reach.
  bool is_near(geometry::Vec3 a, geometry::Vec3 b, double reach) const;

  // Signed distance of a point to the nearest ungrown set, at most `cap`. `hint` is a guess of that set, updated by
  // the call; it does not change the result.
  double clearance(geometry::Vec3 point, double cap, std::uint32_t& hint) const;

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  // The data of an ellipsoid that a search reads, in the order of the tree's leaves.
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

  // Distance of the ungrown set to a; if it is above `enough`, any value above `enough` may be returned.
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

// Minimum of gamma = r^T A r - 1, r = centre - p, over all grown ellipsoids and the points (3 numbers each): below 0
// inside one; infinite without ellipsoids or points. Exact up to rounding; visits each ellipsoid once per 64 points.
double least_gamma(const EllipsoidIndex& index, std::span<const double> points);

}  // namespace alula
