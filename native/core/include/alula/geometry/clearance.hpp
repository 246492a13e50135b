// Exact clearance of path segments from many obstacles, independent of any filter or planner.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/bvh.hpp"
#include "alula/geometry/convex_distance.hpp"
#include "alula/geometry/ellipsoid_distance.hpp"

namespace alula {

// The signed distance of a segment to a convex obstacle is the minimum over its points of the
// signed distance of a point: the Euclidean distance outside, minus the distance to the boundary
// inside. For a polytope the signed distance inside is max_l (n_l . p - d_l), so a segment that enters it has
// minus the deepest such depth. The clearance is the minimum over all obstacles and `cap`: distances of at least
// `cap` are returned as `cap` (infinity when there are no obstacles and no cap).
//
// Signs are exact for polytopes (decided by their planes). Errors are a few roundings of the
// coordinates, except for polytopes closer than 1e-6 times their size: there the result is the gap
// between separating planes, which is never above the true distance and below it by less than 1e-7 times that
// size. All lengths in one unit and frame.

// Convex polytopes, row-compressed: the planes n . x <= d with unit outward normals, and the vertices.
class PolytopeSet {
 public:
  // Copies the arrays. Each polytope has at least 4 planes and 1 vertex; `starts` partition the rows.
  PolytopeSet(std::span<const double> normals, std::span<const double> offsets,
              std::span<const std::int64_t> plane_start, std::span<const double> vertices,
              std::span<const std::int64_t> vertex_start);

  std::size_t size() const { return plane_start_.size() - 1; }
  const geometry::Bvh& tree() const { return tree_; }
  geometry::PolytopeView polytope(std::size_t k) const;
  const geometry::Box& box(std::size_t k) const { return boxes_[k]; }

  // Clearance of one segment. `nearest` is a guess of the nearest obstacle, updated by the call; it does not change
  // the result.
  double clearance(geometry::Vec3 a, geometry::Vec3 b, double cap, std::uint32_t& nearest,
                   std::vector<double>& scratch) const;

 private:
  std::vector<double> normals_, offsets_;
  std::vector<geometry::Vec3> vertices_;
  std::vector<std::int64_t> plane_start_, vertex_start_;
  std::vector<geometry::Box> boxes_;
  geometry::Bvh tree_;
};

struct Level;  // ellipsoid.hpp

// The k-sigma ellipsoids {x : (x - mu)' inv(Sigma) (x - mu) <= k^2} of Gaussians, each grown by its loss as in
// `level_of` of ellipsoid.hpp: the signed distance of the grown set (the Minkowski sum of the ellipsoid and a ball)
// is that of the ellipsoid minus the radius of the ball.
class EllipsoidSet {
 public:
  // Reads the arrays, which must not change: mean (3 per Gaussian), scale (3, one-sigma semi-axes > 0), quat_wxyz
  // (4), loss (3) or nothing. `owner` keeps them alive as long as the set. Beside them it needs about 50 bytes per
  // Gaussian.
  EllipsoidSet(std::span<const float> mean, std::span<const float> scale, std::span<const float> quat_wxyz,
               std::span<const float> loss, double k, std::shared_ptr<const void> owner);

  // An ellipsoid, and the radius of the ball that it is grown by.
  struct Grown {
    geometry::Ellipsoid ellipsoid;
    double radius;
  };

  std::size_t size() const { return mean_.size() / 3; }
  const geometry::Bvh& tree() const { return tree_; }
  Grown grown(std::size_t i) const;
  double clearance(geometry::Vec3 a, geometry::Vec3 b, double cap, std::uint32_t& nearest,
                   std::vector<double>& scratch) const;

 private:
  Level level(std::size_t i) const;
  geometry::Ellipsoid ellipsoid(std::size_t i, double k) const;

  std::span<const float> mean_, scale_, quat_, loss_;
  double k_;
  std::shared_ptr<const void> owner_;
  geometry::Bvh tree_;
};

// Clearance of each segment from start[i] to end[i] (3 numbers each), in parallel, by branch and bound. Time about
// log n for obstacles that are small compared with their distances. The result does not depend on `jobs`.
std::vector<double> segment_clearance(const PolytopeSet& obstacles, std::span<const double> start,
                                      std::span<const double> end, double cap, unsigned jobs, Control& control);
std::vector<double> segment_clearance(const EllipsoidSet& obstacles, std::span<const double> start,
                                      std::span<const double> end, double cap, unsigned jobs, Control& control);

}  // namespace alula
