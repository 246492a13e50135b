#include "alula/qp/qp.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "alula/qp/qp_check.hpp"
#include "alula/qp/qp_columns.hpp"
#include "alula/qp/qp_dual.hpp"

namespace alula {
namespace {

using qp::Columns;
using qp::DualPass;
using qp::Outcome;
using qp::Prepared;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

void check_sizes(const QpProblem& p) {
  const std::size_t m = p.bounds.size();
  if (p.n < 1 || p.n > kQpMaxVariables) throw std::invalid_argument("a quadratic program has 1 to 10 variables");
  if (m >= qp::kNone) throw std::invalid_argument("too many rows");
  if (p.hessian.size() != p.n * p.n || p.gradient.size() != p.n || p.rows.size() != m * p.n) {
    throw std::invalid_argument("the arrays of a quadratic program do not fit together");
  }
}

QpResult failed(int iterations) {
  QpResult result;
  result.violation = kInfinity;
  result.iterations = iterations;
  return result;
}

bool all_finite(std::span<const double> values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

// The slow and careful run, for what double precision cannot settle. What is infeasible by less than a
// certificate can show, and feasible by more than a proof bears, is taken for feasible.
QpResult solve_wide(const QpProblem& problem, int iterations) {
  for (const double loose : {1.0, qp::kLoose}) {
    DualPass<qp::Wide, 0> pass(problem, loose);
    QpResult result;
    if (!pass.factor()) break;
    const Outcome outcome = pass.run({}, {}, result);
    result.iterations += iterations;
    if (outcome != Outcome::stuck) return result;
    iterations = result.iterations;
  }
  return failed(iterations);
}

}  // namespace

QpSolver QpSolver::with_backend(QpBackend backend) {
  QpSolver solver;
  solver.backend_ = std::move(backend);
  return solver;
}

void QpSolver::reserve(std::size_t rows) {
  const std::size_t size = Columns::size_for(rows, kQpMaxVariables);
  if (columns_.size() < size) columns_.resize(size);
}

template <int N>
QpResult QpSolver::solve_with(const QpProblem& problem, std::span<const std::uint32_t> warm) {
  int iterations = 0;
  for (const bool cold : {false, true}) {
    if (cold && warm.empty()) break;
    DualPass<double, N> pass(problem);
    const bool factored = pass.factor();
    Columns columns(columns_.data(), problem.bounds.size());
    std::uint32_t bad = qp::kNone;
    const Prepared prepared =
        columns.fill<N>(problem, pass.lower(), pass.inverse_diagonal(), DualPass<double, N>::kMax, bad);
    if (prepared == Prepared::not_finite) return failed(0);
    QpResult result;
    if (prepared == Prepared::impossible) {
      result.status = QpStatus::infeasible;
      result.active_count = 1;
      result.active[0] = bad;
      result.multiplier[0] = 1;
      result.violation = problem.bounds[bad];
      return result;
    }
    if (!factored || prepared == Prepared::extreme) break;
    const Outcome outcome = pass.run(columns, cold ? std::span<const std::uint32_t>{} : warm, result);
    result.iterations += iterations;
    if (outcome != Outcome::stuck) return result;
    iterations = result.iterations;
  }
  return solve_wide(problem, iterations);
}

QpResult QpSolver::solve(const QpProblem& problem, std::span<const std::uint32_t> warm) {
  check_sizes(problem);
  if (!all_finite(problem.hessian) || !all_finite(problem.gradient)) return failed(0);
  if (backend_) {
    if (!all_finite(problem.rows) || !all_finite(problem.bounds)) return failed(0);
    QpResult result = backend_(problem);
    if (result.status == QpStatus::failed || !all_finite(result.x)) return failed(result.iterations);
    if (result.status == QpStatus::optimal) {
      result.violation = qp::violations<0>(problem, result.x.data()).greatest;
    } else {
      result.violation = 0;
      for (std::size_t k = 0; k < result.active_count; ++k) {
        result.violation += result.multiplier[k] * problem.bounds[result.active[k]];
      }
    }
    return result;
  }
  const std::size_t size = Columns::size_for(problem.bounds.size(), problem.n);
  if (columns_.size() < size) columns_.resize(size);
  switch (problem.n) {
    case 3:
      return solve_with<3>(problem, warm);
    case 4:
      return solve_with<4>(problem, warm);
    case 5:
      return solve_with<5>(problem, warm);
    case 8:
      return solve_with<8>(problem, warm);
    case 10:
      return solve_with<10>(problem, warm);
    default:
      return solve_with<0>(problem, warm);
  }
}

}  // namespace alula
