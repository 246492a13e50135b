// Bindings of alula/flight/flight.hpp, alula/flight/simulation.hpp and alula/filters/adapters.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <variant>

#include "alula/filters/adapters.hpp"
#include "alula/filters/chord_filter.hpp"
#include "alula/flight/simulation.hpp"
#include "fields.hpp"
#include "flight/flight_log.hpp"
#include "python_control.hpp"
#include "racer_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Choices<flight::VehicleModel> {
  static constexpr std::array names{"single-integrator", "double-integrator", "quadrotor", "racer"};
};

template <>
struct Choices<flight::Interface> {
  static constexpr std::array names{"velocity", "acceleration", "wrench", "body-rates", "sticks"};
};

template <>
struct Choices<flight::CommandKind> {
  static constexpr std::array names{"velocity", "acceleration", "wrench", "sticks"};
};

template <>
struct Fields<flight::FollowingOptions> {
  using Options = flight::FollowingOptions;
  static constexpr std::tuple all{
      Field{"horizontal_acceleration_m_s2", &Options::horizontal_acceleration_m_s2, "limit; 0: not shaped [m/s^2]"},
      Field{"horizontal_jerk_m_s3", &Options::horizontal_jerk_m_s3, "limit of its change [m/s^3]"},
      Field{"vertical_acceleration_m_s2", &Options::vertical_acceleration_m_s2, "the same, vertically [m/s^2]"},
      Field{"vertical_jerk_m_s3", &Options::vertical_jerk_m_s3, "limit of its change [m/s^3]"},
      Field{"lag_s", &Options::lag_s, "of the acceleration within the attitude loop [s]"},
      Field{"position_gain_per_s", &Options::position_gain_per_s,
            "velocity by the error of the shaped position [1/s]"},
      Field{"velocity_gain_per_s", &Options::velocity_gain_per_s, "acceleration by that of the velocity [1/s]"},
      Field{"climb_gain_per_s", &Options::climb_gain_per_s, "the same, vertically [1/s]"}};
};

template <>
struct Fields<flight::VehicleSpec> {
  using Spec = flight::VehicleSpec;
  static constexpr std::tuple all{
      Field{"model", &Spec::model, "single-integrator, double-integrator, quadrotor or racer"},
      Field{"interface", &Spec::interface, "velocity, acceleration, wrench, body-rates or sticks"},
      Field{"gains", &Spec::gains, "gains of the tracking controller"},
      Field{"plant", &Spec::plant, "true lag, air, noise and delay"},
      Field{"assumed", &Spec::assumed, "lag and delay that controller and filters assume"},
      Field{"max_rate_rad_s", &Spec::max_rate, "limit of a commanded body rate [rad/s]"},
      Field{"rate_time_constant_s", &Spec::rate_time_constant_s, "of each axis of the vehicle's own rate loop [s]"},
      Field{"velocity_gain_per_s", &Spec::velocity_gain, "of the velocity loop [1/s]"},
      Field{"following", &Spec::following, "how the autopilot shapes velocities and accelerations"},
      Field{"velocity_lag_s", &Spec::velocity_lag_s,
            "assumed time constant with which velocities are followed, of all axes or of each [s]"},
      Field{"max_speed_m_s", &Spec::max_speed, "limit of velocity commands, and of points [m/s]"},
      Field{"max_acceleration_m_s2", &Spec::max_acceleration, "limit of points [m/s^2]"},
      Field{"max_jerk_m_s3", &Spec::max_jerk, "limit of a double integrator [m/s^3]"},
      Field{"actuation_delay_s", &Spec::actuation_delay_s, "of a double integrator [s]"},
      Field{"radius_m", &Spec::radius_m, "of the sphere [m]"},
      Field{"racer", &Spec::racer, "thrust by throttle, for sticks"},
      Field{"racer_options", &Spec::racer_options, "what the true racer has and its model lacks"},
      Field{"mass_scale", &Spec::mass_scale, "true mass over that of the body"},
      Field{"rate_gain_scale", &Spec::rate_gain_scale, "true gain of the rate loop over that of the model"}};
};

