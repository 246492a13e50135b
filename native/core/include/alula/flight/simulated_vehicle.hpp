// Simulated vehicles behind one interface: points, quadrotors and racing quadrotors, by any of their commands.
//
//   model                interfaces                                       equations
//   single integrator    velocity                                         p' = u, |u| limited
//   double integrator    acceleration, velocity                           p' = v, v' = a; EncounterPlant where
//   limited quadrotor            wrench, body rates with thrust,                  Plant: rigid body, rotors, air
//                        acceleration, velocity
//   racer                sticks                                           Racer: thrust by throttle, rate loop
//
// A command beyond what a plant takes itself is followed by the vehicle's own cascade: velocity to acceleration by
// the gain, acceleration to attitude and thrust by the tracking controller, in each tick from the true state, as an
// autopilot does with its own estimate. With `following`, velocities and accelerations are shaped first, in each step
// of the plant (autopilot.hpp).
#pragma once

#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "alula/dynamics/plant.hpp"
#include "alula/dynamics/racer.hpp"
#include "alula/dynamics/tracking_controller.hpp"
#include "alula/flight/autopilot.hpp"
#include "alula/flight/encounter_plant.hpp"

namespace alula::flight {

enum class VehicleModel : std::uint8_t { single_integrator, double_integrator, quadrotor, racer };

// Commands that a vehicle takes, from the outermost loop to the innermost.
enum class Interface : std::uint8_t { velocity, acceleration, wrench, body_rates, sticks };

// A command for one tick; the member of its interface counts.
struct Command {
  Interface interface = Interface::velocity;
  Vec3 velocity;      // [m/s]
  Vec3 acceleration;  // [m/s^2]
  Wrench wrench;      // thrust also of body rates [N, N m]
  Vec3 rates;         // [rad/s]
  RacerCommand sticks;
  double yaw = 0;  // to hold, for velocities and accelerations [rad]
};

bool is_finite(const Command& command);

struct VehicleSpec {
  VehicleModel model = VehicleModel::quadrotor;
  Interface interface = Interface::wrench;
  Quadrotor body;            // of a point: any
  TrackingGains gains;       // of the tracking controller, on board and in the simulation
  PlantOptions plant;        // true: lag, air, noise and delay of measurements
  ActuatorModel assumed;     // by controller and filters
  Vec3 max_rate{10, 10, 4};  // limit of a commanded body rate [rad/s]
  Vec3 rate_time_constant_s{0.02, 0.02,
                            0.02};   // of the rate loop, a first-order lag of each axis within the rotors' limits
  double velocity_gain = 2;          // of the velocity loop, a = gain (u - v) [1/s]
  FollowingOptions following;        // of a quadrotor by velocities or accelerations, as an autopilot flies it
  geometry::PerAxis velocity_lag_s;  // assumed time constants of a vehicle that follows velocities; 0: at once
  double max_speed = std::numeric_limits<double>::infinity();         // of velocity commands, and of points [m/s]
  double max_acceleration = std::numeric_limits<double>::infinity();  // of points [m/s^2]
  double max_jerk = std::numeric_limits<double>::infinity();          // of a double integrator [m/s^3]
  double actuation_delay_s = 0;                                       // of a double integrator
  double radius_m = 0;
  RacerModel racer;  // thrust by throttle, for sticks
  RacerOptions racer_options;
  double mass_scale = 1, rate_gain_scale = 1;  // true mass and inertia, and rate loop, over those of the model
};

// Throws std::invalid_argument where the model does not take the interface, or a number is out of range.
void check(const VehicleSpec& spec);

// A double integrator with limits of jerk, speed or delay, whose limit of the acceleration is per axis; else it is of
// the norm.
inline bool has_inner_limits(const VehicleSpec& spec) {
  return std::isfinite(spec.max_jerk) || std::isfinite(spec.max_speed) || spec.actuation_delay_s > 0;
}

// The acceleration of the velocity loop, limited.
Vec3 velocity_loop(const VehicleSpec& spec, Vec3 commanded, Vec3 v);

// The gains of the tracking controller when it holds a velocity.
inline TrackingGains holding(const VehicleSpec& spec) {
  TrackingGains gains = spec.gains;
  gains.kv = spec.velocity_gain;
  return gains;
}

// The reference of the tracking controller for a velocity to hold from here.
inline ReferencePoint reference_for(Vec3 p, Vec3 velocity, double yaw) {
  ReferencePoint point;
  point.p = p, point.v = velocity, point.yaw = yaw;
  return point;
}

// One flight; a function of the commands, the seed and the trial. Not thread-safe.
class SimulatedVehicle {
 public:
  SimulatedVehicle(const VehicleSpec& spec, double dt_s, int plant_steps, const RandomStream& random);

  // `attitude`: of a racer, the quaternion of x.sigma to all bits.
  void reset(const State& x, const std::optional<Vec4>& attitude = {});
  void command(const Command& command);  // for the tick that begins
  void step();                           // of the plant: plant_steps in a tick
  void end_tick();                       // switches the attitude to |sigma| <= 1

  const State& state() const { return x_; }
  Vec3 acceleration() const;
  State measured() const;
  // Of a racing quadrotor.
  const RacerState& racer() const { return racer_.state(); }
  std::optional<Vec4> attitude_of(const State& measured) const;  // where nothing disturbed the attitude
  Kinematics kinematics() const { return {x_.p, x_.v, acceleration()}; }

 private:
  Wrench wrench_of_rates() const;
  Wrench wrench_of_acceleration(Vec3 a) const;
  bool is_shaped() const { return spec_.following.is_on() && command_.interface < Interface::wrench; }

  const VehicleSpec& spec_;
  double h_;
  Plant body_;
  DoubleIntegrator point_;
  EncounterPlant limited_;
  Racer racer_;
  Sensor sensor_;
  Autopilot autopilot_;
  bool is_limited_ = false;  // a double integrator with limits of jerk, speed or delay
  Command command_;
  Wrench held_;
  State x_;
  Vec3 point_acceleration_;
  double time_ = 0;
  std::uint64_t steps_ = 0;
};

}  // namespace alula::flight
