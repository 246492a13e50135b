// Moving obstacles of a flight: their true motion, the vehicle's sensor, and the tracks that filters see.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "alula/tracking/tracker.hpp"
#include "alula_avoidance.h"

namespace alula::flight {

struct MovingSpec {
  std::vector<ObstacleSpec> obstacles;
  RadarOptions radar;
  TrackerOptions tracker;
  // Maximum turn rate of the sensor. It turns to the middle of all approaching tracks if the field of view is wide
  // enough for them, else to the most urgent one. 0: it always looks along the course.
  double yaw_rate_rad_s = 1;
};

// Throws std::invalid_argument for an invalid specification.
void check(const MovingSpec& spec);

// Moving obstacles of consecutive trials; memory is kept between them. A trial is a function of (seed, trial).
class MovingWorld {
 public:
  // dt: a tick [s], of `plant_steps` steps. `spec` is not owned.
  MovingWorld(const MovingSpec& spec, double dt_s, int plant_steps);

  // Draws the obstacles of a trial for a vehicle that starts so; the sensor looks along `course`.
  void begin(const RandomStream& random, const Kinematics& start, geometry::Vec3 course);

  // Makes the scan that is due at a step of the plant, if any. Called once for each step, before `advance`.
  void sense(std::int64_t step, const Kinematics& vehicle);
  // The confirmed tracks at a time, of the scans that have arrived. `own` is the vehicle's estimate of itself.
  std::span<const alula_track> tracks(double now, const alula_vehicle_state& own);
  // Moves the obstacles by one step of the plant; `vehicle` is the state at its beginning, which they may aim at.
  void advance(double dt_s, const Kinematics& vehicle);

  // The vehicle's noisy estimate of its own state, of the sensor's options.
  Kinematics own_state(const Kinematics& vehicle, std::int64_t step) const;
  std::size_t size() const { return truth_.size(); }
  const std::vector<Kinematics>& truth() const { return truth_; }
  const std::vector<Kinematics>& before() const { return before_; }  // before the last `advance`
  std::span<const alula_track> tracks() const { return tracks_; }    // those of the last call
  std::int64_t obstacle_near(const float* position) const;           // -1: none within 5 m
  std::int64_t track_near(geometry::Vec3 position) const;            // index of the nearest one within 5 m, or -1

 private:
  struct Scan {
    double time = 0;
    FieldOfView field;
    std::vector<Detection> detections;
  };

  const MovingSpec& spec_;
  double dt_s_;
  int plant_steps_;
  double track_radius_ = 0;  // sensors do not measure the size: the largest radius is used
  Tracker tracker_;
  RandomStream random_;
  geometry::Vec3 course_{1, 0, 0};
  double yaw_ = 0;
  std::vector<std::unique_ptr<ObstacleMotion>> obstacle_;
  std::vector<Kinematics> truth_, before_;
  std::vector<Scan> scan_;  // pending scans, oldest first; then buffers for reuse
  std::size_t scans_ = 0;
  std::uint64_t scanned_ = 0;
  std::vector<alula_track> tracks_;
};

// Minimum |r(t)| for 0 <= t <= h of the parabola from r0 to r1 with the acceleration a. Exact to rounding where the
// distance has one minimum, else too large by at most |a| h^2 / 8.
double closest_approach(geometry::Vec3 r0, geometry::Vec3 r1, geometry::Vec3 a, double h);

}  // namespace alula::flight
