// Bindings of alula/flight/splat_flight.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>

#include "alula/flight/obstacle_motion.hpp"
#include "alula/flight/splat_flight.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Choices<flight::PlantKind> {
  static constexpr std::array names{"quadrotor", "double-integrator"};
};

template <>
struct Choices<flight::CommandInterface> {
  static constexpr std::array names{"wrench", "body-rates"};
};

template <>
struct Fields<flight::FlightVehicle> {
  using Vehicle = flight::FlightVehicle;
  static constexpr std::tuple all{
      Field{"plant", &Vehicle::kind, "quadrotor or double-integrator"},
      Field{"interface", &Vehicle::interface, "wrench or body-rates"},
      Field{"max_rate_rad_s", &Vehicle::max_rate, "limit of a commanded body rate [rad/s]"},
      Field{"rate_time_constant_s", &Vehicle::rate_time_constant_s,
            "time constant of the vehicle's own rate loop [s]"},
      Field{"max_acceleration_m_s2", &Vehicle::max_acceleration, "limit of the double integrator [m/s^2]"},
      Field{"assumed", &Vehicle::assumed, "lag and delay that controller and filters assume"}};
};

namespace {

using namespace flight;

// Rules with an optional number of steps.
struct FlightRulesArguments : FlightRules {
  std::optional<std::int64_t> steps;
};

// Output of a filter that runs in Python.
struct Answer {
  std::uint8_t status = 0;
  double margin = 0;
  std::int64_t active = -1;
  double thrust_rate = 0;
  bool infeasible = false, certified = false;
  double filter_s = 0;
};

}  // namespace

template <>
struct Fields<FlightRulesArguments> {
  using Rules = FlightRulesArguments;
  static constexpr std::tuple all{
      Field{"dt_s", &Rules::dt_s, "a tick of controller and filter [s]"},
      Field{"plant_steps", &Rules::steps,
            "steps of the plant in a tick; default: as many as make none longer than 1 ms"},
      Field{"controller_ticks", &Rules::controller_ticks, "ticks for which the controller's command is held"},
      Field{"filter_ticks", &Rules::filter_ticks, "ticks for which the filter's input is held"},
      Field{"stop_fraction", &Rules::stop_fraction, "reached within this fraction of the start-goal distance"},
      Field{"stop_floor_m", &Rules::stop_floor_m, "or within this distance [m]"},
      Field{"stop_speed", &Rules::stop_speed, "slower than this, with the reference at its end [m/s]"},
      Field{"stuck_speed", &Rules::stuck_speed,
            "stuck below this speed, and farther than that from the reference [m/s]"},
      Field{"stuck_ticks", &Rules::stuck_ticks, "number of ticks below that speed"},
      Field{"time_factor", &Rules::time_factor, "time limit in durations of the reference"},
      Field{"max_time_s", &Rules::max_time_s, "time limit, when above 0 [s]"},
      Field{"lower", &Rules::lower, "lower corner of the box that must not be left [m]"},
      Field{"upper", &Rules::upper, "upper corner of that box [m]"}};
};

template <>
struct Fields<Answer> {
  static constexpr std::tuple all{Field{"status", &Answer::status, "SafetyStatus", Limits{}, true},
                                  Field{"margin", &Answer::margin, "value of the barrier", Limits{}, true},
                                  Field{"active", &Answer::active, "ellipsoid that decides, or -1"},
                                  Field{"thrust_rate", &Answer::thrust_rate, "rate of the thrust [N/s]"},
                                  Field{"infeasible", &Answer::infeasible, "the program had no solution"},
                                  Field{"certified", &Answer::certified, "a safe manoeuvre remains"},
                                  Field{"filter_s", &Answer::filter_s, "duration of the filter [s]"}};
};

