// Closed loop of a rigid body, or of a double integrator, that follows a reference among ellipsoids.
//
// In each tick of dt, the controller uses the measured state and the reference, the filter changes the nominal
// command, and the vehicle flies the result, held, in steps of the plant. Only the filter has the obstacles.
// Collisions are judged afterwards, so a collision does not end a flight.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/dynamics/plant.hpp"
#include "alula/dynamics/state_predictor.hpp"
#include "alula/dynamics/tracking_controller.hpp"
#include "alula/filters/safety_filter.hpp"

namespace alula::flight {

enum class Outcome : std::uint8_t { flying, reached, stuck, timeout, refused };

enum class PlantKind : std::uint8_t {
  quadrotor,         // the rigid body; accelerations are flown through the attitude loop
  double_integrator  // p' = v, v' = a with a held: takes accelerations only, exactly
};

// Commands sent to the vehicle: the wrench itself, or body rates that the vehicle's rate loop follows.
enum class CommandInterface : std::uint8_t { wrench, body_rates };

struct FlightRules {
  double dt_s = 0.01;                 // a tick of controller and filter
  std::int64_t plant_steps = 10;      // of the plant in a tick
  std::int64_t controller_ticks = 1;  // the nominal command of the controller is held for this many ticks,
  std::int64_t filter_ticks = 1;   // and the filter's input for this many; an acceleration waits for the controller
  double stop_fraction = 0.01;     // goal reached: within this fraction of the start-goal distance,
  double stop_floor_m = 0.05;      // or within this distance,
  double stop_speed = 0.1;         // and slower than this, with the reference at its end [m/s]
  double stuck_speed = 0.02;       // stuck: slower than this, and outside the stop distance from the reference,
  std::int64_t stuck_ticks = 200;  // for this many ticks
  double time_factor = 3;          // timeout: this multiple of the reference's duration,
  double max_time_s = 0;           // or this time, when above 0
  Vec3 lower{-1e9, -1e9, -1e9};    // a flight that leaves this box is refused
  Vec3 upper{1e9, 1e9, 1e9};
};

// The vehicle with its controller: all of the closed loop except the filter.
struct FlightVehicle {
  Quadrotor body;
  TrackingGains gains;
  PlantOptions plant;
  PlantKind kind = PlantKind::quadrotor;
  CommandInterface interface = CommandInterface::wrench;
  Vec3 max_rate{10, 10, 4};            // limit of a commanded body rate [rad/s]
  double rate_time_constant_s = 0.02;  // of the vehicle's rate loop, a first-order lag within the rotors' limits
  double max_acceleration = std::numeric_limits<double>::infinity();  // of the double integrator [m/s^2]
  // The actuator model that controller and filters assume; `plant` is the true one. With a delay they receive the
  // predicted current state. Their rotor thrusts are always the model's, never the plant's.
  ActuatorModel assumed;
};

// A row per tick, for the time at its beginning unless stated otherwise; `state` has one more row, the end.
struct SplatFlightLog {
  std::vector<double> position;      // (ticks * plant_steps + 1, 3): the path, at the rate of the plant [m]
  std::vector<double> state;         // (ticks + 1, 12): p, sigma, v, omega
  std::vector<double> a_nominal;     // (ticks, 3): nominal acceleration of the controller [m/s^2]
  std::vector<double> a_command;     // (ticks, 3): filtered acceleration [m/s^2]
  std::vector<double> a_error;       // (ticks): largest |a - a_command| within the tick, at the rate of the plant
  std::vector<double> u_nominal;     // (ticks, 4): T and tau of the controller [N, N m]
  std::vector<double> u;             // (ticks, 4): the command, within the limits of the rotors
  std::vector<double> rotor_thrust;  // (ticks, 4) [N]
  std::vector<double> margin;        // (ticks): FilterReport, from here on
  std::vector<double> gate_m;
  std::vector<std::int64_t> active;
  std::vector<std::uint32_t> candidates, rows, iterations;
  std::vector<std::uint8_t> status, flags;  // flags: 1 capped, 2 infeasible, 4 certified, 8 beyond the rotors' limits
  std::vector<float> filter_s, tick_s;      // measured times: the filter alone; controller and filter
  Outcome outcome = Outcome::flying;
  std::size_t ticks() const { return status.size(); }
};

// One flight, a tick at a time: filter nominal() at state(), then advance() with the filter's report.
//
// It starts at the reference's beginning with its velocity, level, with its yaw. The commanded acceleration of a tick
// is the filter's own, flown by `realise`, or for a wrench -g e3 + T / m R^T e3 of its T along the axis that the
// filter saw. Both are held for the tick, so `a_error` is FastBridge's realisation error (eq. 11-12) for every
// filter: what attitude, rotors and air leave of the command, and for a wrench the turn of the axis before the next
// command.
//
// A guide is a filter of accelerations that changes the nominal command before the filter, through
// the controller's own attitude loop. It only affects the path, not safety.
class FlightTrial {
 public:
  // `seed` and `trial` are of the plant's noise; `guide` is cloned, or null. Throws std::invalid_argument when a
  // rule means nothing or the guide does not give accelerations.
  FlightTrial(const FlightVehicle& vehicle, const FlightRules& rules, const ReferenceCurve& reference,
              std::uint64_t seed, std::uint32_t trial, const SafetyFilter* guide = nullptr);

