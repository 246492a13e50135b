// What sensors make of moving obstacles: detections without names, with misses and clutter.
//
// Source: Mandaokar, Rinner 2025 (DR-ACBF), section IV-A; numbers that it does not give are options.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/flight/obstacle_motion.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula::flight {

// Radar: obstacles within the field of view, each found with a probability; white noise of range, angles and range
// rate; clutter. Mocap: position alone, of all within `max_range_m`, each found with the probability. Ideal: position
// alone, of all. A position has the covariance of its noise to first order.

// A position, with a covariance; of the velocity the component along `los` is measured too if `has_doppler`.
struct Detection {
  geometry::Vec3 position;    // world frame [m]
  geometry::Mat3 covariance;  // [m^2]
  bool has_doppler = false;
  geometry::Vec3 los;     // from the sensor
  double range_rate = 0;  // of the obstacle along it, the sensor's own motion taken out [m/s]
  double range_rate_sigma = 0;
};

enum class SensorKind : std::uint8_t { radar, ideal, mocap };

struct RadarOptions {
  SensorKind kind = SensorKind::radar;
  double rate_hz = 20;
  double half_azimuth_rad = 0.6981317007977318, half_elevation_rad = 0.17453292519943295;  // about the body's x axis
  double max_range_m = 150;
  double detection_probability = 0.95;
  // Both angles are across the line of sight: an error of the azimuth is the horizontal one over cos(elevation).
  double sigma_range_m = 0.15, sigma_azimuth_rad = 0.008726646259971648, sigma_elevation_rad = 0.012217304763960306;
  double sigma_range_rate_m_s = 0.1;
  double clutter_per_scan = 0.1;       // Poisson, uniform in the field of view's volume,
  double clutter_range_rate_m_s = 15;  // with range rates uniform within +- this
  double noise_scale = 1;              // of all sigmas
  double position_sigma_m = 0;         // ideal and mocap: white noise per axis, taken as 1e-4 at least
  double delay_s = 0;                  // of a detection until the tracker gets it
  double own_position_sigma_m = 0, own_velocity_sigma_m_s = 0;  // of the vehicle's own state, per axis
};

// Where a scan could find something: what is in it is seen with the detection probability, what is not with none.
struct FieldOfView {
  geometry::Vec3 position;  // of the sensor, as it believes
  double yaw = 0;
  double half_azimuth_rad = 0, half_elevation_rad = 0;  // pi and pi / 2: all around
  double max_range_m = 0;

  // Whether all within `margin` standard deviations of a Gaussian position is in it: of the
  // range and of both angles, each on its own and to first order.
  bool holds(geometry::Vec3 mean, const geometry::Mat3& covariance, double margin) const;
};

FieldOfView field_of_view(const RadarOptions& options, const Kinematics& own, double yaw);

// What the vehicle believes of itself at `step`: position and velocity with their noise. Acceleration as it is.
Kinematics own_state(const RadarOptions& options, const Kinematics& vehicle, const RandomStream& random,
                     std::uint64_t step);

// Field of view about the horizontal heading (cos yaw, sin yaw, 0): levelled.
// One scan at `step` for obstacles `truth`; appends to `out`, obstacles in their order, then clutter. A function of
// (random, step) and the arguments: the numbers of an obstacle do not depend on which others are seen.
// What is measured from the vehicle becomes world coordinates by `own_state`, whose noise is in the covariance and in
// `range_rate_sigma`. An obstacle that is not finite is not seen.
void scan(const RadarOptions& options, const Kinematics& vehicle, double yaw, std::span<const Kinematics> truth,
          const RandomStream& random, std::uint64_t step, std::vector<Detection>& out);

// Throws std::invalid_argument for options that mean nothing.
void check(const RadarOptions& options);

}  // namespace alula::flight
