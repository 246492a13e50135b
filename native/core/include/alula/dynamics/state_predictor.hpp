// The state now from one measured a while ago, and the rotors' thrusts, by the model of the vehicle.
//
// Only commands are needed: rotors follow what they are told, and from the measured state on the body's model is
// integrated with the wrenches that they made meanwhile. Without disturbances, and with the lag and delay that the
// vehicle has, what comes out is the true state, up to rounding and the error of RK4 with steps of a millisecond.
#pragma once

#include <vector>

#include "alula/dynamics/actuators.hpp"

namespace alula::flight {

// Of one flight. A tick: `now` gives the state for controller and filter, `lead` makes what they decided a command,
// and `fly` takes that. Allocates in the constructor only.
class StatePredictor {
 public:
  // Throws std::invalid_argument for a model or a tick without meaning.
  StatePredictor(const Quadrotor& body, const ActuatorModel& model, double tick_s);

  const ActuatorModel& model() const { return model_; }
  void reset();  // it has hovered for as long as matters

  // The state now, |sigma| <= 1, from the one `age_s` ago: at most the model's delay, less when there was none yet.
  State now(const State& measured, double age_s) const;
  State now(const State& measured) const { return now(measured, model_.delay_s); }

  // What the rotors give now [N].
  const Vec4& rotors() const { return rotors_; }

  // The command that leads the rotors to `wished` by the end of a tick that begins now; `wished` itself without lag.
  Wrench lead(const Wrench& wished) const {
    const double lag = model_.motor_time_constant_s;
    return lag > 0 ? leading(body_, lag, rotors_, wished, tick_s_) : wished;
  }

  // `command` is flown from now on for a tick; one that is not finite leaves the rotors with the last one.
  void fly(const Wrench& command);

 private:
  struct Tick {
    Wrench command;
    Vec4 rotors;  // when it began
  };
  const Tick& ago(std::size_t ticks) const { return past_[(next_ + past_.size() - ticks) % past_.size()]; }

  Quadrotor body_;
  ActuatorModel model_;
  double tick_s_;
  Vec4 rotors_{};
  std::vector<Tick> past_;  // a ring
  std::size_t next_ = 0;
};

}  // namespace alula::flight
