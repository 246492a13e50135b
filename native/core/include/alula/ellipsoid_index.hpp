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

  // The at most `count` ellipsoids nearest to the segment a..b of those nearer than `reach` to it, by distance, ties
  // by number. The distance is that of the ungrown set: of a point (a == b) exact and negative inside, of a segment
  // exact to 1e-9 of the reach. Those that a segment meets are at distance 0 and ordered by that of a, those not
  // nearer than `reach` to a are left out. `found` is replaced.
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                    std::vector<Found>& found) const {
    return nearest(a, b, reach, count, found, [](std::uint32_t) { return true; });
  }

  // The same among those that `accept(item)`, which is asked last.
  template <class Accept>
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count, std::vector<Found>& found,
                    Accept&& accept) const {
    found.clear();
    QueryCost cost;
    if (count == 0 || !(reach > -kInfinity)) return cost;
    const geometry::Vec3 d = b - a;
    const bool is_point = d.x == 0 && d.y == 0 && d.z == 0;
    double within = reach;  // what is farther than that cannot be among them
    cost.nodes = tree_.visit_in_order(a, d, within, [&](std::uint32_t slot, std::uint32_t item) {
      ++cost.items;
      double distance = distance_of(slot, a, d, within);
      if (distance > within) return;
      if (!is_point && (distance <= 0 || !centre_is_nearer(slot, a, reach))) {
        const double of_a = distance_of(slot, a, {}, reach);
        if (!(of_a < reach)) return;
        if (distance <= 0) distance = of_a - reach;  // before all others, and still in order
      }
      const bool is_full = found.size() == count;
      if (!(distance < reach) || (is_full && !nearer({item, distance}, found.front())) || !accept(item)) return;
      if (is_full) {
        std::pop_heap(found.begin(), found.end(), nearer);
        found.back() = {item, distance};
        std::push_heap(found.begin(), found.end(), nearer);
      } else {
        found.push_back({item, distance});
        if (found.size() < count) return;
        std::make_heap(found.begin(), found.end(), nearer);
      }
      within = is_point ? found.front().distance : std::max(0.0, found.front().distance);
    });
    std::sort(found.begin(), found.end(), nearer);
    if (!is_point)
      for (Found& f : found) f.distance = std::max(0.0, f.distance);
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

  bool centre_is_nearer(std::uint32_t slot, geometry::Vec3 a, double reach) const {
    const float* mean = row_[slot].mean;
    const geometry::Vec3 to{mean[0] - a.x, mean[1] - a.y, mean[2] - a.z};
    return reach > 0 && geometry::dot(to, to) < reach * reach * (1 - 1e-12);
  }

  // Of the ungrown set to the segment a + t d, not above 0 where it meets that; anything above `enough` stands for
  // one above it.
  double distance_of(std::uint32_t slot, geometry::Vec3 a, geometry::Vec3 d, double enough) const;

  std::vector<GrownEllipsoid> grown_;
  geometry::Bvh tree_;
  std::vector<std::uint32_t> slot_;  // of an item
  std::vector<Row> row_;             // of a slot
  std::vector<Level> level_;         // of a slot, or one for all
  double radius_;
};

}  // namespace alula
