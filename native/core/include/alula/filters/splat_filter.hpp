// Protocol of the filters among ellipsoids: state and nominal input in, checked input out.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "alula/dynamics/quadrotor.hpp"
#include "alula/filters/options.hpp"
#include "alula/geometry/ellipsoid_index.hpp"

namespace alula::flight {

// The values of `alula_filter_status` in native/onboard, and one more.
enum class SplatFilterStatus : std::uint8_t {
  ok = 0,          // the nominal input satisfies all rows and is returned bit by bit
  filtered = 1,    // the nearest input that satisfies all rows
  recovering = 3,  // no safe input was found: best effort, reported as unsafe
  refused = 4,     // non-finite input, or the solver has no verdict: hover or zero acceleration
  backup = 5       // the backup policy is flown
};

// Vehicle state of a filter; thrust and its rate are the last applied values.
struct FlightState {
  State x;
  double thrust = 0;       // T [N]
  double thrust_rate = 0;  // T' [N/s]
  // Thrust of each rotor now [N], for a shield with a motor time constant; without a value the rotors hover.
  std::optional<Vec4> rotors;
};

// Nominal input of the tracking controller, and its tracking errors.
struct Nominal {
  Vec3 acceleration;                                // of the translation: a_r - (K_p e_p + K_v e_v) / m [m/s^2]
  Wrench wrench;                                    // T and tau of the geometric controller
  double thrust_rate = 0, thrust_acceleration = 0;  // T', T'' of the same
  Vec3 position_error, velocity_error, reference_acceleration;  // e_p, e_v, a_r, for the CLF row
};

enum class InputKind : std::uint8_t { acceleration, wrench };

struct FilterReport {
  SplatFilterStatus status = SplatFilterStatus::refused;
  Vec3 acceleration;       // for InputKind::acceleration
  Wrench wrench;           // for InputKind::wrench
  double thrust_rate = 0;  // T' at the end of the tick, for InputKind::wrench
  double margin =
      0;  // the filter's own barrier: minimum of h over the rows, or h_b for cone-backup; infinite without rows
  std::int64_t active = -1;  // ellipsoid of the row with the largest multiplier
  // Values for the log.
  double gate_m = 0;             // distance gate of this tick
  std::uint32_t candidates = 0;  // ellipsoids within the gate, at most k
  std::uint32_t rows = 0;        // barrier rows of the program
  std::uint32_t iterations = 0;  // of the program
  bool capped = false;           // the cap k excluded ellipsoids within the gate
  bool infeasible = false;       // the program has no solution
  bool certified = false;        // the returned input was checked to leave a safe backup manoeuvre
};

// One per thread. `filter` returns only inputs that it has checked and that are finite.
class SplatFilter {
 public:
  virtual ~SplatFilter() = default;
  virtual InputKind kind() const = 0;
  virtual FilterReport filter(const FlightState& state, const Nominal& nominal) = 0;
  virtual void reset() {}  // before another flight: clear warm starts and commitments
  virtual std::unique_ptr<SplatFilter> clone() const = 0;
};

}  // namespace alula::flight
