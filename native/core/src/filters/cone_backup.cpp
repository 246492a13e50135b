#include "alula/filters/cone_backup.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

using geometry::dot;

int steps_of(const BackupPolicy& policy, const ConeBackupOptions& o) {
  if (o.steps > 0 || !(o.horizon_s > 0) || o.nodes < 1) return std::max(1, o.steps);
  return static_cast<int>(std::clamp(std::ceil(o.horizon_s / o.nodes * policy.fastest_rate()), 1.0, 100.0));
}

std::size_t rows_of(const ConeBackupOptions& o) {
  return static_cast<std::size_t>(o.pruning.count) * (static_cast<std::size_t>(std::max(0, o.nodes)) + 2);
}

}  // namespace

ConeBackup::ConeBackup(const BackupPolicy& policy, std::shared_ptr<const EllipsoidIndex> index,
                       const ConeBackupOptions& options, QpSolver solver, Surroundings surroundings,
                       Surroundings others)
    : policy_(policy),
      options_(options),
      pruner_(index, options.pruning, with_room(std::move(others), options.shielded ? options.room_m : 0)),
      roomy_(index, options.shielded ? options.room_m : 0),
      shield_(policy, surroundings.map ? std::move(surroundings) : Surroundings::of(index), options.shield_options,
              index),
      flow_(policy, options.horizon_s, options.nodes, steps_of(policy, options), policy.escapes()),
      program_(policy.vehicle(), rows_of(options), std::move(solver)) {
  const ConeBackupOptions& o = options_;
  const auto require = [](bool holds, const char* what) {
    if (!holds) throw std::invalid_argument(what);
  };
  require(o.alpha_running > 0 && o.alpha_terminal > 0 && std::isfinite(o.alpha_running + o.alpha_terminal),
          "alpha_running and alpha_terminal must be positive");
  require(o.first_node >= 0 && o.first_node <= o.nodes, "the first node must be one of the nodes");
  require(o.min_speed_m_s >= 0 && o.far > 0, "min_speed_m_s must not be negative, and far must be positive");
  require(o.room_m >= 0 && std::isfinite(o.room_m), "the room of rows must not be negative");
  require(o.lateral_bias >= 0 && o.lateral_bias < 1 && o.tracking.weight >= 0 && o.tracking.rate > 0 &&
              o.tracking.kp > 0 && o.tracking.kv > 0,
          "bias and weight must not be negative, and rate and gains of the tracking row positive");
}

// Manoeuvre of the flow ahead: to rest, or for `cone_escape` the shield's manoeuvre.
Manoeuvre ConeBackup::plan(const State& x, std::span<const Found> near) {
  if (!policy_.escapes()) return {};
  Manoeuvre chosen;
  if (options_.shielded) {
    chosen = shield_.plan(x, near);
  } else {
    const Escapes escapes = escape_velocities(pruner_.index(), near, x.p, x.v);
    if (escapes.count > 0) chosen = {escapes.velocity[0], shield_.hold_ticks()};
  }
  chosen.ticks = static_cast<int>(std::lround(chosen.ticks * options_.shield_options.tick_s / flow_.step()));
  return chosen;
}

// True if the course meets some ellipsoid head-on.
bool ConeBackup::add_rows(const State& x, std::span<const Found> near, FilterReport& report, bool& inside) {
  const ConeBackupOptions& o = options_;
  bool head_on = false;
  for (const Found& found : near) {
    const GrownEllipsoid& e = roomy_.of(pruner_, found.item);
    const Cone now = collision_cone(e, x.p, x.v);
    head_on = head_on || is_head_on(now);
    inside = inside || now.is_inside();
    for (int k = 0; k <= flow_.nodes() && !now.is_inside(); ++k) {
      const Vec3 v = flow_.state(k).v;
      if (dot(v, v) < o.min_speed_m_s * o.min_speed_m_s) continue;
      const Cone c = flow_.cone(e, k);
      if (c.delta < 0 && c.gamma > 0) continue;
      report.margin = std::min(report.margin, c.h);
      if (k < o.first_node || c.h > o.far * c.beta) continue;
      program_.add(flow_.running_row(c, k, o.alpha_running), pruner_.number(found.item));
    }
    const Cone last = flow_.cone(e, flow_.nodes());
    program_.add(flow_.clear_row(last, flow_.nodes(), o.alpha_terminal), pruner_.number(found.item));
    report.margin = std::min(report.margin, last.gamma);
  }
  report.rows = static_cast<std::uint32_t>(program_.barrier_rows());
  return head_on;
}

FilterReport ConeBackup::filter(const FlightState& state, const Nominal& nominal) {
  FilterReport report;
  report.margin = kInfinity;
  const Quadrotor& vehicle = policy_.vehicle();
  if (!is_usable(state, nominal)) return refused(vehicle);
  shield_.see(state);
  const ConeBackupOptions& o = options_;
  const std::span<const Found> near = pruner_.near(state.x.p, state.x.v, true, report);
  flow_.run(state.x, plan(state.x, near));

  const Vec4 nominal_input{nominal.wrench.thrust, nominal.wrench.torque.x, nominal.wrench.torque.y,
                           nominal.wrench.torque.z};
  program_.start(nominal_input);
  bool inside = false;
  const bool head_on = add_rows(state.x, near, report, inside);
  program_.track(o.tracking, nominal, thrust_axis(state.x.sigma), vehicle.gravity());

  Shield* const shield = o.shielded ? &shield_ : nullptr;
  const bool unsafe = inside || report.margin < 0;
  const auto end = [&](const Wrench& wrench, double rate, SafetyStatus status) {
    report.thrust_rate = rate;
    finish(shield, state.x, wrench, unsafe ? SafetyStatus::recovering : status, status, near, report);
    return report;
  };
  if (program_.holds(nominal_input) && program_.tracks(nominal_input) && vehicle.admissible(nominal.wrench))
    return end(nominal.wrench, nominal.thrust_rate, SafetyStatus::ok);

  Vec4 best{};
  if (o.solver == BackupSolver::interpolation) {
    const Wrench base = flow_.input();
    if (program_.interpolate({base.thrust, base.torque.x, base.torque.y, base.torque.z}, best, report))
      return end(vehicle.limited(program_.wrench(best)), 0, SafetyStatus::filtered);
  } else {
    Vec4 target = nominal_input;
    if (head_on) {
      const Vec3 torque = tilting_torque(program_, state.x, side_of(state.x.v), o.lateral_bias);
      for (std::size_t j = 0; j < 3; ++j) target[j + 1] += torque[static_cast<int>(j)];
    }
    if (program_.solve(target, best, report))
      return end(vehicle.limited(program_.wrench(best)), 0, SafetyStatus::filtered);
  }
  fly_backup(shield, policy_, state.x, o.try_nominal ? &nominal.wrench : nullptr, near, report);
  return report;
}

}  // namespace alula::flight
