#include "alula/filters/cone_ecbf.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

constexpr double kSameThrust = 0.01;   // of hover: within this the extension counts as at the nominal thrust
constexpr double kLeastThrust = 0.05;  // of hover: minimum for the smooth snap, torques need thrust to turn

}  // namespace

double ecbf_pole(double h, double h1, double h2, double lambda, double most) {
  if (!(h > 0)) return lambda;
  double pole = std::max(lambda, -h1 / h);
  // psi_2 is >= 0 beyond the larger of its roots.
  const double discriminant = h1 * h1 - h * h2;
  if (discriminant > 0) pole = std::max(pole, (-h1 + std::sqrt(discriminant)) / h);
  return pole <= most ? pole : lambda;
}

ConeEcbf::ConeEcbf(const BackupPolicy& policy, std::shared_ptr<const EllipsoidIndex> index,
                   const ConeEcbfOptions& options, QpSolver solver, Surroundings surroundings, Surroundings others)
    : policy_(policy),
      options_(options),
      pruner_(index, options.pruning, with_room(std::move(others), options.shielded ? options.room_m : 0)),
      roomy_(index, options.shielded ? options.room_m : 0),
      shield_(policy, surroundings.map ? std::move(surroundings) : Surroundings::of(index), options.shield_options,
              index),
      program_(policy.vehicle(), options.pruning.count, std::move(solver)),
      smooth_(options.pruning.count, options.smooth_nominal) {
  const ConeEcbfOptions& o = options_;
  const auto require = [](bool holds, const char* what) {
    if (!holds) throw std::invalid_argument(what);
  };
  require(
      o.lambda > 0 && o.lambda_max >= o.lambda && std::isfinite(o.lambda_max) && o.escape_rate > 0 &&
          o.return_time >= 0 && o.min_speed_m_s >= 0 && std::isfinite(o.min_speed_m_s),
      "poles of the cone filter need 0 < lambda <= lambda_max, a positive escape rate, a return time and a minimum "
      "speed");
  require(o.thrust_bandwidth_rad_s > 0 && o.thrust_bandwidth_rad_s * o.shield_options.tick_s < 1,
          "the bandwidth of the thrust times the tick must lie between 0 and 1");
  require(o.thrust_damping > 0 && o.max_thrust_rate_n_s > 0 && o.min_thrust >= 0 && o.min_thrust < 1,
          "damping and rate of the thrust must be positive, and its minimum below that of hover");
  require(o.room_m >= 0 && std::isfinite(o.room_m), "the room of rows must not be negative");
  require(o.lateral_bias >= 0 && o.lateral_bias < 1 && o.tracking.weight >= 0 && o.tracking.rate > 0 &&
              o.tracking.kp > 0 && o.tracking.kv > 0,
          "bias and weight must not be negative, and rate and gains of the tracking row positive");
}

double ConeEcbf::pole(const Cone& c, const ConeRates& d) const {
  const ConeEcbfOptions& o = options_;
  if (c.h > 0) return ecbf_pole(c.h, d.h1, d.h2, o.lambda, o.lambda_max);
  return std::clamp(o.return_time * c.beta / c.delta, o.lambda, o.lambda_max);
}

// True if the course meets some ellipsoid head-on.
bool ConeEcbf::add_rows(const FlightState& state, const SnapMap& map, std::span<const Found> near, bool moves,
                        FilterReport& report, bool& inside) {
  bool head_on = false;
  for (const Found& found : near) {
    const GrownEllipsoid& e = roomy_.of(pruner_, found.item);
    const Cone c = collision_cone(e, state.x.p, state.x.v);
    const ConeRates d = cone_rates(e, c, map.acceleration, map.jerk);
    inside = inside || c.is_inside();
    head_on = head_on || (moves && is_head_on(c));
    const bool on_gamma = !moves || c.is_inside();
    report.margin = std::min(report.margin, on_gamma ? c.gamma : c.h);
    const SnapRow snap =
        on_gamma ? snap_escape_row(c, d, map, options_.escape_rate) : ecbf_row(c, d, map, pole(c, d));
    smooth_.add(c, on_gamma, found.item);
    program_.add({{snap.row[0] * affine_unit_, snap.row[1], snap.row[2], snap.row[3]},
                  snap.bound - snap.row[0] * affine_zero_},
                 pruner_.number(found.item));
  }
  report.rows = static_cast<std::uint32_t>(program_.barrier_rows());
  return head_on;
}

