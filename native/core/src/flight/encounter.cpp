#include "alula/flight/encounter.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "alula/flight/encounter_plant.hpp"
#include "alula/flight/encounter_watch.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::norm;
using geometry::Vec3;
using Clock = std::chrono::steady_clock;

constexpr double kSameTime = 1e-9;  // tolerance between two multiples of a step [s]
constexpr double kReacted = 0.05;   // an acceleration this far from the nominal is a reaction [m/s^2]
constexpr double kWallsAhead = 5;   // walls farther than this time at full speed are not passed on [s], ...
constexpr double kBraking = 0.5;    // ... unless stopping before them takes this fraction of the maximum acceleration

Vec3 clipped(Vec3 a, double limit) {
  for (int i = 0; i < 3; ++i) a[i] = std::clamp(a[i], -limit, limit);
  return a;
}

// Acceleration that brakes along the velocity to standstill, without reversal.
Vec3 braking(Vec3 v, double limit, double dt) {
  const double largest = std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
  return clipped(-std::min(1 / dt, limit / std::max(largest, 1e-12)) * v, limit);
}

// State of consecutive trials; memory is kept between them.
class Encounter {
 public:
  Encounter(const EncounterSpec& spec, const MovingFilter& filter, std::uint64_t seed, bool keeps_path)
      : spec_(spec),
        filter_(filter.clone()),
        plant_(spec.vehicle, spec.rules),
        world_(spec.moving, spec.rules.dt_s, spec.rules.plant_steps),
        seed_(seed),
        keeps_path_(keeps_path),
        course_(spec.vehicle.goal - spec.vehicle.start) {
    const double length = norm(course_);
    course_ = spec.vehicle.hovers || !(length > 0) ? Vec3{1, 0, 0} : 1 / length * course_;
  }

  EncounterLog fly(std::uint32_t trial);

 private:
  void begin(std::uint32_t trial);
  void see(double now, std::int64_t tick);
  void see_walls();
  Vec3 nominal() const;
  void judge_answer(const MovingReport& report, Vec3 command, Vec3 nominal, double now, double took);
  void advance();
  bool have_receded(double now);
  void keep(const MovingReport& report, Vec3 command, Vec3 nominal);

  const EncounterSpec& spec_;
  std::unique_ptr<MovingFilter> filter_;
  EncounterPlant plant_;
  MovingWorld world_;
  std::uint64_t seed_;
  bool keeps_path_;
  Vec3 course_;
  alula_vehicle_state seen_{};
  Vec3 seen_p_, seen_v_;
  std::span<const alula_track> tracks_;
  std::vector<alula_wall> walls_;
  struct Separating {
    double gap, spare;  // spare: possible increase of the speed towards it
    Vec3 normal;
  };
  std::vector<Separating> separating_;
  struct Window {  // window of an obstacle
    bool is_open = false;
    double reacted_s = EncounterMetrics::kNever;
  };
  std::vector<Window> window_;
  double receded_s_ = 0;
  RiskWindows risk_;
  std::uint32_t nearest_wall_ = 0;
  std::vector<double> scratch_;
  EncounterLog log_;
};

void Encounter::begin(std::uint32_t trial) {
  const Kinematics start{spec_.vehicle.start, spec_.vehicle.start_speed_m_s * course_, {}};
  plant_.reset(start);
  filter_->reset();
  world_.begin({seed_, trial}, start, course_);
  receded_s_ = 0;
  window_.assign(world_.size(), {});
  risk_.reset(spec_.rules.risk_window_s, spec_.rules.dt_s);
  log_ = {};
  log_.obstacle.resize(world_.size());
}

// Inputs of the filter in a tick: confirmed tracks, walls, the vehicle's own state.
void Encounter::see(double now, std::int64_t tick) {
  const std::int64_t step = tick * spec_.rules.plant_steps;
  world_.sense(step, plant_.state());
  const RadarOptions& radar = spec_.moving.radar;
  const Kinematics own = world_.own_state(plant_.state(), step);
  seen_p_ = own.p, seen_v_ = own.v;
  const auto variance = static_cast<float>(radar.own_position_sigma_m * radar.own_position_sigma_m);
  for (int i = 0; i < 3; ++i) {
    seen_.position[i] = static_cast<float>(seen_p_[i]);
    seen_.velocity[i] = static_cast<float>(seen_v_[i]);
  }
  seen_.covariance[0] = seen_.covariance[3] = seen_.covariance[5] = variance;

  tracks_ = world_.tracks(now, seen_);
  for (const alula_track& track : tracks_) {
    const std::int64_t of = world_.obstacle_near(track.position);
    if (of < 0) continue;
    EncounterMetrics& m = log_.obstacle[static_cast<std::size_t>(of)];
    if (std::isnan(m.detected_s)) m.detected_s = now;
  }
  see_walls();
}