template <>
struct Fields<flight::PlanClockOptions> {
  using Options = flight::PlanClockOptions;
  static constexpr std::tuple all{
      Field{"near_m", &Options::near_m, "error up to which the time runs at full rate [m]"},
      Field{"far_m", &Options::far_m, "error from which on it stands still [m]"},
      Field{"slew_per_s", &Options::slew_per_s, "maximum change of the rate [1/s]"},
      Field{"via_s", &Options::via_s, "times of the via points along the plan, ascending [s]"},
      Field{"via_m", &Options::via_m, "distance within which a via point counts as passed [m]"},
      Field{"own_via_m", &Options::own_via_m, "the same of each via point, where they differ [m]"}};
};

template <>
struct Fields<flight::DisturbanceOptions> {
  using Options = flight::DisturbanceOptions;
  static constexpr std::tuple all{
      Field{"time_s", &Options::time_s, "time constant of the estimate of disturbances; 0: none [s]"},
      Field{"max_m_s2", &Options::max_m_s2, "maximum length of the estimate [m/s^2]"},
      Field{"max_interval_s", &Options::max_interval_s,
            "after a longer time without a measurement the estimate goes on from the next one [s]"}};
};

template <>
struct Fields<flight::ResponseOptions> {
  using Options = flight::ResponseOptions;
  static constexpr std::tuple all{
      Field{"time_s", &Options::time_s,
            "time constant of the estimate of what a vehicle's response leaves out; 0: none [s]"},
      Field{"room_m_s2", &Options::room_m_s2,
            "by which the interval of expected accelerations is wider on both sides [m/s^2]"},
      Field{"delay_s", &Options::delay_s, "a command of this age may be the one that is followed [s]"},
      Field{"shortest_lag_s", &Options::shortest_lag_s, "shortest lag of a vehicle that follows velocities [s]"},
      Field{"jerk_m_s3", &Options::jerk_m_s3, "with which accelerations are followed at least [m/s^3]"},
      Field{"release_s", &Options::release_s, "time constant with which the bound decays [s]"},
      Field{"max_m_s2", &Options::max_m_s2, "maximum length of the estimate [m/s^2]"},
      Field{"max_interval_s", &Options::max_interval_s,
            "after a longer time without a measurement the estimate begins anew [s]"}};
};

template <>
struct Fields<flight::FlightOptions> {
  using Options = flight::FlightOptions;
  static constexpr std::tuple all{
      Field{"dt_s", &Options::dt_s, "a tick [s]"},
      Field{"controller_ticks", &Options::controller_ticks, "ticks for which the nominal command is held"},
      Field{"filter_ticks", &Options::filter_ticks, "ticks for which the filters' command is held"},
      Field{"stale_s", &Options::stale_s, "a measurement older than this is not predicted any more [s]"},
      Field{"has_losses", &Options::has_losses, "measurements can be missing"},
      Nested{&Options::disturbance, "disturbance_"},
      Nested{&Options::response, "response_"}};
};

template <>
struct Fields<flight::Losses> {
  using Losses = flight::Losses;
  static constexpr std::tuple all{
      Field{"share", &Losses::share, "probability that a measurement is lost"},
      Field{"from_s", &Losses::from_s, "beginning of an outage [s]"},
      Field{"for_s", &Losses::for_s, "its duration [s]"},
      Field{"radio_from_s", &Losses::radio_from_s, "beginning of an outage of the pilot's radio [s]"},
      Field{"radio_for_s", &Losses::radio_for_s, "its duration [s]"}};
};

template <>
struct Fields<flight::SimulationRules> {
  using Rules = flight::SimulationRules;
  static constexpr std::tuple all{
      Field{"plant_steps", &Rules::plant_steps, "steps of the plant in a tick"},
      Field{"stop_speed_m_s", &Rules::stop_speed,
            "reached when slower than this, with the reference at its end [m/s]"},
      Field{"stuck_speed_m_s", &Rules::stuck_speed, "stuck below this speed, away from the reference [m/s],"},
      Field{"stuck_ticks", &Rules::stuck_ticks, "for this many ticks"},
      Field{"receded_s", &Rules::receded_s, "ends when all obstacles have receded for so long [s]"},
      Field{"lower", &Rules::lower, "lower corner of the box that must not be left [m]"},
      Field{"upper", &Rules::upper, "upper corner of that box [m]"},
      Field{"ends_when_refused", &Rules::ends_when_refused, "a refused command ends the flight"},
      Field{"ends_at_goal", &Rules::ends_at_goal, "a goal that is reached ends the flight, and being stuck"},
      Field{"risk_window_s", &Rules::risk_window_s, "window of the risk of encounters [s]"},
      Field{"keeps_path", &Rules::keeps_path, "the path is kept"},
      Field{"keeps_ticks", &Rules::keeps_ticks, "a complete row per tick is kept, not only what a judge counts"}};
};