FilterReport ConeEcbf::filter(const FlightState& state, const Nominal& nominal) {
  FilterReport report;
  report.margin = kInfinity;
  if (!is_usable(state, nominal)) return refused(policy_.vehicle());
  shield_.see(state);
  const Quadrotor& vehicle = policy_.vehicle();
  const ConeEcbfOptions& o = options_;
  const double m = vehicle.mass(), dt = o.shield_options.tick_s;
  const double u = state.thrust / m, u1 = state.thrust_rate / m;
  const bool extends = o.cascade == ThrustCascade::extension;
  const bool moves = geometry::norm(state.x.v) >= o.min_speed_m_s;
  const std::span<const Found> near = pruner_.near(state.x.p, state.x.v, moves, report);
  const SnapMap map = snap_map(vehicle, state);

  // z is the variable: u_T'' = affine_zero + affine_unit z, T = zero + unit z.
  const double w = o.thrust_bandwidth_rad_s, coasting = u + u1 * dt;
  Vec4 nominal_input{nominal.wrench.thrust, nominal.wrench.torque.x, nominal.wrench.torque.y,
                     nominal.wrench.torque.z};
  if (extends) {
    nominal_input[0] = nominal.thrust_acceleration / m + 2 * o.thrust_damping * w * (nominal.thrust_rate / m - u1) +
                       w * w * (nominal.wrench.thrust / m - u);
    affine_zero_ = 0, affine_unit_ = 1;
    program_.start(nominal_input, m * coasting, m * dt * dt / 2, w * w * vehicle.max_thrust() / m);
  } else {
    affine_zero_ = -coasting / (dt * dt), affine_unit_ = 1 / (m * dt * dt);
    program_.start(nominal_input);
  }
  const auto thrust_row = [&](double sign, double bound) {  // sign T >= bound
    const double unit = extends ? m * dt * dt / 2 : 1, zero = extends ? m * coasting : 0;
    program_.add_limit({{sign * unit, 0, 0, 0}, bound - sign * zero});
  };
  const auto rate_row = [&](double sign) {  // |T'| at the end of the tick
    const double unit = extends ? m * dt : 1 / dt, zero = extends ? m * u1 : -m * u / dt;
    program_.add_limit({{sign * unit, 0, 0, 0}, -o.max_thrust_rate_n_s - sign * zero});
  };
  thrust_row(1, o.min_thrust * vehicle.hover_thrust());
  if (extends) rate_row(1), rate_row(-1);
  bool inside = false;
  smooth_.start(dt);
  const bool head_on = add_rows(state, map, near, moves, report, inside);
  program_.track(o.tracking, nominal, map.per_thrust, vehicle.gravity());

  const auto end = [&](const Wrench& wrench, double rate, SafetyStatus status) {
    report.thrust_rate = std::isfinite(rate) ? rate : 0;
    finish(o.shielded ? &shield_ : nullptr, state.x, wrench, inside ? SafetyStatus::recovering : status, status, near,
           report);
    return report;
  };
  const double close = kSameThrust * vehicle.hover_thrust();
  const bool at_nominal =
      !extends || std::abs(program_.wrench(nominal_input).thrust - nominal.wrench.thrust) <= close;
  const bool holds = program_.holds(nominal_input), releases = smooth_.is_releasing();
  if (!releases && at_nominal && holds && program_.tracks(nominal_input) && vehicle.admissible(nominal.wrench))
    return end(nominal.wrench, nominal.thrust_rate, SafetyStatus::ok);

  Vec4 target = nominal_input, best{};
  if (smooth_.is_on() && (releases || !(holds || program_.clears(nominal_input))) &&
      u > kLeastThrust * vehicle.gravity()) {
    target = snap_input(vehicle, state, map, smooth_.snap(map, state.x.v, nominal), nominal.wrench.torque.z);
    target[0] = (target[0] - affine_zero_) / affine_unit_;
    if (!releases || !program_.clears(target)) smooth_.hold();
  }
  if (head_on) {
    const Vec3 torque = tilting_torque(program_, state.x, side_of(state.x.v), o.lateral_bias);
    for (std::size_t j = 0; j < 3; ++j) target[j + 1] += torque[static_cast<int>(j)];
  }
  if (program_.solve(target, best, report)) {
    const Wrench wrench = vehicle.limited(program_.wrench(best));
    const double rate = extends ? state.thrust_rate + m * dt * best[0] : (wrench.thrust - state.thrust) / dt;
    return end(wrench, rate, SafetyStatus::filtered);
  }
  smooth_.hold();
  fly_backup(o.shielded ? &shield_ : nullptr, policy_, state.x, o.try_nominal ? &nominal.wrench : nullptr, near,
             report);
  return report;
}

}  // namespace alula::flight
