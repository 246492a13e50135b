// Bindings of alula/filters/moving_filter.hpp and of the parts of native/onboard behind it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cfloat>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "alula/filters/moving_filter.hpp"
#include "alula/filters/option_fields.hpp"
#include "arrays.hpp"
#include "filters/onboard_inputs.hpp"
#include "python_qp.hpp"
#include "track_rows.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using flight::MovingFilter;
using flight::MovingFilterOptions;
using flight::MovingMethod;
using flight::MovingReport;
using Triple = std::array<double, 3>;
template <class T>
using Out = nb::ndarray<nb::numpy, T>;

constexpr std::array<std::pair<const char*, MovingMethod>, 6> kMethods{{{"none", MovingMethod::none},
                                                                        {"dr_acbf", MovingMethod::dr_acbf},
                                                                        {"dr_acbf_qp", MovingMethod::dr_acbf_qp},
                                                                        {"mpc", MovingMethod::mpc},
                                                                        {"cbf_qp", MovingMethod::cbf_qp},
                                                                        {"rp_cbf", MovingMethod::rp_cbf}}};

}  // namespace

template <>
struct Fields<MovingFilterOptions> {
  static constexpr std::tuple all{Nested{&MovingFilterOptions::config}, Nested{&MovingFilterOptions::mpc, "mpc_"},
                                  Nested{&MovingFilterOptions::cbf_qp, "cbf_qp_"},
                                  Nested{&MovingFilterOptions::rp_cbf, "rp_cbf_"}};
};

