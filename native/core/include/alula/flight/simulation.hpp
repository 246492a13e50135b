// Simulated flights: a vehicle, what it measures, what moves around it, and the flight that decides.
//
// Per tick: the sensor measures, unless the measurement is lost; `Flight` decides; the vehicle flies the command, a
// zero-order hold, in steps, while obstacles move. The encounters with them are measured from the truth at every
// step, in continuous time, and so is the distance to the fence of a racer. Clearance to static obstacles is judged
// after the flight from the path. A flight is a function of (seed, trial) and of its parts, except for measured
// times.
//
// Figures over the whole flight are always kept, and what a judge counts in each tick; its path and complete rows of
// ticks where the rules say so.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/flight/encounter_metrics.hpp"
#include "alula/flight/fence_metrics.hpp"
#include "alula/flight/flight.hpp"
#include "alula/flight/geofence_pilot.hpp"
#include "alula/flight/moving_world.hpp"

namespace alula::flight {

// Losses of measurements, and of the pilot's radio. Times are those of the flight [s].
struct Losses {
  double share = 0;  // probability that a measurement is lost, each on its own
  double from_s = std::numeric_limits<double>::infinity(), for_s = 0;
  double radio_from_s = std::numeric_limits<double>::infinity(), radio_for_s = 0;
};

struct SimulationRules {
  int plant_steps = 10;
  double stop_speed = 0.1;         // reached: slower than this, with the reference at its end [m/s]; not of a point
                                   // moved by velocities
  double stuck_speed = 0.02;       // stuck: slower than this and away from the reference,
  std::int64_t stuck_ticks = 200;  // for this many ticks
  double receded_s = std::numeric_limits<double>::infinity();  // ends when all obstacles have receded for this time
  Vec3 lower{-1e9, -1e9, -1e9};                                // a flight that leaves this box is refused
  Vec3 upper{1e9, 1e9, 1e9};
  bool ends_when_refused = true;               // otherwise it flies on with what stands in for refused commands
  bool ends_at_goal = true;                    // otherwise neither a goal that is reached nor being stuck ends it
  double risk_window_s = 0.4;                  // window of the risk of encounters: assumed duration of a command
  bool keeps_path = true, keeps_ticks = true;  // ticks: complete rows of each
};

struct SimulationSpec {
  VehicleSpec vehicle;
  FlightOptions options;
  SimulationRules rules;
  Losses losses;
  MovingSpec moving;
  const Geofence* fence = nullptr;  // not owned; of a racer: flights are judged by its fence and its limits
  // Not owned: a filter among moving obstacles that gets the nominal command of flights without filters, for the
  // metrics of their encounters. Its answer is not flown.
  const SafetyFilter* watcher = nullptr;
};

// One trial: where it starts and what it shall do.
struct Task {
  State start;
  Mission mission;
  std::optional<Pilot> pilot;
  double max_time_s = 60;
  double stop_distance_m = 0.05;          // of the goal, where it counts as reached
  std::optional<Vec4> attitude;           // of the start of a racer, as FlightState has it
  std::optional<Vec3> expected_velocity;  // by which obstacles are drawn to meet the vehicle; else the mission's mean
};

enum class End : std::uint8_t { flying, reached, stuck, timeout, refused, passed, ended };

// Rows of ticks are for the time at their beginning.
struct SimulatedFlight {
  End end = End::flying;
  std::int64_t ticks = 0;
  double path_length_m = 0, max_speed_m_s = 0;   // over the steps of the plant
  double max_acceleration_m_s2 = 0;              // first and
  double mean_jerk_m_s3 = 0, max_jerk_m_s3 = 0;  // second differences of the velocity from tick to tick
  State last;
  EncounterLog encounters;
  std::optional<FenceLog> fence;
  std::vector<double> path;          // (ticks * plant_steps + 1, 3) [m]
  std::vector<double> state;         // (ticks + 1, 12): p, sigma, v, omega
  std::vector<double> attitude;      // (ticks + 1, 4) of a racer: quaternion w, x, y, z
  std::vector<double> estimate;      // (ticks, 12)
  std::vector<double> measured;      // (ticks, 12), NaN where it was lost
  std::vector<double> nominal;       // (ticks, 3): velocity or acceleration of the mission; 0 of a pilot
  std::vector<double> u_nominal;     // (ticks, 4): T and tau of the mission's controller; 0 of points [N, N m]
  std::vector<double> a_command;     // (ticks, 3): `Decision::acceleration`, NaN without one
  std::vector<double> a_error;       // (ticks): largest |a - a_command| at the ends of the plant's steps
  std::vector<double> rotor_thrust;  // (ticks, 4) of the command, as model; 0 without a wrench [N]
  std::vector<double> command;       // (ticks, 11): velocity or acceleration or rates (3), wrench (4), sticks (4)
  std::vector<double> plan_s;        // (ticks + 1): time along a plan that waits for the vehicle, else empty [s]
  std::vector<double> sticks;        // (ticks, 4) of the pilot, NaN when silent
  std::vector<double> obstacle;      // (ticks, n, 3)
  std::vector<double> track;         // (ticks, n, 3), NaN without one
  // (ticks, filters); flags: 1 capped, 2 infeasible, 4 certified, 8 certified against tubes,
  // and 16 times the mode of a filter among moving obstacles
  std::vector<double> margin;               // always kept,
  std::vector<std::uint8_t> status, flags;  // too,
  std::vector<float> filter_s;              // measured, too
  std::vector<double> gate_m;
  std::vector<std::int64_t> active;
  std::vector<std::uint32_t> candidates, rows, iterations;
  std::vector<float> tick_s;              // (ticks) measured: all of observe and decide; always kept
  std::vector<std::uint8_t> mark;         // (ticks): 1 refused, 2 stale, 4 beyond the rotors' limits; always kept
  std::vector<alula_track> tracks;        // as the flight saw them, of all ticks
  std::vector<std::int64_t> track_start;  // (ticks + 1): first row of a tick
};

// Throws std::invalid_argument for an invalid specification.
void check(const SimulationSpec& spec);

// Flies every task with clones of the filters, on `jobs` threads; task i has the number `first_trial` + i.
std::vector<SimulatedFlight> simulate(const SimulationSpec& spec, std::span<const Task> tasks,
                                      std::span<const SafetyFilter* const> filters, std::uint64_t seed,
                                      std::uint32_t first_trial, unsigned jobs, Control& control);

}  // namespace alula::flight
