// Bindings of alula/dynamics/pendulum.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "alula/dynamics/pendulum.hpp"
#include "arrays.hpp"
#include "fields.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Fields<flight::PendulumOptions> {
  using Options = flight::PendulumOptions;
  static constexpr std::tuple all{
      Field{"largest_angle", &Options::largest_angle, "theta_max [rad]"},
      Field{"end_rate", &Options::end_rate, "rate at the end of the flow [rad/s]"},
      Field{"k", &Options::k, "gain of the backup controller [1/s]"},
      Field{"push_distance", &Options::push_distance,
            "distance from the limit within which the backup controller moves away [rad]"},
      Field{"push_gain", &Options::push_gain, "gain of that motion [1/s]"},
      Field{"push_rate", &Options::push_rate, "maximum rate of that motion [rad/s]"},
      Field{"horizon_s", &Options::horizon_s, "horizon of the flow [s]"},
      Field{"steps", &Options::steps, "steps of the flow"},
      Field{"beta", &Options::beta, "gain of the regulation"},
      Field{"alpha", &Options::alpha, "gain of the QP [1/s]"},
      Field{"largest_input", &Options::largest_input, "maximum input of the QP and of u_des"}};
};

namespace flight {
namespace {

using Doubles = nb::ndarray<nb::numpy, double>;

PendulumRule rule_of(const std::string& name) {
  if (name == "regulation") return PendulumRule::regulation;
  if (name == "backup-qp") return PendulumRule::backup_qp;
  throw std::invalid_argument("no rule is called " + name);
}

void insert(std::vector<double>& to, const PendulumReport& r) {
  to.insert(to.end(), {r.u, r.h_i, r.lambda, static_cast<double>(r.rows), r.is_infeasible ? 1.0 : 0.0});
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_pendulum(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  nb::class_<PendulumFilter>(m, "PendulumFilter",
                             "A safety filter of the inverted pendulum theta'' = sin theta + u: `regulation` or "
                             "`backup-qp`.")
      .def(
          "__init__",
          [](PendulumFilter* self, const std::string& rule, const nb::kwargs& others) {
            PendulumOptions options;
            fields::assign(options, others, "PendulumFilter");
            new (self) PendulumFilter(rule_of(rule), options);
          },
          "rule"_a, "others"_a, nb::sig(fields::signature(PendulumOptions{}, "self, rule: str").c_str()),
          fields::documentation(PendulumOptions{}).c_str())
      .def(
          "filter",
          [](PendulumFilter& self, const In<double, nb::shape<-1, 2>>& states, double u_des) {
            const std::size_t count = states.shape(0);
            std::vector<double> result;
            {
              const nb::gil_scoped_release release;
              result.reserve(5 * count);
              for (std::size_t i = 0; i < count; ++i) {
                insert(result, self.filter({states.data()[2 * i], states.data()[2 * i + 1]}, u_des));
              }
            }
            return to_numpy(std::move(result), {count, 5});
          },
          "states"_a, "u_des"_a, "Filter at states (N, 2): u, h_I, lambda, rows, infeasible (N, 5).")
      .def(
          "fly",
          [](PendulumFilter& self, double angle, double rate, double u_des, double dt, int ticks) {
            if (!(dt > 0) || ticks < 1 || ticks > 10'000'000) throw std::invalid_argument("no such flight");
            const std::size_t count = static_cast<std::size_t>(ticks);
            std::vector<double> result;
            {
              const nb::gil_scoped_release release;
              result.reserve(7 * count);
              PendulumState x{angle, rate};
              for (int k = 0; k < ticks; ++k) {
                const PendulumReport r = self.filter(x, u_des);
                result.insert(result.end(), {x.angle, x.rate});
                insert(result, r);
                x = step_pendulum(x, r.u, dt);
              }
            }
            return to_numpy(std::move(result), {count, 7});
          },
          "angle"_a, "rate"_a, "u_des"_a, "dt"_a, "ticks"_a,
          "Fly the closed loop: theta, theta', u, h_I, lambda, rows, infeasible (ticks, 7).");
}
