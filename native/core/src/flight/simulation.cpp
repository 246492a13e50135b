#include "alula/flight/simulation.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "alula/base/constants.hpp"
#include "alula/base/parallel.hpp"
#include "alula/filters/adapters.hpp"

namespace alula::flight {
namespace {

using Clock = std::chrono::steady_clock;
using geometry::dot;
using geometry::norm;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::uint32_t kLoss = 0x5000'0000;  // channel of random numbers
constexpr double kFastest = 1e5;              // [m/s] a higher speed means that the integration diverges
constexpr const char* kDiverges = "the simulated motion diverges: too much drag or wind for so few plant_steps";

void append(std::vector<double>& rows, Vec3 v) { rows.insert(rows.end(), {v.x, v.y, v.z}); }
void append(std::vector<double>& rows, const State& x) {
  for (const Vec3& part : {x.p, x.sigma, x.v, x.omega}) append(rows, part);
}
void append(std::vector<double>& rows, const Wrench& u) { rows.push_back(u.thrust), append(rows, u.torque); }
void append(std::vector<double>& rows, const RacerCommand& u) { rows.push_back(u.throttle), append(rows, u.rates); }

bool within(Vec3 p, Vec3 lower, Vec3 upper) {  // false for NaN
  for (int i = 0; i < 3; ++i)
    if (!(p[i] >= lower[i] && p[i] <= upper[i])) return false;
  return true;
}

bool is_during(double time, double from, double length) { return time >= from && time < from + length; }

// One simulated flight.
class Trial {
 public:
  Trial(const SimulationSpec& spec, const Task& task, std::span<const SafetyFilter* const> filters,
        const RandomStream& random)
      : spec_(spec),
        task_(task),
        random_(random),
        vehicle_(spec.vehicle, spec.options.dt_s, spec.rules.plant_steps, random),
        world_(spec.moving, spec.options.dt_s, spec.rules.plant_steps),
        flight_(spec.vehicle, spec.options, task.mission, filters),
        encounters_(spec.vehicle.radius_m, spec.rules.risk_window_s, spec.options.dt_s) {
    if (spec.watcher != nullptr) watcher_ = spec.watcher->clone();
    if (spec.fence != nullptr) fence_.emplace(*spec.fence, spec.rules.keeps_ticks);
    if (task.pilot) hand_.emplace(*task.pilot, spec.vehicle.racer, random, task.start.p.z);
  }

  SimulatedFlight fly();

 private:
  Vec3 mean_velocity() const;
  Observation see(double now);
  void note(const Decision& decision, float seconds);
  void note_all(const Observation& seen, const Decision& decision);
  void note_state();
  void watch(const Observation& seen, const Decision& decision, double now);
  void step(std::int64_t index);
  bool have_receded(double now);
  Vec3 goal() const;
  End judged(const Decision& decision);

