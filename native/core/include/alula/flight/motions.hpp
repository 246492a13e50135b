// Motions of obstacles, after all their random parameters are drawn.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "alula/flight/obstacle_motion.hpp"

namespace alula::flight {

inline constexpr double kFallGravity = 9.81;  // gravity of ballistic obstacles [m/s^2]

// Speed and distance along a path, with an acceleration up to a maximum speed.
struct Pace {
  double speed = 0, acceleration = 0, most = 0;

  double ramp() const {
    return acceleration > 0 ? (most - speed) / acceleration : 0;
  }  // duration of the acceleration [s]
  double way(double t) const {
    const double up = std::min(t, ramp());
    return speed * t + acceleration * up * (t - up / 2);
  }
  double speed_at(double t) const { return speed + acceleration * std::min(t, ramp()); }
  double acceleration_at(double t) const { return t < ramp() ? acceleration : 0; }
};

// Duration of a leg, and the distance covered at half of that time on a leg twice as long as this distance.
// s(x) = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7 has zero derivatives up to jerk at 0 and 1.
struct Leg {
  static constexpr double peak_speed = 35.0 / 16, peak_acceleration = 7.513188404399293;  // of s
  static constexpr double longest = 1e9;  // [s]; a longer leg counts as hovering, which keeps the time finite
  double speed = 0, acceleration = 0;

  double time(double length) const {
    return std::min(longest,
                    std::max(peak_speed * length / speed, std::sqrt(peak_acceleration * length / acceleration)));
  }
  double half_way(double t) const {
    return std::min(speed / peak_speed * t, 2 * t * t * acceleration / peak_acceleration);
  }
};

// Motion along a straight line, exact at any time.
std::unique_ptr<ObstacleMotion> move_straight(double start_s, Vec3 p, Vec3 heading, const Pace& pace);

// Motion with a turning heading: `spec` gives the turn rate, the release distance and the target.
std::unique_ptr<ObstacleMotion> move_curving(const ObstacleSpec& spec, Vec3 p, Vec3 heading, const Pace& pace,
                                             Vec3 meeting_error);

std::unique_ptr<ObstacleMotion> move_thrown(double start_s, Vec3 p, Vec3 v, double drag);

// The velocity at which a throw from p is at `target` after t > 0. Throws std::invalid_argument if drag makes that
// impossible.
Vec3 throw_velocity(Vec3 p, Vec3 target, double t, double drag);

// Flight from rest to rest through points; consecutive points differ.
std::unique_ptr<ObstacleMotion> move_flown(double start_s, const FlownBody& pilot, const std::vector<Vec3>& points,
                                           const Leg& leg);

}  // namespace alula::flight