namespace {

Doubles to_array(geometry::Vec3 v) { return Rows(1).add(v).array({3}); }

using LogDict = nb::typed<nb::dict, nb::str, nb::any>;

LogDict to_dict(SplatFlightLog&& log) {
  const std::size_t ticks = log.ticks(), points = log.position.size() / 3;
  LogDict result;
  result["position"] = to_numpy(std::move(log.position), {points, 3});
  result["state"] = to_numpy(std::move(log.state), {ticks + 1, 12});
  result["a_nominal"] = to_numpy(std::move(log.a_nominal), {ticks, 3});
  result["a_command"] = to_numpy(std::move(log.a_command), {ticks, 3});
  result["a_error"] = to_numpy(std::move(log.a_error), {ticks});
  result["u_nominal"] = to_numpy(std::move(log.u_nominal), {ticks, 4});
  result["u"] = to_numpy(std::move(log.u), {ticks, 4});
  result["rotor_thrust"] = to_numpy(std::move(log.rotor_thrust), {ticks, 4});
  result["margin"] = to_numpy(std::move(log.margin), {ticks});
  result["gate_m"] = to_numpy(std::move(log.gate_m), {ticks});
  result["active"] = to_numpy(std::move(log.active), {ticks});
  result["candidates"] = to_numpy(std::move(log.candidates), {ticks});
  result["rows"] = to_numpy(std::move(log.rows), {ticks});
  result["iterations"] = to_numpy(std::move(log.iterations), {ticks});
  result["status"] = to_numpy(std::move(log.status), {ticks});
  result["flags"] = to_numpy(std::move(log.flags), {ticks});
  result["filter_s"] = to_numpy(std::move(log.filter_s), {ticks});
  result["tick_s"] = to_numpy(std::move(log.tick_s), {ticks});
  result["outcome"] = static_cast<int>(log.outcome);
  return result;
}

nb::typed<nb::list, LogDict> run(const FlightVehicle& vehicle, const FlightRules& rules,
                                 const std::vector<ReferenceCurve>& references, const SafetyFilter* filter,
                                 const SafetyFilter* guide, std::uint64_t seed, std::uint32_t first_trial,
                                 unsigned jobs, nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<SplatFlightLog> logs;
  {
    const nb::gil_scoped_release release;
    logs = fly(vehicle, rules, references, filter, guide, seed, first_trial, jobs, control);
  }
  nb::typed<nb::list, LogDict> result;
  for (SplatFlightLog& log : logs) result.append(to_dict(std::move(log)));
  return result;
}

// A trial that owns its reference.
struct SteppedFlight {
  ReferenceCurve reference;
  FlightVehicle vehicle;
  FlightTrial trial;

  SteppedFlight(const FlightVehicle& what, const FlightRules& rules, const ReferenceCurve& curve, std::uint64_t seed,
                std::uint32_t number, const SafetyFilter* guide)
      : reference(curve), vehicle(what), trial(vehicle, rules, reference, seed, number, guide) {}
  SteppedFlight(const SteppedFlight&) = delete;

  int advance(const InVector<double>& u, const nb::kwargs& others) {
    Answer answer;
    fields::assign(answer, others, "advance");
    if (u.size() != 3 && u.size() != 4) throw std::invalid_argument("an input has 3 or 4 numbers");
    const bool is_wrench = u.size() == 4;
    FilterReport report;
    report.status = static_cast<SafetyStatus>(answer.status);
    if (report.status == SafetyStatus::refused)
      report.wrench.thrust = vehicle.body.hover_thrust();
    else if (is_wrench)
      report.wrench = {u.data()[0], {u.data()[1], u.data()[2], u.data()[3]}};
    else
      report.acceleration = {u.data()[0], u.data()[1], u.data()[2]};
    report.thrust_rate = answer.thrust_rate;
    report.margin = answer.margin;
    report.active = answer.active;
    report.infeasible = answer.infeasible;
    report.certified = answer.certified;
    const CommandKind kind = is_wrench ? CommandKind::wrench : CommandKind::acceleration;
    return static_cast<int>(trial.advance(report, kind, answer.filter_s));
  }
};

// Number of plant steps in a tick, each at most 1 ms: at least as fine as a shield's prediction.
std::int64_t fine_steps(double dt_s) {
  const double steps = std::ceil(dt_s / 1e-3 - 1e-9);
  return steps > 1 && steps < 1e9 ? static_cast<std::int64_t>(steps) : 1;  // 1 also for values that `fly` rejects
}

}  // namespace
}  // namespace alula

