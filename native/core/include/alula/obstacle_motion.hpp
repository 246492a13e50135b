// Obstacles that move: what they truly do, as a function of time, of the vehicle and of the trial.
//
// Positions in the world frame [m], z up. A moving obstacle is advanced tick by tick; all that is random is a
// function of (seed, trial, obstacle), never of the order of calls.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "alula/random.hpp"

namespace alula::flight {

struct Kinematics {
  geometry::Vec3 p, v, a;
};

// One obstacle of a scenario, drawn for a trial.
class ObstacleMotion {
 public:
  virtual ~ObstacleMotion() = default;
  // Before `start_s` it is where it starts. `vehicle` is the state that it sees (an obstacle may aim).
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

// Ranges are drawn uniformly unless said otherwise: from == to is a number. Angles in radian.
struct Range {
  double from = 0, to = 0;
};

struct ObstacleSpec {
  MotionKind kind = MotionKind::constant_velocity;
  double radius_m = 0.15;
  // Where: either at `position`, or at `distance_m` from the vehicle's start, at an azimuth from its course and an
  // elevation; `side` draws the sign of the azimuth.
  bool is_relative = true;
  geometry::Vec3 position;
  double distance_m = 50;
  Range azimuth, elevation;
  bool either_side = false;
  geometry::Vec3 offset_sigma;  // normal, in the frame (course, left, up) [m]
  // How fast and where to: `heading` is from the direction to the meeting point, outwards; that is where both would
  // be at the same time if the vehicle held its course and speed, or the vehicle's start (`aims_at_vehicle`).
  Range speed_m_s{5, 8}, heading, acceleration_m_s2;
  geometry::Vec3 velocity;  // when `is_relative` is false and it is not 0: as given
  bool aims_at_vehicle = false;
  geometry::Vec3 meeting_sigma;                                       // normal error of the meeting point [m]
  double max_speed_m_s = 12, turn_rate_rad_s = 0.25, release_m = 12;  // turns until this near
  double drag_per_m = 0;                                              // ballistic: a = g - drag |v| v
  double start_s = 0;                                                 // rests (or is held) before
  std::vector<geometry::Vec3> way_points;                             // quadrotor
};

// Draws the obstacle of one trial. `vehicle` is the start, its velocity the course.
// Throws std::invalid_argument for a specification that means nothing.
std::unique_ptr<ObstacleMotion> draw(const ObstacleSpec& spec, const Kinematics& vehicle, const RandomStream& random,
                                     std::uint32_t obstacle);

}  // namespace alula::flight
