// Metrics of flights of a racing drone in a geofence, and random safe starts.
//
// Distances are measured at every step of the plant, in double precision, along the chord from the previous step.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "alula/base/random.hpp"
#include "alula/filters/geofence.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula::flight {

// Random starts of a racing drone.
struct RacerStarts {
  geometry::Box box;
  double speed_m_s = 10, tilt_rad = 1;  // at most
};

// The first random draw from which the backup controller stays inside, h_I > 0, and that is the radius away from
// `others`, where there are any. Throws std::invalid_argument when there is none among many draws.
RacerState safe_start(const Geofence& geofence, const RacerStarts& starts, const RandomStream& random,
                      const ObstacleMap* others = nullptr);

// Metrics of a flight. All but the distance are of its last filter, one of sticks.
struct FenceLog {
  double min_distance_m = std::numeric_limits<double>::infinity();  // minus the radius; below 0 is a violation
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
  // Rows of ticks, for the time at their beginning.
  std::vector<double> figure;        // (ticks, 5): lambda, h_i, distance, margin, v_towards
  std::vector<double> distance;      // (ticks): the true one over the last step of the plant, minus the radius
  std::vector<std::uint8_t> status;  // (ticks): alula_geofence_status
};

// Collects the metrics of one flight.
class FenceRecorder {
 public:
  // `geofence` has the fence, the radius, the tick and the limits of commands. Rows of ticks are kept if asked for.
  FenceRecorder(const Geofence& geofence, bool keeps_ticks)
      : fence_(geofence.fence()), config_(geofence.config()), keeps_ticks_(keeps_ticks) {}

  void begin(Vec3 p) { advance(p, p); }
  // The filter's report in the tick that begins; `x` is the truth.
  void note(const RacerState& x, const std::optional<RacerCommand>& pilot, const GeofenceReport& report);
  void advance(Vec3 before, Vec3 after);  // a step of the plant

  FenceLog finish() { return std::move(log_); }

 private:
  void note_lambda(const RacerState& x, const GeofenceReport& report);

  const Fence& fence_;
  const alula_geofence_config& config_;
  FenceLog log_;
  std::uint32_t braked_for_ = ALULA_GEOFENCE_NONE;
  bool keeps_ticks_, is_free_ = true;
  double distance_ = 0, backup_s_ = 0;
};

}  // namespace alula::flight
