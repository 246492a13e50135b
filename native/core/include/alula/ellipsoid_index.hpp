// Ellipsoids of a splat, found by distance: a tick costs by what is near, not by what exists.
#pragma once

#include <cstdint>
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

  // The at most `count` ellipsoids nearest to the segment a..b of those nearer than `reach`, by distance, ties
  // by number. The distance is that of the ungrown set, negative inside: exact for a point (a == b), and for a
  // segment a lower bound that is exact to 1e-9 of the reach. `found` is replaced.
  QueryCost nearest(geometry::Vec3 a, geometry::Vec3 b, double reach, std::size_t count,
                    std::vector<Found>& found) const;

  // Signed distance of a point to the nearest ungrown set, at most `cap`. `hint` is a guess that is updated.
  double clearance(geometry::Vec3 point, double cap, std::uint32_t& hint) const;

 private:
  std::vector<GrownEllipsoid> grown_;
  std::vector<geometry::Ellipsoid> ellipsoid_;
  std::vector<double> ball_;  // radius of the ball that losses add to `ellipsoid_`
  geometry::Bvh tree_;
  double radius_;
};

}  // namespace alula
