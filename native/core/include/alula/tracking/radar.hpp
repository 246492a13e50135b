// Simulated sensors of moving obstacles: detections without identity, with misses and clutter.
//
// Source: Mandaokar, Rinner 2025 (DR-ACBF), section IV-A; numbers that the paper does not state are options.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/flight/obstacle_motion.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula::flight {

// Radar: obstacles within the field of view, each detected with a probability; white noise of range, angles and range
// rate; clutter. Mocap: only the position, of all obstacles within `max_range_m`, each detected with the probability.
// Ideal: only the position, of all obstacles. The covariance of a position is that of its noise to first order.

// A measured position with its covariance; if `has_doppler`, also the velocity component along `los`.
struct Detection {
  geometry::Vec3 position;    // world frame [m]
  geometry::Mat3 covariance;  // [m^2]
  bool has_doppler = false;
  geometry::Vec3 los;     // from the sensor
  double range_rate = 0;  // velocity of the obstacle along it, without the sensor's own motion [m/s]
  double range_rate_sigma = 0;
};

enum class SensorKind : std::uint8_t { radar, ideal, mocap };

struct RadarOptions {
  SensorKind kind = SensorKind::radar;
  double rate_hz = 20;
  double half_azimuth_rad = 0.6981317007977318, half_elevation_rad = 0.17453292519943295;  // about the body's x axis
  double max_range_m = 150;
  double detection_probability = 0.95;
  // Both angles are across the line of sight: an azimuth error is the horizontal error over cos(elevation).
  double sigma_range_m = 0.15, sigma_azimuth_rad = 0.008726646259971648, sigma_elevation_rad = 0.012217304763960306;
  double sigma_range_rate_m_s = 0.1;
  double clutter_per_scan = 0.1;       // Poisson, uniform in the field of view's volume,
  double clutter_range_rate_m_s = 15;  // with range rates uniform within +- this
  double noise_scale = 1;              // factor on all sigmas
  double position_sigma_m = 0;         // ideal and mocap: white noise per axis, at least 1e-4
  double delay_s = 0;                  // between a detection and the tracker
  double own_position_sigma_m = 0, own_velocity_sigma_m_s = 0;  // noise of the vehicle's own state, per axis
};

// The region that a scan covers: an obstacle inside is detected with the detection probability, outside never.
struct FieldOfView {
  geometry::Vec3 position;  // estimated position of the sensor
  double yaw = 0;
  double half_azimuth_rad = 0, half_elevation_rad = 0;  // pi and pi / 2: all around
  double max_range_m = 0;

  // True if it contains everything within `margin` standard deviations of a Gaussian position: of the
  // range and of both angles, each separately and to first order.
  bool holds(geometry::Vec3 mean, const geometry::Mat3& covariance, double margin) const;
};

FieldOfView field_of_view(const RadarOptions& options, const Kinematics& own, double yaw);

// The vehicle's estimate of its own state at `step`: position and velocity with noise, the true acceleration.
Kinematics own_state(const RadarOptions& options, const Kinematics& vehicle, const RandomStream& random,
                     std::uint64_t step);

// One scan at `step` for obstacles `truth`; appends to `out`, obstacles in their order, then clutter. The field of
// view is level, about the horizontal heading (cos yaw, sin yaw, 0). A function of (random, step) and the arguments:
// the numbers of an obstacle do not depend on which others are detected. Measurements relative to the vehicle become
// world coordinates by `own_state`; its noise is included in the covariance and in `range_rate_sigma`. An obstacle
// that is not finite is not detected.
void scan(const RadarOptions& options, const Kinematics& vehicle, double yaw, std::span<const Kinematics> truth,
          const RandomStream& random, std::uint64_t step, std::vector<Detection>& out);

// Throws std::invalid_argument for options out of range.
void check(const RadarOptions& options);

}  // namespace alula::flight
