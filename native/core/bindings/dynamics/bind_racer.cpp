// Bindings of alula/dynamics/racer.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include "fields.hpp"
#include "racer_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Fields<flight::RacerModel> {
  using Model = flight::RacerModel;
  static constexpr std::tuple all{Field{"gravity", &Model::gravity, "gravity [m/s^2]"},
                                  Field{"thrust", &Model::thrust, "a_0, a_1, a_2 of the thrust map [m/s^2]"},
                                  Field{"rate_gain", &Model::rate_gain, "gain of the rate loop [1/s]"},
                                  Field{"max_rate", &Model::max_rate, "maximum rates of a command [rad/s]"}};
};

template <>
struct Fields<flight::RacerOptions> {
  using Options = flight::RacerOptions;
  static constexpr std::tuple all{
      Field{"mass", &Options::mass, "mass, used only for the drag [kg]"},
      Field{"mass_scale", &Options::mass_scale, "ratio of true to assumed mass"},
      Field{"thrust_scale", &Options::thrust_scale, "ratio of true to assumed thrust"},
      Field{"rate_gain_scale", &Options::rate_gain_scale, "ratio of true to assumed gain of the rate loop"},
      Field{"delay_s", &Options::delay_s, "time from a command until it acts [s]"},
      Field{"linear_drag", &Options::linear_drag, "linear drag along the body axes [N s/m]"},
      Field{"quadratic_drag", &Options::quadratic_drag, "quadratic drag along the body axes [N s^2/m^2]"},
      Field{"wind_m_s", &Options::wind_m_s, "mean wind [m/s]"},
      Field{"gust_m_s", &Options::gust_m_s, "standard deviation of gusts per axis [m/s]"},
      Field{"gust_time_s", &Options::gust_time_s, "time constant of gusts [s]"},
      Field{"sag_share", &Options::sag_share, "fraction of the thrust that is lost at full throttle"},
      Field{"sag_time_s", &Options::sag_time_s, "time constant of that loss [s]"}};
};

}  // namespace alula

void bind_racer(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  fields::bind<RacerModel>(
      m, "RacerModel",
      "A drone behind a rate loop: thrust a_0 + a_1 u + a_2 u^2 [m/s^2] of the throttle, and rates "
      "that follow their command with a gain [1/s].")
      .def("throttle_for", &RacerModel::throttle_for, "acceleration"_a,
           "The throttle for an acceleration [m/s^2], in [0, 1].");
  fields::bind<RacerOptions>(m, "RacerOptions",
                             "Disturbances of a racing drone's plant that its model omits; all off by default.");
  nb::class_<Racer>(m, "Racer", "A flight of a racing drone; a function of commands, seed and trial.")
      .def(
          "__init__",
          [](Racer* self, const RacerModel& of, const RacerOptions& options, std::uint64_t seed,
             std::uint32_t trial) { new (self) Racer(of, options, RandomStream{seed, trial}); },
          "model"_a, "options"_a = RacerOptions{}, nb::kw_only(), "seed"_a = 0, "trial"_a = 0)
      .def(
          "reset", [](Racer& self, const InRacer& x) { self.reset(racer_at(x.data())); }, "x"_a,
          "Reset to a state (13): p, v, q wxyz, omega.")
      .def(
          "step",
          [](Racer& self, double dt, const InCommand& u) {
            if (!(dt > 0)) throw std::invalid_argument("a step must be positive");
            self.step(dt, command_at(u.data()));
          },
          "dt"_a, "u"_a, "Advance by dt with a command (4): throttle, rates.")
      .def_prop_ro(
          "state", [](const Racer& self) { return to_array(self.state()); }, nb::rv_policy::move)
      .def_prop_ro("time", &Racer::time);
}
