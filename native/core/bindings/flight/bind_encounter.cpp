// Bindings of alula/flight/encounter.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <utility>
#include <vector>

#include "alula/flight/encounter.hpp"
#include "alula/flight/encounter_watch.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Fields<flight::EncounterVehicle> {
  using Vehicle = flight::EncounterVehicle;
  static constexpr std::tuple all{
      Field{"start", &Vehicle::start, "start [m]"},
      Field{"goal", &Vehicle::goal, "goal [m]"},
      Field{"start_speed_m_s", &Vehicle::start_speed_m_s, "speed at the start, along the course [m/s]"},
      Field{"cruise_m_s", &Vehicle::cruise_m_s, "nominal speed [m/s]"},
      Field{"gain", &Vehicle::gain, "gain of the speed error [1/s]"},
      Field{"radius_m", &Vehicle::radius_m, "radius of the sphere [m]"},
      Field{"max_speed_m_s", &Vehicle::max_speed_m_s, "maximum |v| of the executed motion [m/s]"},
      Field{"max_acceleration_m_s2", &Vehicle::max_acceleration_m_s2, "maximum |a|_inf of a command [m/s^2]"},
      Field{"max_jerk_m_s3", &Vehicle::max_jerk_m_s3, "maximum |da/dt|_inf of the executed motion [m/s^3]"},
      Field{"actuation_delay_s", &Vehicle::actuation_delay_s, "time from a command until it acts [s]"},
      Field{"hovers", &Vehicle::hovers, "hold the start instead of flying to the goal"}};
};

template <>
struct Fields<flight::EncounterRules> {
  using Rules = flight::EncounterRules;
  static constexpr std::tuple all{
      Field{"dt_s", &Rules::dt_s, "time step of the filter [s]"},
      Field{"plant_steps", &Rules::plant_steps, "steps of the plant per tick"},
      Field{"max_time_s", &Rules::max_time_s, "time limit [s]"},
      Field{"receded_s", &Rules::receded_s, "a trial ends when all obstacles have receded for so long [s]"},
      Field{"risk_window_s", &Rules::risk_window_s, "window of the mission risk [s]"}};
};

