#include "alula/flight/splat_flight.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>

#include "alula/base/parallel.hpp"

namespace alula::flight {
namespace {

using Clock = std::chrono::steady_clock;
using geometry::cross;
using geometry::dot;
using geometry::e3;

double seconds_since(Clock::time_point before) {
  return std::chrono::duration<double>(Clock::now() - before).count();
}

void append(std::vector<double>& rows, Vec3 v) { rows.insert(rows.end(), {v.x, v.y, v.z}); }
void append(std::vector<double>& rows, const Wrench& u) {
  rows.insert(rows.end(), {u.thrust, u.torque.x, u.torque.y, u.torque.z});
}
void append(std::vector<double>& rows, const State& x) {
  for (const Vec3& part : {x.p, x.sigma, x.v, x.omega}) append(rows, part);
}

bool within(Vec3 p, Vec3 lower, Vec3 upper) {  // false for NaN
  for (int i = 0; i < 3; ++i)
    if (!(p[i] >= lower[i] && p[i] <= upper[i])) return false;
  return true;
}

void check(const FlightVehicle& vehicle, const FlightRules& rules) {
  const bool good =
      rules.dt_s > 0 && std::isfinite(rules.dt_s) && rules.plant_steps > 0 && rules.controller_ticks > 0 &&
      rules.filter_ticks > 0 && rules.stop_fraction >= 0 && rules.stop_floor_m > 0 && rules.stop_speed > 0 &&
      rules.stuck_speed >= 0 && rules.stuck_ticks > 0 && rules.time_factor > 0 && rules.max_time_s >= 0 &&
      vehicle.rate_time_constant_s > 0 && vehicle.max_rate.x > 0 && vehicle.max_rate.y > 0 && vehicle.max_rate.z > 0;
  if (!good) throw std::invalid_argument("the rules of a flight must be positive");
}

// The assumed actuators, with the vehicle's rate loop where it is commanded by rates.
ActuatorModel assumed_by(const FlightVehicle& vehicle) {
  ActuatorModel model = vehicle.assumed;
  if (vehicle.interface == CommandInterface::body_rates) model.rate_time_constant_s = vehicle.rate_time_constant_s;
  return model;
}

bool is_same(const Wrench& a, const Wrench& b) {
  return a.thrust == b.thrust && a.torque.x == b.torque.x && a.torque.y == b.torque.y && a.torque.z == b.torque.z;
}

Vec3 acceleration_of(const Quadrotor& body, const State& x, double thrust) {
  return thrust / body.mass() * geometry::transposed_times(body_from_inertial(x.sigma), e3) - body.gravity() * e3;
}

}  // namespace

FlightTrial::FlightTrial(const FlightVehicle& vehicle, const FlightRules& rules, const ReferenceCurve& reference,
                         std::uint64_t seed, std::uint32_t trial, const SafetyFilter* guide)
    : vehicle_(vehicle),
      rules_(rules),
      reference_(reference),
      body_(vehicle.body, vehicle.plant, RandomStream{seed, trial}),
      point_(vehicle.max_acceleration, vehicle.plant.sensor, RandomStream{seed, trial}),
      predictor_(vehicle.body, assumed_by(vehicle), rules.dt_s),
      guide_(guide == nullptr ? nullptr : guide->clone()) {
  check(vehicle, rules);
  if (guide_) {
    if (guide_->kind() != CommandKind::acceleration) throw std::invalid_argument("a guide gives accelerations");
    guide_->reset();
  }
  const ReferencePoint start = reference.at(reference.start());
  goal_ = reference.at(reference.end()).p;
  stop_distance_ = std::max(rules.stop_fraction * norm(goal_ - start.p), rules.stop_floor_m);
  const double allowed_s = rules.max_time_s > 0 ? rules.max_time_s : rules.time_factor * reference.duration();
  max_ticks_ = std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(allowed_s / rules.dt_s - 1e-9)));
  x_ = State{start.p, is_rigid() ? shadowed(std::tan(start.yaw / 4) * e3) : Vec3{}, start.v, {}};
  is_rigid() ? body_.reset(x_) : point_.reset(x_);
  seen_.thrust = vehicle.body.hover_thrust();
  append(log_.position, x_.p);
  append(log_.state, x_);
  observe();
}

