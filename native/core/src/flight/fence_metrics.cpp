#include "alula/flight/fence_metrics.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <stdexcept>
#include <utility>

namespace alula::flight {
namespace {

constexpr std::uint32_t kStart = 0x6000'0000;  // channel of random numbers
constexpr std::uint64_t kDraws = 2000;

bool same_bits(const alula_racer_command& a, const alula_racer_command& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

bool is_in_limits(const RacerCommand& u, const alula_racer_model& model) {
  bool good = u.throttle >= 0 && u.throttle <= 1;
  for (int i = 0; i < 3; ++i) good = good && std::abs(u.rates[i]) <= model.max_rate[i];
  return good;
}

RacerState drawn(const RacerStarts& starts, const RandomStream& random, std::uint64_t draw) {
  const auto a = random.uniforms(draw, kStart), b = random.uniforms(draw, kStart + 1);
  RacerState x;
  for (int i = 0; i < 3; ++i) {
    x.p[i] = starts.box.lower[i] + a[static_cast<std::size_t>(i)] * (starts.box.upper[i] - starts.box.lower[i]);
  }
  const Vec3 direction = random.normals(draw, kStart + 2), turn = random.normals(draw, kStart + 3);
  x.v = starts.speed_m_s * a[3] / geometry::norm(direction) * direction;
  // tilt about a horizontal axis, after any yaw
  const double yaw = std::numbers::pi * b[0], towards = 2 * std::numbers::pi * b[1];
  const double half = 0.5 * starts.tilt_rad * b[2], c = std::cos(half), s = std::sin(half);
  const double tx = s * std::cos(towards), ty = s * std::sin(towards), yc = std::cos(yaw), ys = std::sin(yaw);
  x.q = {yc * c, yc * tx - ys * ty, yc * ty + ys * tx, ys * c};
  x.omega = turn;
  return x;
}

}  // namespace

RacerState safe_start(const Geofence& geofence, const RacerStarts& starts, const RandomStream& random,
                      const ObstacleMap* others) {
  const double radius = geofence.config().radius_m;
  MapMemory memory = others == nullptr ? MapMemory{} : others->memory();
  for (std::uint64_t draw = 0; draw < kDraws; ++draw) {
    const RacerState x = drawn(starts, random, draw);
    if (others != nullptr && others->distance(x.p, radius, memory) < radius) continue;
    if (geofence.evaluate(x).h_i > 0) return x;
  }
  throw std::invalid_argument("no start in the box is safe");
}

void FenceRecorder::note(const RacerState& x, const std::optional<RacerCommand>& pilot,
                         const GeofenceReport& report) {
  const alula_geofence_result& r = report.detail;
  ++log_.ticks;
  std::int64_t* const count[] = {&log_.passed,   &log_.blended,   &log_.backup,
                                 &log_.no_pilot, &log_.hand_over, &log_.refused};
  ++*count[report.status];
  if (report.status == ALULA_GEOFENCE_PASSED && (!pilot || !same_bits(r.command, to_onboard(*pilot))))
    ++log_.altered_passes;
  if (!is_in_limits(report.command, config_.model) || !(r.lambda >= 0 && r.lambda <= 1)) ++log_.out_of_range;
  if (report.status < ALULA_GEOFENCE_HAND_OVER) log_.min_h_i = std::min(log_.min_h_i, double{r.h_i});
  if (report.status <= ALULA_GEOFENCE_BACKUP) note_lambda(x, report);
  if (!keeps_ticks_) return;
  log_.figure.insert(log_.figure.end(), {r.lambda, r.h_i, r.distance_m, r.margin_m, r.v_towards});
  log_.distance.push_back(distance_);
  log_.status.push_back(static_cast<std::uint8_t>(report.status));
}

void FenceRecorder::note_lambda(const RacerState& x, const GeofenceReport& report) {
  const double lambda = report.detail.lambda, radius = config_.radius_m;
  log_.min_lambda = std::min(log_.min_lambda, lambda);
  if (lambda < 0.5 && is_free_) {
    ++log_.interventions;
    is_free_ = false;
    if (std::isnan(log_.brake_distance_m)) {
      braked_for_ = fence_.braked_for(report.detail.deciding, x.p, x.v);
      log_.brake_distance_m = fence_.distance_to(braked_for_, x.p) - radius;
    }
  }
  if (lambda > 0.9) is_free_ = true;
  if (log_.interventions > 0 && std::isnan(log_.stop_distance_m) && geometry::norm(x.v) < 0.5)
    log_.stop_distance_m = fence_.distance_to(braked_for_, x.p) - radius;
  backup_s_ = report.status == ALULA_GEOFENCE_BACKUP ? backup_s_ + double{config_.tick_s} : 0;
  log_.longest_backup_s = std::max(log_.longest_backup_s, backup_s_);
}

void FenceRecorder::advance(Vec3 before, Vec3 after) {
  distance_ = fence_.clearance(before, after) - config_.radius_m;
  log_.min_distance_m = std::min(log_.min_distance_m, distance_);
}

}  // namespace alula::flight
