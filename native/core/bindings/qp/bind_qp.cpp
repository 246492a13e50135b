// Bindings of alula/qp/qp.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <stdexcept>
#include <utility>
#include <vector>

#include "alula/qp/qp.hpp"
#include "arrays.hpp"
#include "python_qp.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace alula;

namespace {

using Matrix = In<double, nb::shape<-1, -1>>;
using Stack = In<double, nb::shape<-1, -1, -1>>;
using Names = In<std::uint32_t, nb::shape<-1>>;

template <class T>
nb::ndarray<nb::numpy, T> copied(std::span<const T> values, std::initializer_list<std::size_t> shape) {
  return to_numpy(std::vector<T>(values.begin(), values.end()), shape);
}

QpProblem view(const Matrix& hessian, const InVector<double>& gradient, const Matrix& rows,
               const InVector<double>& bounds) {
  const std::size_t n = gradient.size();
  if (hessian.shape(0) != n || hessian.shape(1) != n || rows.shape(1) != n || rows.shape(0) != bounds.size()) {
    throw std::invalid_argument("the arrays of a quadratic program do not fit together");
  }
  return {n, as_span(hessian), as_span(gradient), as_span(rows), as_span(bounds)};
}

// n is not part of the result.
struct Answer {
  std::size_t n;
  QpResult result;
};

Answer solve(QpSolver& solver, Matrix hessian, InVector<double> gradient, Matrix rows, InVector<double> bounds,
             std::optional<Names> warm) {
  const QpProblem problem = view(hessian, gradient, rows, bounds);
  const nb::gil_scoped_release release;
  return {problem.n, solver.solve(problem, as_span(warm))};
}

// Solves all problems of a stack in order; see the docstring.
nb::typed<nb::dict, nb::str, nb::any> solve_many(QpSolver& solver, Stack hessian, Matrix gradient, Stack rows,
                                                 Matrix bounds,
                                                 std::optional<In<std::uint32_t, nb::shape<-1, -1>>> warm,
                                                 unsigned repeats) {
  const std::size_t count = gradient.shape(0), n = gradient.shape(1), m = bounds.shape(1);
  if (hessian.shape(0) != count || hessian.shape(1) != n || hessian.shape(2) != n || rows.shape(0) != count ||
      rows.shape(1) != m || rows.shape(2) != n || bounds.shape(0) != count || (warm && warm->shape(0) != count)) {
    throw std::invalid_argument("the arrays of a stack of quadratic programs do not fit together");
  }
  std::vector<double> x(count * n), multiplier(count * (n + 1)), violation(count), elapsed(count);
  std::vector<std::uint8_t> status(count);
  std::vector<std::int32_t> active(count * (n + 1), -1), iterations(count);
  {
    const nb::gil_scoped_release release;
    solver.reserve(m);
    for (std::size_t i = 0; i < count; ++i) {
      const QpProblem problem{n,
                              {hessian.data() + i * n * n, n * n},
                              {gradient.data() + i * n, n},
                              {rows.data() + i * m * n, m * n},
                              {bounds.data() + i * m, m}};
      std::span<const std::uint32_t> names;
      if (warm) names = {warm->data() + i * warm->shape(1), warm->shape(1)};
      QpResult result;
      for (unsigned run = 0; run < std::max(1u, repeats); ++run) {
        const auto start = std::chrono::steady_clock::now();
        result = solver.solve(problem, names);
        const double ns = std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count();
        elapsed[i] = run == 0 ? ns : std::min(elapsed[i], ns);
      }
      status[i] = static_cast<std::uint8_t>(result.status);
      std::copy_n(result.x.begin(), n, x.begin() + static_cast<std::ptrdiff_t>(i * n));
      for (std::size_t k = 0; k < result.active_count; ++k) {
        active[i * (n + 1) + k] = static_cast<std::int32_t>(result.active[k]);
        multiplier[i * (n + 1) + k] = result.multiplier[k];
      }
      violation[i] = result.violation;
      iterations[i] = result.iterations;
    }
  }
  nb::dict answer;
  answer["status"] = to_numpy(std::move(status), {count});
  answer["x"] = to_numpy(std::move(x), {count, n});
  answer["active"] = to_numpy(std::move(active), {count, n + 1});
  answer["multipliers"] = to_numpy(std::move(multiplier), {count, n + 1});
  answer["violation"] = to_numpy(std::move(violation), {count});
  answer["iterations"] = to_numpy(std::move(iterations), {count});
  answer["elapsed_ns"] = to_numpy(std::move(elapsed), {count});
  return answer;
}

QpResult ask(const nb::object& callable, const QpProblem& problem) {
  const nb::gil_scoped_acquire gil;
  const std::size_t n = problem.n, m = problem.bounds.size();
  const nb::object answer = callable(copied(problem.hessian, {n, n}), copied(problem.gradient, {n}),
                                     copied(problem.rows, {m, n}), copied(problem.bounds, {m}));
  const auto parts = nb::cast<nb::tuple>(answer);
  if (parts.size() != 4) throw std::invalid_argument("a QP backend answers (status, x, active, multipliers)");
  const auto status = nb::cast<int>(parts[0]);
  const auto x = nb::cast<std::vector<double>>(parts[1]);
  const auto active = nb::cast<std::vector<std::uint32_t>>(parts[2]);
  const auto multiplier = nb::cast<std::vector<double>>(parts[3]);
  if (status < 0 || status > 2 || x.size() != n || active.size() != multiplier.size() ||
      std::any_of(active.begin(), active.end(), [m](std::uint32_t row) { return row >= m; })) {
    throw std::invalid_argument("a QP backend gave an answer that does not fit its problem");
  }
  QpResult result;
  result.status = static_cast<QpStatus>(status);
  std::copy(x.begin(), x.end(), result.x.begin());
  // An interior-point method returns a multiplier for every row; the result stores the largest ones.
  std::vector<std::size_t> order(active.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  const std::size_t kept = std::min(order.size(), n + 1);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return multiplier[a] > multiplier[b]; });
  std::sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(kept),
            [&](std::size_t a, std::size_t b) { return active[a] < active[b]; });
  for (std::size_t k = 0; k < kept; ++k) {
    result.active[k] = active[order[k]];
    result.multiplier[k] = multiplier[order[k]];
  }
  result.active_count = kept;
  return result;
}

}  // namespace