void FlightTrial::observe() {
  const auto before = Clock::now();
  seen_.x = is_rigid() ? body_.measured() : point_.measured();
  seen_.x.sigma = shadowed(seen_.x.sigma);  // delayed measurements precede the switch at the end of the tick
  if (is_rigid()) seen_.x = predictor_.now(seen_.x, time_s()), seen_.rotors = predictor_.rotors();
  if (!is_turn(rules_.controller_ticks)) {
    guide_s_ = 0, controller_s_ = seconds_since(before);
    return;
  }
  target_ = reference_.at(reference_.start() + time_s());
  // The controller uses its own thrust, unless another one is applied.
  nominal_ = track(vehicle_.body, vehicle_.gains, seen_.x, target_, is_other_ ? seen_.thrust : own_thrust);
  guide_s_ = 0;
  if (guide_) {
    const auto start = Clock::now();
    const FilterReport bent = guide_->filter(seen_, nominal_);
    guide_s_ = seconds_since(start);
    if (bent.status != SafetyStatus::ok && bent.status != SafetyStatus::refused) {
      if (is_rigid())
        nominal_.wrench = realise(vehicle_.body, vehicle_.gains, seen_.x, target_, nominal_, bent.acceleration);
      nominal_.acceleration = bent.acceleration;
    }
  }
  controller_s_ = seconds_since(before) - guide_s_;
}

FilterReport FlightTrial::unfiltered() const {
  FilterReport report;
  report.status = SafetyStatus::ok;
  report.acceleration = nominal_.acceleration;
  report.wrench = nominal_.wrench;
  report.thrust_rate = nominal_.thrust_rate;
  report.margin = std::numeric_limits<double>::infinity();
  return report;
}

Outcome FlightTrial::advance(const FilterReport& answer, CommandKind kind, double filter_s) {
  if (log_.outcome != Outcome::flying) throw std::logic_error("the flight is over");
  if (kind == CommandKind::wrench && !is_rigid()) throw std::invalid_argument("a double integrator has no wrench");
  const double thrust_before = seen_.thrust;
  double error = 0, realise_s = 0;
  Wrench led;
  if (!is_rigid()) {
    command_ = answer.acceleration;
    for (std::int64_t i = 0; i < rules_.plant_steps; ++i) {
      point_.step(rules_.dt_s / static_cast<double>(rules_.plant_steps), command_);
      append(log_.position, point_.state().p);
    }
    error = norm(point_.acceleration() - command_);
    is_limited_ = error > 0;
    x_ = point_.state();
  } else {
    const auto before = Clock::now();
    if (is_turn(kind == CommandKind::wrench ? rules_.filter_ticks : rules_.controller_ticks)) renew(answer, kind);
    led = predictor_.lead(flown_);
    realise_s = seconds_since(before);
    error = fly(led);
    predictor_.fly(led, rates_, seen_.x);
    seen_.thrust = flown_.thrust;
    is_other_ = flown_.thrust != nominal_.wrench.thrust;
  }
  seen_.thrust_rate = kind == CommandKind::wrench ? answer.thrust_rate : (seen_.thrust - thrust_before) / rules_.dt_s;

  append(log_.state, x_);
  append(log_.a_nominal, nominal_.acceleration);
  append(log_.a_command, command_);
  append(log_.u_nominal, nominal_.wrench);
  append(log_.u, led);
  const Vec4 rotors = is_rigid() ? vehicle_.body.rotor_thrust(led) : Vec4{};
  log_.rotor_thrust.insert(log_.rotor_thrust.end(), rotors.begin(), rotors.end());
  log_.a_error.push_back(error);
  log_.margin.push_back(answer.margin);
  log_.gate_m.push_back(answer.gate_m);
  log_.active.push_back(answer.active);
  log_.candidates.push_back(answer.candidates);
  log_.rows.push_back(answer.rows);
  log_.iterations.push_back(answer.iterations);
  log_.status.push_back(static_cast<std::uint8_t>(answer.status));
  log_.flags.push_back(static_cast<std::uint8_t>((answer.capped ? 1 : 0) | (answer.infeasible ? 2 : 0) |
                                                 (answer.certified ? 4 : 0) | (is_limited_ ? 8 : 0)));
  log_.filter_s.push_back(static_cast<float>(filter_s + guide_s_));
  log_.tick_s.push_back(static_cast<float>(controller_s_ + guide_s_ + filter_s + realise_s));
  log_.outcome = judged(answer.status);
  if (log_.outcome == Outcome::flying) observe();
  return log_.outcome;
}

