// Encounters with moving obstacles, flown in closed loop: world, sensors, tracker, filter, vehicle; and their
// metrics.
//
// Per control tick: scan (at the radar's rate), track, nominal command, filter, plant. Metrics use the truth, between
// ticks too (the distance of two points that move uniformly within a step of the plant). A trial is a function of
// (seed, trial) alone.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "alula/moving_filter.hpp"
#include "alula/parallel.hpp"
#include "alula/tracker.hpp"

namespace alula::flight {

struct EncounterVehicle {
  geometry::Vec3 start{0, 0, 10}, goal{200, 0, 10};
  double start_speed_m_s = 4, cruise_m_s = 4;  // along the course
  double gain = 2;                             // of the speed error [1/s]
  double max_speed_m_s = 12;
  double max_jerk_m_s3 = 60;     // |da/dt|_inf, of what is executed
  double actuation_delay_s = 0;  // of a command until it begins to act
  bool hovers = false;           // the goal is the start: hold it
};

struct EncounterRules {
  double dt_s = 0.01;
  int plant_steps = 10;
  double max_time_s = 14;
  double receded_s = 1;  // ends when all obstacles have receded for so long
};

struct EncounterSpec {
  EncounterVehicle vehicle;
  EncounterRules rules;
  std::vector<ObstacleSpec> obstacles;
  RadarOptions radar;
  TrackerOptions tracker;
  std::vector<double> wall_planes;         // (n, 4) rows of hulls, outward normal and offset,
  std::vector<std::uint32_t> wall_starts;  // and where each hull starts, one more than there are
};

// Of one obstacle in a trial.
struct EncounterMetrics {
  double closest_m = std::numeric_limits<double>::infinity();  // min |P| over the run, centre to centre
  double separation_m =
      std::numeric_limits<double>::quiet_NaN();  // min |P| from the first warning to the end of HOVER
  double closing_m_s = std::numeric_limits<double>::quiet_NaN();  // true, at the first warning that it is urgent in
  double warned_s = std::numeric_limits<double>::quiet_NaN(), detected_s = warned_s;  // first time
  double command_s = warned_s;  // wall clock from the decision to the first avoiding command (t_cm): not reproducible
  double reaction_s = warned_s;  // and the simulated time until |a - a_nominal| > 0.05 (t_r)
  double avoid_s = warned_s;     // from there to the end of HOVER (t_a)
  bool collided = false;
};

struct EncounterLog {
  std::vector<EncounterMetrics> obstacle;
  bool refused = false;
  double wall_clearance_m = std::numeric_limits<double>::infinity();
  std::int64_t ticks = 0, active_ticks = 0, infeasible_ticks = 0, recovering_ticks = 0;
  double worst_violation = 0;
  double risk_spent = 0;             // sum over ticks of the risk that the flown rows left, a bound of the mission's
  std::vector<float> active_tick_s;  // processing time of each active tick (t_cp): not reproducible
  // With `keeps_path`, per tick:
  std::vector<double> vehicle, obstacles, tracks, command, nominal;  // (ticks, 9), (ticks, n, 3), ...
  std::vector<std::uint8_t> mode, status;
};

// Flies trials `first` to `first + count` of a specification.
std::vector<EncounterLog> fly_encounters(const EncounterSpec& spec, const MovingFilter& filter, std::uint64_t seed,
                                         std::uint32_t first, std::uint32_t count, bool keeps_path, unsigned jobs,
                                         Control& control);

}  // namespace alula::flight
