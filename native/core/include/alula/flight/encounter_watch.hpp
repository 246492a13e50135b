// What the tracks of an encounter say: where the sensor turns, and the risk that commands leave.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "alula/geometry/vec3.hpp"
#include "alula_avoidance.h"

namespace alula::flight {

// How far to turn from `yaw` [rad]: to the middle between the leftmost and the rightmost track that closes in, or,
// when the field of view is too narrow for both, to the most urgent one; to the course without any.
double turn_to(std::span<const alula_track> tracks, const alula_vehicle_state& vehicle, double yaw,
               double half_azimuth_rad, geometry::Vec3 course);

// Bound of the probability that an obstacle is within `radius` when it comes closest in the next `window` [s], while
// the vehicle keeps the command and the obstacle its velocity. With m the predicted relative position then, S its
// covariance and s = |m| - radius: whoever is within the radius is so along m too, where the variance is
// w = m' S m / |m|^2, so that with c = w / (w + s^2) it is at most c (Cantelli), and for errors with one mode, as
// here, 4 c / 9 or, from c = 3 / 8 on, 4 c / 3 - 1 / 3 (Vysochanskij, Petunin 1985, one-sided); 1 for s <= 0. 0 for a
// track that recedes already.
double risk_of(const alula_track& track, const alula_vehicle_state& vehicle, geometry::Vec3 command, double radius,
               double window);

// The sum over windows, one after the other, and tracks of the largest risk in the window.
class RiskWindows {
 public:
  void reset(double window_s, double dt_s);
  // One tick.
  void add(std::span<const alula_track> tracks, const alula_vehicle_state& vehicle, geometry::Vec3 command,
           double radius_m);
  double sum() const;  // until now

 private:
  double window_s_ = 0, closed_ = 0;
  std::int64_t ticks_ = 1, tick_ = 0;                   // in a window; since the beginning
  std::vector<std::pair<std::uint32_t, double>> open_;  // of tracks, by id
};

}  // namespace alula::flight