// For each polytope, the plane that separates it best from the vehicle; its distance is at most the polytope's. Where
// there are too many, those are chosen before which the vehicle could not stop if it were a little faster: walls that
// it passes closely must not displace the one that it flies towards.
void Encounter::see_walls() {
  walls_.clear();
  if (spec_.walls == nullptr) return;
  separating_.clear();
  const double speed = spec_.vehicle.max_speed_m_s, brake = kBraking * spec_.vehicle.max_acceleration_m_s2;
  const double farthest = std::max(kWallsAhead * speed, speed * speed / (2 * brake));
  for (std::size_t k = 0; k < spec_.walls->size(); ++k) {
    const geometry::PolytopeView hull = spec_.walls->polytope(k);
    double best = -std::numeric_limits<double>::infinity();
    Vec3 normal;
    for (std::size_t l = 0; l < hull.offsets.size(); ++l) {
      const Vec3 n = geometry::from_rows(hull.normals.data() + 3 * l);
      const double gap = dot(n, seen_p_) - hull.offsets[l];
      if (gap > best) best = gap, normal = n;
    }
    if (!(best < farthest)) continue;
    const double stops_from = std::sqrt(2 * brake * std::max(0.0, best - spec_.vehicle.radius_m));
    separating_.push_back({best, stops_from + dot(normal, seen_v_), normal});
  }
  if (separating_.size() > ALULA_WALLS) {
    std::nth_element(separating_.begin(), separating_.begin() + ALULA_WALLS, separating_.end(),
                     [](const auto& a, const auto& b) { return a.spare < b.spare; });
    separating_.resize(ALULA_WALLS);
  }
  std::sort(separating_.begin(), separating_.end(), [](const auto& a, const auto& b) { return a.gap < b.gap; });
  for (const auto& [gap, spare, n] : separating_) {
    walls_.push_back(
        {{static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)}, static_cast<float>(gap)});
  }
}

Vec3 Encounter::nominal() const {
  const EncounterVehicle& v = spec_.vehicle;
  const Vec3 left = (v.hovers ? v.start : v.goal) - seen_p_;
  const double distance = norm(left);
  double speed = std::min(v.cruise_m_s, std::sqrt(v.max_acceleration_m_s2 * distance));
  // The square root is steep at the goal, which matters when hovering there: use a well-damped spring.
  if (v.hovers) speed = std::min(speed, v.gain / 2 * distance);
  const Vec3 wanted = distance > 0 ? speed / distance * left : Vec3{};
  return clipped(v.gain * (wanted - seen_v_), v.max_acceleration_m_s2);
}

