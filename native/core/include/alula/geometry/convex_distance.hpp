// Exact distances of a point, a segment, or the convex hull of a few points, to one convex polytope.
#pragma once

#include <span>
#include <vector>

#include "alula/geometry/vec3.hpp"

namespace alula::geometry {

// Result of `hull_distance`: lower <= distance <= upper. `upper` is the distance between a point of each
// hull; `lower` is the gap between parallel planes that separate the hulls, or 0. The search
// ends when the two agree to rounding; close to contact they agree to about 1e-15 size^2 / upper.
struct Bracket {
  double lower, upper;
  Vec3 apart;  // the point of `a` minus that of `b`, of length `upper`
};

// Euclidean distance of the convex hulls of two point sets, by the algorithm of Gilbert, Johnson
// and Keerthi (1988) with an exhaustive, hence robust, choice among the at most eight faces of the
// simplex that hold the newest point. Stops early once lower >= enough.
Bracket hull_distance(std::span<const Vec3> a, std::span<const Vec3> b, double enough);

// min over 0 <= t <= 1 of max_l (value_l + t slope_l), for at least one line: a piecewise linear,
// convex function, minimised exactly by intersecting its active lines. O(lines) per step, a
// handful of steps.
double minimum_of_maximum(std::span<const double> value, std::span<const double> slope);

// One convex polytope: unit outward normals (3 per plane), offsets, and the vertices.
struct PolytopeView {
  std::span<const double> normals;
  std::span<const double> offsets;
  std::span<const Vec3> vertices;
};

struct SignedDistance {
  double value;  // negative inside: minus the distance to the surface
  Vec3 normal;   // unit outward normal at the closest point, the gradient of `value`
};

// Signed distance of a point, as below for a segment of length 0; the normal of a contact is that of a plane.
SignedDistance signed_distance(const PolytopeView& polytope, Vec3 p, double enough);

// Signed distance of the segment from a to b: the minimum over its points p of
//   max_l (n_l . p - d_l)   when that is <= 0 for some p: the deepest penetration, negative;
//   the Euclidean distance  otherwise, as the lower end of its bracket: never too large.
// If the exact value is >= enough, any value >= enough may be returned.
// `scratch` only saves allocations.
double signed_distance(const PolytopeView& polytope, Vec3 a, Vec3 b, double enough, std::vector<double>& scratch);

}  // namespace alula::geometry
