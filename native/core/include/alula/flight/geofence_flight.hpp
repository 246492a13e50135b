// Flights of a racing drone inside a geofence with simulated pilots.
//
// Per tick of the filter: the pilot uses the true state, the filter the navigation's, and the plant takes
// `plant_steps` steps with the filter's command. Distances are measured at every step of the plant, in double
// precision, along the chord from the previous step. A flight is a function of (seed, trial).
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/filters/backup_qp.hpp"
#include "alula/flight/geofence_pilot.hpp"

namespace alula::flight {

enum class FenceRule : std::uint8_t { none, geofence, backup_qp };

struct GeofenceRules {
  double duration_s = 8;
  int plant_steps = 4;  // per tick of the filter
  FenceRule rule = FenceRule::geofence;
  double alpha = BackupQpOptions{}.alpha;  // of backup_qp
  // Navigation is missing in [from, from + for); `radio` the same for the pilot.
  double stale_from_s = std::numeric_limits<double>::infinity(), stale_for_s = 0;
  double radio_from_s = std::numeric_limits<double>::infinity(), radio_for_s = 0;
};

void check(const GeofenceRules& rules);

struct GeofenceSpec {
  RacerModel model;  // of plant and pilot; the filter has its own in its parameters
  RacerOptions options;
  Pilot pilot;
  GeofenceRules rules;
  std::optional<RacerState> start;  // if missing, a random one with h_I > 0 from:
  geometry::Box start_box;
  double start_speed_m_s = 10, start_tilt_rad = 1;
};

struct GeofenceTrace {
  std::vector<double> state;     // (n, 13): p, v, q wxyz, omega, at the beginning of a tick
  std::vector<double> pilot;     // (n, 4): throttle, rates; NaN when silent
  std::vector<double> command;   // (n, 4)
  std::vector<double> figure;    // (n, 5): lambda, h_i, distance, margin, v_towards
  std::vector<double> distance;  // (n): the true one over the last step of the plant, minus the radius
  std::vector<std::uint8_t> status;
};

struct GeofenceLog {
  double min_distance_m = std::numeric_limits<double>::infinity();  // minus the radius; below 0 is a violation
  double max_speed_m_s = 0;
  double min_lambda = 1;
  double min_h_i = std::numeric_limits<double>::infinity();
  // Distance to what the vehicle brakes for (Fence::braked_for) when first lambda < 1/2, and to the same when first
  // slower than 0.5 m/s after it, both minus the radius.
  double brake_distance_m = std::numeric_limits<double>::quiet_NaN();
  double stop_distance_m = std::numeric_limits<double>::quiet_NaN();
  std::int64_t ticks = 0, passed = 0, blended = 0, backup = 0, no_pilot = 0, hand_over = 0, refused = 0;
  std::int64_t interventions = 0;   // times lambda fell below 1/2, after having been above 9/10
  std::int64_t altered_passes = 0;  // commands of PASSED that differ from the pilot's bits; must be 0
  std::int64_t out_of_range = 0;    // commands outside the model's limits or lambda outside [0, 1]; must be 0
  double longest_backup_s = 0;      // longest time with u_B alone
  double path_length_m = 0;         // over the steps of the plant
  double mean_jerk_m_s3 = 0, max_jerk_m_s3 = 0;  // second difference of the velocity over ticks
  std::vector<float> tick_s;  // measured time of the filter in each tick; not a function of (seed, trial)
  RacerState start, end;
  GeofenceTrace trace;
};

GeofenceLog fly_in_fence(const GeofenceSpec& spec, const Geofence& filter, RandomStream random, bool keeps_trace);

// Trials first .. first + count - 1, in parallel; the result does not depend on `jobs`.
std::vector<GeofenceLog> fly_in_fences(const GeofenceSpec& spec, const Geofence& filter, std::uint64_t seed,
                                       std::uint32_t first, std::uint32_t count, bool keeps_trace, unsigned jobs,
                                       Control& control);

}  // namespace alula::flight
