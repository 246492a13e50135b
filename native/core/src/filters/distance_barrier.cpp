#include "alula/filters/distance_barrier.hpp"

#include <algorithm>
#include <cmath>

namespace alula::flight {
namespace {

using geometry::dot;

// v^T H v with H along the ellipsoid's axes, for v in the world's frame.
double curvature(const geometry::Ellipsoid& e, const geometry::Projection& at, Vec3 v) {
  double sum = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += dot(e.axis[i], v) * at.hessian[i][j] * dot(e.axis[j], v);
  return sum;
}

// The same, with v's world components used as components along the axes by descending length; each axis points
// to the side of the point.
double published_curvature(const geometry::Ellipsoid& e, const geometry::Projection& at, Vec3 v) {
  int order[3] = {0, 1, 2};
  std::sort(order, order + 3, [&](int i, int j) { return e.semi[i] != e.semi[j] ? e.semi[i] > e.semi[j] : i < j; });
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const bool flips = (at.local[order[i]] < 0) != (at.local[order[j]] < 0);
      sum += v[i] * v[j] * (flips ? -1 : 1) * at.hessian[order[i]][order[j]];
    }
  }
  return sum;
}

}  // namespace

DistanceBarrier distance_barrier(const EllipsoidIndex& index, const DistanceLaw& law, std::uint32_t item, Vec3 p,
                                 Vec3 v) {
  const geometry::Ellipsoid e = index.ellipsoid(item);
  const geometry::Projection at = geometry::project(e, p);
  const double phi = at.distance < 0 ? -1 : 1, radius = index.radius() + index.ball(item);
  const double a = law.alpha, b = law.beta;
  DistanceBarrier result;
  result.h = barrier_at(law, at.distance, radius);
  result.distance = at.distance - index.ball(item);
  result.row.row = 2 * phi * at.offset;
  const double bend = law.hessian == SaferHessian::correct ? curvature(e, at, v) : published_curvature(e, at, v);
  result.row.bound = -(phi * bend + (a + b) * dot(result.row.row, v) + a * b * result.h);
  return result;
}

DistanceBarrier contact_barrier(const Contact& contact, const DistanceLaw& law, double radius, Vec3 p, Vec3 v) {
  const double d = dot(contact.normal, p - contact.point), along = dot(contact.normal, v);
  const double a = law.alpha, b = law.beta;
  DistanceBarrier result;
  result.h = barrier_at(law, d, radius);
  result.distance = d;
  result.row.row = 2 * std::abs(d) * contact.normal;
  const double bend = 2 * along * along;
  result.row.bound = -((d < 0 ? -bend : bend) + (a + b) * dot(result.row.row, v) + a * b * result.h);
  return result;
}

double contact_reach(const DistanceLaw& law, double radius, Vec3 v, Vec3 u) {
  const double w = geometry::norm(u + (law.alpha + law.beta) * v) / (law.alpha * law.beta);
  return (1 + 1e-9) * (w + std::hypot(w, radius + law.more_m));
}

}  // namespace alula::flight
