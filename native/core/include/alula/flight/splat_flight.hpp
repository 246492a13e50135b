// Closed loop of a rigid body, or of a double integrator, that follows a reference among ellipsoids.
//
// A tick of dt: the controller looks at the measured state and the reference, the filter changes what it asks
// for, and the vehicle flies the result, held, in steps of the plant. Obstacles are not known here but to the
// filter: whether a flight collided is judged afterwards, so a collision does not end it.
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
#include "alula/filters/splat_filter.hpp"
#include "alula/flight/rollout.hpp"

namespace alula::flight {

enum class PlantKind : std::uint8_t {
  quadrotor,         // the rigid body; accelerations are flown through the attitude loop
  double_integrator  // p' = v, v' = a with a held: takes accelerations only, exactly
};

// What the vehicle is told: the wrench itself, or body rates that its own loop follows.
enum class CommandInterface : std::uint8_t { wrench, body_rates };

struct FlightRules {
  double dt_s = 0.01;              // a tick of controller and filter
  std::int64_t plant_steps = 10;   // of the plant in a tick
  double stop_fraction = 0.01;     // reached within this part of the start-goal distance,
  double stop_floor_m = 0.05;      // or within this,
  double stop_speed = 0.1;         // slower than this, with the reference at its end [m/s]
  double stuck_speed = 0.02;       // stuck: slower than this and further than that from the reference
  std::int64_t stuck_ticks = 200;  // for so long
  double time_factor = 3;          // timeout: so many durations of the reference,
  double max_time_s = 0;           // or this, when above 0
  Vec3 lower{-1e9, -1e9, -1e9};    // a flight that leaves this box is refused
  Vec3 upper{1e9, 1e9, 1e9};
};

// Everything that flies but the filter.
struct FlightVehicle {
  Quadrotor body;
  TrackingGains gains;
  PlantOptions plant;
  PlantKind kind = PlantKind::quadrotor;
  CommandInterface interface = CommandInterface::wrench;
  Vec3 max_rate{10, 10, 4};            // limit of a commanded body rate [rad/s]
  double rate_time_constant_s = 0.02;  // of the vehicle's own rate loop, a first-order lag where the rotors allow it
  double max_acceleration = std::numeric_limits<double>::infinity();  // of the double integrator [m/s^2]
  // What controller and filters take the rigid body for; `plant` says what it is. With a delay they see the state
  // that is predicted for now. Of the rotors' thrusts they have the model's, never the plant's.
  ActuatorModel assumed;
};

// A row per tick, of the time at its beginning unless said otherwise; `state` has one more, the end.
struct SplatFlightLog {
  std::vector<double> position;      // (ticks * plant_steps + 1, 3): the path, at the rate of the plant [m]
  std::vector<double> state;         // (ticks + 1, 12): p, sigma, v, omega
  std::vector<double> a_nominal;     // (ticks, 3): what the controller asked for [m/s^2]
  std::vector<double> a_command;     // (ticks, 3): what the filter let through [m/s^2]
  std::vector<double> a_error;       // (ticks): largest |a - a_command| within the tick, at the rate of the plant
  std::vector<double> u_nominal;     // (ticks, 4): T and tau of the controller [N, N m]
  std::vector<double> u;             // (ticks, 4): as commanded, within the limits of the rotors
  std::vector<double> rotor_thrust;  // (ticks, 4) [N]
  std::vector<double> margin;        // (ticks): FilterReport, from here on
  std::vector<double> gate_m;
  std::vector<std::int64_t> active;
  std::vector<std::uint32_t> candidates, rows, iterations;
  std::vector<std::uint8_t> status, flags;  // flags: 1 capped, 2 infeasible, 4 certified, 8 not what the rotors can
  std::vector<float> filter_s, tick_s;      // measured: the filter alone; controller and filter
  Outcome outcome = Outcome::flying;
  std::size_t ticks() const { return status.size(); }
};

// One flight, a tick at a time: filter nominal() at state(), then advance() with the answer.
//
// It starts at the reference's beginning with its velocity, level, with its yaw. For accelerations `a_command`
// is the filter's, flown by `realise`; for wrenches it is -g e3 + T / m R^T e3 of the filter's T along the true
// axis, so that `a_error` is what the rotors and the air withhold.
//
// A guide is a filter of accelerations that bends what the controller asks for before the filter sees it, through
// the controller's own attitude loop. Nothing rests on it but where the vehicle goes.
class FlightTrial {
 public:
  // `seed` and `trial` are of the plant's noise; `guide` is cloned, or null. Throws std::invalid_argument when a
  // rule means nothing or the guide does not give accelerations.
  FlightTrial(const FlightVehicle& vehicle, const FlightRules& rules, const ReferenceCurve& reference,
              std::uint64_t seed, std::uint32_t trial, const SplatFilter* guide = nullptr);

  const FlightState& state() const { return seen_; }
  const Nominal& nominal() const { return nominal_; }
  Outcome outcome() const { return log_.outcome; }
  double time_s() const { return static_cast<double>(log_.ticks()) * rules_.dt_s; }

  // What stands for a filter's answer without one: the nominal acceleration, or the wrench.
  FilterReport unfiltered() const;

  // Flies the answer for a tick; `filter_s` is how long the filter took, to which the guide's time is added.
  Outcome advance(const FilterReport& answer, InputKind kind, double filter_s);

  SplatFlightLog& log() { return log_; }

 private:
  bool is_rigid() const { return vehicle_.kind == PlantKind::quadrotor; }
  void observe();
  double fly(const FilterReport& answer, InputKind kind, const Wrench& flown, const Wrench& led);
  Outcome judged(SplatFilterStatus status);

  FlightVehicle vehicle_;
  FlightRules rules_;
  const ReferenceCurve& reference_;
  Plant body_;  // one of the two flies
  DoubleIntegrator point_;
  StatePredictor predictor_;
  State x_;  // the true state
  ReferencePoint target_;
  FlightState seen_;
  Nominal nominal_;
  Vec3 goal_;
  std::unique_ptr<SplatFilter> guide_;
  double stop_distance_, controller_s_ = 0, guide_s_ = 0;
  bool is_other_ = false;  // whether the thrust that is flown is not the controller's
  std::int64_t max_ticks_, still_ = 0;
  SplatFlightLog log_;
};

// Flies every reference behind clones of `guide` and `filter`, each of which may be null, on `jobs` threads. All but
// the measured times is independent of `jobs`; trial i has the number `first_trial` + i.
std::vector<SplatFlightLog> fly(const FlightVehicle& vehicle, const FlightRules& rules,
                                std::span<const ReferenceCurve> references, const SplatFilter* filter,
                                const SplatFilter* guide, std::uint64_t seed, std::uint32_t first_trial,
                                unsigned jobs, Control& control);

// Least gamma = r^T A r - 1, r = centre - p, over all grown ellipsoids and the points (3 numbers each): below 0
// inside one; infinite without ellipsoids or points. Exact up to rounding; visits each ellipsoid once per 64 points.
double least_gamma(const EllipsoidIndex& index, std::span<const double> points);

}  // namespace alula::flight
