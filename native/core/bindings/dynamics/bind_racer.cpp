// Bindings of alula/dynamics/racer.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include "racer_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_racer(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  const RacerModel model;
  nb::class_<RacerModel>(
      m, "RacerModel",
      "A drone behind a rate loop: thrust a_0 + a_1 u + a_2 u^2 [m/s^2] of the throttle, and rates "
      "that follow their command with a gain [1/s].")
      .def(
          "__init__",
          [](RacerModel* self, double gravity, const std::array<double, 3>& thrust, double rate_gain,
             const Triple& max_rate) {
            const RacerModel made{gravity, thrust, rate_gain, vector_of(max_rate)};
            check(made);
            new (self) RacerModel(made);
          },
          nb::kw_only(), "gravity"_a = model.gravity, "thrust"_a = model.thrust, "rate_gain"_a = model.rate_gain,
          "max_rate"_a = triple_of(model.max_rate), "ValueError for numbers without meaning.")
      .def_ro("gravity", &RacerModel::gravity)
      .def_ro("thrust", &RacerModel::thrust)
      .def_ro("rate_gain", &RacerModel::rate_gain)
      .def_prop_ro("max_rate", [](const RacerModel& self) { return triple_of(self.max_rate); })
      .def("throttle_for", &RacerModel::throttle_for, "acceleration"_a,
           "The throttle for an acceleration [m/s^2], in [0, 1].");
  const RacerOptions o;
  nb::class_<RacerOptions>(m, "RacerOptions",
                           "What a racing drone's plant does beside its model; all off by default.")
      .def(
          "__init__",
          [](RacerOptions* self, double mass, double mass_scale, double thrust_scale, double rate_gain_scale,
             double delay, const Triple& linear_drag, const Triple& quadratic_drag, const Triple& wind,
             const Triple& gust, double gust_time, double sag_share, double sag_time) {
            const RacerOptions made{mass,
                                    mass_scale,
                                    thrust_scale,
                                    rate_gain_scale,
                                    delay,
                                    vector_of(linear_drag),
                                    vector_of(quadratic_drag),
                                    vector_of(wind),
                                    vector_of(gust),
                                    gust_time,
                                    sag_share,
                                    sag_time};
            check(made);
            new (self) RacerOptions(made);
          },
          nb::kw_only(), "mass"_a = o.mass, "mass_scale"_a = o.mass_scale, "thrust_scale"_a = o.thrust_scale,
          "rate_gain_scale"_a = o.rate_gain_scale, "delay_s"_a = o.delay_s,
          "linear_drag"_a = triple_of(o.linear_drag), "quadratic_drag"_a = triple_of(o.quadratic_drag),
          "wind_m_s"_a = triple_of(o.wind_m_s), "gust_m_s"_a = triple_of(o.gust_m_s), "gust_time_s"_a = o.gust_time_s,
          "sag_share"_a = o.sag_share, "sag_time_s"_a = o.sag_time_s,
          "Mass [kg] is for the drag [N s/m, N s^2/m^2] along the body's axes alone. ValueError for numbers without "
          "meaning.");
  nb::class_<Racer>(m, "Racer", "A flight of a racing drone; a function of commands, seed and trial.")
      .def(
          "__init__",
          [](Racer* self, const RacerModel& of, const RacerOptions& options, std::uint64_t seed,
             std::uint32_t trial) { new (self) Racer(of, options, RandomStream{seed, trial}); },
          "model"_a, "options"_a = RacerOptions{}, nb::kw_only(), "seed"_a = 0, "trial"_a = 0)
      .def(
          "reset", [](Racer& self, const InRacer& x) { self.reset(racer_at(x.data())); }, "x"_a,
          "To a state (13): p, v, q wxyz, omega.")
      .def(
          "step",
          [](Racer& self, double dt, const InCommand& u) {
            if (!(dt > 0)) throw std::invalid_argument("a step must be positive");
            self.step(dt, command_at(u.data()));
          },
          "dt"_a, "u"_a, "A step with a command (4): throttle, rates.")
      .def_prop_ro(
          "state", [](const Racer& self) { return to_array(self.state()); }, nb::rv_policy::move)
      .def_prop_ro("time", &Racer::time);
}
