#include "alula/flight/encounter_metrics.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::norm;

constexpr double kReacted = 0.05;  // an acceleration this far from the nominal is a reaction [m/s^2]

}  // namespace

void EncounterRecorder::begin(std::size_t obstacles) {
  window_.assign(obstacles, {});
  log_.obstacle.resize(obstacles);
}

void EncounterRecorder::track(double now, const MovingWorld& world) {
  for (const alula_track& track : world.tracks()) {
    const std::int64_t of = world.obstacle_near(track.position);
    if (of < 0) continue;
    EncounterMetrics& m = log_.obstacle[static_cast<std::size_t>(of)];
    if (std::isnan(m.detected_s)) m.detected_s = now;
  }
}

void EncounterRecorder::answer(const MovingReport& report, const FlightState& seen, Vec3 command, Vec3 nominal,
                               double now, double took, const MovingWorld& world, const Kinematics& vehicle) {
  risk_.add(seen.tracks, vehicle_state_of(seen), command, radius_);
  const bool has_warned = report.warned && report.urgent >= 0;
  const std::int64_t urgent =
      has_warned ? world.obstacle_near(seen.tracks[static_cast<std::size_t>(report.urgent)].position) : -1;
  if (urgent >= 0) {
    const auto i = static_cast<std::size_t>(urgent);
    EncounterMetrics& m = log_.obstacle[i];
    if (std::isnan(m.warned_s)) {
      const Vec3 p = world.truth()[i].p - vehicle.p, v = world.truth()[i].v - vehicle.v;
      m.warned_s = now;
      m.closing_m_s = std::max(0.0, -dot(p, v) / std::max(norm(p), 1e-9));
      m.separation_m = norm(p);
      m.command_s = took;
      window_[i].is_open = true;
    }
  }
  const bool has_reacted = norm(command - nominal) > kReacted;
  for (std::size_t i = 0; i < window_.size(); ++i) {
    if (!window_[i].is_open) continue;
    EncounterMetrics& m = log_.obstacle[i];
    Window& w = window_[i];
    if (has_reacted && std::isnan(w.reacted_s)) w.reacted_s = now, m.reaction_s = now - m.warned_s;
    if (report.mode != ALULA_NOMINAL || now == m.warned_s) continue;
    w.is_open = false;
    if (!std::isnan(w.reacted_s)) m.avoid_s = now - w.reacted_s;
  }
  const bool is_refused = report.status == MovingStatus::refused;
  log_.refused_ticks += is_refused;
  log_.filtered_ticks += report.status != MovingStatus::ok;
  log_.recovering_ticks += report.status == MovingStatus::recovering;
  log_.infeasible_ticks += !is_refused && !report.feasible;
  log_.iterations += report.iterations;
  log_.risk_spent += report.risk_left;
  log_.worst_violation = std::max(log_.worst_violation, report.violation);
  if (!report.warned && report.mode == ALULA_NOMINAL) return;
  ++log_.active_ticks;
  log_.active_tick_s.push_back(static_cast<float>(took));
}

void EncounterRecorder::advance(const Kinematics& before, const Kinematics& after, double h,
                                const MovingWorld& world) {
  for (std::size_t i = 0; i < world.size(); ++i) {
    const Kinematics &was = world.before()[i], &is = world.truth()[i];
    const Vec3 a = 1 / h * ((is.v - after.v) - (was.v - before.v));
    const double closest = closest_approach(was.p - before.p, is.p - after.p, a, h);
    EncounterMetrics& m = log_.obstacle[i];
    m.closest_m = std::min(m.closest_m, closest);
    if (window_[i].is_open) m.separation_m = std::min(m.separation_m, closest);
  }
}

EncounterLog EncounterRecorder::finish() {
  log_.mission_risk = risk_.sum();
  return std::move(log_);
}

}  // namespace alula::flight
