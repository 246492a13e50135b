#include "alula/dynamics/state_predictor.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

constexpr double kStep = kRateLoopPeriod;  // of RK4 too [s]

}  // namespace

StatePredictor::StatePredictor(const Quadrotor& body, const ActuatorModel& model, double tick_s)
    : body_(body), model_(model), tick_s_(tick_s) {
  check(model);
  if (!(tick_s > 0 && model.delay_s / tick_s <= 1e5))
    throw std::invalid_argument(
        "the tick of a predictor must be positive, and at most 100 000 of them make the delay");
  past_.resize(static_cast<std::size_t>(std::ceil(model.delay_s / tick_s)) + 1);
  reset();
}

void StatePredictor::reset() {
  const Wrench hover = body_.limited({body_.hover_thrust(), {}});
  rotors_ = body_.rotor_thrust(hover);
  std::fill(past_.begin(), past_.end(), Tick{hover, {}, {}, rotors_});
}

State StatePredictor::now(const State& measured, double age_s) const {
  const double age = std::clamp(age_s, 0.0, model_.delay_s), lag = model_.motor_time_constant_s;
  State x = measured;
  if (!(age > kSameTime)) return x;
  for (std::size_t k = static_cast<std::size_t>(std::ceil((age - kSameTime) / tick_s_)); k > 0; --k) {
    const Tick& tick = ago(k);
    const double skipped = std::max(0.0, static_cast<double>(k) * tick_s_ - age);
    Vec4 rotors = tick.rotors;
    if (skipped > 0 && lag > 0) {
      State before = tick.x;
      if (has_rate_loop()) advance(before, rotors, tick, skipped);  // the rotors depend on the rates
      if (!has_rate_loop()) rotors = followed(body_.rotors(), rotors, body_.rotor_thrust(tick.command), lag, skipped);
    }
    advance(x, rotors, tick, tick_s_ - skipped);
    x.sigma = shadowed(x.sigma);
  }
  return x;
}

// The body and its rotors after `time` of a tick's command.
void StatePredictor::advance(State& x, Vec4& rotors, const Tick& tick, double time) const {
  const double lag = model_.motor_time_constant_s;
  const int steps = std::max(1, static_cast<int>(std::ceil((time - kSameTime) / kStep)));
  const double h = time / steps;
  Wrench u = tick.command;
  for (int i = 0; i < steps; ++i) {
    if (has_rate_loop()) {
      u.torque = rate_loop_torque(body_, x.omega, tick.rates, model_.rate_time_constant_s);
      u.thrust = tick.command.thrust;
      u = body_.limited(u);
    }
    x = lag > 0 ? following_step(body_, lag, x, rotors, u, h,
                                 [&](const State& at, const Wrench& made) { return body_.derivative(at, made); })
                : body_.step(x, u, h);
  }
}

double StatePredictor::thrust(double from_s, double to_s) const {
  const double lag = model_.motor_time_constant_s, newest = ago(1).command.thrust;
  double beyond = 0, time = 0;  // beyond the newest command [N s]
  const auto oldest = static_cast<std::size_t>(std::ceil((from_s - kSameTime) / tick_s_));
  for (std::size_t k = std::min(oldest, past_.size()); k > 0; --k) {
    const Tick& tick = ago(k);
    const double after = static_cast<double>(k) * tick_s_, begin = std::max(0.0, after - from_s),
                 end = std::min(tick_s_, after - to_s);
    if (!(end - begin > kSameTime)) continue;
    beyond += (end - begin) * (tick.command.thrust - newest), time += end - begin;
    if (lag > 0)
      beyond += lag * (std::exp(-begin / lag) - std::exp(-end / lag)) *
                (body_.wrench(tick.rotors).thrust - tick.command.thrust);
  }
  return time > 0 ? newest + beyond / time : newest;
}

void StatePredictor::fly(const Wrench& command, Vec3 rates, const State& now) {
  const Tick& last = ago(1);
  const double lag = model_.motor_time_constant_s;
  Tick tick{command, rates, now, rotors_};
  if (!is_finite(command) || !geometry::is_finite(rates)) tick.command = last.command, tick.rates = last.rates;
  if (!has_rate_loop() && is_finite(command)) tick.command = body_.saturated(command);
  past_[next_] = tick;
  next_ = (next_ + 1) % past_.size();
  if (has_rate_loop() && lag > 0) {
    State x = now;
    advance(x, rotors_, tick, tick_s_);
    if (!is_finite(x)) rotors_ = tick.rotors;
    return;
  }
  const Vec4 goal = body_.rotor_thrust(tick.command);
  rotors_ = lag > 0 ? followed(body_.rotors(), rotors_, goal, lag, tick_s_) : goal;
}

}  // namespace alula::flight