QpBackend alula::qp_backend(nb::object callable) {
  if (callable.is_none()) return {};
  if (!PyCallable_Check(callable.ptr())) throw nb::type_error("a QP backend is a callable");
  const std::shared_ptr<nb::object> kept(new nb::object(std::move(callable)), [](nb::object* held) {
    const nb::gil_scoped_acquire gil;
    delete held;
  });
  return [kept](const QpProblem& problem) { return ask(*kept, problem); };
}

QpSolver alula::qp_solver(nb::object callable) {
  QpBackend backend = qp_backend(std::move(callable));
  return backend ? QpSolver::with_backend(std::move(backend)) : QpSolver();
}

void bind_qp(nb::module_& m) {
  nb::class_<Answer>(m, "QpResult", "Answer of `QpSolver.solve`.")
      .def_prop_ro(
          "status", [](const Answer& self) { return static_cast<int>(self.result.status); },
          "0 optimal, 1 infeasible, 2 failed.")
      .def_prop_ro(
          "x", [](const Answer& self) { return copied<double>({self.result.x.data(), self.n}, {self.n}); },
          nb::rv_policy::move, "The minimiser, shape (n,); zero unless optimal.")
      .def_prop_ro(
          "active",
          [](const Answer& self) {
            const std::size_t size = self.result.active_count;
            return copied<std::uint32_t>({self.result.active.data(), size}, {size});
          },
          nb::rv_policy::move, "Rows with a multiplier, ascending.")
      .def_prop_ro(
          "multipliers",
          [](const Answer& self) {
            const std::size_t size = self.result.active_count;
            return copied<double>({self.result.multiplier.data(), size}, {size});
          },
          nb::rv_policy::move, "Multipliers y of these rows: hessian x + gradient = rows^T y, or the certificate.")
      .def_prop_ro(
          "violation", [](const Answer& self) { return self.result.violation; },
          "Largest (b_i - a_i . x) / |a_i|, at least 0; when infeasible a lower bound for every x; infinite when "
          "failed.")
      .def_prop_ro("iterations", [](const Answer& self) { return self.result.iterations; }, "Number of exchanges.");
  nb::class_<QpSolver>(
      m, "QpSolver",
      "Solver of min 1/2 x^T H x + g^T x with rows x >= bounds; dense, up to 10 variables, active set.")
      .def(
          "__init__", [](QpSolver* self, nb::object backend) { new (self) QpSolver(qp_solver(std::move(backend))); },
          "backend"_a = nb::none(),
          "`backend(hessian, gradient, rows, bounds) -> (status, x, active, multipliers)` solves instead, if given.")
      .def("solve", &solve, "hessian"_a, "gradient"_a, "rows"_a, "bounds"_a, "warm"_a = nb::none(),
           "Solve one problem; `warm` lists rows that are probably active. ValueError when shapes do not fit.")
      .def("solve_many", &solve_many, "hessian"_a, "gradient"_a, "rows"_a, "bounds"_a, "warm"_a = nb::none(),
           "repeats"_a = 1,
           "Solve a stack of problems in order: arrays `status` (k,), `x` (k, n), `active` and `multipliers` "
           "(k, n + 1), filled up with -1 and 0, `violation`, `iterations` and `elapsed_ns` (k,), the minimum of "
           "`repeats`. `warm` (k, w) lists rows; numbers beyond the rows are ignored.");
}
