// Tubes of moving obstacles: balls that contain what each track predicts, up to a horizon.
//
//   tube(t) = ball about p + v t with the radius r(t) = r_o + z sigma(t) + a t^2 / 2,  0 <= t <= horizon
//
// p, v and r_o are of the track, a bounds the obstacle's unknown acceleration, and sigma(t)^2 is the largest
// eigenvalue of cov(p + v t) + cov(own position). With z = sqrt((1 - risk) / risk), Cantelli's inequality bounds the
// probability that an obstacle touches a ball outside of its tube, at each single time, by the risk: contact needs an
// error of more than z sigma along one direction, the one from the tube to the ball. It holds for every distribution
// with this covariance, not jointly for all times.
//
// sigma, the norm of a matrix that is affine in t, is convex, and so is r. Between two of kTubeNodes + 1 times the
// chord of r is therefore an upper bound; that is the radius used.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "alula/geometry/vec3.hpp"
#include "alula_avoidance.h"

namespace alula::flight {

inline constexpr int kTubeNodes = 16;

struct Tube {
  geometry::Vec3 p, v;
  std::array<double, kTubeNodes + 1> radius;  // at equal distances in time, over the horizon [m]
};

// One per thread; allocates in the constructor only.
class Tubes {
 public:
  // Throws std::invalid_argument unless the horizon is positive, 0 < risk < 1 and the acceleration is not negative.
  Tubes(double horizon_s, double risk, double acceleration_m_s2);

  // Makes the tubes of all tracks from now on. Those of a track with numbers that mean nothing, or of more tracks
  // than ALULA_OBSTACLES, are everywhere.
  void set(std::span<const alula_track> tracks, geometry::Vec3 position_variance);
  void clear() { tubes_.clear(), is_everywhere_ = false; }

  bool empty() const { return tubes_.empty() && !is_everywhere_; }
  double horizon() const { return horizon_; }

  // Radius of a tube, for 0 <= t <= horizon.
  double radius(const Tube& tube, double t) const;

  // True if `is_clear(tube)` holds for all tubes that meet the ball of radius `reach` about p within the horizon.
  template <class F>
  bool all_near(geometry::Vec3 p, double reach, F&& is_clear) const {
    if (is_everywhere_) return false;
    for (const Tube& tube : tubes_)
      if (comes_near(tube, p, reach) && !is_clear(tube)) return false;
    return true;
  }

  // True if a point that goes from a to b in [from, to], uniformly up to `off`, keeps `radius` from the tube.
  bool is_clear_of(const Tube& tube, geometry::Vec3 a, geometry::Vec3 b, double from, double to, double radius,
                   double off) const;

 private:
  bool comes_near(const Tube& tube, geometry::Vec3 p, double reach) const;

  double horizon_, deviations_, acceleration_;
  std::vector<Tube> tubes_;
  bool is_everywhere_ = false;
};

}  // namespace alula::flight