namespace flight {
namespace {

using Filters = std::vector<SafetyFilter*>;

// A filter in Python behind the protocol. It runs in one thread: clones share the object.
class PythonFilter final : public SafetyFilter {
 public:
  PythonFilter(CommandKind kind, nb::object made) : kind_(kind), made_(std::move(made)) {}
  PythonFilter(const PythonFilter& other) : kind_(other.kind_) {
    const nb::gil_scoped_acquire acquire;
    made_ = other.made_;
  }
  PythonFilter& operator=(const PythonFilter&) = delete;
  ~PythonFilter() override {
    const nb::gil_scoped_acquire acquire;
    made_.reset();
  }

  CommandKind kind() const override { return kind_; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override {
    const nb::gil_scoped_acquire acquire;
    made_.attr("reset")();
  }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<PythonFilter>(*this); }
  bool shares_state() const override { return true; }

 private:
  CommandKind kind_;
  nb::object made_;
};

nb::dict state_of(const FlightState& s) {
  nb::dict d;
  d["position"] = triple_of(s.x.p), d["sigma"] = triple_of(s.x.sigma);
  d["velocity"] = triple_of(s.x.v), d["omega"] = triple_of(s.x.omega);
  d["thrust"] = s.thrust, d["thrust_rate"] = s.thrust_rate;
  d["rotors"] = s.rotors ? nb::cast(*s.rotors) : nb::object(nb::none());
  d["is_known"] = s.is_known, d["position_variance"] = triple_of(s.position_variance);
  std::vector<double> rows;
  for (const alula_track& t : s.tracks) {
    rows.push_back(t.id);
    for (const float v : t.position) rows.push_back(v);
    for (const float v : t.velocity) rows.push_back(v);
    for (const float v : t.covariance) rows.push_back(v);
    rows.push_back(t.radius_m);
    for (const float v : t.acceleration) rows.push_back(v);
  }
  d["tracks"] = to_numpy(std::move(rows), {s.tracks.size(), 32});
  return d;
}

nb::dict nominal_of(const Nominal& n) {
  nb::dict d;
  d["velocity"] = triple_of(n.velocity), d["acceleration"] = triple_of(n.acceleration);
  d["wrench"] = Vec4{n.wrench.thrust, n.wrench.torque.x, n.wrench.torque.y, n.wrench.torque.z};
  d["thrust_rate"] = n.thrust_rate, d["thrust_acceleration"] = n.thrust_acceleration;
  d["position_error"] = triple_of(n.position_error), d["velocity_error"] = triple_of(n.velocity_error);
  d["reference_acceleration"] = triple_of(n.reference_acceleration);
  d["sticks"] = n.sticks ? nb::cast(Vec4{n.sticks->throttle, n.sticks->rates.x, n.sticks->rates.y, n.sticks->rates.z})
                         : nb::object(nb::none());
  return d;
}

FilterReport PythonFilter::filter(const FlightState& state, const Nominal& nominal) {
  const nb::gil_scoped_acquire acquire;
  const nb::dict answer = nb::cast<nb::dict>(made_.attr("tick")(state_of(state), nominal_of(nominal)));
  FilterReport report;
  report.status = static_cast<SafetyStatus>(nb::cast<int>(answer["status"]));
  const auto u = nb::cast<std::vector<double>>(answer["u"]);
  const std::size_t needed = kind_ < CommandKind::wrench ? 3 : 4;
  if (u.size() != needed) throw std::invalid_argument("a filter returned a command of another kind");
  for (const double value : u)
    if (!std::isfinite(value)) throw std::invalid_argument("a filter returned a command that is not finite");
  const Vec3 first{u[0], u[1], u[2]};
  if (kind_ == CommandKind::velocity) report.velocity = first;
  if (kind_ == CommandKind::acceleration) report.acceleration = first;
  if (kind_ == CommandKind::wrench) report.wrench = wrench_at(u.data());
  if (kind_ == CommandKind::sticks) report.sticks = {u[0], {u[1], u[2], u[3]}};
  report.margin = nb::cast<double>(answer["margin"]);
  report.active = nb::cast<std::int64_t>(answer["active"]);
  report.thrust_rate = nb::cast<double>(answer["thrust_rate"]);
  report.infeasible = nb::cast<bool>(answer["infeasible"]);
  report.certified = nb::cast<bool>(answer["certified"]);
  report.certified_moving = nb::cast<bool>(answer["certified_moving"]);
  report.solve_time_s = nb::cast<std::optional<double>>(answer["solve_time_s"]);
  return report;
}

std::vector<const SafetyFilter*> borrowed(const Filters& filters) {
  for (const SafetyFilter* filter : filters)
    if (filter == nullptr) throw std::invalid_argument("a filter is None; leave it out of the list");
  return {filters.begin(), filters.end()};
}

nb::typed<nb::list, LogDict> run(const SimulationSpec& spec, const std::vector<Task>& tasks, const Filters& filters,
                                 std::uint64_t seed, std::uint32_t first_trial, unsigned jobs, nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<SimulatedFlight> flights;
  {
    const nb::gil_scoped_release release;
    flights = simulate(spec, tasks, borrowed(filters), seed, first_trial, jobs, control);
  }
  nb::typed<nb::list, LogDict> result;
  for (SimulatedFlight& flight : flights) result.append(to_dict(std::move(flight), filters.size()));
  return result;
}

// A flight on board that owns its tracks of this tick.
struct SteppedFlight {
  Flight flight;
  std::vector<alula_track> tracks;

