#include "alula/flight/geofence_flight.hpp"

#include <algorithm>
#include <cfloat>
#include <chrono>
#include <cmath>
#include <cstring>
#include <numbers>
#include <stdexcept>

#include "alula/base/parallel.hpp"

namespace alula::flight {

namespace {

constexpr std::uint32_t kStart = 0x6000'0000;
constexpr std::uint64_t kDraws = 2000;
constexpr double kFastest = 1e5;  // [m/s] a higher speed means that the integration diverges

bool same_bits(const alula_racer_command& a, const alula_racer_command& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

bool is_in_limits(const RacerCommand& u, const alula_racer_model& model) {
  bool good = u.throttle >= 0 && u.throttle <= 1;
  for (int i = 0; i < 3; ++i) good = good && std::abs(u.rates[i]) <= model.max_rate[i];
  return good;
}

RacerState drawn(const GeofenceSpec& spec, RandomStream random, std::uint64_t draw) {
  const auto a = random.uniforms(draw, kStart), b = random.uniforms(draw, kStart + 1);
  RacerState x;
  for (int i = 0; i < 3; ++i) {
    x.p[i] = spec.start_box.lower[i] +
             a[static_cast<std::size_t>(i)] * (spec.start_box.upper[i] - spec.start_box.lower[i]);
  }
  const Vec3 direction = random.normals(draw, kStart + 2), turn = random.normals(draw, kStart + 3);
  x.v = spec.start_speed_m_s * a[3] / geometry::norm(direction) * direction;
  // tilt about a horizontal axis, after any yaw
  const double yaw = std::numbers::pi * b[0], towards = 2 * std::numbers::pi * b[1];
  const double half = 0.5 * spec.start_tilt_rad * b[2], c = std::cos(half), s = std::sin(half);
  const double tx = s * std::cos(towards), ty = s * std::sin(towards), yc = std::cos(yaw), ys = std::sin(yaw);
  x.q = {yc * c, yc * tx - ys * ty, yc * ty + ys * tx, ys * c};
  x.omega = turn;
  return x;
}

// The first random draw from which the backup controller stays inside.
RacerState start_of(const GeofenceSpec& spec, const Geofence& filter, RandomStream random) {
  if (spec.start) return *spec.start;
  for (std::uint64_t draw = 0; draw < kDraws; ++draw) {
    const RacerState x = drawn(spec, random, draw);
    if (filter.evaluate(x).h_i > 0) return x;
  }
  throw std::invalid_argument("no start in the box is safe");
}

class Log {
 public:
  Log(GeofenceLog& log, const Fence& fence, bool keeps_trace) : log_(log), fence_(fence), keeps_trace_(keeps_trace) {}

  void note(const RacerState& x, const std::optional<RacerCommand>& pilot, const GeofenceReport& report,
            const alula_geofence_config& config, double distance) {
    const alula_geofence_result& r = report.detail;
    ++log_.ticks;
    std::int64_t* const count[] = {&log_.passed,   &log_.blended,   &log_.backup,
                                   &log_.no_pilot, &log_.hand_over, &log_.refused};
    ++*count[report.status];
    if (report.status == ALULA_GEOFENCE_PASSED && (!pilot || !same_bits(r.command, to_onboard(*pilot)))) {
      ++log_.altered_passes;
    }
    if (!is_in_limits(report.command, config.model) || !(r.lambda >= 0 && r.lambda <= 1)) ++log_.out_of_range;
    if (report.status < ALULA_GEOFENCE_HAND_OVER) log_.min_h_i = std::min(log_.min_h_i, double{r.h_i});
    if (report.status <= ALULA_GEOFENCE_BACKUP) note_lambda(x, report, config);
    note_jerk(x, config.tick_s);
    if (keeps_trace_) trace(x, pilot, report, distance);
  }

  void finish() {
    if (log_.ticks > 2) log_.mean_jerk_m_s3 /= static_cast<double>(log_.ticks - 2);
  }

 private:
  void note_lambda(const RacerState& x, const GeofenceReport& report, const alula_geofence_config& config) {
    const double lambda = report.detail.lambda, dt = config.tick_s, radius = config.radius_m;
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
    if (log_.interventions > 0 && std::isnan(log_.stop_distance_m) && geometry::norm(x.v) < 0.5) {
      log_.stop_distance_m = fence_.distance_to(braked_for_, x.p) - radius;
    }
    backup_s_ = report.status == ALULA_GEOFENCE_BACKUP ? backup_s_ + dt : 0;
    log_.longest_backup_s = std::max(log_.longest_backup_s, backup_s_);
  }

  void note_jerk(const RacerState& x, double dt) {
    const Vec3 change = x.v - velocity_, bend = change - change_;
    if (log_.ticks > 2) {
      const double jerk = geometry::norm(bend) / (dt * dt);
      log_.mean_jerk_m_s3 += jerk;  // the sum, until `finish`
      log_.max_jerk_m_s3 = std::max(log_.max_jerk_m_s3, jerk);
    }
    velocity_ = x.v, change_ = change;
  }

  void trace(const RacerState& x, const std::optional<RacerCommand>& pilot, const GeofenceReport& report,
             double distance) {
    GeofenceTrace& t = log_.trace;
    for (const Vec3& v : {x.p, x.v}) t.state.insert(t.state.end(), {v.x, v.y, v.z});
    t.state.insert(t.state.end(), x.q.begin(), x.q.end());
    t.state.insert(t.state.end(), {x.omega.x, x.omega.y, x.omega.z});
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const RacerCommand nominal = pilot.value_or(RacerCommand{nan, {nan, nan, nan}});
    for (auto [to, u] : {std::pair{&t.pilot, &nominal}, std::pair{&t.command, &report.command}}) {
      to->insert(to->end(), {u->throttle, u->rates.x, u->rates.y, u->rates.z});
    }
    const alula_geofence_result& r = report.detail;
    t.figure.insert(t.figure.end(), {r.lambda, r.h_i, r.distance_m, r.margin_m, r.v_towards});
    t.distance.push_back(distance);
    t.status.push_back(static_cast<std::uint8_t>(report.status));
  }

  GeofenceLog& log_;
  const Fence& fence_;
  std::uint32_t braked_for_ = ALULA_GEOFENCE_NONE;
  bool keeps_trace_, is_free_ = true;
  double backup_s_ = 0;
  Vec3 velocity_, change_;
};

}  // namespace

void check(const GeofenceRules& rules) {
  if (!(rules.duration_s > 0 && rules.duration_s <= 3600) || rules.plant_steps < 1 || rules.plant_steps > 1000) {
    throw std::invalid_argument("a flight takes 0 to 3600 s, with 1 to 1000 steps of the plant per tick");
  }
  if (!(rules.alpha > 0)) throw std::invalid_argument("alpha must be positive");
  if (!(rules.stale_for_s >= 0) || !(rules.radio_for_s >= 0)) {
    throw std::invalid_argument("outages last 0 s or longer");
  }
}

namespace {

// The command of a tick. For backup_qp, lambda is 1, or 0 when it changed the pilot's command; without a pilot
// it flies the geofence's backup.
GeofenceReport decide(const RacerState* navigation, const std::optional<RacerCommand>& pilot, FenceRule rule,
                      Geofence& filter, std::optional<BackupQp>& program) {
  if (rule == FenceRule::geofence || (program && !pilot)) return filter.filter(navigation, pilot ? &*pilot : nullptr);
  GeofenceReport report;
  if (!pilot || navigation == nullptr) return report;
  report.status = ALULA_GEOFENCE_PASSED;
  report.command = *pilot;
  report.detail.lambda = 1;
  report.detail.h_i = -FLT_MAX;  // not evaluated
  report.detail.deciding = ALULA_GEOFENCE_NONE;
  if (program) {
    const BackupQpReport found = program->filter(*navigation, *pilot);
    report.command = found.command;
    report.detail.h_i = static_cast<float>(found.h_i);
    if (!found.is_passed) {
      report.status = found.is_infeasible ? ALULA_GEOFENCE_BACKUP : ALULA_GEOFENCE_BLENDED;
      report.detail.lambda = 0;
    }
  }
  report.detail.command = to_onboard(report.command);
  return report;
}

}  // namespace

GeofenceLog fly_in_fence(const GeofenceSpec& spec, const Geofence& original, RandomStream random, bool keeps_trace) {
  check(spec.rules);
  Geofence filter = original;
  const alula_geofence_config& config = filter.config();
  const double tick = config.tick_s, dt = tick / spec.rules.plant_steps, radius = config.radius_m;
  Racer plant(spec.model, spec.options, random);
  GeofenceLog log;
  log.start = start_of(spec, filter, random);
  plant.reset(log.start);
  PilotHand hand(spec.pilot, spec.model, random, log.start.p.z);
  Log notes(log, filter.fence(), keeps_trace);
  std::optional<BackupQp> program;
  if (spec.rules.rule == FenceRule::backup_qp) program.emplace(filter, spec.rules.alpha);
  // the tick is a float: its rounding must not add a tick
  const auto ticks = static_cast<std::int64_t>(std::ceil(spec.rules.duration_s / tick * (1 - 1e-7)));
  double distance = filter.fence().clearance(log.start.p, log.start.p) - radius;
  log.min_distance_m = distance;
  for (std::int64_t k = 0; k < ticks; ++k) {
    const double time = static_cast<double>(k) * tick;
    const auto is_out = [time](double from, double length) { return time >= from && time < from + length; };
    std::optional<RacerCommand> pilot = hand(time, plant.state());
    if (is_out(spec.rules.radio_from_s, spec.rules.radio_for_s)) pilot.reset();
    const bool is_stale = is_out(spec.rules.stale_from_s, spec.rules.stale_for_s);
    const auto started = std::chrono::steady_clock::now();
    const GeofenceReport report =
        decide(is_stale ? nullptr : &plant.state(), pilot, spec.rules.rule, filter, program);
    log.tick_s.push_back(std::chrono::duration<float>(std::chrono::steady_clock::now() - started).count());
    notes.note(plant.state(), pilot, report, config, distance);
    for (int j = 0; j < spec.rules.plant_steps; ++j) {
      const Vec3 before = plant.state().p;
      plant.step(dt, report.command);
      distance = filter.fence().clearance(before, plant.state().p) - radius;
      log.min_distance_m = std::min(log.min_distance_m, distance);
      log.path_length_m += geometry::norm(plant.state().p - before);
    }
    const double speed = geometry::norm(plant.state().v);
    if (!(speed < kFastest)) {  // also NaN, which distances would not reveal
      throw std::overflow_error("the simulated motion diverges: too much drag or wind for so few plant_steps");
    }
    log.max_speed_m_s = std::max(log.max_speed_m_s, speed);
  }
  log.end = plant.state();
  notes.finish();
  return log;
}

std::vector<GeofenceLog> fly_in_fences(const GeofenceSpec& spec, const Geofence& filter, std::uint64_t seed,
                                       std::uint32_t first, std::uint32_t count, bool keeps_trace, unsigned jobs,
                                       Control& control) {
  std::vector<GeofenceLog> logs(count);
  parallel_chunks(count, 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const RandomStream random{seed, first + static_cast<std::uint32_t>(i)};
      logs[i] = fly_in_fence(spec, filter, random, keeps_trace);
    }
  });
  return logs;
}

}  // namespace alula::flight