void Encounter::judge_answer(const MovingReport& report, Vec3 command, Vec3 nominal, double now, double took) {
  const bool has_warned = report.warned && report.urgent >= 0;
  const std::int64_t urgent =
      has_warned ? world_.obstacle_near(tracks_[static_cast<std::size_t>(report.urgent)].position) : -1;
  if (urgent >= 0) {
    const auto i = static_cast<std::size_t>(urgent);
    EncounterMetrics& m = log_.obstacle[i];
    if (std::isnan(m.warned_s)) {
      const Vec3 p = world_.truth()[i].p - plant_.state().p, v = world_.truth()[i].v - plant_.state().v;
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

// Advances the plant and the obstacles by one step and updates the closest distances.
void Encounter::advance() {
  const double h = spec_.rules.dt_s / spec_.rules.plant_steps;
  const Kinematics before = plant_.state();
  plant_.step();
  const Kinematics& after = plant_.state();
  world_.advance(h, before);
  for (std::size_t i = 0; i < world_.size(); ++i) {
    const Kinematics &was = world_.before()[i], &is = world_.truth()[i];
    const Vec3 a = 1 / h * ((is.v - after.v) - (was.v - before.v));
    const double closest = closest_approach(was.p - before.p, is.p - after.p, a, h);
    EncounterMetrics& m = log_.obstacle[i];
    m.closest_m = std::min(m.closest_m, closest);
    if (window_[i].is_open) m.separation_m = std::min(m.separation_m, closest);
  }
  log_.path_length_m += norm(after.p - before.p);
  log_.max_speed_m_s = std::max(log_.max_speed_m_s, norm(after.v));
  if (spec_.walls == nullptr || spec_.walls->size() == 0) return;
  const double bend = norm(after.a) * h * h / 8;  // maximum distance of the path from the chord
  const double radius = spec_.vehicle.radius_m;
  const double least =
      spec_.walls->clearance(before.p, after.p, log_.wall_clearance_m + radius + bend, nearest_wall_, scratch_);
  log_.wall_clearance_m = std::min(log_.wall_clearance_m, least - bend - radius);
}

bool Encounter::have_receded(double now) {
  const std::vector<Kinematics>& truth = world_.truth();
  if (truth.empty()) return false;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const bool recedes = now >= spec_.moving.obstacles[i].start_s &&
                         dot(truth[i].p - plant_.state().p, truth[i].v - plant_.state().v) > 0;
    if (!recedes) {
      receded_s_ = now;
      return false;
    }
  }
  return now - receded_s_ >= spec_.rules.receded_s - kSameTime;
}

void Encounter::keep(const MovingReport& report, Vec3 command, Vec3 nominal) {
  const auto add = [](std::vector<double>& rows, Vec3 v) { rows.insert(rows.end(), {v.x, v.y, v.z}); };
  const Kinematics& x = plant_.state();
  for (const Vec3 v : {x.p, x.v, x.a}) add(log_.vehicle, v);
  for (const Kinematics& o : world_.truth()) {
    add(log_.obstacles, o.p);
    const std::int64_t nearest = world_.track_near(o.p);
    const float* p = nearest < 0 ? nullptr : tracks_[static_cast<std::size_t>(nearest)].position;
    constexpr double none = EncounterMetrics::kNever;
    add(log_.tracks, p == nullptr ? Vec3{none, none, none} : Vec3{p[0], p[1], p[2]});
  }
  add(log_.command, command);
  add(log_.nominal, nominal);
  log_.mode.push_back(report.mode);
  log_.status.push_back(static_cast<std::uint8_t>(report.status));
}

EncounterLog Encounter::fly(std::uint32_t trial) {
  begin(trial);
  const EncounterRules& rules = spec_.rules;
  const auto ticks = static_cast<std::int64_t>(std::ceil(rules.max_time_s / rules.dt_s - 1e-6));
  Vec3 last_v = plant_.state().v, older_v = last_v;
  double jerk = 0;
  for (std::int64_t tick = 0; tick < ticks; ++tick) {
    const double now = static_cast<double>(tick) * rules.dt_s;
    if (tick > 0 && have_receded(now)) {
      log_.outcome = EncounterOutcome::passed;
      break;
    }
    see(now, tick);
    const Vec3 desired = nominal();
    const Clock::time_point start = Clock::now();
    const MovingReport report = filter_->filter(seen_, tracks_, walls_, desired);
    const double took = std::chrono::duration<double>(Clock::now() - start).count();
    const Vec3 command = report.status == MovingStatus::refused
                             ? braking(seen_v_, spec_.vehicle.max_acceleration_m_s2, rules.dt_s)
                             : clipped(report.acceleration, spec_.vehicle.max_acceleration_m_s2);
    if (report.status == MovingStatus::refused) filter_->flown(command);
    judge_answer(report, command, desired, now, took);
    risk_.add(tracks_, seen_, command, spec_.vehicle.radius_m);
    if (keeps_path_) keep(report, command, desired);
    plant_.command(command);
    for (std::int64_t s = 0; s < rules.plant_steps; ++s) {
      if (s > 0) world_.sense(tick * rules.plant_steps + s, plant_.state());
      advance();
    }
    const Vec3 v = plant_.state().v;
    if (tick > 0) {
      const double change = norm(v - 2 * last_v + older_v) / (rules.dt_s * rules.dt_s);
      log_.max_jerk_m_s3 = std::max(log_.max_jerk_m_s3, change);
      jerk += change;
    }
    older_v = last_v, last_v = v;
    ++log_.ticks;
  }
  log_.mission_risk = risk_.sum();
  log_.mean_jerk_m_s3 = log_.ticks > 1 ? jerk / static_cast<double>(log_.ticks - 1) : 0;
  for (std::size_t i = 0; i < world_.size(); ++i) {
    const double sum = spec_.vehicle.radius_m + spec_.moving.obstacles[i].radius_m;
    log_.obstacle[i].collided = log_.obstacle[i].closest_m <= sum;
  }
  return std::move(log_);
}

}  // namespace

std::vector<EncounterLog> fly_encounters(const EncounterSpec& spec, const MovingFilter& filter, std::uint64_t seed,
                                         std::uint32_t first, std::uint32_t count, bool keeps_path, unsigned jobs,
                                         Control& control) {
  check(spec);
  std::vector<EncounterLog> logs(count);
  parallel_chunks(count, 4, jobs, control, [&](std::size_t begin, std::size_t end) {
    Encounter encounter(spec, filter, seed, keeps_path);
    for (std::size_t i = begin; i < end; ++i) logs[i] = encounter.fly(first + static_cast<std::uint32_t>(i));
  });
  return logs;
}

}  // namespace alula::flight
