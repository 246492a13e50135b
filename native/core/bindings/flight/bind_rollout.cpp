// Bindings of alula/flight/rollout.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <memory>
#include <stdexcept>

#include "alula/flight/rollout.hpp"
#include "arrays.hpp"
#include "fields.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Fields<TrialRules> {
  static constexpr std::tuple all{
      Field{"dt_s", &TrialRules::dt_s, "time step [s]", Limits{}, true},
      Field{"gain", &TrialRules::gain, "gain of the nominal controller [1/s]", Limits{}, true},
      Field{"v_max", &TrialRules::v_max, "speed limit [m/s]", Limits{}, true},
      Field{"stop_fraction", &TrialRules::stop_fraction, "reached within this fraction of the start-goal distance",
            Limits{}, true},
      Field{"stuck_speed", &TrialRules::stuck_speed, "stuck below this speed [m/s]", Limits{}, true},
      Field{"stuck_steps", &TrialRules::stuck_steps, "number of steps below that speed", Limits{}, true},
      Field{"max_steps", &TrialRules::max_steps, "time limit in steps", Limits{}, true}};
};

namespace {

std::vector<Vec3> points_of(const InRows3<double>& rows) {
  std::vector<Vec3> points(rows.shape(0));
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double* p = rows.data() + 3 * i;
    points[i] = {p[0], p[1], p[2]};
  }
  return points;
}

// Trial that owns its reference.
struct SteppedTrial {
  std::vector<double> position, velocity;
  Trial trial;

  SteppedTrial(const Vec3& start, const Vec3& goal, const TrialRules& rules,
               const InRows3<double>& reference_position, const InRows3<double>& reference_velocity)
      : position(reference_position.data(), reference_position.data() + reference_position.size()),
        velocity(reference_velocity.data(), reference_velocity.data() + reference_velocity.size()),
        trial(start, goal, rules, {position, velocity}) {}
  SteppedTrial(const SteppedTrial&) = delete;
};

using LogDict = nb::typed<nb::dict, nb::str, nb::any>;

LogDict to_dict(TrialLog&& log) {
  const std::size_t steps = log.status.size();
  LogDict result;
  result["position"] = to_numpy(std::move(log.position), {steps + 1, 3});
  result["u_nom"] = to_numpy(std::move(log.u_nom), {steps, 3});
  result["u"] = to_numpy(std::move(log.u), {steps, 3});
  result["margin"] = to_numpy(std::move(log.margin), {steps});
  result["status"] = to_numpy(std::move(log.status), {steps});
  result["filter_s"] = to_numpy(std::move(log.filter_s), {steps});
  result["outcome"] = static_cast<int>(log.outcome);
  return result;
}

nb::typed<nb::list, LogDict> run(const flight::SafetyFilter& filter, const InRows3<double>& start,
                                 const InRows3<double>& goal, const TrialRules& rules,
                                 const InRows3<double>& reference_position, const InRows3<double>& reference_velocity,
                                 unsigned jobs, nb::object progress) {
  const auto starts = points_of(start), goals = points_of(goal);
  const Reference reference{as_span(reference_position), as_span(reference_velocity)};
  PythonControl control(std::move(progress));
  std::vector<TrialLog> logs;
  {
    const nb::gil_scoped_release release;
    logs = rollout(filter, starts, goals, rules, reference, jobs, control);
  }
  nb::typed<nb::list, LogDict> result;
  for (TrialLog& log : logs) result.append(to_dict(std::move(log)));
  return result;
}

}  // namespace
}  // namespace alula

void bind_rollout(nb::module_& m) {
  using namespace alula;
  fields::bind<TrialRules>(m, "TrialRules", "End conditions of a flight, and its nominal controller.");

  nb::class_<SteppedTrial>(m, "Trial",
                           "One flight a step at a time: nominal(), then advance() with the input that is flown.\n"
                           "The reference arrays (K, 3) hold a row every dt; without rows the goal is flown to.")
      .def(nb::init<const Vec3&, const Vec3&, const TrialRules&, const InRows3<double>&, const InRows3<double>&>(),
           "start"_a, "goal"_a, "rules"_a, "reference_position"_a, "reference_velocity"_a)
      .def("nominal", [](const SteppedTrial& self) { return self.trial.nominal(); })
      .def(
          "advance",
          [](SteppedTrial& self, const Vec3& u, bool refused) {
            return static_cast<int>(self.trial.advance(u, refused));
          },
          "u"_a, "refused"_a, "The outcome after the step: 0 flying, 1 reached, 2 stuck, 3 timeout, 4 refused.")
      .def_prop_ro("position", [](const SteppedTrial& self) { return self.trial.position(); });

  m.def("rollout", &run, "filter"_a, "start"_a, "goal"_a, "rules"_a, "reference_position"_a, "reference_velocity"_a,
        nb::kw_only(), "jobs"_a = 0, "progress"_a = nb::none(),
        "Fly all trials on threads behind clones of a filter of velocities; per trial a dict of position (steps + 1, "
        "3), u_nom and u (steps, 3), margin, "
        "status and filter_s (steps), and the outcome.");
}
