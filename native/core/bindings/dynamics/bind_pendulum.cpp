// Bindings of alula/dynamics/pendulum.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "alula/dynamics/pendulum.hpp"
#include "arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
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
}  // namespace alula::flight

void bind_pendulum(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  const PendulumOptions o;
  nb::class_<PendulumFilter>(m, "PendulumFilter",
                             "A safety filter of the inverted pendulum theta'' = sin theta + u: `regulation` or "
                             "`backup-qp`.")
      .def(
          "__init__",
          [](PendulumFilter* self, const std::string& rule, double largest_angle, double end_rate, double k,
             double push_distance, double push_gain, double push_rate, double horizon, int steps, double beta,
             double alpha, double largest_input) {
            new (self) PendulumFilter(rule_of(rule), {largest_angle, end_rate, k, push_distance, push_gain, push_rate,
                                                      horizon, steps, beta, alpha, largest_input});
          },
          "rule"_a, nb::kw_only(), "largest_angle"_a = o.largest_angle, "end_rate"_a = o.end_rate, "k"_a = o.k,
          "push_distance"_a = o.push_distance, "push_gain"_a = o.push_gain, "push_rate"_a = o.push_rate,
          "horizon_s"_a = o.horizon_s, "steps"_a = o.steps, "beta"_a = o.beta, "alpha"_a = o.alpha,
          "largest_input"_a = o.largest_input)
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
          "states"_a, "u_des"_a, "At states (N, 2): u, h_I, lambda, rows, infeasible (N, 5).")
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
          "Closed loop: theta, theta', u, h_I, lambda, rows, infeasible (ticks, 7).");
}
