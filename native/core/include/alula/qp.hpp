// Small dense convex quadratic programs with many rows, solved exactly.
//
//   minimise  1/2 x^T H x + g^T x   subject to   a_i . x >= b_i,  i = 0..m-1
//
// H symmetric positive definite, n <= kQpMaxVariables. A dual active-set method (Goldfarb, Idnani 1983):
// it starts at the unconstrained minimiser, so needs no feasible point, and ends after finitely many
// exchanges either at the minimiser, with multipliers, or with a Farkas certificate that there is none.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace alula {

inline constexpr std::size_t kQpMaxVariables = 8;

enum class QpStatus : std::uint8_t {
  optimal,
  infeasible,  // `multiplier` y >= 0 proves it: y^T A = 0 up to rounding, y^T b > 0
  failed       // a number is not finite, H is not positive definite, or rounding prevents a verdict
};

struct QpProblem {
  std::size_t n = 0;
  std::span<const double> hessian;   // (n, n)
  std::span<const double> gradient;  // (n)
  std::span<const double> rows;      // (m, n)
  std::span<const double> bounds;    // (m)
};

struct QpResult {
  QpStatus status = QpStatus::failed;
  std::array<double, kQpMaxVariables> x{};  // the minimiser when optimal
  std::size_t active_count = 0;
  std::array<std::uint32_t, kQpMaxVariables + 1> active{};  // rows with a multiplier, ascending
  std::array<double, kQpMaxVariables + 1> multiplier{};     // of those rows: H x + g = A^T y, or the certificate
  double violation = 0;  // max_i (b_i - a_i . x) / |a_i|, never below 0; of the result, recomputed from the input
  int iterations = 0;
};

// Holds the workspace: `solve` allocates nothing once it has seen as many rows. Deterministic: equal
// problems give equal bits, whatever was solved before unless `warm` names rows to start from.
class QpSolver {
 public:
  QpSolver() = default;
  explicit QpSolver(std::size_t rows) { reserve(rows); }
  void reserve(std::size_t rows);

  // `warm`: rows believed active, for instance those of the last tick; wrong ones cost time, not correctness.
  QpResult solve(const QpProblem& problem, std::span<const std::uint32_t> warm = {});

 private:
  std::vector<double> scale_;
  std::vector<std::uint8_t> in_set_;
};

}  // namespace alula
