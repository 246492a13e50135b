// Actuator and measurement lag of a quadrotor: between the command and the wrench, and between the state and its
// measurement.
#pragma once

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

// The model that filters assume. Defaults: no lag, so the wrench acts at once and the measured state is current.
struct ActuatorModel {
  double motor_time_constant_s = 0;  // of each rotor's thrust, f' = (f_command - f) / time constant
  double delay_s = 0;                // age of the measured state
  // Of each axis of the rate loop of a vehicle that is commanded by thrust and body rates, see `rate_loop_torque`; 0
  // for all: it is commanded by wrenches.
  Vec3 rate_time_constant_s;
};

inline bool has_rate_loop(Vec3 time_constant_s) {
  return time_constant_s.x > 0 && time_constant_s.y > 0 && time_constant_s.z > 0;
}

// Throws std::invalid_argument for a number out of range.
inline void check(const ActuatorModel& model) {
  const auto require = [](double value, double most, const char* what) {
    if (!(value >= 0 && value <= most)) throw std::invalid_argument(what);
  };
  require(model.motor_time_constant_s, 10, "the time constant of the motors must be in 0..10 s");
  require(model.delay_s, 10, "a delay must be in 0..10 s");
  for (int i = 0; i < 3; ++i)
    require(model.rate_time_constant_s[i], 10, "the time constants of a rate loop must be in 0..10 s");
  if (norm(model.rate_time_constant_s) > 0 && !has_rate_loop(model.rate_time_constant_s))
    throw std::invalid_argument("a rate loop needs a time constant for each axis");
}

// The rotors' thrusts after they follow `goal` for a time t with the time constant `lag` > 0, within their limits:
// f(t) = goal + (f(0) - goal) e^(-t / lag). Each is monotonic in t, and so are thrust and torques.
inline Vec4 followed(const RotorLayout& limits, const Vec4& from, const Vec4& goal, double lag, double t) {
  const double left = std::exp(-t / lag);
  Vec4 f{};
  for (std::size_t i = 0; i < 4; ++i)
    f[i] = std::clamp(goal[i] + left * (from[i] - goal[i]), limits.f_min[i], limits.f_max[i]);
  return f;
}

// One RK4 step of dt with rotors that follow a command; `rotors` become those at the end of the step.
// derivative(x, u) is the derivative of the body's state for a wrench.
template <class F>
State following_step(const Quadrotor& body, double lag, const State& x, Vec4& rotors, const Wrench& command,
                     double dt, F&& derivative) {
  const Vec4 goal = body.rotor_thrust(command), from = rotors;
  const Wrench middle = body.wrench(followed(body.rotors(), from, goal, lag, dt / 2));
  rotors = followed(body.rotors(), from, goal, lag, dt);
  const Wrench first = body.wrench(from), last = body.wrench(rotors);
  return rk4_step(x, dt, [&](double t, const State& at) {
    return derivative(at, t == 0 ? first : t < dt ? middle : last);
  });
}

// The command with which the rotors produce `target` when it has been held for a time, within their limits.
inline Wrench leading(const Quadrotor& body, double lag, const Vec4& rotors, const Wrench& target, double held_s) {
  const double gain = 1 / -std::expm1(-held_s / lag);
  Vec4 f = body.rotor_thrust(target);
  for (std::size_t i = 0; i < 4; ++i) f[i] = rotors[i] + gain * (f[i] - rotors[i]);
  return body.limited(body.wrench(f));
}

// The thrust to command, together with body rates, with which the rotors produce `target` when it has been held for a
// time. A rate loop makes the torques itself: those that the rotors have now must not limit the thrust.
inline double leading_thrust(const Quadrotor& body, double lag, const Vec4& rotors, double target, double held_s) {
  const double from = body.wrench(rotors).thrust;
  return body.limited({from - (target - from) / std::expm1(-held_s / lag), {}}).thrust;
}

// Period of the rate loop of a vehicle, as of the simulated one by default: 1 kHz [s].
inline constexpr double kRateLoopPeriod = 1e-3;

// The torque of a rate loop that turns each axis of the body to its commanded rate as a first-order lag.
inline Vec3 rate_loop_torque(const Quadrotor& body, Vec3 omega, Vec3 rates, Vec3 time_constant_s) {
  const Vec3 inertia = body.inertia();
  Vec3 turning = geometry::multiply(inertia, rates - omega);
  for (int i = 0; i < 3; ++i) turning[i] = 1 / time_constant_s[i] * turning[i];
  return geometry::cross(omega, geometry::multiply(inertia, omega)) + turning;
}

// Times after which a torque leads to the body rates that are commanded for it: a rate loop turns the rates after its
// own time constant into the torque now; a command that is held for longer must not pass beyond its rates [s].
inline Vec3 rate_lead_s(Vec3 time_constant_s, double held_s) {
  for (int i = 0; i < 3; ++i) time_constant_s[i] = std::max(time_constant_s[i], held_s);
  return time_constant_s;
}

}  // namespace alula::flight
