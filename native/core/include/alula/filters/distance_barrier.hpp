// Barrier on the squared distance to one ellipsoid, its row over the acceleration, and a lower bound on that row.
//
// With the signed distance d of the vehicle's centre p to an ellipsoid, its closest point y, phi = sign(d), o = p -
// y,
//   h = phi |o|^2 - r^2,   row:  2 phi o . u + phi v^T H v + (alpha + beta) 2 phi o . v + alpha beta h >= 0,
// with H the Hessian of d^2. r is the index's radius plus the growth that the losses of the ellipsoid add.
// Source: SAFER-Splat (arXiv 2409.09868), its public implementation for the published Hessian.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "alula/filters/collision_cone.hpp"
#include "alula/filters/options.hpp"
#include "alula/geometry/ellipsoid_index.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula::flight {

struct DistanceLaw {
  double alpha = 5, beta = 1;  // poles of h'' + (alpha + beta) h' + alpha beta h >= 0 [1/s]
  SaferHessian hessian = SaferHessian::correct;
  // Added to r as far as there is room: h is 0 for less room than that, so the vehicle may not come nearer [m].
  double more_m = 0;
};

// h at a signed distance, for the radius r and that of the law.
inline double barrier_at(const DistanceLaw& law, double distance, double radius) {
  const double h = distance * std::abs(distance) - radius * radius;
  if (!(law.more_m > 0 && h > 0)) return h;
  const double grown = radius + law.more_m;
  return std::max(0.0, distance * distance - grown * grown);
}

struct DistanceBarrier {
  double h = 0;
  double distance = 0;  // signed, to the ungrown set [m]
  AccelerationRow row;
};

DistanceBarrier distance_barrier(const EllipsoidIndex& index, const DistanceLaw& law, std::uint32_t item, Vec3 p,
                                 Vec3 v);

// The same for the half-space behind a contact, {y : normal . (y - point) <= 0}, and a ball of `radius` about p.
// Outside it has the same h as the obstacle for the p of the contact, and contains the obstacle if that is convex: it
// leaves out 2 d v^T (Hessian of d) v >= 0 of the obstacle's row, so its own is sufficient. SaferHessian does not
// matter.
DistanceBarrier contact_barrier(const Contact& contact, const DistanceLaw& law, double radius, Vec3 p, Vec3 v);

// The distance from which on rows of contacts hold for u: alpha beta d^2 - 2 d |u + (alpha + beta) v| >= alpha beta
// r^2.
double contact_reach(const DistanceLaw& law, double radius, Vec3 v, Vec3 u);

// A lower bound on row . u - bound of every ellipsoid whose closest point y is in a box. Outside, H is positive
// semidefinite in either frame, so with w = u + (alpha + beta) v the remaining terms are no less than
//   alpha beta |o|^2 + 2 o . w - alpha beta r^2  =  alpha beta (|o + w / (alpha beta)|^2 - r^2) - |w|^2 / (alpha
//   beta),
// The minimum of this over a box of o is found axis by axis. It is below zero only where y is within
// sqrt(r^2 + |w|^2 / (alpha beta)^2) of p + w / (alpha beta). The projection does not move along o, so the correct H
// has v^T H v >= 2 (o . v)^2 / |o|^2, which is added. If the vehicle is inside the ellipsoid, it is in the box, where
// o may be 0. The bound is negative there, so such an ellipsoid is always measured.
class DistanceRowBound {
 public:
  DistanceRowBound(const DistanceLaw& law, double radius, Vec3 p, Vec3 v, Vec3 u)
      : p_(p),
        v_(v),
        w_(u + (law.alpha + law.beta) * v),
        stiffness_(law.alpha * law.beta),
        radius_(radius + law.more_m),
        is_radial_(law.hessian == SaferHessian::correct) {}

  double operator()(const geometry::Box& box, double ball) const {
    double least = 0, size = 0, near = 0, far = 0, far2 = 0;
    for (int i = 0; i < 3; ++i) {
      const double low = p_[i] - box.upper[i], high = p_[i] - box.lower[i];
      const double o = std::min(std::max(-w_[i] / stiffness_, low), high);
      const double square = stiffness_ * o * o, product = 2 * o * w_[i];
      least += square + product, size += square + std::abs(product);
      near += std::min(low * v_[i], high * v_[i]), far += std::max(low * v_[i], high * v_[i]);
      far2 += std::max(low * low, high * high);
    }
    const double r = radius_ + ball, inner = stiffness_ * r * r;
    double bend = 0;
    if (is_radial_ && (near > 0 || far < 0)) {
      const double along = near > 0 ? near : far;
      bend = 2 * along * along / far2;
    }
    return least + bend - inner - kSlack * (size + bend + inner);
  }

 private:
  static constexpr double kSlack = 1e-12;  // exceeds the rounding error of a row

  Vec3 p_, v_, w_;
  double stiffness_, radius_;
  bool is_radial_;
};

// A lower bound on h of every ellipsoid in a box, with r = radius: no ellipsoid is nearer than the box, unless the
// vehicle is inside the box.
inline double least_barrier(const geometry::Box& box, double radius, Vec3 p) {
  const double squared = squared_distance(box, {p, p});
  return squared > 0 ? (1 - 1e-12) * squared - (1 + 1e-12) * radius * radius
                     : -std::numeric_limits<double>::infinity();
}

}  // namespace alula::flight
