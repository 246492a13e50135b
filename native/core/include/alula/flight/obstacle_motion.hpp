// Moving obstacles: their true motion as a function of time, of the vehicle and of the trial.
//
// Positions in the world frame [m], z up. A moving obstacle is advanced tick by tick; all random values are a
// function of (seed, trial, obstacle), never of the order of calls.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "alula/base/random.hpp"
#include "alula/dynamics/tracking_controller.hpp"

namespace alula::flight {

struct Kinematics {
  geometry::Vec3 p, v, a;
};

// One obstacle of a scenario, drawn for a trial.
class ObstacleMotion {
 public:
  virtual ~ObstacleMotion() = default;
  // Until `start_s` it stays at its start. `vehicle` is the state that it observes (an obstacle may aim).
  virtual void step(double dt, const Kinematics& vehicle) = 0;
  virtual const Kinematics& state() const = 0;
};

enum class MotionKind : std::uint8_t {
  constant_velocity,
  accelerating,  // along its heading, up to a speed
  curving,       // turns its heading towards the intercept at a bounded rate until near, and accelerates
  ballistic,     // thrown: gravity and quadratic drag
  quadrotor      // a second vehicle: rigid body, geometric controller, rotor limits, flying to way-points
};

// Ranges are drawn uniformly unless stated otherwise; from == to is a fixed value. Angles in radian.
struct Range {
  double from = 0, to = 0;
};

// Body and controller gains of a quadrotor that flies as an obstacle.
struct FlownBody {
  Quadrotor body;
  TrackingGains gains;
};

// A Crazyflie 2.1 as in examples/vehicles.
FlownBody small_quadrotor();

struct ObstacleSpec {
  MotionKind kind = MotionKind::constant_velocity;
  double radius_m = 0.15;
  // Start: either at `position`, or at `distance_m` from the vehicle's start, at an azimuth from its course and an
  // elevation; `either_side` draws the sign of the azimuth. The course is the horizontal direction of the vehicle's
  // velocity, or the x axis at zero velocity. With `crosses`, azimuth and elevation are those seen from the meeting
  // point: the angle between its path and the vehicle's, which fixes the start at this distance.
  bool is_relative = true;
  geometry::Vec3 position;
  double distance_m = 50;
  Range azimuth, elevation;
  bool either_side = false, crosses = false;
  geometry::Vec3 offset_sigma;  // standard deviation of the start, in the frame (course, left, up) [m]
  // Speed and direction: `heading` turns about the vertical from the direction to the meeting point, outwards: to the
  // side of the vehicle's path on which the obstacle is. The meeting point is where both would be at the same time if
  // the vehicle held its course and speed from its start (the point of nearest approach if they cannot meet), or the
  // vehicle's start (`aims_at_vehicle`). A curving obstacle recomputes it from the vehicle's state at each step. The
  // speed of a ballistic obstacle is horizontal, its mean until the meeting point, and it is thrown so as to hit it;
  // that of a quadrotor is the maximum on a leg.
  Range speed_m_s{5, 8}, heading, acceleration_m_s2;
  geometry::Vec3 velocity;  // used as given when `is_relative` is false and it is not 0
  bool aims_at_vehicle = false;
  geometry::Vec3 meeting_sigma;  // normal error of the meeting point, in the frame (course, left, up) [m]
  double max_speed_m_s = 12, turn_rate_rad_s = 0.25,
         release_m = 12;  // release_m: at this distance it stops turning permanently
  double drag_per_m = 0;  // ballistic: a = g - drag |v| v
  double start_s = 0;     // at rest (or held) until then
  // A quadrotor flies from rest to rest along straight legs, in world coordinates. Without way-points it flies one
  // leg through the meeting point to the same distance beyond it, or 2 mm if it starts at that point.
  // `acceleration_m_s2` limits the acceleration of a leg; 0: up to g / 2.
  std::vector<geometry::Vec3> way_points;
  FlownBody pilot = small_quadrotor();
};

// Throws std::invalid_argument for an invalid specification.
void check(const ObstacleSpec& spec);

// Draws the obstacle of one trial. `vehicle` is the start, its velocity the course.
// Throws std::invalid_argument for an invalid specification, or one that cannot meet this vehicle.
std::unique_ptr<ObstacleMotion> draw(const ObstacleSpec& spec, const Kinematics& vehicle, const RandomStream& random,
                                     std::uint32_t obstacle);

}  // namespace alula::flight
