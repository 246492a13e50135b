// Metrics of encounters with moving obstacles, and of the filter that avoids them.
//
// They use the true states, between steps too: within a step of the plant the vehicle's acceleration is constant, and
// the relative motion is approximated by a parabola.
//
// Source: Mandaokar, Rinner 2025 (DR-ACBF, arXiv 2512.00462), section IV-A.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "alula/filters/safety_filter.hpp"
#include "alula/flight/encounter_watch.hpp"
#include "alula/flight/moving_world.hpp"

namespace alula::flight {

// Metrics of one obstacle in a flight.
struct EncounterMetrics {
  static constexpr double kNever = std::numeric_limits<double>::quiet_NaN();

  double closest_m = std::numeric_limits<double>::infinity();  // min |P| over the run, centre to centre
  double separation_m = kNever;  // min |P| from its warning to the end of HOVER, or of the run
  double closing_m_s = kNever;   // true closing speed at its warning
  double detected_s = kNever;    // first time at which a confirmed track is near it
  double warned_s = kNever;      // first warning in which it is the most urgent obstacle
  double command_s = kNever;     // wall time of the filter in that tick, at least t_cm: not reproducible
  double reaction_s = kNever;    // simulated time from the warning until |a - a_nominal| > 0.05 (t_r minus t_cm)
  double avoid_s = kNever;       // from there to the end of HOVER (t_a)
};

// Metrics of a flight. All but `obstacle` are those of its last filter among moving obstacles, and 0 without one.
struct EncounterLog {
  std::vector<EncounterMetrics> obstacle;
  // Active: in a manoeuvre, or warned. Filtered: the command is not the nominal.
  std::int64_t active_ticks = 0, filtered_ticks = 0, infeasible_ticks = 0, recovering_ticks = 0, refused_ticks = 0,
               iterations = 0;
  double worst_violation = 0;  // maximum row violation of the flown commands, as an acceleration [m/s^2]
  double risk_spent = 0;       // sum over ticks of the remaining risk: bound on the probability that any row fails
  // Sum over consecutive windows and tracks of the largest `risk_of` (encounter_watch.hpp) in each. It is not a
  // bound: other ticks of a window could fail too, and obstacles are assumed to keep their velocity.
  double mission_risk = 0;
  std::vector<float> active_tick_s;  // processing time of each active tick (t_cp): not reproducible
};

// Collects the metrics of one flight.
class EncounterRecorder {
 public:
  // risk_window_s: window of `mission_risk`, the assumed duration of a command.
  EncounterRecorder(double radius_m, double risk_window_s, double dt_s) : radius_(radius_m) {
    risk_.reset(risk_window_s, dt_s);
  }

  void begin(std::size_t obstacles);
  // The confirmed tracks at a time.
  void track(double now, const MovingWorld& world);
  // The answer of the filter to the state that it saw; `command` is what is flown, `vehicle` the truth.
  void answer(const MovingReport& report, const FlightState& seen, Vec3 command, Vec3 nominal, double now,
              double took, const MovingWorld& world, const Kinematics& vehicle);
  // A step of the plant: the vehicle before and after it. The obstacles have moved.
  void advance(const Kinematics& before, const Kinematics& after, double h, const MovingWorld& world);

  EncounterLog finish();

 private:
  struct Window {  // from the warning of an obstacle to the end of the manoeuvre
    bool is_open = false;
    double reacted_s = EncounterMetrics::kNever;
  };
  double radius_;
  std::vector<Window> window_;
  RiskWindows risk_;
  EncounterLog log_;
};

}  // namespace alula::flight
