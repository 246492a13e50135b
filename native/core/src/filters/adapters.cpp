#include "alula/filters/adapters.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>

#include "alula/base/least.hpp"
#include "alula/filters/moving_guide.hpp"

namespace alula::flight {
namespace {

constexpr double kWallsAhead = 5;  // walls farther than this time at full speed are not passed on [s], ...
constexpr double kBraking = 0.5;   // ... unless stopping before them takes this fraction of the maximum acceleration

SafetyStatus status_of(alula_geofence_status status) {
  switch (status) {
    case ALULA_GEOFENCE_PASSED:
      return SafetyStatus::ok;
    case ALULA_GEOFENCE_BLENDED:
      return SafetyStatus::filtered;
    case ALULA_GEOFENCE_BACKUP:
    case ALULA_GEOFENCE_NO_PILOT:
      return SafetyStatus::backup;
    case ALULA_GEOFENCE_HAND_OVER:
      return SafetyStatus::recovering;
    default:
      return SafetyStatus::refused;
  }
}

}  // namespace

WallPlanes::WallPlanes(std::shared_ptr<const ObstacleMap> map, double max_speed, double max_acceleration,
                       double radius)
    : map_(std::move(map)), brake_(kBraking * max_acceleration), radius_(radius) {
  farthest_ = std::max(kWallsAhead * max_speed, max_speed * max_speed / (2 * brake_));
  if (map_) memory_ = map_->memory();
  near_.reserve(ALULA_WALLS), walls_.reserve(ALULA_WALLS);
}

std::span<const alula_wall> WallPlanes::at(Vec3 p, Vec3 v) {
  walls_.clear(), near_.clear();
  if (!map_ || !geometry::is_finite(p)) return {};
  double reach = farthest_;
  const double speed = norm(v);
  const auto before = [](const Near& a, const Near& b) {
    return a.spare < b.spare || (a.spare == b.spare && nearer(a.contact, b.contact));
  };
  const auto keep = [&](const Contact& c) {
    // possible increase of the speed towards it
    const Near it{c, std::sqrt(2 * brake_ * std::max(0.0, c.distance - radius_)) + dot(c.normal, v)};
    if (!keep_least(near_, ALULA_WALLS, it, before)) return;
    // Farther away the vehicle has more to spare, even where it flies straight at the obstacle.
    const double most = near_.front().spare + speed;
    reach = std::min(farthest_, (1 + 1e-12) * (radius_ + most * most / (2 * brake_)));
  };
  map_->visit(p, reach, std::ref(keep), memory_);
  std::sort(near_.begin(), near_.end(), [](const Near& a, const Near& b) { return nearer(a.contact, b.contact); });
  for (const Near& each : near_) {
    const auto n = to_float(each.contact.normal);
    walls_.push_back({{n[0], n[1], n[2]}, round_down(each.contact.distance)});
  }
  return walls_;
}

FilterReport VelocityFilter::filter(const FlightState& state, const Nominal& nominal) {
  const geometry::Vec3 p = state.x.p, u = nominal.velocity;
  FilterReport report;
  if (is_bare_) {
    const alula_polytope_value value = filter_.evaluate({p.x, p.y, p.z});
    report.velocity = u, report.status = SafetyStatus::ok, report.solve_time_s = 0;
    report.margin = value.smooth - static_cast<float>(filter_.config().radius_m);
    report.active = value.nearest == ALULA_NO_HULL ? -1 : static_cast<std::int64_t>(value.nearest);
    return report;
  }
  const FilterOutput output = filter_.filter({p.x, p.y, p.z}, {u.x, u.y, u.z}, state.more_margin_m);
  report.status = static_cast<SafetyStatus>(output.status);
  report.velocity = {output.u[0], output.u[1], output.u[2]};
  report.margin = output.detail.margin_m;
  report.active = output.detail.active == ALULA_NO_HULL ? -1 : static_cast<std::int64_t>(output.detail.active);
  return report;
}

alula_vehicle_state vehicle_state_of(const FlightState& state) {
  alula_vehicle_state own{};
  for (int i = 0; i < 3; ++i) {
    own.position[i] = static_cast<float>(state.x.p[i]);
    own.velocity[i] = static_cast<float>(state.x.v[i]);
  }
  own.covariance[0] = static_cast<float>(state.position_variance.x);
  own.covariance[3] = static_cast<float>(state.position_variance.y);
  own.covariance[5] = static_cast<float>(state.position_variance.z);
  return own;
}

FilterReport MovingSafety::filter(const FlightState& state, const Nominal& nominal) {
  const MovingReport found =
      filter_->filter(vehicle_state_of(state), state.tracks, walls_.at(state.x.p, state.x.v), nominal.acceleration);
  FilterReport report;
  report.status = static_cast<SafetyStatus>(found.status);
  report.acceleration = found.acceleration;
  report.margin = -found.violation;
  report.active = found.warned ? found.urgent : -1;
  report.rows = found.rows;
  report.iterations = found.iterations;
  report.infeasible = found.status != MovingStatus::refused && !found.feasible;
  report.moving = found;
  return report;
}

FenceFilter::FenceFilter(const Geofence& geofence, std::optional<double> alpha, bool is_bare)
    : geofence_(geofence), alpha_(alpha), is_bare_(is_bare) {
  if (alpha_) program_.emplace(geofence_, *alpha_);
}

void FenceFilter::reset() {
  geofence_.reset();
  if (program_) program_->reset();
}

FilterReport FenceFilter::filter(const FlightState& state, const Nominal& nominal) {
  const RacerState x = to_racer(state.x, state.attitude);
  const std::optional<RacerCommand>& pilot = nominal.sticks;
  const bool is_heard = pilot && is_finite(*pilot);
  FilterReport report;
  GeofenceReport& found = report.fence.emplace();
  if (is_bare_ || (program_ && is_heard)) {
    if (!is_heard || !state.is_known) return report;
    found.status = ALULA_GEOFENCE_PASSED;
    found.command = *pilot;
    found.detail.lambda = 1;
    found.detail.h_i = -FLT_MAX;  // not evaluated
    found.detail.deciding = ALULA_GEOFENCE_NONE;
    report.margin = std::numeric_limits<double>::infinity();
    if (!is_bare_) by_program(x, *pilot, report);
    found.detail.command = to_onboard(found.command);
  } else {
    found = geofence_.filter(state.is_known ? &x : nullptr, pilot ? &*pilot : nullptr);
    report.margin = found.detail.h_i;
  }
  report.sticks = found.command;
  report.status = status_of(found.status);
  return report;
}

// lambda is 1, or 0 where the program changed the pilot's command.
void FenceFilter::by_program(const RacerState& x, const RacerCommand& pilot, FilterReport& report) {
  geofence_.reset();  // the state that it remembers would be out of date after this tick
  const BackupQpReport solved = program_->filter(x, pilot);
  GeofenceReport& found = *report.fence;
  found.command = solved.command;
  found.detail.h_i = static_cast<float>(solved.h_i);
  report.margin = solved.h_i;
  report.rows = static_cast<std::uint32_t>(solved.rows);
  report.infeasible = solved.is_infeasible;
  if (solved.is_passed) return;
  found.status = solved.is_infeasible ? ALULA_GEOFENCE_BACKUP : ALULA_GEOFENCE_BLENDED;
  found.detail.lambda = 0;
}

RacerState to_racer(const State& x, const std::optional<Vec4>& attitude) {
  if (attitude) return {x.p, x.v, *attitude, x.omega};
  const double n = dot(x.sigma, x.sigma), scale = 1 / (1 + n);
  return {x.p, x.v, {scale * (1 - n), 2 * scale * x.sigma.x, 2 * scale * x.sigma.y, 2 * scale * x.sigma.z}, x.omega};
}

State from_racer(const RacerState& x) {
  const double sign = x.q[0] < 0 ? -1 : 1;
  const Vec3 axis{x.q[1], x.q[2], x.q[3]};
  return {x.p, sign / (1 + std::abs(x.q[0])) * axis, x.v, x.omega};
}

}  // namespace alula::flight
