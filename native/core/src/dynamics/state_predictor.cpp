#include "alula/dynamics/state_predictor.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

constexpr double kStep = 1e-3;      // of RK4 [s]
constexpr double kSameTime = 1e-9;  // [s]

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
  std::fill(past_.begin(), past_.end(), Tick{hover, rotors_});
}

State StatePredictor::now(const State& measured, double age_s) const {
  const double age = std::clamp(age_s, 0.0, model_.delay_s), lag = model_.motor_time_constant_s;
  State x = measured;
  if (!(age > kSameTime)) return x;
  for (std::size_t k = static_cast<std::size_t>(std::ceil((age - kSameTime) / tick_s_)); k > 0; --k) {
    const Tick& tick = ago(k);
    const double skipped = std::max(0.0, static_cast<double>(k) * tick_s_ - age);
    const int steps = std::max(1, static_cast<int>(std::ceil((tick_s_ - skipped - kSameTime) / kStep)));
    const double h = (tick_s_ - skipped) / steps;
    Vec4 rotors = tick.rotors;
    if (lag > 0 && skipped > 0)
      rotors = followed(body_.rotors(), rotors, body_.rotor_thrust(tick.command), lag, skipped);
    for (int i = 0; i < steps; ++i)
      x = lag > 0 ? following_step(body_, lag, x, rotors, tick.command, h,
                                   [&](const State& at, const Wrench& u) { return body_.derivative(at, u); })
                  : body_.step(x, tick.command, h);
    x.sigma = shadowed(x.sigma);
  }
  return x;
}

void StatePredictor::fly(const Wrench& command) {
  const Wrench u = is_finite(command) ? body_.saturated(command) : ago(1).command;
  past_[next_] = {u, rotors_};
  next_ = (next_ + 1) % past_.size();
  const double lag = model_.motor_time_constant_s;
  const Vec4 goal = body_.rotor_thrust(u);
  rotors_ = lag > 0 ? followed(body_.rotors(), rotors_, goal, lag, tick_s_) : goal;
}

}  // namespace alula::flight
