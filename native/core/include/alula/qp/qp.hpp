// Small dense convex quadratic programs with many rows, solved exactly.
//
//   minimise  1/2 x^T H x + g^T x   subject to   a_i . x >= b_i,  i = 0..m-1
//
// H symmetric positive definite, n <= kQpMaxVariables. A dual active-set method (Goldfarb, Idnani 1983):
// it starts at the unconstrained minimiser, so needs no feasible point, and ends after finitely many
// exchanges either at the minimiser, with multipliers, or with a Farkas certificate that no x is feasible.
// Every verdict is proved from the input itself before it is returned, see `QpStatus`.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace alula {

inline constexpr std::size_t kQpMaxVariables = 10;

// u = 2^-53; absolute values and comparisons are componentwise.
enum class QpStatus : std::uint8_t {
  // b - A x <= 32 u (|A| |x| + |b|), with equality up to the same in rows with a multiplier y > 0, and
  // |H x + g - A^T y| <= 256 u (|H| |x| + |g| + |A|^T y): x solves a program that differs by rounding. If rows
  // contradict each other by too little for a certificate, the bounds are 128 times as large, 5e-13; see
  // `violation`.
  optimal,
  // `multiplier` y >= 0 has |y^T A| <= 32 u y^T |A| and y^T b > 32 u y^T |b|: no x satisfies all rows, except
  // possibly some x beyond the range of double precision, |y^T A| |x| >= y^T b.
  infeasible,
  // A number is not finite, H is not positive definite to rounding, or neither of the above can be proved, as for
  // rows that contradict each other up to tilts of about 1e-15. Treat it as infeasible without a proof.
  failed
};

struct QpProblem {
  std::size_t n = 0;
  std::span<const double> hessian;   // (n, n); only its symmetric part matters
  std::span<const double> gradient;  // (n)
  std::span<const double> rows;      // (m, n)
  std::span<const double> bounds;    // (m)
};

struct QpResult {
  QpStatus status = QpStatus::failed;
  std::array<double, kQpMaxVariables> x{};  // the minimiser when optimal, else zero
  std::size_t active_count = 0;
  std::array<std::uint32_t, kQpMaxVariables + 1> active{};  // rows with a multiplier, ascending
  // y of those rows, above 0: H x + g = A^T y; or the certificate, scaled so that sum_i y_i |a_i| = 1 (a row of
  // zeros with b > 0 stands alone, with y = 1).
  std::array<double, kQpMaxVariables + 1> multiplier{};
  // optimal: max_i (b_i - a_i . x) / |a_i|, never below 0, recomputed from the input.
  // infeasible: y^T b; every x violates some row by at least that. failed: infinite.
  double violation = 0;
  int iterations = 0;  // exchanges of the active set
};

// Another solver of the same programs, for instance Clarabel called through Python.
using QpBackend = std::function<QpResult(const QpProblem&)>;

// Holds the workspace: `solve` allocates nothing once it has solved a program with as many rows. Deterministic:
// without `warm`, equal problems give equal bits, whatever was solved before. One per thread.
class QpSolver {
 public:
  QpSolver() = default;
  explicit QpSolver(std::size_t rows) { reserve(rows); }
  // A solver that calls `backend` instead. Its result is returned without a proof, but x must be finite and the
  // violation is recomputed from the input: the caller decides how much violation it tolerates.
  static QpSolver with_backend(QpBackend backend);
  void reserve(std::size_t rows);
  bool has_backend() const { return static_cast<bool>(backend_); }

  // `warm`: rows expected to be active, for instance those of the last tick. Wrong ones cost time, not
  // correctness; row numbers out of range are ignored. Numbers that are not finite give `failed`.
  // Throws std::invalid_argument when a size does not fit, and whatever the backend throws.
  QpResult solve(const QpProblem& problem, std::span<const std::uint32_t> warm = {});

 private:
  template <int N>
  QpResult solve_with(const QpProblem& problem, std::span<const std::uint32_t> warm);

  std::vector<double> columns_;  // the scaled rows, transposed; see qp.cpp
  QpBackend backend_;
};

}  // namespace alula
