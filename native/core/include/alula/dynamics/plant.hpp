// The simulated plants: the bodies of the filters' models with disturbances, which are off by default.
//
// The result of a call is a function of the state, the command, the seed, the trial and the number of the step,
// never of the clock. Not thread-safe: one plant per flight.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "alula/base/random.hpp"
#include "alula/dynamics/actuators.hpp"
#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

// Measurement of a state: a delay, and noise with these standard deviations per axis. It is white, unless the errors
// of position and velocity have a correlation time: then they are first-order Gauss-Markov processes, as an
// estimator's.
struct SensorOptions {
  double position_noise_m = 0, velocity_noise_m_s = 0;
  double attitude_noise_rad = 0;  // of a random rotation vector about the body's axes
  double rate_noise_rad_s = 0;
  double noise_time_s = 0;  // correlation time of the errors of position and velocity; 0: white
  double delay_s = 0;       // the state this long ago is measured; the first state until there is one
};

// Throws std::invalid_argument for a number that is negative or not finite.
void check(const SensorOptions& options);

// The past states of a flight, for the sensor's delay. The ring buffer grows until it spans the delay.
class Sensor {
 public:
  Sensor(const SensorOptions& options, RandomStream random);

  void reset(const State& x);
  void record(double time, const State& x);  // after each step
  State measured(std::uint64_t step) const;  // repeatable: equal for equal steps

 private:
  struct Sample {
    double time;
    State x;
  };
  State delayed() const;
  Sample& at(std::size_t i) { return ring_[(oldest_ + i) % ring_.size()]; }
  const Sample& at(std::size_t i) const { return ring_[(oldest_ + i) % ring_.size()]; }

  SensorOptions options_;
  RandomStream random_;
  std::vector<Sample> ring_;
  std::size_t oldest_ = 0, count_ = 0;
  Vec3 position_error_, velocity_error_;  // of unit variance,
  std::uint64_t steps_ = 0;               // of these steps
  double time_ = 0;
};

struct PlantOptions {
  // Each rotor's thrust follows its command, f' = (f_command - f) / time constant; 0: at once.
  double motor_time_constant_s = 0;
  // F = -R^T (linear + quadratic |w|) w, componentwise on the air speed w = R (v - wind) [N s/m, N s^2/m^2].
  Vec3 linear_drag, quadratic_drag;
  // The wind is constant plus gusts of this standard deviation per axis, a first-order Gauss-Markov process
  // (stationary from the start, held within a step). It acts through drag only.
  Vec3 wind_m_s, gust_m_s;
  double gust_time_s = 1;
  SensorOptions sensor;
};

// Throws std::invalid_argument for a number out of range.
void check(const PlantOptions& options);

// A quadrotor. The rotors' limits always hold: a command beyond them is clipped rotor by rotor. Without
// options and within the limits a step is `Quadrotor::step`, bit by bit. A command that is not finite is
// ignored: the rotors keep the last command, initially hovering.
class Plant {
 public:
  Plant(const Quadrotor& quadrotor, const PlantOptions& options = {}, RandomStream random = {});

  void reset(const State& x);  // hovering rotors, time and step 0
  void step(double dt, const Wrench& command);
  void switch_shadow();  // to |sigma| <= 1; between control ticks only

  const State& state() const { return x_; }
  State measured() const { return sensor_.measured(steps_); }  // repeated calls give the same value
  const Wrench& wrench() const { return wrench_; }             // current wrench of the rotors
  double thrust() const { return wrench_.thrust; }
  Vec3 acceleration() const { return derivative(x_, wrench_).v; }
  Vec3 wind() const { return options_.wind_m_s + gust_; }  // [m/s]
  double time() const { return time_; }
  std::uint64_t steps() const { return steps_; }

 private:
  State derivative(const State& x, const Wrench& u) const;

  Quadrotor quadrotor_;
  PlantOptions options_;
  RandomStream random_;
  Sensor sensor_;
  bool has_drag_, has_gusts_;
  State x_;
  Wrench wrench_, command_;
  Vec4 rotor_{};  // thrusts now [N]
  Vec3 gust_;
  double time_ = 0;
  std::uint64_t steps_ = 0;
};

// p' = v, v' = a with a held: exact in a step. An acceleration beyond the limit is scaled down to it. One that
// is not finite is replaced by the last one, initially 0. Attitude and rates of the state stay 0.
class DoubleIntegrator {
 public:
  explicit DoubleIntegrator(double max_acceleration = std::numeric_limits<double>::infinity(),
                            const SensorOptions& sensor = {}, RandomStream random = {});

  void reset(const State& x);
  void step(double dt, Vec3 acceleration);

  const State& state() const { return x_; }
  State measured() const { return sensor_.measured(steps_); }
  Vec3 acceleration() const { return acceleration_; }
  double time() const { return time_; }
  std::uint64_t steps() const { return steps_; }

 private:
  double max_acceleration_;
  Sensor sensor_;
  State x_;
  Vec3 acceleration_;
  double time_ = 0;
  std::uint64_t steps_ = 0;
};

}  // namespace alula::flight