namespace {

MovingFilterOptions defaults() {
  MovingFilterOptions options{};
  options.config = alula_dr_acbf_defaults();
  return options;
}

MovingFilterOptions options_of(const Numbers& numbers) {
  MovingFilterOptions options = defaults();
  assign_numbers(options, numbers, "a moving filter");
  return options;
}

std::unique_ptr<MovingFilter> make(const std::string& method, const Numbers& numbers, nb::object backend) {
  MovingFilterOptions options = options_of(numbers);
  options.backend = qp_backend(std::move(backend));
  for (const auto& [name, value] : kMethods) {
    if (method == name) return flight::make_moving_filter(value, options);
  }
  throw std::invalid_argument("no moving filter is called " + method);
}

alula_vehicle_state vehicle_of(const Triple& position, const Triple& velocity,
                               const std::array<double, 6>& covariance) {
  alula_vehicle_state vehicle;
  for (std::size_t k = 0; k < 3; ++k) {
    vehicle.position[k] = static_cast<float>(position[k]);
    vehicle.velocity[k] = static_cast<float>(velocity[k]);
  }
  for (std::size_t k = 0; k < 6; ++k) vehicle.covariance[k] = static_cast<float>(covariance[k]);
  return vehicle;
}

// Runs one tick, and measures the median time of `repeats` further ticks on copies.
std::tuple<MovingReport, double> filter(MovingFilter& self, const Triple& position, const Triple& velocity,
                                        const Tracks& tracks, const InRows4<double>& walls, const Triple& nominal,
                                        const std::array<double, 6>& covariance, unsigned repeats) {
  const alula_vehicle_state vehicle = vehicle_of(position, velocity, covariance);
  const auto all = tracks_of(tracks);
  const auto planes = walls_of(walls);
  const geometry::Vec3 u_nom{nominal[0], nominal[1], nominal[2]};
  const nb::gil_scoped_release release;
  std::vector<double> elapsed(repeats);
  std::unique_ptr<MovingFilter> copy;
  for (double& time : elapsed) {
    copy = self.clone();
    const auto start = std::chrono::steady_clock::now();
    copy->filter(vehicle, all, planes, u_nom);
    time = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
  std::sort(elapsed.begin(), elapsed.end());
  return {self.filter(vehicle, all, planes, u_nom),
          elapsed.empty() ? std::numeric_limits<double>::quiet_NaN() : elapsed[elapsed.size() / 2]};
}

std::vector<alula_half_space> rows_of(const InRows4<double>& rows) {
  std::vector<alula_half_space> result(rows.shape(0));
  for (std::size_t i = 0; i < result.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) result[i].normal[k] = static_cast<float>(rows.data()[4 * i + k]);
    result[i].bound = static_cast<float>(rows.data()[4 * i + 3]);
  }
  return result;
}

// (a, feasible, violation, iterations, basis, seconds)
std::tuple<Triple, bool, double, unsigned, std::vector<unsigned>, double> project(
    const InRows4<double>& rows, const Triple& start, const std::string& solver, double limit, double omega,
    unsigned iterations, unsigned soft, unsigned repeats) {
  const auto all = rows_of(rows);
  const auto count = static_cast<std::uint32_t>(all.size());
  const float a0[3] = {static_cast<float>(start[0]), static_cast<float>(start[1]), static_cast<float>(start[2])};
  const auto size = static_cast<float>(limit);
  std::function<void(alula_projection*)> solve;
  if (solver == "exact") {
    solve = [&](alula_projection* found) { alula_project_exact(all.data(), count, size, a0, found); };
  } else if (solver == "gs") {
    solve = [&](alula_projection* found) {
      alula_project_gauss_southwell(all.data(), count, size, static_cast<float>(omega), iterations, a0, found);
    };
  } else if (solver == "least-violation") {
    solve = [&](alula_projection* found) {
      alula_project_least_violation(all.data(), count, std::min(soft, count), size, a0, found);
    };
  } else {
    throw std::invalid_argument("solver is exact, gs or least-violation");
  }
  alula_projection found;
  const auto begin = std::chrono::steady_clock::now();
  for (unsigned i = 0; i < std::max(1u, repeats); ++i) solve(&found);
  const double time = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return {{found.a[0], found.a[1], found.a[2]},
          found.feasible != 0,
          count > 0 ? static_cast<double>(found.violation) : -std::numeric_limits<double>::infinity(),
          found.iterations,
          std::vector<unsigned>(found.basis, found.basis + found.basis_count),
          time / std::max(1u, repeats)};
}

// Exact projections of many problems with equal numbers of rows: a (k, 3), feasible (k), violation (k).
std::tuple<Out<float>, Out<std::uint8_t>, Out<float>, Out<std::uint32_t>> project_many(
    const In<double, nb::shape<-1, -1, 4>>& rows, const InRows3<double>& start, double limit) {
  const std::size_t count = rows.shape(0), size = rows.shape(1);
  if (start.shape(0) != count) throw std::invalid_argument("one start per problem");
  std::vector<float> a(3 * count), violation(count);
  std::vector<std::uint8_t> feasible(count);
  std::vector<std::uint32_t> iterations(count);
  std::vector<alula_half_space> row(size);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t j = 0; j < size; ++j) {
      const double* from = rows.data() + 4 * (i * size + j);
      row[j] = {{static_cast<float>(from[0]), static_cast<float>(from[1]), static_cast<float>(from[2])},
                static_cast<float>(from[3])};
    }
    const double* p = start.data() + 3 * i;
    const float a0[3] = {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
    alula_projection found;
    alula_project_exact(row.data(), static_cast<std::uint32_t>(size), static_cast<float>(limit), a0, &found);
    std::copy_n(found.a, 3, a.begin() + static_cast<std::ptrdiff_t>(3 * i));
    feasible[i] = found.feasible != 0;
    violation[i] = found.violation;
    iterations[i] = found.iterations;
  }
  return {to_numpy(std::move(a), {count, 3}), to_numpy(std::move(feasible), {count}),
          to_numpy(std::move(violation), {count}), to_numpy(std::move(iterations), {count})};
}

alula_encounter encounter_of(double distance, double closing, double radius, double envelope, double sigma2_p,
                             double sigma2_v) {
  alula_encounter m{};
  m.distance_m = static_cast<float>(distance);
  m.closing_m_s = static_cast<float>(closing);
  m.radius_m = static_cast<float>(radius);
  m.envelope = static_cast<float>(envelope);
  m.sigma2_p = static_cast<float>(sigma2_p);
  m.sigma2_v = static_cast<float>(sigma2_v);
  m.active = m.has_row = m.closing_m_s > 0;
  return m;
}

}  // namespace
}  // namespace alula

