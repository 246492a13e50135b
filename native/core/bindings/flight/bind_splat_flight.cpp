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

#include "alula/flight/splat_flight.hpp"
#include "flight_arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using namespace flight;
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
                                 const std::vector<ReferenceCurve>& references, const SplatFilter* filter,
                                 const SplatFilter* guide, std::uint64_t seed, std::uint32_t first_trial,
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
                std::uint32_t number, const SplatFilter* guide)
      : reference(curve), vehicle(what), trial(vehicle, rules, reference, seed, number, guide) {}
  SteppedFlight(const SteppedFlight&) = delete;

  int advance(const InVector<double>& u, unsigned status, double margin, std::int64_t active, double thrust_rate,
              bool infeasible, bool certified, double filter_s) {
    if (u.size() != 3 && u.size() != 4) throw std::invalid_argument("an input has 3 or 4 numbers");
    const bool is_wrench = u.size() == 4;
    FilterReport report;
    report.status = static_cast<SplatFilterStatus>(status);
    if (report.status == SplatFilterStatus::refused)
      report.wrench.thrust = vehicle.body.hover_thrust();
    else if (is_wrench)
      report.wrench = {u.data()[0], {u.data()[1], u.data()[2], u.data()[3]}};
    else
      report.acceleration = {u.data()[0], u.data()[1], u.data()[2]};
    report.thrust_rate = thrust_rate;
    report.margin = margin;
    report.active = active;
    report.infeasible = infeasible;
    report.certified = certified;
    const InputKind kind = is_wrench ? InputKind::wrench : InputKind::acceleration;
    return static_cast<int>(trial.advance(report, kind, filter_s));
  }
};

PlantKind plant_kind(const std::string& name) {
  if (name == "quadrotor") return PlantKind::quadrotor;
  if (name == "double-integrator") return PlantKind::double_integrator;
  throw std::invalid_argument("a plant is a quadrotor or a double-integrator");
}

// Steps of the plant in a tick of which none is longer than 1 ms: at least as fine as what a shield predicts.
std::int64_t fine_steps(double dt_s) {
  const double steps = std::ceil(dt_s / 1e-3 - 1e-9);
  return steps > 1 && steps < 1e9 ? static_cast<std::int64_t>(steps) : 1;  // 1 too for what `fly` will refuse
}

CommandInterface command_interface(const std::string& name) {
  if (name == "wrench") return CommandInterface::wrench;
  if (name == "body-rates") return CommandInterface::body_rates;
  throw std::invalid_argument("an interface takes a wrench or body-rates");
}

}  // namespace
}  // namespace alula

void bind_splat_flight(nb::module_& m) {
  using namespace alula;
  nb::class_<FlightVehicle>(m, "FlightVehicle", "What flies among ellipsoids: body, controller, plant and interface.")
      .def(
          "__init__",
          [](FlightVehicle* self, const Quadrotor& body, const TrackingGains& gains, const PlantOptions& options,
             const std::string& plant, const std::string& interface, const Triple& max_rate,
             double rate_time_constant, double max_acceleration, const ActuatorModel& assumed) {
            new (self) FlightVehicle{body,
                                     gains,
                                     options,
                                     plant_kind(plant),
                                     command_interface(interface),
                                     vector_of(max_rate),
                                     rate_time_constant,
                                     max_acceleration,
                                     assumed};
          },
          "body"_a, "gains"_a = TrackingGains{}, "options"_a = PlantOptions{}, nb::kw_only(), "plant"_a = "quadrotor",
          "interface"_a = "wrench", "max_rate_rad_s"_a = Triple{10, 10, 4}, "rate_time_constant_s"_a = 0.02,
          "max_acceleration_m_s2"_a = std::numeric_limits<double>::infinity(), "assumed"_a = ActuatorModel{},
          "options: what the plant does; assumed: what controller and filters take its rotors and sensors for.");

  nb::class_<FlightRules>(m, "FlightRules", "Times of a flight, and when it ends.")
      .def(
          "__init__",
          [](FlightRules* self, double dt_s, std::optional<std::int64_t> plant_steps, double stop_fraction,
             double stop_floor_m, double stop_speed, double stuck_speed, std::int64_t stuck_ticks, double time_factor,
             double max_time_s, const Triple& lower, const Triple& upper) {
            const std::int64_t steps = plant_steps.value_or(fine_steps(dt_s));
            new (self)
                FlightRules{dt_s,        steps,       stop_fraction, stop_floor_m,     stop_speed,      stuck_speed,
                            stuck_ticks, time_factor, max_time_s,    vector_of(lower), vector_of(upper)};
          },
          nb::kw_only(), "dt_s"_a = 0.01, "plant_steps"_a = nb::none(), "stop_fraction"_a = 0.01,
          "stop_floor_m"_a = 0.05, "stop_speed"_a = 0.1, "stuck_speed"_a = 0.02, "stuck_ticks"_a = 200,
          "time_factor"_a = 3.0, "max_time_s"_a = 0.0, "lower"_a = Triple{-1e9, -1e9, -1e9},
          "upper"_a = Triple{1e9, 1e9, 1e9},
          "plant_steps: of the plant in a tick; by default as many as make none longer than 1 ms.");

  nb::class_<SteppedFlight>(m, "FlightTrial",
                            "One flight a tick at a time: state() and nominal(), then advance() with the answer.")
      .def(nb::init<const FlightVehicle&, const FlightRules&, const ReferenceCurve&, std::uint64_t, std::uint32_t,
                    const SplatFilter*>(),
           "vehicle"_a, "rules"_a, "reference"_a, nb::kw_only(), "seed"_a = 0, "trial"_a = 0, "guide"_a = nb::none())
      .def(
          "state",
          [](const SteppedFlight& self) {
            const FlightState& s = self.trial.state();
            return std::make_tuple(to_array(s.x.p), to_array(s.x.sigma), to_array(s.x.v), to_array(s.x.omega),
                                   s.thrust, s.thrust_rate, s.rotors.value_or(Vec4{}));
          },
          "Position, attitude (MRP), velocity, body rates, thrust and its rate, and what each rotor gives.")
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
          "advance", &SteppedFlight::advance, "u"_a, nb::kw_only(), "status"_a, "margin"_a, "active"_a = -1,
          "thrust_rate"_a = 0.0, "infeasible"_a = false, "certified"_a = false, "filter_s"_a = 0.0,
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

  m.def(
      "least_gamma",
      [](const EllipsoidIndex& index, const InRows3<double>& points) {
        const nb::gil_scoped_release release;
        return least_gamma(index, as_span(points));
      },
      "index"_a, "points"_a, "Least r' A r - 1 over the grown ellipsoids and the points (T, 3); below 0 inside one.");
}