void bind_splat_flight(nb::module_& m) {
  using namespace alula;
  nb::class_<FlightVehicle>(m, "FlightVehicle", "Vehicle among ellipsoids: body, controller, plant and interface.")
      .def(
          "__init__",
          [](FlightVehicle* self, const Quadrotor& body, const TrackingGains& gains, const PlantOptions& options,
             const nb::kwargs& others) {
            FlightVehicle made{body, gains, options};
            fields::assign(made, others, "FlightVehicle");
            new (self) FlightVehicle(std::move(made));
          },
          "body"_a, "gains"_a = TrackingGains{}, "options"_a = PlantOptions{}, "others"_a,
          nb::sig(fields::signature(FlightVehicle{small_quadrotor().body},
                                    "self, body: Quadrotor, gains: TrackingGains = ..., options: PlantOptions = ...")
                      .c_str()),
          fields::documentation(
              FlightVehicle{small_quadrotor().body},
              "`options` are the plant's disturbances; `assumed` is the model of rotors and sensors "
              "in controller and filters.")
              .c_str());

  fields::bind_from<FlightRules, FlightRulesArguments>(
      m, "FlightRules", "Timing of a flight and its end conditions.", [](const FlightRulesArguments& given) {
        FlightRules rules = given;
        rules.plant_steps = given.steps.value_or(fine_steps(given.dt_s));
        return rules;
      });

  nb::class_<SteppedFlight>(m, "FlightTrial",
                            "One flight a tick at a time: state() and nominal(), then advance() with the answer.")
      .def(nb::init<const FlightVehicle&, const FlightRules&, const ReferenceCurve&, std::uint64_t, std::uint32_t,
                    const SafetyFilter*>(),
           "vehicle"_a, "rules"_a, "reference"_a, nb::kw_only(), "seed"_a = 0, "trial"_a = 0, "guide"_a = nb::none())
      .def(
          "state",
          [](const SteppedFlight& self) {
            const FlightState& s = self.trial.state();
            return std::make_tuple(to_array(s.x.p), to_array(s.x.sigma), to_array(s.x.v), to_array(s.x.omega),
                                   s.thrust, s.thrust_rate, s.rotors.value_or(Vec4{}));
          },
          "Position, attitude (MRP), velocity, body rates, thrust and its rate, and the thrust of each rotor.")
      .def(
          "nominal",
          [](const SteppedFlight& self) {
            const Nominal& n = self.trial.nominal();
            return std::make_tuple(to_array(n.acceleration), to_array(n.wrench), n.thrust_rate, n.thrust_acceleration,
                                   to_array(n.position_error), to_array(n.velocity_error),
                                   to_array(n.reference_acceleration));
          },
          "Acceleration, wrench, T' and T'', errors of position and velocity, acceleration of the reference.")
      .def(
          "is_filtered", [](const SteppedFlight& self) { return self.trial.is_filtered(); },
          "Whether the filter runs in this tick; in the others its last answer is flown again.")
      .def(
          "advance", &SteppedFlight::advance, "u"_a, "others"_a,
          nb::sig(fields::signature(Answer{}, "self, u: NDArray[numpy.float64]", "advance", "int").c_str()),
          "Fly an acceleration (3) or a wrench (4) for a tick; the outcome: 0 flying, 1 reached, 2 stuck, 3 timeout, "
          "4 refused.")
      .def(
          "log", [](SteppedFlight& self) { return to_dict(SplatFlightLog(self.trial.log())); },
          "All ticks so far, as `fly` returns them.");

  m.def(
      "fly", &run, "vehicle"_a, "rules"_a, "references"_a, "filter"_a.none(), nb::kw_only(), "guide"_a = nb::none(),
      "seed"_a = 0, "first_trial"_a = 0, "jobs"_a = 0, "progress"_a = nb::none(),
      "Fly every reference behind a clone of the filter, or without one; per flight a dict of arrays with a row per "
      "tick, the path at the rate of the plant, and the outcome.");
}