// Makes the wrench, its acceleration and its body rates from the report of a filter.
void FlightTrial::renew(const FilterReport& answer, CommandKind kind) {
  const bool is_wrench = kind == CommandKind::wrench;
  const Wrench unlimited =
      is_wrench ? answer.wrench
                : realise(vehicle_.body, vehicle_.gains, seen_.x, target_, nominal_, answer.acceleration);
  flown_ = vehicle_.body.limited(unlimited);
  is_limited_ = !is_same(unlimited, flown_);
  // A thrust is an acceleration along the axis that the filter saw; held, as the acceleration of a filter is.
  command_ = is_wrench ? acceleration_of(vehicle_.body, seen_.x, answer.wrench.thrust) : answer.acceleration;
  if (vehicle_.interface != CommandInterface::body_rates) return;
  const double held_s = rules_.dt_s * static_cast<double>(is_wrench ? rules_.filter_ticks : rules_.controller_ticks);
  rates_ = body_rates(vehicle_.body, seen_.x, flown_, rate_lead_s(vehicle_.rate_time_constant_s, held_s),
                      vehicle_.max_rate);
}

// Flies the wrench, held, or its body rates for a tick. Returns the largest difference of the body's acceleration and
// the commanded one at the ends of the plant's steps.
double FlightTrial::fly(const Wrench& led) {
  const double dt = rules_.dt_s / static_cast<double>(rules_.plant_steps);
  const bool by_rates = vehicle_.interface == CommandInterface::body_rates;
  double worst = 0;
  for (std::int64_t i = 0; i < rules_.plant_steps; ++i) {
    Wrench u = led;
    if (by_rates) {
      u.torque = rate_loop_torque(vehicle_.body, x_.omega, rates_, vehicle_.rate_time_constant_s);
      u = vehicle_.body.limited(u);
    }
    body_.step(dt, u);
    x_ = body_.state();
    append(log_.position, x_.p);
    worst = std::max(worst, norm(body_.acceleration() - command_));
  }
  body_.switch_shadow();
  x_ = body_.state();
  return worst;
}

Outcome FlightTrial::judged(SafetyStatus status) {
  if (status == SafetyStatus::refused || !is_finite(x_) || !within(x_.p, rules_.lower, rules_.upper))
    return Outcome::refused;
  const double speed = norm(x_.v);
  const bool over = time_s() >= reference_.duration() - 1e-9;
  if (over && norm(x_.p - goal_) <= stop_distance_ && speed <= rules_.stop_speed) return Outcome::reached;
  // A vehicle may rest where the reference rests; it is stuck only if it is away from the reference.
  const bool behind = norm(x_.p - reference_.at(reference_.start() + time_s()).p) > stop_distance_;
  still_ = speed < rules_.stuck_speed && behind ? still_ + 1 : 0;
  if (still_ >= rules_.stuck_ticks) return Outcome::stuck;
  return static_cast<std::int64_t>(log_.ticks()) >= max_ticks_ ? Outcome::timeout : Outcome::flying;
}

std::vector<SplatFlightLog> fly(const FlightVehicle& vehicle, const FlightRules& rules,
                                std::span<const ReferenceCurve> references, const SafetyFilter* filter,
                                const SafetyFilter* guide, std::uint64_t seed, std::uint32_t first_trial,
                                unsigned jobs, Control& control) {
  check(vehicle, rules);
  std::vector<SplatFlightLog> logs(references.size());
  parallel_chunks(references.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    const std::unique_ptr<SafetyFilter> own = filter == nullptr ? nullptr : filter->clone();
    // Without a filter a rigid body flies the controller's own wrench, the same that `realise` gives.
    const CommandKind kind = own ? own->kind() : CommandKind::acceleration;
    for (std::size_t i = begin; i < end; ++i) {
      if (own) own->reset();
      FlightTrial trial(vehicle, rules, references[i], seed, first_trial + static_cast<std::uint32_t>(i), guide);
      FilterReport answer;
      while (trial.outcome() == Outcome::flying) {
        if (!own) {
          trial.advance(trial.unfiltered(), kind, 0);
          continue;
        }
        const auto before = Clock::now();
        if (trial.is_filtered()) answer = own->filter(trial.state(), trial.nominal());
        const double seconds = seconds_since(before);
        if (answer.status == SafetyStatus::refused) answer.wrench = {vehicle.body.hover_thrust(), {}};
        trial.advance(answer, kind, answer.solve_time_s.value_or(seconds));
      }
      logs[i] = std::move(trial.log());
    }
  });
  return logs;
}

}  // namespace alula::flight
