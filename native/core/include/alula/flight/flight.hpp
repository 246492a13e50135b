// A flight as the computer on board sees it: measurements in, commands out, a tick at a time.
//
// The simulation calls it for thousands of trials, and `fly` with the measurements of a link, so what was simulated
// is what flies. In each tick:
//
//   observe   the newest measurement, if one arrived, is predicted to now; tracks of what moves are taken as they are
//   decide    mission -> nominal command -> the filters in their order, each with the command of the one before it ->
//             command of the vehicle's interface
//   sent      the command that the vehicle got for this tick: the decided one, or another one, if a fence behind it
//             had the last word. Predictions and filters go on from it; without it, nothing was sent.
//
// Commands go from the outermost loop of the vehicle to the innermost, and so do the filters: velocities, then
// accelerations, then wrenches, then sticks. Between two kinds stands one cascade: a velocity is held by the tracking
// controller (of a double integrator: by a gain), an acceleration flown through its attitude loop, a wrench turned
// into body rates or, by the map of the throttle, into sticks. The last filter is what is certified.
//
// A refused command is never flown: braking, rest or hovering stands in its place until the next filter. When the
// last filter refuses, or the state is older than `stale_s`, the decision says so.
//
// A vehicle that follows velocities or accelerations itself is predicted from the commands that it got: a velocity u
// with the lag tau of that loop, v = u + (v_0 - u) exp(-t / tau), so that p + tau v moves by u t. For a time with no
// such command its velocity counts as constant.
//
// Of a quadrotor that is commanded by wrenches or body rates, what its model leaves out can be estimated
// (disturbance.hpp). Controller and filters then see the attitude, and give the thrust, for which the disturbance
// vanishes; command and prediction have the true ones. Of a quadrotor that follows velocities or accelerations itself
// it is estimated from its response (response.hpp): a commanded acceleration is sent less the estimate, and filters
// of velocities take it into account (chord_filter.hpp).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "alula/dynamics/disturbance.hpp"
#include "alula/dynamics/response.hpp"
#include "alula/dynamics/state_predictor.hpp"
#include "alula/filters/safety_filter.hpp"
#include "alula/flight/plan_clock.hpp"
#include "alula/flight/simulated_vehicle.hpp"
#include "alula/planning/reference_curve.hpp"

namespace alula::flight {

enum class MissionKind : std::uint8_t {
  curve,  // a reference, at rest after its end; a curve of one point hovers
  goal,   // straight to a goal, by a law of the outermost loop
  pilot,  // by the sticks of each tick
  given   // a reference, by the point that each observation brings
};

// What makes the nominal command.
struct Mission {
  MissionKind kind = MissionKind::curve;
  std::shared_ptr<const ReferenceCurve> curve;
  Vec3 goal;
  // u = v_ref + gain / 2 (p_ref - p), at most `speed`: PolyMerge (arXiv 2606.16232), eq. 16. Where the cascade
  // follows it, plus a_ref over the gain of its velocity loop; if no filter changes u, it has jerk and snap as well.
  // To a goal: a = gain (u - v) with |u| = min(speed, sqrt(a_max d)), and while hovering gain d / 2.
  double gain = 2;
  double speed = std::numeric_limits<double>::infinity();  // [m/s]
  bool hovers = false;
  std::optional<PlanClockOptions> clock;  // of a curve: its time waits for the vehicle; else it does not

  double duration() const { return kind == MissionKind::curve ? curve->duration() : 0; }
};

struct FlightOptions {
  double dt_s = 0.01;
  std::int64_t controller_ticks = 1;  // the nominal command is held for this many ticks,
  std::int64_t filter_ticks = 1;      // and the command of the filters for this many
  double stale_s = 0.5;               // a measurement older than this is not predicted any more
  bool has_losses = false;            // measurements can be missing: the predictor keeps commands for stale_s
  DisturbanceOptions disturbance;     // of a quadrotor commanded by wrenches or body rates
  ResponseOptions response;           // of a quadrotor that follows velocities or accelerations
};

struct Observation {
  double now_s = 0;
  std::optional<State> measured;  // nothing: none arrived in this tick
  std::optional<Vec4> attitude;   // of `measured`, as FlightState has it
  std::span<const alula_track> tracks;
  Vec3 position_variance;
  std::optional<RacerCommand> sticks;    // of the pilot
  std::optional<ReferencePoint> target;  // of a mission by given points
  std::optional<double> age_s;           // of `measured`, if it is known; else it is the assumed delay
  double slip_m = 0;                     // see FlightState; finite and not negative
};

// Record of one filter in one tick.
struct FilterRecord {
  FilterReport report;
  float seconds = 0;  // measured
};

struct Decision {
  Command command;
  bool is_refused = false;  // the last filter refused, or there is no state
  bool is_stale = false;
  bool is_filtered = false;  // filters were called in this tick; in the others their last command is held
  bool is_limited = false;   // rotors or limits of a point cannot realise what the filters returned
  // What the command asks of the body, held with it: of a wrench, that of its thrust along the axis that the filters
  // saw. Without a value for velocities and sticks. The body's difference from it is FastBridge's realisation error
  // (eq. 11-12): what attitude, rotors and air leave of the command.
  std::optional<Vec3> acceleration;
};

class Flight {
 public:
  // Filters are cloned. Throws std::invalid_argument for filters that are not in the order of their kinds or beyond
  // the vehicle's interface, and for options out of range.
  Flight(const VehicleSpec& vehicle, const FlightOptions& options, const Mission& mission,
         std::span<const SafetyFilter* const> filters);