  SteppedFlight(const VehicleSpec& vehicle, const FlightOptions& options, const Mission& mission,
                const Filters& filters)
      : flight(vehicle, options, mission, borrowed(filters)) {}
  SteppedFlight(const SteppedFlight&) = delete;

  void observe(double now_s, const std::optional<InState>& measured, const nb::bytes& seen, const Triple& variance,
               const std::optional<Vec4>& sticks, const std::optional<InReference>& target,
               const std::optional<double>& age_s, double slip_m) {
    if (seen.size() % sizeof(alula_track) != 0) throw std::invalid_argument("these are no tracks");
    tracks.resize(seen.size() / sizeof(alula_track));
    std::memcpy(tracks.data(), seen.data(), seen.size());
    Observation observation;
    observation.now_s = now_s;
    if (measured) observation.measured = state_at(measured->data());
    observation.tracks = tracks;
    observation.position_variance = vector_of(variance);
    if (sticks) observation.sticks = RacerCommand{(*sticks)[0], {(*sticks)[1], (*sticks)[2], (*sticks)[3]}};
    if (target) observation.target = reference_at(target->data());
    observation.age_s = age_s, observation.slip_m = slip_m;
    flight.observe(observation);
  }

  void sent(const nb::handle& interface, const std::optional<Vec4>& values) {
    if (!values) return flight.sent();
    Command other;
    other.interface = fields::choice<Interface>(interface, "interface");
    const Vec3 first{(*values)[0], (*values)[1], (*values)[2]}, last{(*values)[1], (*values)[2], (*values)[3]};
    other.velocity = other.acceleration = first;
    other.wrench = {(*values)[0], last}, other.rates = last;
    flight.sent(other);
  }

