// Values derived from the tracks of an encounter: the sensor's turn, and the remaining risk of commands.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "alula/geometry/vec3.hpp"
#include "alula_avoidance.h"

namespace alula::flight {

// Angle to turn from `yaw` [rad]: to the middle between the leftmost and the rightmost approaching track, or to the
// most urgent one when the field of view is too narrow for both; to the course when no track approaches.
double turn_to(std::span<const alula_track> tracks, const alula_vehicle_state& vehicle, double yaw,
               double half_azimuth_rad, geometry::Vec3 course);

// Bound on the probability that an obstacle is within `radius` when it comes closest in the next `window` [s], while
// the vehicle keeps the command and the obstacle its velocity. Let m be the predicted relative position at that time,
// S its covariance and s = |m| - radius. An obstacle within the radius is so along m too, where the variance is
// w = m' S m / |m|^2. With c = w / (w + s^2) the probability is at most c (Cantelli). For errors with one mode, as
// here, it is at most 4 c / 9 or, from c = 3 / 8 on, 4 c / 3 - 1 / 3 (Vysochanskij, Petunin 1985, one-sided). It is 1
// for s <= 0, and 0 for a track that already recedes.
double risk_of(const alula_track& track, const alula_vehicle_state& vehicle, geometry::Vec3 command, double radius,
               double window);

// Sum over consecutive windows and tracks of the largest risk in the window.
class RiskWindows {
 public:
  void reset(double window_s, double dt_s);
  // Adds one tick.
  void add(std::span<const alula_track> tracks, const alula_vehicle_state& vehicle, geometry::Vec3 command,
           double radius_m);
  double sum() const;  // until now

 private:
  double window_s_ = 0, closed_ = 0;
  std::int64_t ticks_ = 1, tick_ = 0;                   // ticks in a window; ticks since the beginning
  std::vector<std::pair<std::uint32_t, double>> open_;  // largest risks of the open window, by track id
};

}  // namespace alula::flight
