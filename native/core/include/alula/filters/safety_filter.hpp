// Protocol of all safety filters: estimate and nominal command in, checked command out.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "alula/dynamics/disturbance.hpp"
#include "alula/dynamics/quadrotor.hpp"
#include "alula/dynamics/racer.hpp"
#include "alula/filters/geofence.hpp"
#include "alula/filters/moving_filter.hpp"
#include "alula/filters/options.hpp"
#include "alula/geometry/ellipsoid_index.hpp"
#include "alula_avoidance.h"

namespace alula::flight {

// The values of `alula_filter_status` in native/onboard, and one more.
enum class SafetyStatus : std::uint8_t {
  ok = 0,          // the nominal input satisfies all rows and is returned bit by bit
  filtered = 1,    // the nearest input that satisfies all rows
  shortened = 2,   // filtered, and scaled down so that the held step stays clear; of velocities only
  recovering = 3,  // no safe input was found: best effort, reported as unsafe
  refused = 4,     // non-finite input, or the solver has no verdict: hover, zero acceleration or zero velocity
  backup = 5       // the backup policy is flown
};

// Vehicle state of a filter; thrust and its rate are the last applied values.
struct FlightState {
  State x;
  Level level;             // of what its attitude accounts for: the true acceleration by that of the model
  double thrust = 0;       // T [N]
  double thrust_rate = 0;  // T' [N/s]
  // Thrust of each rotor now [N], for a shield with a motor time constant; without a value the rotors hover.
  std::optional<Vec4> rotors;
  // What moves, predicted to now, as a tracker estimates it.
  std::span<const alula_track> tracks;
  Vec3 position_variance;  // of the estimate x.p, per axis [m^2]
  // Acceleration that the model leaves out, as estimated where the state does not account for it [m/s^2]; see
  // response.hpp. Of accelerations the command that is sent counters it, so only filters of velocities use it.
  Vec3 disturbance;
  // What it may be in addition, beyond what noise makes [m/s^2]; see disturbance.hpp.
  double disturbance_bound = 0;
  // Distance by which position and velocity contradict each other [m]: what the position has moved in a window of
  // time, less the velocity integrated over it. Which of both is wrong is not known.
  double slip_m = 0;
  double more_margin_m = 0;  // of velocities: margin to keep in addition, where there is that room
  bool is_known = true;      // false: there is no navigation, and the state means nothing
  // Of a racing quadrotor: the attitude x.sigma as its unit quaternion w, x, y, z, where that is known to all bits.
  std::optional<Vec4> attitude;
};

// What margins grow by, one law for all filters [m]: `way_before_reaction` of the disturbance, and the slip. If the
// position is what is wrong, the vehicle is that far from where it was seen to come from. If it is the velocity,
// wrong by slip / window, a point of rest that is predicted over a time up to the window is off by no more.
inline double added_margin(const FlightState& state) {
  return way_before_reaction(state.disturbance_bound) + state.slip_m;
}
inline double added_margin(const FlightState& state, double lag_s) {
  return way_before_reaction(state.disturbance_bound, lag_s) + state.slip_m;
}

// The state as filters among moving obstacles read it.
alula_vehicle_state vehicle_state_of(const FlightState& state);

// Nominal input of the tracking controller, and its tracking errors. A filter reads the command of its kind.
struct Nominal {
  Vec3 velocity;                                    // [m/s]
  Vec3 acceleration;                                // of the translation: a_r - (K_p e_p + K_v e_v) / m [m/s^2]
  Wrench wrench;                                    // T and tau of the geometric controller
  double thrust_rate = 0, thrust_acceleration = 0;  // T', T'' of the same
  Vec3 position_error, velocity_error, reference_acceleration;  // e_p, e_v, a_r, for the CLF row
  std::optional<RacerCommand> sticks;                           // throttle and body rates; without a value: silent
};

// Kinds of commands, from the outermost loop of a vehicle to the innermost.
enum class CommandKind : std::uint8_t { velocity, acceleration, wrench, sticks };

struct FilterReport {
  SafetyStatus status = SafetyStatus::refused;
  Vec3 velocity;           // for CommandKind::velocity
  Vec3 acceleration;       // for CommandKind::acceleration
  Wrench wrench;           // for CommandKind::wrench
  double thrust_rate = 0;  // T' at the end of the tick, for CommandKind::wrench
  RacerCommand sticks;     // for CommandKind::sticks
  double margin =
      0;  // the filter's own barrier: minimum of h over the rows, or h_b for cone-backup; infinite without rows
  // Ellipsoid of the row with the largest multiplier; from the size of the index on, that size plus the number of an
  // obstacle in the second map of the rows.
  std::int64_t active = -1;
  // Values for the log.
  double gate_m = 0;              // distance gate of this tick
  std::uint32_t candidates = 0;   // ellipsoids within the gate, at most k
  std::uint32_t rows = 0;         // barrier rows of the program
  std::uint32_t iterations = 0;   // of the program
  bool capped = false;            // the cap k excluded ellipsoids within the gate
  bool infeasible = false;        // the program has no solution
  bool certified = false;         // the returned input was checked to leave a safe backup manoeuvre
  bool certified_moving = false;  // that manoeuvre is also clear of the tubes of all tracks, as far as they reach
  std::optional<MovingReport> moving;   // of a filter among moving obstacles
  std::optional<double> solve_time_s;   // measured by the filter itself; without a value by its caller
  std::optional<GeofenceReport> fence;  // of a filter of sticks
};

// One per thread. `filter` returns only inputs that it has checked and that are finite.
class SafetyFilter {
 public:
  virtual ~SafetyFilter() = default;
  virtual CommandKind kind() const = 0;  // of the command that it changes and returns
  virtual FilterReport filter(const FlightState& state, const Nominal& nominal) = 0;
  // Reports the acceleration that is flown when it is not the returned one; the next tick uses it.
  virtual void flown(Vec3 /*acceleration*/) {}
  virtual void reset() {}  // before another flight: clear warm starts and commitments
  virtual std::unique_ptr<SafetyFilter> clone() const = 0;
  virtual bool shares_state() const { return false; }  // with its clones: flights must run in one thread
};

}  // namespace alula::flight
