#include "alula/flight/flight.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace alula::flight {
namespace {

using Clock = std::chrono::steady_clock;
using geometry::norm;

constexpr double kRounding = 1 + 1e-12;  // a velocity that was scaled to the limit is not scaled again

bool is_same(Vec3 a, Vec3 b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

// Acceleration that, held for dt, brakes along the velocity to rest, without reversal.
Vec3 braking(Vec3 v, double most, double dt) {
  const double speed = norm(v);
  return -std::min(1 / dt, (std::isfinite(most) ? most : 5) / std::max(speed, 1e-12)) * v;
}

// The innermost command that a vehicle's interface takes.
CommandKind innermost(Interface interface) {
  switch (interface) {
    case Interface::velocity:
      return CommandKind::velocity;
    case Interface::acceleration:
      return CommandKind::acceleration;
    case Interface::wrench:
      return CommandKind::wrench;
    case Interface::body_rates:
    case Interface::sticks:
      break;
  }
  return CommandKind::sticks;
}

// Of a thrust along the body's axis.
Vec3 acceleration_of(const Quadrotor& body, const State& x, double thrust) {
  return thrust / body.mass() * geometry::transposed_times(body_from_inertial(x.sigma), geometry::e3) -
         body.gravity() * geometry::e3;
}

bool is_rigid_body(const VehicleSpec& vehicle) {
  return vehicle.model == VehicleModel::quadrotor && vehicle.interface >= Interface::wrench;
}

// A quadrotor whose own controller follows velocities or accelerations.
bool follows_itself(const VehicleSpec& vehicle) {
  return vehicle.model == VehicleModel::quadrotor && vehicle.interface < Interface::wrench;
}

std::optional<geometry::PerAxis> lag_of(const VehicleSpec& vehicle) {
  if (vehicle.interface != Interface::velocity) return std::nullopt;
  return vehicle.velocity_lag_s;
}

// Largest age of a measurement that is predicted; not of sticks, whose filters predict themselves [s].
double oldest_s(const VehicleSpec& vehicle, const FlightOptions& options) {
  return vehicle.assumed.delay_s + (options.has_losses ? options.stale_s : 0);
}

// Time by which a velocity set-point leads, so that the loop which follows it has the acceleration of the reference:
// gain (v + a / gain - v) = a. A vehicle that follows velocities itself gets them without a lead [s].
double lead_of(const VehicleSpec& vehicle) {
  return vehicle.interface == Interface::velocity ? 0 : 1 / vehicle.velocity_gain;
}

ActuatorModel remembered(const VehicleSpec& vehicle, const FlightOptions& options) {
  ActuatorModel model = vehicle.assumed;
  if (vehicle.interface == Interface::body_rates) model.rate_time_constant_s = vehicle.rate_time_constant_s;
  if (is_rigid_body(vehicle)) model.delay_s = oldest_s(vehicle, options);
  return model;
}

}  // namespace

Flight::Flight(const VehicleSpec& vehicle, const FlightOptions& options, const Mission& mission,
               std::span<const SafetyFilter* const> filters)
    : vehicle_(vehicle),
      options_(options),
      mission_(mission),
      predictor_(vehicle.body, remembered(vehicle, options), options.dt_s),
      observer_(is_rigid_body(vehicle) ? options.disturbance : DisturbanceOptions{}),
      response_(follows_itself(vehicle) ? options.response : ResponseOptions{}, lag_of(vehicle), options.dt_s,
                oldest_s(vehicle, options)) {
  check(vehicle);
  check(options.disturbance, vehicle.body.gravity());
  check(options.response, vehicle.body.gravity());
  if (!(options.dt_s > 0 && options.controller_ticks > 0 && options.filter_ticks > 0 && options.stale_s > 0))
    throw std::invalid_argument("the ticks of a flight and the age of its states must be positive");
  if (mission.kind == MissionKind::curve && !mission.curve)
    throw std::invalid_argument("a mission along a curve needs the curve");
  if (mission.kind == MissionKind::curve && mission.clock) clock_.emplace(mission.curve, *mission.clock);
  CommandKind outer = CommandKind::velocity;
  for (const SafetyFilter* filter : filters) {
    if (filter->kind() < outer)
      throw std::invalid_argument(
          "filters stand in the order of their commands: velocities, accelerations, wrenches, sticks");
    outer = filter->kind();
    filters_.push_back(filter->clone());
  }
  if (outer > innermost(vehicle.interface))
    throw std::invalid_argument("a filter's command is beyond what the vehicle takes");
  records_.resize(filters_.size());
  const bool is_point = !is_rigid_body(vehicle) && vehicle.interface != Interface::sticks;
  const double kept_s = is_point ? oldest_s(vehicle, options) : 0;
  past_.resize(static_cast<std::size_t>(std::ceil(kept_s / options.dt_s - 1e-9)) + 1);
  reset();
}

void Flight::reset() {
  for (const auto& filter : filters_) filter->reset();
  predictor_.reset();
  observer_.reset(), response_.reset(), level_out_ = {}, true_ = {}, sent_ticks_ = 0, measured_ = 0;
  if (clock_) clock_->reset();
  seen_ = {};
  seen_.thrust = vehicle_.body.hover_thrust();
  flown_ = vehicle_.body.limited({vehicle_.body.hover_thrust(), {}});
  std::fill(past_.begin(), past_.end(), std::nullopt);
  std::fill(records_.begin(), records_.end(), FilterRecord{});
  first_ = nominal_ = {};
  target_ = reference_ = {};
  last_ = {}, attitude_.reset();
  now_ = 0, arrived_ = -1, age_.reset();
  has_state_ = has_target_ = is_other_ = false;
  tick_ = 0, oldest_ = 0;
  decision_ = {};
}

void Flight::observe(const Observation& seen) {
  if (!(seen.slip_m >= 0 && std::isfinite(seen.slip_m)))
    throw std::invalid_argument("the slip of a position must be finite and not negative");
  now_ = seen.now_s, seen_.slip_m = seen.slip_m;
  if (seen.measured && is_finite(*seen.measured)) {
    if (observer_.is_on()) estimate_disturbance(*seen.measured, seen.age_s);
    if (response_.is_on()) response_.update(seen.age_s.value_or(vehicle_.assumed.delay_s), seen.measured->v);
    last_ = *seen.measured, attitude_ = seen.attitude, arrived_ = now_, has_state_ = true;
    age_ = seen.age_s;
  }
  if (seen.target) target_ = *seen.target, has_target_ = true;
  seen_.tracks = seen.tracks;
  seen_.position_variance = seen.position_variance;
  sticks_ = seen.sticks;
  predict();
}

// From the measurement that just arrived, the one before it and the thrust that the rotors had between them. Ticks
// are counted by the commands that were sent, because ticks can be left out while the vehicle goes on with its
// command.
void Flight::estimate_disturbance(const State& measured, const std::optional<double>& age_s) {
  const Quadrotor& body = vehicle_.body;
  if (!has_state_) observer_.begin(thrust_axis(measured.sigma), body.gravity());
  const double sent = static_cast<double>(sent_ticks_) * options_.dt_s,
               age = age_s.value_or(vehicle_.assumed.delay_s);
  const double time = sent - age, thrust = predictor_.thrust(has_state_ ? sent - measured_ : age, age);
  measured_ = time;
  const Vec3 now = acceleration_of(body, measured, thrust);
  observer_.update(time, measured.v, has_state_ ? 0.5 * (acceleration_of(body, last_, thrust) + now) : now);
  level_out_ = Level(observer_.acceleration(), body.gravity());
}

// The state now, from the newest measurement and the commands since.
void Flight::predict() {
  const double waited = now_ - arrived_;
  const bool by_sticks = vehicle_.interface == Interface::sticks;
  // The geofence predicts itself, with a bound of the error, where navigation is missing.
  const double delay = vehicle_.assumed.delay_s, age = (age_ ? *age_ : std::min(now_, delay)) + waited;
  seen_.is_known = has_state_ && (by_sticks ? waited == 0
                                  : age_    ? age <= options_.stale_s + delay
                                            : waited <= options_.stale_s);
  seen_.x = last_, seen_.attitude = attitude_;
  true_ = seen_.x;
  if (!seen_.is_known || by_sticks) return;
  if (is_rigid_body(vehicle_)) {
    true_ = seen_.x = predictor_.now(last_, age);
    seen_.rotors = predictor_.rotors();
    if (observer_.is_on()) {
      const Vec3 d = observer_.acceleration();
      true_.p = true_.p + age * age / 2 * d, true_.v = true_.v + age * d;
      seen_.x = level_out_(true_), seen_.level = level_out_;
      for (double& rotor : *seen_.rotors) rotor /= level_out_.scale();
      seen_.disturbance_bound = std::max(0.0, observer_.bound() - kNoiseBound);
    }
    return;
  }
  seen_.disturbance = response_.acceleration(), seen_.disturbance_bound = response_.bound();
  // A point, or a vehicle with its own cascade: by the commands of the last ticks, each held for a tick.
  const auto ticks = static_cast<std::size_t>(std::ceil(age / options_.dt_s - 1e-9));
  const std::size_t known = std::min(ticks, past_.size());
  double left = age;
  for (std::size_t k = known; k > 0 && left > 1e-12; --k) {
    const double later = static_cast<double>(k - 1) * options_.dt_s;  // the oldest one is held for less than a tick
    const double held = left - later;
    if (!(held > 0)) continue;
    const std::optional<Vec3>& command = past_[(oldest_ + past_.size() - k) % past_.size()];
    if (command)
      follow(*command, held);
    else
      seen_.x.p = seen_.x.p + held * seen_.x.v;
    left -= held;
  }
}

// The predicted state after a command was held for a time. v' = (u - v) / lag + d is a response to u + lag d.
void Flight::follow(Vec3 command, double held) {
  State& x = seen_.x;
  const bool is_velocity = vehicle_.interface == Interface::velocity;
  if (response_.is_on()) {
    const Vec3 d = response_.acceleration();
    command = command + (is_velocity ? geometry::by_axis(vehicle_.velocity_lag_s, d) : d);
  }
  if (vehicle_.model == VehicleModel::single_integrator) {
    x.p = x.p + held * command;
  } else if (is_velocity && is_rigid()) {
    for (int i = 0; i < 3; ++i) {
      const double lag = vehicle_.velocity_lag_s[i];
      const double v = lag > 0 ? command[i] + std::exp(-held / lag) * (x.v[i] - command[i]) : x.v[i];
      x.p[i] = x.p[i] + held * (lag > 0 ? command[i] : v) + lag * (x.v[i] - v);
      x.v[i] = v;
    }
  } else {
    const Vec3 a = is_velocity ? velocity_loop(vehicle_, command, x.v) : command;
    x.p = x.p + held * x.v + held * held / 2 * a;
    x.v = x.v + held * a;
  }
}

// The nominal command of the mission, as far in as it goes; `level_` is the outermost kind.
void Flight::make_nominal() {
  if (mission_.kind == MissionKind::pilot) {
    nominal_ = {};
    nominal_.sticks = sticks_;
    level_ = CommandKind::sticks;
    return;
  }
  const State& x = seen_.x;
  Vec3 towards = mission_.goal - x.p;
  Vec3 velocity;
  if (mission_.kind != MissionKind::goal) {
    if (mission_.kind == MissionKind::curve)
      target_ = clock_ ? clock_->target() : mission_.curve->at(mission_.curve->start() + now_);
    velocity = target_.v + lead_of(vehicle_) * target_.a + mission_.gain / 2 * (target_.p - x.p);
  } else {
    target_ = reference_for(mission_.goal, {}, target_.yaw);
    velocity = mission_.gain / 2 * towards;
  }
  reference_ = target_, gains_ = vehicle_.gains;
  const bool is_point = vehicle_.model == VehicleModel::double_integrator;
  const bool by_law = mission_.kind == MissionKind::goal && vehicle_.model != VehicleModel::single_integrator;
  if (by_law) {
    const double distance = norm(towards),
                 most = std::isfinite(vehicle_.max_acceleration) ? vehicle_.max_acceleration : 5;
    double speed = std::min(mission_.speed, std::sqrt(most * distance));
    // The square root is steep at the goal, which matters when hovering there: use a well-damped spring.
    if (mission_.hovers) speed = std::min(speed, mission_.gain / 2 * distance);
    velocity = distance > 0 ? speed / distance * towards : Vec3{};
  } else {
    velocity = limited(velocity, std::min(mission_.speed, vehicle_.max_speed));
  }
  const bool by_velocity = (!filters_.empty() && filters_.front()->kind() == CommandKind::velocity) ||
                           vehicle_.interface == Interface::velocity || by_law;
  if (by_velocity || vehicle_.model == VehicleModel::single_integrator) {
    nominal_ = {};
    nominal_.velocity = velocity;
    level_ = CommandKind::velocity;
    if (by_law && is_point) {
      nominal_.acceleration = mission_.gain * (velocity - x.v);
      for (int i = 0; i < 3; ++i)
        nominal_.acceleration[i] =
            std::clamp(nominal_.acceleration[i], -vehicle_.max_acceleration, vehicle_.max_acceleration);
      if (vehicle_.interface == Interface::acceleration &&
          (filters_.empty() || filters_.front()->kind() != CommandKind::velocity))
        level_ = CommandKind::acceleration;
    }
  } else {
    // The controller uses its own thrust, unless another one is applied.
    nominal_ = track(vehicle_.body, vehicle_.gains, x, target_, is_other_ ? seen_.thrust : own_thrust);
    nominal_.velocity = velocity;
    level_ = CommandKind::acceleration;  // the wrench belongs to it
  }
  nominal_.sticks = sticks_;
}

// From the command that `nominal_` holds at one level to that of another, inwards.
void Flight::lower(CommandKind from, CommandKind to) {
  const State& x = seen_.x;
  if (from == CommandKind::velocity && to > CommandKind::velocity) {
    const Vec3 velocity = nominal_.velocity;
    if (is_rigid()) {
      reference_ = reference_for(x.p, velocity, target_.yaw);
      if (mission_.kind != MissionKind::goal && is_same(velocity, first_.velocity)) {  // no filter changed it
        reference_ = target_;
        reference_.p = x.p, reference_.v = velocity - lead_of(vehicle_) * target_.a;
      }
      gains_ = holding(vehicle_);
      const std::optional<RacerCommand> sticks = nominal_.sticks;
      nominal_ = track(vehicle_.body, gains_, x, reference_);
      nominal_.velocity = velocity, nominal_.sticks = sticks;
    } else {
      nominal_.acceleration = velocity_loop(vehicle_, velocity, x.v);
    }
  }
  if (to == CommandKind::sticks && from < CommandKind::sticks) {
    const Wrench u = vehicle_.body.limited(nominal_.wrench);
    const double held = held_s(options_.filter_ticks);
    nominal_.sticks = RacerCommand{
        vehicle_.racer.throttle_for(u.thrust / vehicle_.body.mass()),
        body_rates(vehicle_.body, x, u, rate_lead_s(vehicle_.rate_time_constant_s, held), vehicle_.max_rate)};
  }
}

// The command of a filter becomes the nominal one of the next.
void Flight::take(const FilterReport& report, CommandKind kind) {
  switch (kind) {
    case CommandKind::velocity:
      nominal_.velocity = report.velocity;
      break;
    case CommandKind::acceleration:
      if (is_rigid())  // the nominal acceleration gives the nominal wrench, bit by bit
        nominal_.wrench = realise(vehicle_.body, gains_, seen_.x, reference_, nominal_, report.acceleration);
      nominal_.acceleration = report.acceleration;
      break;
    case CommandKind::wrench:
      nominal_.wrench = report.wrench;
      nominal_.thrust_rate = report.thrust_rate;
      break;
    case CommandKind::sticks:
      nominal_.sticks = report.sticks;
      break;
  }
}

// What is flown instead of a refused command.
void Flight::stand_in(CommandKind kind) {
  FilterReport rest;
  rest.status = SafetyStatus::recovering;
  const double held = held_s(std::min(options_.controller_ticks, options_.filter_ticks));
  rest.acceleration = seen_.is_known ? braking(seen_.x.v, vehicle_.max_acceleration, held) : Vec3{};
  rest.wrench = {vehicle_.body.hover_thrust(), {}};
  // A receiver's motors stand still without a command, as when a pilot is silent.
  if (vehicle_.interface != Interface::sticks)
    rest.sticks = {vehicle_.racer.throttle_for(vehicle_.racer.gravity), {}};
  take(rest, kind);
}

const Decision& Flight::decide() {
  const bool is_aimless = mission_.kind == MissionKind::given && !has_target_;
  decision_.is_stale = is_aimless || (!seen_.is_known && mission_.kind != MissionKind::pilot);
  if (decision_.is_stale) {
    decision_.is_refused = true, decision_.is_filtered = false;
    tick_ = 0;  // controller and filters begin anew
    level_ = std::min(innermost(vehicle_.interface),
                      vehicle_.interface == Interface::sticks ? CommandKind::sticks : CommandKind::wrench);
    stand_in(level_);
    for (FilterRecord& record : records_) record = {};
    finish();
    return decision_;
  }
  const bool is_controlled = is_turn(options_.controller_ticks), is_filtered = is_turn(options_.filter_ticks);
  decision_.is_filtered = is_filtered;
  if (is_controlled) make_nominal(), first_ = nominal_, first_level_ = level_;
  if (is_filtered || is_controlled) {
    decision_.is_refused = false;
    nominal_ = first_, level_ = first_level_;
    for (std::size_t i = 0; i < filters_.size(); ++i) {
      SafetyFilter& filter = *filters_[i];
      FilterRecord& record = records_[i];
      const CommandKind kind = filter.kind();
      if (level_ < kind) lower(level_, kind);
      level_ = std::max(level_, kind);
      if (is_filtered) {
        const auto start = Clock::now();
        record.report = filter.filter(seen_, nominal_);
        record.seconds = std::chrono::duration<float>(Clock::now() - start).count();
        if (const auto& own = record.report.solve_time_s) record.seconds = static_cast<float>(*own);
      }
      if (record.report.status == SafetyStatus::refused) {
        stand_in(kind);
        if (kind == CommandKind::acceleration) filter.flown(nominal_.acceleration);
        decision_.is_refused = i + 1 == filters_.size();
      } else {
        take(record.report, kind);
      }
    }
  }
  finish();
  ++tick_;
  return decision_;
}

// The command of the interface.
void Flight::finish() {
  Command& c = decision_.command;
  c.interface = vehicle_.interface;
  c.yaw = target_.yaw;
  switch (vehicle_.interface) {
    case Interface::velocity:
      c.velocity = nominal_.velocity;
      if (norm(c.velocity) > vehicle_.max_speed * kRounding) c.velocity = limited(c.velocity, vehicle_.max_speed);
      break;
    case Interface::acceleration:
      if (level_ == CommandKind::velocity) lower(level_, CommandKind::acceleration);
      decision_.acceleration = c.acceleration = nominal_.acceleration;
      if (response_.is_on()) c.acceleration = c.acceleration - response_.acceleration();
      if (is_rigid()) break;
      if (has_inner_limits(vehicle_)) {
        for (int i = 0; i < 3; ++i)
          c.acceleration[i] = std::clamp(c.acceleration[i], -vehicle_.max_acceleration, vehicle_.max_acceleration);
      } else {
        c.acceleration = limited(c.acceleration, vehicle_.max_acceleration);
      }
      decision_.is_limited = c.acceleration.x != nominal_.acceleration.x ||
                             c.acceleration.y != nominal_.acceleration.y ||
                             c.acceleration.z != nominal_.acceleration.z;
      break;
    case Interface::wrench:
    case Interface::body_rates: {
      if (level_ == CommandKind::velocity) lower(level_, CommandKind::wrench);
      // An acceleration waits for the controller, through whose attitude loop it is flown.
      const bool by_wrench = !filters_.empty() && filters_.back()->kind() >= CommandKind::wrench;
      const std::int64_t held_ticks = by_wrench ? options_.filter_ticks : options_.controller_ticks;
      if (level_ == CommandKind::sticks) {
        const RacerCommand u = nominal_.sticks.value_or(RacerCommand{});
        flown_ = {vehicle_.body.mass() * vehicle_.racer.acceleration(u.throttle), {}};
        c.wrench = flown_, c.rates = u.rates;
        decision_.acceleration.reset();
      } else {
        if (is_turn(held_ticks)) {
          const Wrench wanted = nominal_.wrench;
          flown_ = vehicle_.body.limited(wanted);
          decision_.is_limited = flown_.thrust != wanted.thrust || flown_.torque.x != wanted.torque.x ||
                                 flown_.torque.y != wanted.torque.y || flown_.torque.z != wanted.torque.z;
          // One command for the whole hold, as filters roll it out: rotors with lag reach the wrench at its end.
          const double held = held_s(decision_.is_stale ? 1 : held_ticks);
          c.wrench = predictor_.lead(
              observer_.is_on() ? vehicle_.body.limited({level_out_.scale() * flown_.thrust, flown_.torque}) : flown_,
              held);
          decision_.acceleration =
              by_wrench ? acceleration_of(vehicle_.body, seen_.x, wanted.thrust) : nominal_.acceleration;
          if (decision_.is_stale)
            c.rates = {}, decision_.acceleration.reset();
          else if (vehicle_.interface == Interface::body_rates)
            c.rates = body_rates(vehicle_.body, seen_.x, flown_, rate_lead_s(vehicle_.rate_time_constant_s, held),
                                 vehicle_.max_rate);
        }
      }
      seen_.thrust_rate =
          by_wrench ? records_.back().report.thrust_rate : (flown_.thrust - seen_.thrust) / options_.dt_s;
      is_other_ = flown_.thrust != first_.wrench.thrust;
      break;
    }
    case Interface::sticks:
      if (level_ < CommandKind::sticks) lower(level_, CommandKind::sticks);
      c.sticks = nominal_.sticks.value_or(RacerCommand{});  // silent: the motors stand still, as receivers do
      break;
  }
}

// The plan's time, after a tick with a command.
void Flight::go_on() {
  if (clock_ && !decision_.is_stale) clock_->advance(options_.dt_s, norm(seen_.x.p - target_.p));
}

void Flight::sent() {
  go_on();
  const Command& c = decision_.command;
  switch (vehicle_.interface) {
    case Interface::velocity:
      return remember(c.velocity);
    case Interface::acceleration:
      return remember(c.acceleration);
    case Interface::wrench:
    case Interface::body_rates:
      predictor_.fly(c.wrench, c.rates, true_);
      seen_.thrust = flown_.thrust;
      ++sent_ticks_;
      return;
    case Interface::sticks:
      return;
  }
}

void Flight::sent(const Command& other) {
  go_on();
  const bool is_same = other.interface == vehicle_.interface;
  switch (vehicle_.interface) {
    case Interface::velocity:
      return remember(is_same ? std::optional(other.velocity) : std::nullopt);
    case Interface::acceleration:
      return remember(is_same ? std::optional(other.acceleration) : std::nullopt);
    case Interface::wrench:
    case Interface::body_rates:  // the torque that its loop makes of other rates is not known
      if (other.interface < Interface::wrench || other.interface == Interface::sticks) return;
      predictor_.fly(
          {other.wrench.thrust, is_same && vehicle_.interface == Interface::wrench ? other.wrench.torque
                                                                                   : decision_.command.wrench.torque},
          other.rates, true_);
      seen_.thrust = other.wrench.thrust / level_out_.scale();
      ++sent_ticks_;
      return;
    case Interface::sticks:
      return;
  }
}

void Flight::remember(const std::optional<Vec3>& command) {
  response_.sent(command);
  past_[oldest_] = command;
  oldest_ = (oldest_ + 1) % past_.size();
}

}  // namespace alula::flight
