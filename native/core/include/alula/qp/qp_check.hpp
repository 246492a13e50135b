// The proofs behind the verdicts of qp.hpp: residuals of the input itself, accumulated in extended precision.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>

#include "alula/qp/qp.hpp"

namespace alula::qp {

using Wide = long double;

inline constexpr std::uint32_t kNone = 0xffffffffu;
inline constexpr double kUnit = 0x1p-53;
inline constexpr double kFeasible = 32 * kUnit;     // of |a_i| . |x| + |b_i|
inline constexpr double kStationary = 256 * kUnit;  // of (|H| |x| + |g| + |A|^T y)_j
inline constexpr double kLoose = 128;               // times these, where the strict proof does not exist
inline constexpr double kCertain = 32 * kUnit;      // of (y^T |A|)_j and of y^T |b|

// |v|; what is subnormal counts as the least normal number, as it is rounded like one.
template <class Real>
Wide magnitude(Real v) {
  const Wide size = std::fabs(static_cast<Wide>(v)), least = std::numeric_limits<double>::min();
  return size < least ? least : size;
}

// |sum| <= bound; what has overflowed proves nothing.
inline bool within(Wide sum, Wide bound) { return std::isfinite(bound) && std::fabs(sum) <= bound; }

inline Wide symmetric(const QpProblem& p, std::size_t j, std::size_t k) {
  return (static_cast<Wide>(p.hessian[j * p.n + k]) + static_cast<Wide>(p.hessian[k * p.n + j])) / 2;
}

// |a_i|, for any size of its entries.
inline double row_norm(const QpProblem& p, std::size_t i) {
  Wide sum = 0;
  for (std::size_t j = 0; j < p.n; ++j) sum += static_cast<Wide>(p.rows[i * p.n + j]) * p.rows[i * p.n + j];
  return static_cast<double>(std::sqrt(sum));
}

// a_i . x - b_i, and the size |a_i| . |x| + |b_i| of its terms.
template <class Real>
Wide slack(const QpProblem& p, std::size_t i, const Real* x, Wide& size) {
  Wide sum = -static_cast<Wide>(p.bounds[i]);
  size = std::fabs(sum);
  for (std::size_t j = 0; j < p.n; ++j) {
    const Wide a = p.rows[i * p.n + j];
    sum += a * x[j];
    size += std::fabs(a) * magnitude(x[j]);
  }
  return sum;
}

struct Violations {
  double greatest = 0;          // max_i (b_i - a_i . x) / |a_i|, at least 0
  std::uint32_t worst = kNone;  // the row violated most beyond rounding
};

// n is a template parameter for speed; 0: p.n.
template <int N>
Violations violations(const QpProblem& p, const double* x, double loose = 1) {
  const std::size_t n = N > 0 ? static_cast<std::size_t>(N) : p.n, m = p.bounds.size();
  Violations found;
  double worst = 0;
  for (std::size_t i = 0; i < m; ++i) {
    const double* a = p.rows.data() + i * n;
    double gap = p.bounds[i];
    for (std::size_t j = 0; j < n; ++j) gap -= a[j] * x[j];
    if (gap <= 0) continue;  // also what is not a number goes on
    Wide size = 0;
    const Wide exact = -slack(p, i, x, size);
    if (exact <= 0) continue;
    const double distance = static_cast<double>(exact) / row_norm(p, i);
    if (!(distance <= found.greatest)) found.greatest = distance;
    if (!within(exact, loose * kFeasible * size) && !(distance <= worst)) {
      worst = distance;
      found.worst = static_cast<std::uint32_t>(i);
    }
  }
  return found;
}

// Whether x is finite, y >= 0 of the given rows makes it stationary, and these rows hold with equality.
inline bool is_stationary(const QpProblem& p, const double* x, std::span<const std::uint32_t> rows, const double* y,
                          double loose) {
  for (std::size_t j = 0; j < p.n; ++j) {
    if (!std::isfinite(x[j])) return false;
    Wide sum = p.gradient[j], size = std::fabs(sum);
    for (std::size_t k = 0; k < p.n; ++k) {
      const Wide h = symmetric(p, j, k);
      sum += h * x[k];
      size += std::fabs(h) * magnitude(x[k]);
    }
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const Wide a = p.rows[rows[k] * p.n + j];
      sum -= a * y[k];
      size += std::fabs(a) * magnitude(y[k]);
    }
    if (!within(sum, loose * kStationary * size)) return false;
  }
  for (std::size_t k = 0; k < rows.size(); ++k) {
    Wide size = 0;
    const Wide distance = slack(p, rows[k], x, size);
    if (!(y[k] >= 0) || !within(distance, loose * kFeasible * size)) return false;
  }
  return true;
}

// Whether y >= 0 of the given rows proves that no x obeys them all; `gain` is y^T b.
inline bool is_certificate(const QpProblem& p, std::span<const std::uint32_t> rows, const double* y, double& gain) {
  for (std::size_t j = 0; j < p.n; ++j) {
    Wide sum = 0, size = 0;
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const Wide term = static_cast<Wide>(p.rows[rows[k] * p.n + j]) * y[k];
      sum += term;
      size += std::fabs(term);
    }
    if (!within(sum, kCertain * size)) return false;
  }
  Wide sum = 0, size = 0;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    if (!(y[k] >= 0)) return false;
    const Wide term = static_cast<Wide>(p.bounds[rows[k]]) * y[k];
    sum += term;
    size += std::fabs(term);
  }
  gain = static_cast<double>(sum);
  return std::isfinite(size) && sum > kCertain * size && std::isfinite(gain);
}

}  // namespace alula::qp
