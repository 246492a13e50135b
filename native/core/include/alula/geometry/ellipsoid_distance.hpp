// Exact signed distances of points and segments to one ellipsoid.
#pragma once

#include <span>

#include "alula/geometry/convex_distance.hpp"
#include "alula/geometry/vec3.hpp"

namespace alula::geometry {

// {mu + sum_i z_i axis[i] : sum_i (z_i / semi[i])^2 <= 1}; orthonormal axes, semi-axes > 0.
struct Ellipsoid {
  Vec3 centre;
  Vec3 axis[3];
  Vec3 semi;
};

// The ellipsoid of a Gaussian at level k: semi-axes k * scale; the axes are the columns of the rotation
// of the quaternion (w, x, y, z), which this function normalises.
Ellipsoid gaussian_ellipsoid(const float* mean, const float* scale, const float* quat_wxyz, double k);

// Exact axis-aligned bounds of an ellipsoid, rounded outward.
Box bounds(const Ellipsoid& ellipsoid);

// Signed Euclidean distance of a point. The closest point y solves
//   y_i = semi_i^2 z_i / (lambda + semi_i^2),   sum_i (y_i / semi_i)^2 = 1,
// with lambda > 0 outside and -min(semi)^2 <= lambda <= 0 inside. Newton's iteration on
// 1 / |y / semi|, which is concave in lambda, converges from the left without overshoot; inside
// it runs on lambda + min(semi)^2, so that an axis of 1e-9 loses no digits.
SignedDistance signed_distance(const Ellipsoid& ellipsoid, Vec3 point);

// Minimum of the signed distance over the segment from a to b: convex in the parameter, bracketed
// by tangents until the bracket is below rounding. If the minimum is >= enough, any value >= enough may be returned.
double signed_distance(const Ellipsoid& ellipsoid, Vec3 a, Vec3 b, double enough);

// Distance for searches that discard most candidates, to an ellipsoid centred at the origin and aligned with the
// axes: of a point (signed), and of the segment start + t along, 0 <= t <= 1 (0 where it meets the ellipsoid).
// Returns infinity as soon as the distance is known to exceed `enough`: the squared distance is the maximum over
// mu >= 0 of the concave dual
//   q(mu) = mu min_t (sum_i z_i(t)^2 / (mu + semi_i^2) - 1),
// so every step of Newton's iteration gives a lower bound, and t has a closed form.
double distance_below(Vec3 semi, Vec3 point, double enough);
double distance_below(Vec3 semi, Vec3 start, Vec3 along, double enough);

// The same for many at once, with the same bits, four at a time and so in about a third of the time. Entries with
// along = 0 are points.
struct Sighted {
  Vec3 semi, start, along;
  double enough;
};
void distances_below(std::span<const Sighted> each, std::span<double> distance);

// The signed distance of a point as in signed_distance, and the derivatives that a barrier on its square needs. The
// projection onto the surface has the Jacobian diag(s) - u u^T / sum_i (s_i n_i^2) along the axes of the ellipsoid,
// with s_i = semi_i^2 / (lambda + semi_i^2), n_i = z_i / (lambda + semi_i^2) and u_i = s_i n_i. The Hessian of the
// squared distance is twice (identity minus Jacobian). It is infinite or NaN where the closest point is not unique.
struct Projection {
  double distance;       // signed, negative inside
  Vec3 offset;           // point - the closest point of the surface
  Vec3 local;            // point - centre, along the axes of the ellipsoid
  double hessian[3][3];  // of distance^2 along the axes of the ellipsoid
};
Projection project(const Ellipsoid& ellipsoid, Vec3 point);

}  // namespace alula::geometry
