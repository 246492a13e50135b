// Reference trajectory: position and yaw as piecewise polynomials of degree 7, as in `alula/plan`.
#pragma once

#include <span>
#include <vector>

#include "alula/geometry/mat3.hpp"

namespace alula::flight {

// Position up to snap [m, m/s, ...], yaw up to its second derivative [rad, ...].
struct ReferencePoint {
  geometry::Vec3 p, v, a, j, s;
  double yaw = 0, yaw_rate = 0, yaw_acceleration = 0;
};

// On piece k component d of (x, y, z, yaw) is sum_j coefficient[k][d][j] (t - time[k])^j.
// Before the first knot and from the last knot on it rests there: all derivatives are zero.
class ReferenceCurve {
 public:
  // time (K + 1), strictly increasing [s]; coefficient (K, 4, 8). Throws std::invalid_argument
  // when the shapes do not fit, K is 0 or a number is not finite.
  ReferenceCurve(std::span<const double> time, std::span<const double> coefficient);

  ReferencePoint at(double t) const;
  double start() const { return time_.front(); }
  double end() const { return time_.back(); }
  double duration() const { return end() - start(); }

 private:
  std::vector<double> time_, coefficient_;
};

}  // namespace alula::flight