  const FlightState& state() const { return seen_; }
  const Nominal& nominal() const { return nominal_; }
  Outcome outcome() const { return log_.outcome; }
  double time_s() const { return static_cast<double>(log_.ticks()) * rules_.dt_s; }
  // Whether the filter runs in this tick; in the others its last report is flown again.
  bool is_filtered() const { return is_turn(rules_.filter_ticks); }

  // The report that replaces a filter's when there is none: the nominal acceleration, or the wrench.
  FilterReport unfiltered() const;

  // Flies the filter's report for a tick; `filter_s` is the filter's time, to which the guide's time is added.
  Outcome advance(const FilterReport& answer, CommandKind kind, double filter_s);

  SplatFlightLog& log() { return log_; }

 private:
  bool is_rigid() const { return vehicle_.kind == PlantKind::quadrotor; }
  bool is_turn(std::int64_t ticks) const { return static_cast<std::int64_t>(log_.ticks()) % ticks == 0; }
  void observe();
  void renew(const FilterReport& answer, CommandKind kind);
  double fly(const Wrench& led);
  Outcome judged(SafetyStatus status);

  FlightVehicle vehicle_;
  FlightRules rules_;
  const ReferenceCurve& reference_;
  Plant body_;  // only one of the two is used
  DoubleIntegrator point_;
  StatePredictor predictor_;
  State x_;  // the true state
  ReferencePoint target_;
  FlightState seen_;
  Nominal nominal_;
  Wrench flown_;          // the command, held until the next one, and what it means:
  Vec3 command_, rates_;  // its acceleration and, for the interface body_rates, its rates
  bool is_limited_ = false;
  Vec3 goal_;
  std::unique_ptr<SafetyFilter> guide_;
  double stop_distance_, controller_s_ = 0, guide_s_ = 0;
  bool is_other_ = false;  // the applied thrust differs from the controller's
  std::int64_t max_ticks_, still_ = 0;
  SplatFlightLog log_;
};

// Flies every reference with clones of `guide` and `filter`, each of which may be null, on `jobs` threads. All but
// the measured times is independent of `jobs`; trial i has the number `first_trial` + i.
std::vector<SplatFlightLog> fly(const FlightVehicle& vehicle, const FlightRules& rules,
                                std::span<const ReferenceCurve> references, const SafetyFilter* filter,
                                const SafetyFilter* guide, std::uint64_t seed, std::uint32_t first_trial,
                                unsigned jobs, Control& control);

}  // namespace alula::flight