  void reset();  // before another flight, and when others have flown the vehicle
  void observe(const Observation& seen);
  const Decision& decide();
  void sent();                      // what was decided; again for each tick that the vehicle goes on with it
  void sent(const Command& other);  // of any interface

  const FlightState& estimate() const { return seen_; }
  const Nominal& nominal() const { return first_; }  // of the mission, before any filter
  std::span<const FilterRecord> records() const { return records_; }
  const ReferencePoint& target() const { return target_; }
  // The estimated acceleration that the model leaves out, and the bound on what is missing in it [m/s^2].
  Vec3 disturbance() const { return observer_.is_on() ? observer_.acceleration() : response_.acceleration(); }
  double disturbance_bound() const { return observer_.is_on() ? observer_.bound() : response_.bound(); }
  // What the margins of filters grow by because of the bound and the slip [m].
  double added_margin() const {
    return vehicle_.interface == Interface::velocity ? flight::added_margin(seen_, vehicle_.velocity_lag_s.most())
                                                     : flight::added_margin(seen_);
  }
  const std::optional<PlanClock>& clock() const { return clock_; }

 private:
  bool is_turn(std::int64_t ticks) const { return tick_ % ticks == 0; }
  double held_s(std::int64_t ticks) const { return options_.dt_s * static_cast<double>(ticks); }
  bool is_rigid() const { return vehicle_.model == VehicleModel::quadrotor; }
  void predict();
  void estimate_disturbance(const State& measured, const std::optional<double>& age_s);
  void follow(Vec3 command, double held);
  void make_nominal();
  void lower(CommandKind from, CommandKind to);
  void take(const FilterReport& report, CommandKind kind);
  void stand_in(CommandKind kind);
  void finish();
  void remember(const std::optional<Vec3>& command);
  void go_on();

  VehicleSpec vehicle_;
  FlightOptions options_;
  Mission mission_;
  std::optional<PlanClock> clock_;
  std::vector<std::unique_ptr<SafetyFilter>> filters_;
  StatePredictor predictor_;
  DisturbanceObserver observer_;
  ResponseObserver response_;
  Level level_out_;              // of the disturbance,
  State true_;                   // and the predicted state with its true attitude
  std::int64_t sent_ticks_ = 0;  // since the flight began, for the times of measurements
  double measured_ = 0;          // time of the newest measurement by them [s]
  FlightState seen_;
  Nominal first_, nominal_;
  std::optional<RacerCommand> sticks_;  // of the pilot in this tick
  // The outermost command that `nominal_` has, and `first_`.
  CommandKind level_ = CommandKind::acceleration, first_level_ = CommandKind::acceleration;
  ReferencePoint target_, reference_;  // of the mission; of the cascade in this tick,
  TrackingGains gains_;                // with its gains
  State last_;                         // newest measurement,
  std::optional<Vec4> attitude_;       // and its attitude
  double now_ = 0, arrived_ = -1;
  std::optional<double> age_;  // of that measurement, if it is known
  bool has_state_ = false, has_target_ = false;
  std::int64_t tick_ = 0;  // since the state became known, from which controller and filters count theirs
  Wrench flown_;
  bool is_other_ = false;  // the applied thrust differs from the controller's
  // Velocities or accelerations that were sent in the last ticks, a ring; none where others were sent.
  std::vector<std::optional<Vec3>> past_;
  std::size_t oldest_ = 0;  // of them
  std::vector<FilterRecord> records_;
  Decision decision_;
};

}  // namespace alula::flight
