// Closed-loop encounters with moving obstacles: world, sensors, tracker, filter, vehicle; and their metrics.
//
// Per control tick: scans that have arrived, tracks, nominal command, filter, plant. Scans are made at the sensor's
// rate, at the first plant step that is due. The nominal command goes to the goal,
//
//   v_des = min(cruise, sqrt(a_max dist)) towards it,  a = clip(gain (v_des - v), a_max),
//
// and a refused command is replaced by braking. Metrics use the true states, between steps too: within a step of the
// plant the vehicle's acceleration is constant, and the relative motion is approximated by a parabola. A trial is a
// function of (seed, trial) alone, except for its measured times.
//
// Source: Mandaokar, Rinner 2025 (DR-ACBF, arXiv 2512.00462), section IV-A.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "alula/base/parallel.hpp"
#include "alula/filters/moving_filter.hpp"
#include "alula/flight/moving_world.hpp"
#include "alula/geometry/clearance.hpp"

namespace alula::flight {

struct EncounterVehicle {
  geometry::Vec3 start{0, 0, 10}, goal{200, 0, 10};
  double start_speed_m_s = 4, cruise_m_s = 4;  // along the course
  double gain = 2;                             // of the speed error [1/s]
  double radius_m = 0.15;
  double max_speed_m_s = 12;         // limit of the executed |v|
  double max_acceleration_m_s2 = 6;  // limit of |a|_inf of a command
  double max_jerk_m_s3 = 60;         // limit of the executed |da/dt|_inf, except where the speed limit acts
  double actuation_delay_s = 0;      // time from a command until it begins to act
  bool hovers = false;               // the goal is the start: hold it
};

struct EncounterRules {
  double dt_s = 0.01;
  int plant_steps = 10;
  double max_time_s = 14;
  double receded_s = 1;        // a trial ends when all obstacles have receded for this time
  double risk_window_s = 0.4;  // window of `mission_risk`: assumed duration of a command
};

struct EncounterSpec {
  EncounterVehicle vehicle;
  EncounterRules rules;
  MovingSpec moving;
  // Not owned, may be null. For each polytope the filter receives the plane with the best separation, nearest first;
  // of more than ALULA_WALLS, those that allow the vehicle the least speed.
  const PolytopeSet* walls = nullptr;
};

enum class EncounterOutcome : std::uint8_t { passed, timeout };  // passed: all obstacles have receded

// Metrics of one obstacle in a trial.
struct EncounterMetrics {
  static constexpr double kNever = std::numeric_limits<double>::quiet_NaN();

  double closest_m = std::numeric_limits<double>::infinity();  // min |P| over the run, centre to centre
  double separation_m = kNever;  // min |P| from its warning to the end of HOVER, or of the run
  double closing_m_s = kNever;   // true closing speed at its warning
  double detected_s = kNever;    // first time at which a confirmed track is near it
  double warned_s = kNever;      // first warning in which it is the most urgent obstacle
  double command_s = kNever;     // wall time of the filter in that tick, at least t_cm: not reproducible
  double reaction_s = kNever;    // simulated time from the warning until |a - a_nominal| > 0.05 (t_r minus t_cm)
  double avoid_s = kNever;       // from there to the end of HOVER (t_a)
  bool collided = false;         // closest_m is at most the sum of the radii
};

struct EncounterLog {
  std::vector<EncounterMetrics> obstacle;
  EncounterOutcome outcome = EncounterOutcome::timeout;
  double wall_clearance_m = std::numeric_limits<double>::infinity();  // of the vehicle's sphere, below 0 in a wall
  // Active: in a manoeuvre, or warned. Filtered: the command is not the nominal.
  std::int64_t ticks = 0, active_ticks = 0, filtered_ticks = 0, infeasible_ticks = 0, recovering_ticks = 0,
               refused_ticks = 0, iterations = 0;
  double worst_violation = 0;  // maximum row violation of the flown commands, as an acceleration [m/s^2]
  double risk_spent = 0;       // sum over ticks of the remaining risk: bound on the probability that any row fails
  // Sum over consecutive windows and tracks of the largest `risk_of` (encounter_watch.hpp) in each. It is not a
  // bound: other ticks of a window could fail too, and obstacles are assumed to keep their velocity.
  double mission_risk = 0;
  double path_length_m = 0, max_speed_m_s = 0;
  double mean_jerk_m_s3 = 0, max_jerk_m_s3 = 0;  // second differences of the velocity at the rate of the filter
  std::vector<float> active_tick_s;              // processing time of each active tick (t_cp): not reproducible
  // With `keeps_path`, values at the beginning of each tick; for each obstacle also its nearest track, or NaN.
  std::vector<double> vehicle, obstacles, tracks, command, nominal;  // (ticks, 9), (ticks, n, 3), ..., (ticks, 3)
  std::vector<std::uint8_t> mode, status;
};

// Throws std::invalid_argument for an invalid specification.
void check(const EncounterSpec& spec);

// Flies trials `first` to `first + count` of a specification, each with a clone of the filter. Throws like `check`.
std::vector<EncounterLog> fly_encounters(const EncounterSpec& spec, const MovingFilter& filter, std::uint64_t seed,
                                         std::uint32_t first, std::uint32_t count, bool keeps_path, unsigned jobs,
                                         Control& control);

}  // namespace alula::flight