  LogDict decide() {
    Decision decision;
    {
      const nb::gil_scoped_release release;
      decision = flight.decide();
    }
    const Command& c = decision.command;
    LogDict d;
    const Vec3 outer = c.interface == Interface::velocity       ? c.velocity
                       : c.interface == Interface::acceleration ? c.acceleration
                                                                : c.rates;
    d["command"] = Rows(1).add(outer).add(c.wrench).add(c.sticks.throttle).add(c.sticks.rates).array({11});
    d["nominal"] = nominal_of(flight.nominal());
    d["target"] = Rows(1).add(flight.target()).array({18});
    d["is_refused"] = decision.is_refused, d["is_stale"] = decision.is_stale;
    d["is_limited"] = decision.is_limited;
    d["estimate"] = to_array(flight.estimate().x);
    d["disturbance"] = triple_of(flight.disturbance());
    d["disturbance_bound"] = flight.disturbance_bound();
    d["added_margin_m"] = flight.added_margin();
    nb::list filters;
    for (const FilterRecord& r : flight.records()) {
      LogDict one;
      one["status"] = static_cast<int>(r.report.status), one["margin"] = r.report.margin;
      one["active"] = r.report.active, one["rows"] = r.report.rows;
      one["certified"] = r.report.certified, one["certified_moving"] = r.report.certified_moving;
      one["infeasible"] = r.report.infeasible, one["seconds"] = r.seconds;
      one["velocity"] = triple_of(r.report.velocity), one["acceleration"] = triple_of(r.report.acceleration);
      one["thrust"] = r.report.wrench.thrust;
      filters.append(one);
    }
    d["filters"] = filters;
    return d;
  }
};

void bind_adapters(nb::module_& m) {
  nb::class_<VelocityFilter, SafetyFilter>(m, "VelocityFilter", "polytope-cbf as a safety filter of velocities.")
      .def(nb::init<const PolytopeCbf&, bool>(), "filter"_a, nb::kw_only(), "is_bare"_a = false,
           "is_bare: only report the margin, and pass the nominal velocity.");
  nb::class_<ChordFilter, SafetyFilter>(m, "ChordFilter",
                                        "A filter of velocities on the chord of a vehicle that lags.")
      .def(
          "__init__",
          [](ChordFilter* self, const SafetyFilter& filter, const std::variant<double, std::array<double, 3>>& lag,
             double max_speed) {
            const auto* each = std::get_if<std::array<double, 3>>(&lag);
            new (self) ChordFilter(
                filter, each ? geometry::PerAxis(geometry::from_rows(each->data())) : std::get<double>(lag),
                max_speed);
          },
          "filter"_a, nb::kw_only(), "lag_s"_a, "max_speed_m_s"_a, "lag_s: of all axes, or of each.");
  nb::class_<MovingSafety, SafetyFilter>(m, "MovingSafety", "A filter among moving obstacles, with walls of a map.")
      .def(
          "__init__",
          [](MovingSafety* self, const MovingFilter& filter, std::shared_ptr<ObstacleMap> walls, double max_speed,
             double max_acceleration, double radius) {
            new (self) MovingSafety(filter.clone(), {std::move(walls), max_speed, max_acceleration, radius});
          },
          "filter"_a, "walls"_a.none() = nb::none(), nb::kw_only(), "max_speed_m_s"_a, "max_acceleration_m_s2"_a,
          "radius_m"_a, "walls: static obstacles, or None.");
  nb::class_<FenceFilter, SafetyFilter>(m, "FenceFilter", "The geofence, or with alpha the filter backup-qp.")
      .def(nb::init<const Geofence&, std::optional<double>, bool>(), "geofence"_a, "alpha"_a = nb::none(),
           nb::kw_only(), "is_bare"_a = false, nb::keep_alive<1, 2>(), "is_bare: pass the pilot's command.");
  nb::class_<PythonFilter, SafetyFilter>(m, "PythonFilter", "A filter in Python; flights run in one thread.")
      .def(
          "__init__",
          [](PythonFilter* self, nb::handle kind, nb::object made) {
            new (self) PythonFilter(fields::choice<CommandKind>(kind, "kind"), std::move(made));
          },
          "kind"_a, "made"_a, "made: has tick(state, nominal) -> dict and reset().");
}

void bind_clock(nb::module_& m) {
  fields::bind<PlanClockOptions>(m, "PlanClockOptions", "How time along a plan waits: alula/flight/plan_clock.hpp.");
  nb::class_<PlanClock>(m, "PlanClock", "Time along a plan, which slows down for a vehicle that falls behind.")
      .def(
          "__init__",
          [](PlanClock* self, const ReferenceCurve& curve, const PlanClockOptions& options) {
            new (self) PlanClock(std::make_shared<const ReferenceCurve>(curve), options);
          },
          "curve"_a, "options"_a = PlanClockOptions{})
      .def("pause", &PlanClock::pause, "heading_rad"_a)
      .def("enter", &PlanClock::enter, "time_s"_a, "rate"_a, "heading_rad"_a)
      .def("advance", &PlanClock::advance, "dt_s"_a, "error_m"_a)
      .def(
          "target", [](const PlanClock& self) { return Rows(1).add(self.target()).array({1, 18}); },
          "A row of `ReferenceCurve.at`, shape (1, 18), by the slowed time.")
      .def_prop_ro("time_s", &PlanClock::time)
      .def_prop_ro("rate", &PlanClock::rate)
      .def_prop_ro("is_over", &PlanClock::is_over);
}

void bind_specs(nb::module_& m) {
  fields::bind<FollowingOptions>(
      m, "FollowingOptions", "How an autopilot follows velocities and accelerations: alula/flight/autopilot.hpp.");
  nb::class_<Autopilot>(m, "Autopilot", "The motion into which an autopilot shapes set-points.")
      .def(nb::init<const FollowingOptions&>(), "options"_a)
      .def(
          "reset", [](Autopilot& self, const InState& x) { self.reset(state_at(x.data())); }, "state"_a,
          "Begin from a motion; a climb is being braked.")
      .def(
          "follow_velocity",
          [](Autopilot& self, double dt_s, const Triple& u, const InState& x) {
            return triple_of(self.follow_velocity(dt_s, vector_of(u), state_at(x.data())));
          },
          "dt_s"_a, "velocity"_a, "state"_a, "A step; the acceleration that the attitude loop gets [m/s^2].")
      .def(
          "follow_acceleration",
          [](Autopilot& self, double dt_s, const Triple& u, const InState& x) {
            return triple_of(self.follow_acceleration(dt_s, vector_of(u), state_at(x.data())));
          },
          "dt_s"_a, "acceleration"_a, "state"_a)
      .def_prop_ro("velocity", [](const Autopilot& self) { return triple_of(self.velocity()); })
      .def_prop_ro("acceleration", [](const Autopilot& self) { return triple_of(self.acceleration()); });
  bind_clock(m);
  nb::class_<VehicleSpec>(m, "VehicleSpec", "A vehicle, as modelled and as it truly is.")
      .def(
          "__init__",
          [](VehicleSpec* self, const Quadrotor& body, const nb::kwargs& others) {
            VehicleSpec made{.body = body};
            fields::assign(made, others, "VehicleSpec");
            check(made);
            new (self) VehicleSpec(std::move(made));
          },
          "body"_a, "others"_a,
          nb::sig(fields::signature(VehicleSpec{.body = small_quadrotor().body}, "self, body: Quadrotor").c_str()),
          fields::documentation(VehicleSpec{.body = small_quadrotor().body}).c_str());
  fields::bind<FlightOptions>(m, "FlightOptions", "Timing of a flight on board.");
  fields::bind<Losses>(m, "Losses", "Losses of measurements and of the pilot's radio.");
  fields::bind<SimulationRules>(m, "SimulationRules", "Timing of a simulation, and when a flight ends.");
  nb::class_<Mission>(m, "Mission", "What makes the nominal command.")
      .def_static(
          "along",
          [](const ReferenceCurve& curve, double gain, double speed, bool hovers,
             const std::optional<PlanClockOptions>& clock) {
            return Mission{
                MissionKind::curve, std::make_shared<const ReferenceCurve>(curve), {}, gain, speed, hovers, clock};
          },
          "curve"_a, nb::kw_only(), "gain_per_s"_a = Mission{}.gain, "speed_m_s"_a = Mission{}.speed,
          "hovers"_a = false, "clock"_a = nb::none(),
          "Track a curve; with `hovers` until the time is over; with a `clock` its time waits for the vehicle.")
      .def_static(
          "to",
          [](const Triple& goal, double gain, double speed, bool hovers) {
            return Mission{MissionKind::goal, nullptr, vector_of(goal), gain, speed, hovers};
          },
          "goal"_a, nb::kw_only(), "gain_per_s"_a = Mission{}.gain, "speed_m_s"_a = Mission{}.speed,
          "hovers"_a = false, "Straight to a goal; with `hovers` hold it.")
      .def_static(
          "given", [](double gain, double speed) { return Mission{MissionKind::given, nullptr, {}, gain, speed}; },
          nb::kw_only(), "gain_per_s"_a = Mission{}.gain, "speed_m_s"_a = Mission{}.speed,
          "Track the reference point of each tick.")
      .def_static("by_sticks", [] { return Mission{.kind = MissionKind::pilot}; }, "By the sticks of a pilot.");
  nb::class_<Task>(m, "Task", "A trial: its start, its mission, and a simulated pilot where it flies by sticks.")
      .def(
          "__init__",
          [](Task* self, const In<double, nb::shape<-1>>& start, const Mission& mission,
             const std::optional<Pilot>& pilot, double max_time_s, double stop_distance_m,
             const std::optional<Triple>& expected_velocity) {
            if (pilot) check(*pilot);
            const bool is_racer = start.shape(0) == kRacerNumbers;
            if (!is_racer && start.shape(0) != 12) throw std::invalid_argument("a start has 12 or 13 numbers");
            Task task{.start = {}, .mission = mission, .pilot = pilot, .max_time_s = max_time_s};
            task.stop_distance_m = stop_distance_m;
            if (is_racer) {
              const RacerState x = racer_at(start.data());
              task.start = from_racer(x), task.attitude = x.q;
            } else {
              task.start = state_at(start.data());
            }
            if (expected_velocity) task.expected_velocity = vector_of(*expected_velocity);
            new (self) Task(std::move(task));
          },
          "start"_a, "mission"_a, nb::kw_only(), "pilot"_a = nb::none(), "max_time_s"_a = 60.0,
          "stop_distance_m"_a = 0.05, "expected_velocity_m_s"_a = nb::none(),
          "start: position, attitude (MRP), velocity, body rates, or of a racer position, velocity, attitude (unit\n"
          "quaternion w, x, y, z), body rates; expected_velocity_m_s: by which obstacles are drawn to meet the\n"
          "vehicle, else the mean velocity of the mission.")
      .def_ro("max_time_s", &Task::max_time_s, "Maximum duration [s].");
  nb::class_<SimulationSpec>(m, "SimulationSpec", "All parts of simulated flights but the tasks and the filters.")
      .def(
          "__init__",
          [](SimulationSpec* self, const VehicleSpec& vehicle, const FlightOptions& options,
             const SimulationRules& rules, const Losses& losses, const MovingSpec& moving, const Geofence* fence,
             const SafetyFilter* watcher) {
            const SimulationSpec spec{vehicle, options, rules, losses, moving, fence, watcher};
            check(spec);
            new (self) SimulationSpec(spec);
          },
          "vehicle"_a, nb::kw_only(), "options"_a = FlightOptions{}, "rules"_a = SimulationRules{},
          "losses"_a = Losses{}, "moving"_a = MovingSpec{}, "fence"_a.none() = nb::none(),
          "watcher"_a.none() = nb::none(), nb::keep_alive<1, 7>(), nb::keep_alive<1, 8>(),
          "fence: by whose fence and limits flights of a racer are judged; watcher: filter of accelerations among\n"
          "moving obstacles that is not flown, for the metrics of encounters without one that is.");
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_flight(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  bind_adapters(m);
  bind_specs(m);
  m.def("simulate", &run, "spec"_a, "tasks"_a, "filters"_a, nb::kw_only(), "seed"_a = 0, "first_trial"_a = 0,
        "jobs"_a = 0, "progress"_a = nb::none(),
        "Fly every task behind clones of the filters, in their order; per flight a dict of arrays with a row per "
        "tick: alula/flight/simulation.hpp.");
  nb::class_<SteppedFlight>(m, "Flight", "A flight as the computer on board sees it: observe, then decide.")
      .def(nb::init<const VehicleSpec&, const FlightOptions&, const Mission&, const Filters&>(), "vehicle"_a,
           "options"_a, "mission"_a, "filters"_a)
      .def("observe", &SteppedFlight::observe, "now_s"_a, "measured"_a.none(), nb::kw_only(),
           "tracks"_a = nb::bytes("", 0), "position_variance"_a = Triple{}, "sticks"_a = nb::none(),
           "target"_a = nb::none(), "age_s"_a = nb::none(), "slip_m"_a = 0.0,
           "The newest measurement (p, sigma, v, omega), or None; `tracks` as `simulate` returns them; `target` as\n"
           "of ReferenceCurve.at; age_s of the measurement, in place of the assumed delay [s]; `slip_m`, by which "
           "position\n"
           "and integrated velocity differ, which margins grow by.")
      .def(
          "reset", [](SteppedFlight& self) { self.flight.reset(); },
          "Before another flight, and when others have flown the vehicle.")
      .def("sent", &SteppedFlight::sent, "interface"_a = nb::none(), "values"_a = nb::none(),
           "What was decided was sent for this tick; or another command: a velocity, an acceleration (the first "
           "three\n"
           "values), a thrust [N] with torque, or with body rates.")
      .def("decide", &SteppedFlight::decide,
           "A dict: command (11), is_refused, is_stale, is_limited, estimate, and a record of each filter.");
}
