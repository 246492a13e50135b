// Ellipsoids of a splat, found by distance: a tick costs by what is near, not by what exists.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "alula/bvh.hpp"
#include "alula/clearance.hpp"
#include "alula/ellipsoid.hpp"
#include "alula/mat3.hpp"

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
  const GrownEllipsoid& grown(std::uint32_t item) const { return grown_[item]; }

  // The ungrown set of an item: an ellipsoid, and the radius of the ball that its losses add to it [m].
  geometry::Ellipsoid ellipsoid(std::uint32_t item) const { return at_slot(slot_[item]); }
  double ball(std::uint32_t item) const { return level(slot_[item]).inflation; }

  // The at most `count` ellipsoids nearest to the segment a..b of those nearer than `reach`, by distance, ties
  // by number. The distance is that of the ungrown set, negative inside: exact for a point (a == b), and for a
  // segment exact to 1e-9 of the reach. `found` is replaced.
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                    std::vector<Found>& found) const {
    return nearest(a, b, reach, count, found, [](std::uint32_t) { return true; });
  }

  // The same of those whose ungrown set is also nearer than `reach` to a, and that `accept(item)`.
  template <class Accept>
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count, std::vector<Found>& found,
                    Accept&& accept) const {
    found.clear();
    QueryCost cost;
    if (count == 0 || !(reach > -kInfinity)) return cost;
    const geometry::Vec3 d = b - a;
    const bool is_point = d.x == 0 && d.y == 0 && d.z == 0;
    double within = reach;  // of the farthest that is kept, once there are enough
    cost.nodes = tree_.visit_near(a, d, within, [&](std::uint32_t slot, std::uint32_t item) {
      const double distance = distance_of(slot, a, d, within);
      ++cost.items;
      if (distance > within || (found.size() < count && !(distance < reach))) return;
      if (found.size() == count && !nearer({item, distance}, found.front())) return;
      if (!is_point && !(distance_of(slot, a, {}, reach) < reach)) return;
      if (!accept(item)) return;
      if (found.size() == count) {
        std::pop_heap(found.begin(), found.end(), nearer);
        found.back() = {item, distance};
      } else {
        found.push_back({item, distance});
      }
      std::push_heap(found.begin(), found.end(), nearer);
      if (found.size() == count) within = found.front().distance;
    });
    std::sort_heap(found.begin(), found.end(), nearer);
    return cost;
  }

  // Signed distance of a point to the nearest ungrown set, at most `cap`. `hint` is a guess that is updated; it
  // cannot change the result.
  double clearance(geometry::Vec3 point, double cap, std::uint32_t& hint) const;

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  // What a search reads of an ellipsoid, in the order of the tree's leaves.
  struct Row {
    float mean[3], scale[3], quat_wxyz[4];
  };

  static bool nearer(const Found& a, const Found& b) {
    return a.distance != b.distance ? a.distance < b.distance : a.item < b.item;
  }
  Level level(std::uint32_t slot) const { return level_.size() == 1 ? level_[0] : level_[slot]; }
  geometry::Ellipsoid at_slot(std::uint32_t slot) const;

  // Of the ungrown set to the segment a + t d; anything above `enough` stands for one above it.
  double distance_of(std::uint32_t slot, geometry::Vec3 a, geometry::Vec3 d, double enough) const;

  std::vector<GrownEllipsoid> grown_;
  geometry::Bvh tree_;
  std::vector<std::uint32_t> slot_;  // of an item
  std::vector<Row> row_;             // of a slot
  std::vector<Level> level_;         // of a slot, or one for all
  double radius_;
};

}  // namespace alula
