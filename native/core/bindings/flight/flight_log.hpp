// Logs of simulated flights as dicts of numbers and NumPy arrays.
#pragma once

#include <nanobind/nanobind.h>

#include <string>
#include <utility>
#include <vector>

#include "alula/flight/simulation.hpp"
#include "flight_arrays.hpp"

namespace alula::flight {

namespace nb = nanobind;
using LogDict = nb::typed<nb::dict, nb::str, nb::any>;

// A vector per figure of the obstacles, and one number per figure of the filter.
inline void add_metrics(LogDict& d, EncounterLog&& log) {
  using M = EncounterMetrics;
  using L = EncounterLog;
  static constexpr std::pair<const char*, double M::*> kOfObstacles[] = {
      {"closest_m", &M::closest_m},     {"separation_m", &M::separation_m},
      {"closing_m_s", &M::closing_m_s}, {"detected_s", &M::detected_s},
      {"warned_s", &M::warned_s},       {"command_s", &M::command_s},
      {"reaction_s", &M::reaction_s},   {"avoid_s", &M::avoid_s}};
  static constexpr std::pair<const char*, std::int64_t L::*> kCounts[] = {
      {"active_ticks", &L::active_ticks},         {"filtered_ticks", &L::filtered_ticks},
      {"infeasible_ticks", &L::infeasible_ticks}, {"recovering_ticks", &L::recovering_ticks},
      {"refused_ticks", &L::refused_ticks},       {"total_iterations", &L::iterations}};
  static constexpr std::pair<const char*, double L::*> kFigures[] = {
      {"worst_violation", &L::worst_violation}, {"risk_spent", &L::risk_spent}, {"mission_risk", &L::mission_risk}};
  for (const auto& [name, figure] : kOfObstacles) {
    std::vector<double> each;
    for (const M& one : log.obstacle) each.push_back(one.*figure);
    d[name] = to_numpy(std::move(each), {log.obstacle.size()});
  }
  for (const auto& [name, count] : kCounts) d[name] = log.*count;
  for (const auto& [name, figure] : kFigures) d[name] = log.*figure;
  const std::size_t active = log.active_tick_s.size();
  d["active_tick_s"] = to_numpy(std::move(log.active_tick_s), {active});
}

inline LogDict to_dict(FenceLog&& log) {
  LogDict d;
  d["min_distance_m"] = log.min_distance_m, d["min_lambda"] = log.min_lambda, d["min_h_i"] = log.min_h_i;
  d["brake_distance_m"] = log.brake_distance_m, d["stop_distance_m"] = log.stop_distance_m;
  d["ticks"] = log.ticks, d["passed"] = log.passed, d["blended"] = log.blended, d["backup"] = log.backup;
  d["no_pilot"] = log.no_pilot, d["hand_over"] = log.hand_over, d["refused"] = log.refused;
  d["interventions"] = log.interventions, d["altered_passes"] = log.altered_passes;
  d["out_of_range"] = log.out_of_range, d["longest_backup_s"] = log.longest_backup_s;
  const std::size_t rows = log.status.size();
  d["figure"] = to_numpy(std::move(log.figure), {rows, 5});
  d["distance"] = to_numpy(std::move(log.distance), {rows});
  d["status"] = to_numpy(std::move(log.status), {rows});
  return d;
}

inline LogDict to_dict(SimulatedFlight&& f, std::size_t filters) {
  static constexpr const char* kEnds[] = {"flying", "reached", "stuck", "timeout", "refused", "passed", "ended"};
  const std::size_t ticks = f.tick_s.size(), rows = f.estimate.size() / 12, points = f.path.size() / 3,
                    tracks = f.tracks.size();
  const std::size_t n = f.encounters.obstacle.size(), states = f.state.size() / 12, starts = f.track_start.size();
  LogDict d;
  add_metrics(d, std::move(f.encounters));
  if (f.fence) d["fence"] = to_dict(std::move(*f.fence));
  d["last"] = to_array(f.last);
  d["end"] = kEnds[static_cast<std::size_t>(f.end)];
  d["ticks"] = f.ticks;
  d["path_length_m"] = f.path_length_m, d["max_speed_m_s"] = f.max_speed_m_s;
  d["max_acceleration_m_s2"] = f.max_acceleration_m_s2;
  d["mean_jerk_m_s3"] = f.mean_jerk_m_s3, d["max_jerk_m_s3"] = f.max_jerk_m_s3;
  d["path"] = to_numpy(std::move(f.path), {points, 3});
  d["state"] = to_numpy(std::move(f.state), {states, 12});
  const std::size_t attitudes = f.attitude.size() / 4;
  d["attitude"] = to_numpy(std::move(f.attitude), {attitudes, 4});
  d["estimate"] = to_numpy(std::move(f.estimate), {rows, 12});
  d["measured"] = to_numpy(std::move(f.measured), {rows, 12});
  d["nominal"] = to_numpy(std::move(f.nominal), {rows, 3});
  d["u_nominal"] = to_numpy(std::move(f.u_nominal), {rows, 4});
  d["a_command"] = to_numpy(std::move(f.a_command), {rows, 3});
  d["a_error"] = to_numpy(std::move(f.a_error), {rows});
  d["rotor_thrust"] = to_numpy(std::move(f.rotor_thrust), {rows, 4});
  d["command"] = to_numpy(std::move(f.command), {rows, 11});
  const std::size_t times = f.plan_s.size();
  d["plan_s"] = to_numpy(std::move(f.plan_s), {times});
  d["sticks"] = to_numpy(std::move(f.sticks), {rows, 4});
  d["obstacle"] = to_numpy(std::move(f.obstacle), {rows, n, 3});
  d["track"] = to_numpy(std::move(f.track), {rows, n, 3});
  d["margin"] = to_numpy(std::move(f.margin), {ticks, filters});
  d["gate_m"] = to_numpy(std::move(f.gate_m), {rows, filters});
  d["active"] = to_numpy(std::move(f.active), {rows, filters});
  d["candidates"] = to_numpy(std::move(f.candidates), {rows, filters});
  d["rows"] = to_numpy(std::move(f.rows), {rows, filters});
  d["iterations"] = to_numpy(std::move(f.iterations), {rows, filters});
  d["status"] = to_numpy(std::move(f.status), {ticks, filters});
  d["flags"] = to_numpy(std::move(f.flags), {ticks, filters});
  d["filter_s"] = to_numpy(std::move(f.filter_s), {ticks, filters});
  d["tick_s"] = to_numpy(std::move(f.tick_s), {ticks});
  d["mark"] = to_numpy(std::move(f.mark), {ticks});
  d["track_start"] = to_numpy(std::move(f.track_start), {starts});
  d["tracks"] = nb::bytes(reinterpret_cast<const char*>(f.tracks.data()), tracks * sizeof(alula_track));
  return d;
}

}  // namespace alula::flight