  const SimulationSpec& spec_;
  const Task& task_;
  RandomStream random_;
  SimulatedVehicle vehicle_;
  MovingWorld world_;
  Flight flight_;
  EncounterRecorder encounters_;
  std::unique_ptr<SafetyFilter> watcher_;
  std::optional<FenceRecorder> fence_;
  std::optional<PilotHand> hand_;
  double receded_s_ = 0;
  std::int64_t still_ = 0;
  std::optional<Vec3> commanded_;  // acceleration of this tick,
  double error_ = 0;               // and the largest difference from it
  SimulatedFlight log_;
};

Vec3 Trial::goal() const {
  const Mission& m = task_.mission;
  return m.kind == MissionKind::curve ? m.curve->at(m.curve->end()).p : m.goal;
}

// Of the mission.
Vec3 Trial::mean_velocity() const {
  const Mission& m = task_.mission;
  if (m.kind == MissionKind::pilot) return task_.start.v;
  const Vec3 way = goal() - task_.start.p;
  if (m.kind == MissionKind::curve && m.duration() > 0) return 1 / m.duration() * way;
  const double length = norm(way);
  return length > 0 && std::isfinite(m.speed) ? m.speed / length * way : Vec3{};
}

Observation Trial::see(double now) {
  const SimulationSpec& s = spec_;
  const std::int64_t step = log_.ticks * s.rules.plant_steps;
  Observation seen;
  seen.now_s = now;
  const bool is_lost = is_during(now, s.losses.from_s, s.losses.for_s) ||
                       (s.losses.share > 0 && log_.ticks > 0 &&
                        random_.uniforms(static_cast<std::uint64_t>(log_.ticks), kLoss)[0] < s.losses.share);
  if (!is_lost) seen.measured = vehicle_.measured();
  const double sigma = s.vehicle.plant.sensor.position_noise_m, own_sigma = s.moving.radar.own_position_sigma_m;
  const double variance = sigma * sigma + own_sigma * own_sigma;
  seen.position_variance = {variance, variance, variance};
  if (seen.measured) {
    const Kinematics own = world_.own_state({seen.measured->p, seen.measured->v, {}}, step);
    seen.measured->p = own.p, seen.measured->v = own.v;
    seen.attitude = vehicle_.attitude_of(*seen.measured);
  }
  if (world_.size() > 0) {
    world_.sense(step, vehicle_.kinematics());
    const Kinematics own = world_.own_state(vehicle_.kinematics(), step);
    alula_vehicle_state at{};
    for (int i = 0; i < 3; ++i) {
      at.position[i] = static_cast<float>(own.p[i]);
      at.velocity[i] = static_cast<float>(own.v[i]);
    }
    seen.tracks = world_.tracks(now, at);
    encounters_.track(now, world_);
  }
  if (hand_) {
    seen.sticks = (*hand_)(now, vehicle_.racer());
    if (is_during(now, s.losses.radio_from_s, s.losses.radio_for_s)) seen.sticks.reset();
  }
  return seen;
}

// What a judge counts.
void Trial::note(const Decision& decision, float seconds) {
  for (const FilterRecord& r : flight_.records()) {
    const FilterReport& report = r.report;
    log_.margin.push_back(report.margin);
    log_.status.push_back(static_cast<std::uint8_t>(report.status));
    log_.flags.push_back(static_cast<std::uint8_t>((report.capped ? 1 : 0) | (report.infeasible ? 2 : 0) |
                                                   (report.certified ? 4 : 0) | (report.certified_moving ? 8 : 0) |
                                                   (report.moving ? 16 * report.moving->mode : 0)));
    log_.filter_s.push_back(r.seconds);
  }
  log_.tick_s.push_back(seconds);
  log_.mark.push_back(static_cast<std::uint8_t>((decision.is_refused ? 1 : 0) | (decision.is_stale ? 2 : 0) |
                                                (decision.is_limited ? 4 : 0)));
}

void Trial::note_all(const Observation& seen, const Decision& decision) {
  append(log_.estimate, flight_.estimate().x);
  if (seen.measured)
    append(log_.measured, *seen.measured);
  else
    log_.measured.insert(log_.measured.end(), 12, kNaN);
  const Nominal& first = flight_.nominal();
  append(log_.nominal, spec_.vehicle.interface == Interface::velocity ? first.velocity : first.acceleration);
  append(log_.u_nominal, spec_.vehicle.model == VehicleModel::quadrotor ? first.wrench : Wrench{});
  append(log_.a_command, decision.acceleration.value_or(Vec3{kNaN, kNaN, kNaN}));
  const Command& c = decision.command;
  const bool by_rotors = c.interface == Interface::wrench || c.interface == Interface::body_rates;
  const Vec4 rotors = by_rotors ? spec_.vehicle.body.rotor_thrust(c.wrench) : Vec4{};
  log_.rotor_thrust.insert(log_.rotor_thrust.end(), rotors.begin(), rotors.end());
  append(log_.command, c.interface == Interface::velocity       ? c.velocity
                       : c.interface == Interface::acceleration ? c.acceleration
                                                                : c.rates);
  append(log_.command, c.wrench);
  append(log_.command, c.sticks);
  append(log_.sticks, seen.sticks.value_or(RacerCommand{kNaN, {kNaN, kNaN, kNaN}}));
  for (const Kinematics& o : world_.truth()) {
    append(log_.obstacle, o.p);
    const std::int64_t near = world_.track_near(o.p);
    const float* p = near < 0 ? nullptr : world_.tracks()[static_cast<std::size_t>(near)].position;
    append(log_.track, p == nullptr ? Vec3{kNaN, kNaN, kNaN} : Vec3{p[0], p[1], p[2]});
  }
  for (const FilterRecord& r : flight_.records()) {
    log_.gate_m.push_back(r.report.gate_m);
    log_.active.push_back(r.report.active);
    log_.candidates.push_back(r.report.candidates);
    log_.rows.push_back(r.report.rows);
    log_.iterations.push_back(r.report.iterations);
  }
  log_.tracks.insert(log_.tracks.end(), seen.tracks.begin(), seen.tracks.end());
  log_.track_start.push_back(static_cast<std::int64_t>(log_.tracks.size()));
}

void Trial::note_state() {
  append(log_.state, vehicle_.state());
  if (flight_.clock()) log_.plan_s.push_back(flight_.clock()->time());
  if (spec_.vehicle.model != VehicleModel::racer) return;
  const Vec4& q = vehicle_.racer().q;
  log_.attitude.insert(log_.attitude.end(), q.begin(), q.end());
}

// The last filter of each kind, where it was called in this tick.
void Trial::watch(const Observation& seen, const Decision& decision, double now) {
  if (!decision.is_filtered) return;
  const std::span<const FilterRecord> records = flight_.records();
  if (fence_ && !records.empty() && records.back().report.fence)
    fence_->note(vehicle_.racer(), seen.sticks, *records.back().report.fence);
  const auto last = std::find_if(records.rbegin(), records.rend(), [](const auto& r) { return r.report.moving; });
  FilterRecord answer;
  if (last != records.rend()) {
    answer = *last;
  } else if (watcher_ && !decision.is_stale) {
    const auto begin = Clock::now();
    answer.report = watcher_->filter(flight_.estimate(), flight_.nominal());
    answer.seconds = std::chrono::duration<float>(Clock::now() - begin).count();
  }
  if (!answer.report.moving) return;
  const Command& c = decision.command;
  const Vec3 flown = c.interface == Interface::acceleration ? c.acceleration : answer.report.acceleration;
  encounters_.answer(*answer.report.moving, flight_.estimate(), flown, flight_.nominal().acceleration, now,
                     static_cast<double>(answer.seconds), world_, vehicle_.kinematics());
}

void Trial::step(std::int64_t index) {
  const double h = spec_.options.dt_s / spec_.rules.plant_steps;
  if (world_.size() > 0 && index % spec_.rules.plant_steps > 0) world_.sense(index, vehicle_.kinematics());
  const Kinematics before = world_.size() > 0 ? vehicle_.kinematics() : Kinematics{vehicle_.state().p, {}, {}};
  vehicle_.step();
  const State& x = vehicle_.state();
  if (spec_.rules.keeps_ticks && commanded_) error_ = std::max(error_, norm(vehicle_.acceleration() - *commanded_));
  const double moved = norm(x.p - before.p);
  if (std::isfinite(moved)) log_.path_length_m += moved;
  log_.max_speed_m_s = std::max(log_.max_speed_m_s, norm(x.v));
  if (fence_) fence_->advance(before.p, x.p);
  if (spec_.rules.keeps_path) append(log_.path, x.p);
  if (world_.size() == 0) return;
  world_.advance(h, before);
  encounters_.advance(before, vehicle_.kinematics(), h, world_);
}

bool Trial::have_receded(double now) {
  const std::vector<Kinematics>& truth = world_.truth();
  if (truth.empty()) return false;
  const State& x = vehicle_.state();
  for (std::size_t i = 0; i < truth.size(); ++i) {
    if (now >= spec_.moving.obstacles[i].start_s && dot(truth[i].p - x.p, truth[i].v - x.v) > 0) continue;
    receded_s_ = now;
    return false;
  }
  return now - receded_s_ >= spec_.rules.receded_s - kSameTime;
}

End Trial::judged(const Decision& decision) {
  const SimulationRules& rules = spec_.rules;
  const Mission& m = task_.mission;
  const State& x = vehicle_.state();
  const double now = static_cast<double>(log_.ticks) * spec_.options.dt_s, speed = norm(x.v);
  // also NaN, which distances would not reveal
  if (fence_ && !(speed < kFastest)) throw std::overflow_error(kDiverges);
  if (!is_finite(x) || !within(x.p, rules.lower, rules.upper)) return End::refused;
  if (decision.is_refused && rules.ends_when_refused) return End::refused;
  if (!(speed < kFastest)) throw std::overflow_error(kDiverges);
  const bool is_over =
      log_.ticks >= static_cast<std::int64_t>(std::ceil(task_.max_time_s / spec_.options.dt_s * (1 - 1e-7)));
  if (!is_over && have_receded(now)) return End::passed;
  if (m.kind == MissionKind::pilot || m.hovers) return is_over ? End::ended : End::flying;
  if (!rules.ends_at_goal) return is_over ? End::timeout : End::flying;
  const std::optional<PlanClock>& clock = flight_.clock();
  const Vec3 target = clock                          ? clock->target().p
                      : m.kind == MissionKind::curve ? m.curve->at(m.curve->start() + now).p
                                                     : m.goal;
  const bool has_arrived = clock ? clock->is_over() : now >= m.duration() - kSameTime;
  const double still = spec_.vehicle.model == VehicleModel::single_integrator ? 1e300 : rules.stop_speed;
  if (has_arrived && norm(x.p - goal()) <= task_.stop_distance_m && speed <= still) return End::reached;
  // A vehicle may rest where the reference rests; it is stuck only if it is away from the reference.
  const bool is_behind = norm(x.p - target) > task_.stop_distance_m && (!clock || has_arrived);  // it may wait
  still_ = speed < rules.stuck_speed && is_behind ? still_ + 1 : 0;
  if (still_ >= rules.stuck_ticks) return End::stuck;
  return is_over ? End::timeout : End::flying;
}

SimulatedFlight Trial::fly() {
  const int steps = spec_.rules.plant_steps;
  vehicle_.reset(task_.start, task_.attitude);
  if (fence_) fence_->begin(task_.start.p);
  const Vec3 mean = task_.expected_velocity.value_or(mean_velocity());
  const Vec3 way = task_.mission.kind == MissionKind::goal ? goal() - task_.start.p : mean;
  const double length = std::hypot(way.x, way.y), dt = spec_.options.dt_s;
  world_.begin(random_, {task_.start.p, mean, {}}, length > 0 ? 1 / norm(way) * way : Vec3{1, 0, 0});
  encounters_.begin(world_.size());
  const bool keeps_ticks = spec_.rules.keeps_ticks;
  if (spec_.rules.keeps_path) append(log_.path, task_.start.p);
  if (keeps_ticks) note_state(), log_.track_start.push_back(0);
  Vec3 last_v = task_.start.v, older_v = last_v;
  double jerk = 0;
  while (log_.end == End::flying) {
    const double now = static_cast<double>(log_.ticks) * dt;
    const Observation seen = see(now);
    const auto begin = Clock::now();
    flight_.observe(seen);
    const Decision& decision = flight_.decide();
    const float seconds = std::chrono::duration<float>(Clock::now() - begin).count();
    note(decision, seconds);
    if (keeps_ticks) note_all(seen, decision);
    watch(seen, decision, now);
    flight_.sent();
    vehicle_.command(decision.command);
    commanded_ = decision.acceleration, error_ = commanded_ ? 0 : kNaN;
    for (std::int64_t i = 0; i < steps; ++i) step(log_.ticks * steps + i);
    vehicle_.end_tick();
    if (keeps_ticks) log_.a_error.push_back(error_);
    const Vec3 v = vehicle_.state().v;
    log_.max_acceleration_m_s2 = std::max(log_.max_acceleration_m_s2, norm(v - last_v) / dt);
    const double change = norm(v - 2 * last_v + older_v) / (dt * dt);
    if (log_.ticks > 0 && std::isfinite(change)) {
      log_.max_jerk_m_s3 = std::max(log_.max_jerk_m_s3, change);
      jerk += change;
    }
    older_v = last_v, last_v = v;
    ++log_.ticks;
    if (keeps_ticks) note_state();
    log_.end = judged(decision);
  }
  log_.mean_jerk_m_s3 = log_.ticks > 1 ? jerk / static_cast<double>(log_.ticks - 1) : 0;
  log_.last = vehicle_.state();
  log_.encounters = encounters_.finish();
  if (fence_) log_.fence = fence_->finish();
  return std::move(log_);
}

}  // namespace

void check(const SimulationSpec& spec) {
  check(spec.vehicle), check(spec.moving);
  if (spec.watcher != nullptr && spec.watcher->kind() != CommandKind::acceleration)
    throw std::invalid_argument("encounters are watched by a filter of accelerations");
  if (spec.fence != nullptr && spec.vehicle.model != VehicleModel::racer)
    throw std::invalid_argument("flights of a racer are judged by a geofence");
  const SimulationRules& r = spec.rules;
  const FlightOptions& o = spec.options;
  const bool good = o.dt_s >= 1e-4 && o.dt_s <= 1 && r.plant_steps >= 1 && r.plant_steps <= 1000 &&
                    r.stop_speed > 0 && r.stuck_speed >= 0 && r.stuck_ticks > 0 && r.receded_s >= 0 &&
                    r.risk_window_s > 0 && spec.losses.share >= 0 && spec.losses.share <= 1 &&
                    spec.losses.for_s >= 0 && spec.losses.radio_for_s >= 0;
  if (!good) throw std::invalid_argument("the rules of a simulation are out of range");
}

std::vector<SimulatedFlight> simulate(const SimulationSpec& spec, std::span<const Task> tasks,
                                      std::span<const SafetyFilter* const> filters, std::uint64_t seed,
                                      std::uint32_t first_trial, unsigned jobs, Control& control) {
  check(spec);
  for (const Task& task : tasks) {
    if (!is_finite(task.start) || !(task.max_time_s >= spec.options.dt_s && task.max_time_s <= 1e5) ||
        !(task.stop_distance_m > 0))
      throw std::invalid_argument("a start, a time limit or a distance of a goal is out of range");
  }
  std::vector<SimulatedFlight> flights(tasks.size());
  parallel_chunks(tasks.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      flights[i] = Trial(spec, tasks[i], filters, {seed, first_trial + static_cast<std::uint32_t>(i)}).fly();
  });
  return flights;
}

}  // namespace alula::flight