namespace flight {
namespace {

using LogDict = nb::typed<nb::dict, nb::str, nb::any>;

constexpr std::size_t kFigures = 8;

// One row per obstacle: closest, separation, closing, detected, warned, command, reaction, avoid; and `collided`.
void add_metrics(nb::dict& to, const std::vector<EncounterMetrics>& obstacles) {
  const std::size_t n = obstacles.size();
  std::vector<double> rows;
  std::vector<std::uint8_t> collided;
  rows.reserve(n * kFigures);
  for (const EncounterMetrics& m : obstacles) {
    rows.insert(rows.end(), {m.closest_m, m.separation_m, m.closing_m_s, m.detected_s, m.warned_s, m.command_s,
                             m.reaction_s, m.avoid_s});
    collided.push_back(m.collided ? 1 : 0);
  }
  to["obstacle"] = to_numpy(std::move(rows), {n, kFigures});
  to["collided"] = to_numpy(std::move(collided), {n});
}

LogDict to_dict(EncounterLog&& log, bool keeps_path) {
  LogDict result;
  add_metrics(result, log.obstacle);
  result["outcome"] = log.outcome == EncounterOutcome::passed ? "passed" : "timeout";
  result["wall_clearance_m"] = log.wall_clearance_m;
  result["ticks"] = log.ticks;
  result["active_ticks"] = log.active_ticks;
  result["filtered_ticks"] = log.filtered_ticks;
  result["infeasible_ticks"] = log.infeasible_ticks;
  result["recovering_ticks"] = log.recovering_ticks;
  result["refused_ticks"] = log.refused_ticks;
  result["iterations"] = log.iterations;
  result["worst_violation"] = log.worst_violation;
  result["risk_spent"] = log.risk_spent;
  result["mission_risk"] = log.mission_risk;
  result["path_length_m"] = log.path_length_m;
  result["max_speed_m_s"] = log.max_speed_m_s;
  result["mean_jerk_m_s3"] = log.mean_jerk_m_s3;
  result["max_jerk_m_s3"] = log.max_jerk_m_s3;
  const std::size_t active = log.active_tick_s.size();
  result["active_tick_s"] = to_numpy(std::move(log.active_tick_s), {active});
  if (!keeps_path) return result;
  const std::size_t ticks = log.mode.size(), n = log.obstacle.size();
  result["vehicle"] = to_numpy(std::move(log.vehicle), {ticks, 9});
  result["obstacles"] = to_numpy(std::move(log.obstacles), {ticks, n, 3});
  result["tracks"] = to_numpy(std::move(log.tracks), {ticks, n, 3});
  result["command"] = to_numpy(std::move(log.command), {ticks, 3});
  result["nominal"] = to_numpy(std::move(log.nominal), {ticks, 3});
  result["mode"] = to_numpy(std::move(log.mode), {ticks});
  result["status"] = to_numpy(std::move(log.status), {ticks});
  return result;
}

void bind_vehicle_and_rules(nb::module_& m) {
  fields::bind<EncounterVehicle>(m, "EncounterVehicle",
                                 "A sphere among moving obstacles that moves as a double integrator with limits of "
                                 "speed, acceleration and jerk; it holds its start or goes to its goal.");
  fields::bind<EncounterRules>(m, "EncounterRules", "Timing of an encounter and its end conditions.");
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_encounter(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  bind_vehicle_and_rules(m);
  nb::class_<EncounterSpec>(m, "EncounterSpec", "Specification of an encounter, without the filter.")
      .def(
          "__init__",
          [](EncounterSpec* self, const EncounterVehicle& vehicle, const EncounterRules& rules,
             const MovingSpec& moving, const PolytopeSet* walls) {
            const EncounterSpec spec{vehicle, rules, moving, walls};
            check(spec);
            new (self) EncounterSpec(spec);
          },
          nb::kw_only(), "vehicle"_a = EncounterVehicle{}, "rules"_a = EncounterRules{}, "moving"_a = MovingSpec{},
          "walls"_a.none() = nb::none(), nb::keep_alive<1, 5>(),
          "Create a specification; ValueError if it is invalid.");
  m.def(
      "fly_encounters",
      [](const EncounterSpec& spec, const MovingFilter& filter, std::uint64_t seed, std::uint32_t first,
         std::uint32_t count, bool keeps_path, unsigned jobs, nb::object progress) {
        PythonControl control(std::move(progress));
        std::vector<EncounterLog> logs;
        {
          const nb::gil_scoped_release release;
          logs = fly_encounters(spec, filter, seed, first, count, keeps_path, jobs, control);
        }
        nb::typed<nb::list, LogDict> result;
        for (EncounterLog& log : logs) result.append(to_dict(std::move(log), keeps_path));
        return result;
      },
      "spec"_a, "filter"_a, nb::kw_only(), "seed"_a = 0, "first"_a = 0, "count"_a = 1, "keeps_path"_a = false,
      "jobs"_a = 0, "progress"_a = nb::none(),
      "Fly trials first..first + count, each a function of (seed, trial); a dict of figures per trial. `obstacle` "
      "has "
      "a row per obstacle: closest [m], separation [m], closing [m/s], detected, warned, command (measured), "
      "reaction "
      "and avoid [s], NaN for events that did not occur; with keeps_path also a row per tick of the vehicle (p, v, "
      "a), "
      "obstacles, "
      "tracks, command, nominal, mode and status.");
  m.def(
      "collision_risk",
      [](const Triple& position, const Triple& velocity, const std::array<double, 21>& covariance,
         const Triple& command, double radius, double window) {
        const alula_vehicle_state vehicle{};
        alula_track track{};
        for (std::size_t k = 0; k < 3; ++k) {
          track.position[k] = static_cast<float>(position[k]);
          track.velocity[k] = static_cast<float>(velocity[k]);
        }
        for (std::size_t k = 0; k < 21; ++k) track.covariance[k] = static_cast<float>(covariance[k]);
        return risk_of(track, vehicle, vector_of(command), radius, window);
      },
      "position"_a, "velocity"_a, "covariance"_a, "command"_a, "radius"_a, "window_s"_a,
      "Collision risk of an obstacle relative to the vehicle, covariance of (p, v) as a lower triangle row by row: "
      "bound on the "
      "probability that it is within the radius when it comes closest in the window.");
  m.def(
      "closest_approach",
      [](const Triple& r0, const Triple& r1, const Triple& a, double h) {
        return closest_approach(vector_of(r0), vector_of(r1), vector_of(a), h);
      },
      "r0"_a, "r1"_a, "a"_a, "h"_a,
      "Minimum |r(t)|, 0 <= t <= h, of the parabola from r0 to r1 with acceleration a.");
}