void bind_moving_filters(nb::module_& m) {
  using namespace alula;
  nb::class_<MovingReport>(m, "MovingReport", "Report of a filter among moving obstacles for one tick.")
      .def_prop_ro(
          "status", [](const MovingReport& r) { return static_cast<int>(r.status); },
          "0 nominal command, 1 another command that satisfies all rows, 3 minimum violation of the rows, 4 refused.")
      .def_prop_ro(
          "acceleration",
          [](const MovingReport& r) { return Triple{r.acceleration.x, r.acceleration.y, r.acceleration.z}; },
          "Acceleration to fly [m/s^2]; zero when refused, and then it must not be flown.")
      .def_ro("mode", &MovingReport::mode, "0 nominal, 1 avoid, 2 hover.")
      .def_ro("warned", &MovingReport::warned, "True when an obstacle triggers the warning in this tick.")
      .def_ro("risk_m", &MovingReport::risk_m, "The largest CVaR; 0 or more warns.")
      .def_ro("urgent", &MovingReport::urgent, "Index of the most urgent track or -1.")
      .def_ro("horizon_s", &MovingReport::horizon_s, "Horizon of the rows [s].")
      .def_ro("feasible", &MovingReport::feasible, "Rows and box have a common point.")
      .def_ro("rows", &MovingReport::rows, "Number of rows.")
      .def_ro("iterations", &MovingReport::iterations, "Iterations of the solver.")
      .def_ro("violation", &MovingReport::violation, "Violation of the rows, minus infinity without rows.")
      .def_ro("risk_left", &MovingReport::risk_left, "Sum over obstacles of Cantelli's bound at the command.");
  nb::class_<MovingFilter>(m, "MovingFilter", "A filter among moving obstacles; make one with `moving_filter`.")
      .def(
          "filter", &filter, "position"_a, "velocity"_a, "tracks"_a, "walls"_a, "nominal"_a,
          "covariance"_a = std::array<double, 6>{}, "repeats"_a = 0,
          "Filter one tick: the report, and the median time [s] of `repeats` copies of it. `tracks` (n, 29): id, "
          "position,\n"
          "velocity, lower triangle of their covariance row by row, radius. `walls` (m, 4): unit normal towards the\n"
          "vehicle, distance. `covariance` xx, xy, xz, yy, yz, zz of the vehicle's position.")
      .def(
          "flown", [](MovingFilter& self, std::array<double, 3> a) { self.flown({a[0], a[1], a[2]}); },
          "acceleration"_a, "Report the acceleration that is flown in a refused tick.")
      .def("reset", &MovingFilter::reset, "Reset to the state before the first tick.")
      .def("clone", &MovingFilter::clone, "A copy with the same state.");
  m.def("moving_filter", &make, "method"_a, "options"_a = Numbers{}, "backend"_a = nb::none(),
        "Create none, dr_acbf, dr_acbf_qp, mpc, cbf_qp or rp_cbf; `options` override `moving_filter_defaults`; "
        "`backend`\n"
        "solves its quadratic programs, as in QpSolver. ValueError for invalid options.");
  m.def(
      "moving_filter_defaults",
      [] {
        Numbers numbers;
        MovingFilterOptions options = defaults();
        each_field<MovingFilterOptions>(options, [&](const std::string& name, const auto&, const auto& value) {
          numbers[name] = static_cast<double>(value);
        });
        return numbers;
      },
      "All options of `moving_filter` with their defaults.");

  m.def("half_space_projection", &project, "rows"_a, "a0"_a, "solver"_a = "exact", nb::kw_only(), "limit"_a = 6.0,
        "omega"_a = 1.0, "iterations"_a = 15, "soft"_a = 4294967295u, "repeats"_a = 1,
        "min |a - a0| with rows (n, b): n . a <= b and |a|_inf <= limit, by exact, gs or least-violation: (a, "
        "feasible,\n"
        "violation, iterations, basis, seconds).");
  m.def("half_space_projections", &project_many, "rows"_a, "a0"_a, "limit"_a = 6.0,
        "Exact projections of rows (k, n, 4): a (k, 3), feasible, violation and iterations (k).");
  m.def(
      "early_warning",
      [](const Triple& position, const Triple& velocity, const Tracks& track, const Triple& acceleration,
         const std::array<double, 6>& covariance, const Numbers& numbers) {
        alula_avoidance avoidance;
        const MovingFilterOptions options = options_of(numbers);
        if (alula_avoidance_init(&avoidance, &options.config.avoidance) != ALULA_READY || track.shape(0) != 1) {
          throw std::invalid_argument("one track and options in their ranges");
        }
        const alula_vehicle_state vehicle = vehicle_of(position, velocity, covariance);
        const auto tracks = tracks_of(track);
        const float a[3] = {static_cast<float>(acceleration[0]), static_cast<float>(acceleration[1]),
                            static_cast<float>(acceleration[2])};
        return static_cast<double>(alula_early_warning(&avoidance, &vehicle, tracks.data(), a));
      },
      "position"_a, "velocity"_a, "track"_a, "relative_acceleration"_a, "covariance"_a = std::array<double, 6>{},
      "options"_a = Numbers{}, "Maximum over five times of the CVaR of Z, rounded up, plus eps L_Z [m].");
  m.def(
      "early_warning_tails",
      [](double tail) {
        float of_normal = 0, of_square = 0;
        alula_early_warning_tails(static_cast<float>(tail), &of_normal, &of_square);
        return std::tuple<double, double>(of_normal, of_square);
      },
      "tail"_a, "CVaR of a standard normal variable and of its square, rounded up.");
  m.def(
      "acceleration_envelope",
      [](const InRows3<double>& velocity, const Numbers& numbers) {
        alula_avoidance avoidance;
        const MovingFilterOptions options = options_of(numbers);
        if (alula_avoidance_init(&avoidance, &options.config.avoidance) != ALULA_READY) {
          throw std::invalid_argument("options out of range");
        }
        std::vector<float> rows;
        for (std::size_t i = 0; i < velocity.shape(0); ++i) {
          alula_track track{};
          track.position[0] = 100;
          for (std::size_t k = 0; k < 3; ++k) track.velocity[k] = static_cast<float>(velocity.data()[3 * i + k]);
          const alula_vehicle_state vehicle{};
          const float nominal[3] = {0, 0, 0};
          alula_guidance guidance;
          if (alula_avoidance_step(&avoidance, &vehicle, &track, 1, nullptr, 0, nominal, &guidance) != ALULA_READY) {
            throw std::invalid_argument("velocities must be finite");
          }
          rows.insert(rows.end(), avoidance.envelope[0].z1, avoidance.envelope[0].z1 + 3);
          rows.push_back(avoidance.envelope[0].bound);
        }
        return to_numpy(std::move(rows), {velocity.shape(0), 4});
      },
      "velocity"_a, "options"_a = Numbers{}, "z1 and ahat (k, 4) after each of the velocities (k, 3).");
  m.def(
      "allocate_risk",
      [](const InVector<double>& distance, const InVector<double>& closing, double total, bool receding) {
        std::vector<alula_encounter> all;
        for (std::size_t i = 0; i < distance.size(); ++i) {
          all.push_back(encounter_of(distance.data()[i], closing.data()[i], 0, 0, 0, 0));
          if (receding) all.back().has_row = 1;
        }
        std::vector<float> alpha(all.size());
        alula_allocate_risk(all.data(), static_cast<std::uint32_t>(all.size()), static_cast<float>(total),
                            alpha.data());
        const std::size_t count = alpha.size();
        return to_numpy(std::move(alpha), {count});
      },
      "distance"_a, "closing"_a, "total"_a, "receding"_a = false,
      "Risks alpha_i of the obstacles; 0 for obstacles with closing <= 0 unless `receding`.");
  m.def(
      "row_bound",
      [](double distance, double closing, double horizon, double lambda, double radius, double envelope,
         double sigma2_p, double sigma2_v, const Numbers& numbers) {
        const MovingFilterOptions options = options_of(numbers);
        const alula_encounter e = encounter_of(distance, closing, radius, envelope, sigma2_p, sigma2_v);
        return static_cast<double>(
            alula_row_bound(&options.config, &e, static_cast<float>(horizon), static_cast<float>(lambda)));
      },
      "distance"_a, "closing"_a, "horizon_s"_a, "lambda_"_a, nb::kw_only(), "radius_m"_a = 0.3, "envelope"_a = 1.0,
      "sigma2_p"_a = 0.0, "sigma2_v"_a = 0.0, "options"_a = Numbers{}, "b(H) of a row [m/s^2].");
  m.def(
      "cantelli", [](double alpha) { return static_cast<double>(alula_cantelli(static_cast<float>(alpha))); },
      "alpha"_a, "sqrt((1 - alpha) / alpha).");
  m.def(
      "recursive_speed",
      [](double a_max, double horizon) {
        return static_cast<double>(
            alula_dr_acbf_recursive_speed(static_cast<float>(a_max), static_cast<float>(horizon)));
      },
      "a_max"_a, "horizon_s"_a, "Closing speed below which the rows never demand more than a_max.");
}
