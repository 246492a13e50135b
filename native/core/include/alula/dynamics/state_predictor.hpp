// Predicts the current state and rotor thrusts from a delayed measurement with the model of the vehicle.
//
// Only the past commands are needed: the modelled rotors follow them, and the body's model is integrated from the
// measured state with the resulting wrenches. Without disturbances, and with the vehicle's true lag and delay, the
// prediction is the true state up to rounding and the error of RK4 with steps of a millisecond. So is that of a
// vehicle with a rate loop of steps of a millisecond.
#pragma once

#include <vector>

#include "alula/dynamics/actuators.hpp"

namespace alula::flight {

// The predictor of one flight. In each tick, `now` gives the state for controller and filter, and `fly` records the
// command. `lead` converts their wrench to a command that may be held for several ticks. Allocates in the constructor
// only.
class StatePredictor {
 public:
  // Throws std::invalid_argument for a model or a tick out of range.
  StatePredictor(const Quadrotor& body, const ActuatorModel& model, double tick_s);

  const ActuatorModel& model() const { return model_; }
  void reset();  // assumes hovering for at least the delay

  // The current state, |sigma| <= 1, from the state `age_s` ago. The age is at most the model's delay, and smaller
  // at the start of a flight.
  State now(const State& measured, double age_s) const;
  State now(const State& measured) const { return now(measured, model_.delay_s); }

  // The mean thrust of the rotors between two ages, from > to, of the commands that are known [N].
  double thrust(double from_s, double to_s) const;

  // Current thrusts of the rotors [N].
  const Vec4& rotors() const { return rotors_; }

  // The command that brings the rotors to `target` when it has been held for a time, with a rate loop to its thrust;
  // `target` itself without lag.
  Wrench lead(const Wrench& target, double held_s) const {
    const double lag = model_.motor_time_constant_s;
    if (!(lag > 0)) return target;
    if (has_rate_loop()) return {leading_thrust(body_, lag, rotors_, target.thrust, held_s), target.torque};
    return leading(body_, lag, rotors_, target, held_s);
  }
  Wrench lead(const Wrench& target) const { return lead(target, tick_s_); }

  // Records that `command` acts from now on for a tick; if it is not finite, the rotors keep the last one.
  void fly(const Wrench& command) { fly(command, {}, {}); }

  // The same with a rate loop: the thrust of `command` and these body rates are commanded [rad/s]. `now`: the present
  // state, as predicted.
  void fly(const Wrench& command, Vec3 rates, const State& now);

 private:
  struct Tick {
    Wrench command;
    Vec3 rates;
    State x;      // at the start of the tick, with a rate loop
    Vec4 rotors;  // at the start of the tick
  };
  bool has_rate_loop() const { return alula::flight::has_rate_loop(model_.rate_time_constant_s); }
  void advance(State& x, Vec4& rotors, const Tick& tick, double time) const;
  const Tick& ago(std::size_t ticks) const { return past_[(next_ + past_.size() - ticks) % past_.size()]; }

  Quadrotor body_;
  ActuatorModel model_;
  double tick_s_;
  Vec4 rotors_{};
  std::vector<Tick> past_;  // ring buffer
  std::size_t next_ = 0;
};

}  // namespace alula::flight
