// Proofs of the verdicts of qp.hpp: residuals of the input itself, accumulated in extended precision.
//
// Private to qp.cpp. `violations` and `is_stationary` prove an optimum, `is_certificate` proves that there is no
// feasible point, and `Certificate` builds that proof from approximate multipliers.
#pragma once

#include <algorithm>
#include <array>
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

// |v|; a subnormal number counts as the smallest normal one, because it is rounded like one.
template <class Real>
Wide magnitude(Real v) {
  const Wide size = std::fabs(static_cast<Wide>(v)), smallest = std::numeric_limits<double>::min();
  return size < smallest ? smallest : size;
}

// |sum| <= bound; an overflowed bound proves nothing.
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
    if (gap <= 0) continue;  // NaN is examined further
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

// True if x is finite, y >= 0 of the given rows makes it stationary, and these rows hold with equality.
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

// True if y >= 0 of the given rows proves that no x satisfies them all; `gain` is y^T b.
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

// Builds a Farkas certificate from approximate multipliers y > 0: y^T A = 0 and y^T b > 0, so no x satisfies all
// rows.
class Certificate {
 public:
  void append(const QpProblem& p, std::uint32_t row, Wide y) { terms_[size_++] = {row, y, y * row_norm(p, row)}; }

  // Drops the rows whose weight is negligible beside the others.
  Certificate without_noise() const {
    Wide greatest = 0;
    for (std::size_t k = 0; k < size_; ++k) greatest = std::max(greatest, terms_[k].weight);
    Certificate kept;
    for (std::size_t k = 0; k < size_; ++k) {
      if (terms_[k].weight > kCertain * greatest) kept.terms_[kept.size_++] = terms_[k];
    }
    return kept;
  }

  // Solves least squares for relative changes e_k of y that make y^T A zero. Each column is scaled by the sum of
  // the magnitudes of its terms, so a column of small entries counts as much as one of large ones that cancel.
  void balance(const QpProblem& p) {
    for (int pass = 0; pass < 3; ++pass) {
      Column rest{}, size{};
      for (std::size_t j = 0; j < p.n; ++j) {
        for (std::size_t k = 0; k < size_; ++k) {
          const Wide term = p.rows[terms_[k].row * p.n + j] * terms_[k].y;
          rest[j] -= term;
          size[j] += std::fabs(term);
        }
        if (size[j] > 0) rest[j] /= size[j];
      }
      std::array<Column, kMost> basis{}, triangle{};
      Column parts{};
      std::array<std::size_t, kMost> used{};
      std::size_t count = 0;
      for (std::size_t k = 1; k < size_ && count < p.n; ++k) {  // all but one: the scale of y stays
        Column v{};
        for (std::size_t j = 0; j < p.n; ++j) {
          if (size[j] > 0) v[j] = p.rows[terms_[k].row * p.n + j] * terms_[k].y / size[j];
        }
        const Wide whole = dot(v, v);
        for (int twice = 0; twice < 2; ++twice) {
          for (std::size_t l = 0; l < count; ++l) {
            const Wide part = dot(basis[l], v);
            triangle[count][l] += part;
            for (std::size_t j = 0; j < p.n; ++j) v[j] -= part * basis[l][j];
          }
        }
        const Wide square = dot(v, v);
        if (!(square > 1e-30L * whole)) {
          triangle[count] = {};
          continue;
        }
        triangle[count][count] = std::sqrt(square);
        for (std::size_t j = 0; j < p.n; ++j) basis[count][j] = v[j] / triangle[count][count];
        parts[count] = dot(basis[count], rest);
        used[count++] = k;
      }
      for (std::size_t l = count; l-- > 0;) {
        for (std::size_t k = l + 1; k < count; ++k) parts[l] -= triangle[k][l] * parts[k];
        parts[l] /= triangle[l][l];
      }
      for (std::size_t l = 0; l < count; ++l) {
        terms_[used[l]].weight *= 1 + parts[l];
        terms_[used[l]].y *= 1 + parts[l];
      }
    }
  }

  // Rounds y to double, scales it and checks it; stores it as the result if it is a certificate.
  bool prove(const QpProblem& p, QpResult& result) const {
    std::array<Term, kMost> sorted = terms_;
    std::sort(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(size_),
              [](const Term& a, const Term& b) { return a.row < b.row; });
    Wide total = 0;
    for (std::size_t k = 0; k < size_; ++k) total += sorted[k].weight;
    std::array<std::uint32_t, kMost> rows{};
    std::array<double, kMost> y{};
    std::size_t size = 0;
    for (std::size_t k = 0; k < size_; ++k) {
      rows[size] = sorted[k].row;
      y[size] = static_cast<double>(sorted[k].y / total);
      if (!(y[size] >= 0)) return false;
      if (y[size] > 0) ++size;
    }
    double gain = 0;
    if (!is_certificate(p, {rows.data(), size}, y.data(), gain)) return false;
    result.status = QpStatus::infeasible;
    result.active_count = size;
    std::copy_n(rows.begin(), size, result.active.begin());
    std::copy_n(y.begin(), size, result.multiplier.begin());
    result.violation = gain;
    return true;
  }

 private:
  static constexpr std::size_t kMost = kQpMaxVariables + 1;
  using Column = std::array<Wide, kMost>;
  struct Term {
    std::uint32_t row = kNone;
    Wide y = 0, weight = 0;  // weight: y |a|
  };

  static Wide dot(const Column& a, const Column& b) {
    Wide sum = 0;
    for (std::size_t j = 0; j < kQpMaxVariables; ++j) sum += a[j] * b[j];
    return sum;
  }

  std::array<Term, kMost> terms_{};
  std::size_t size_ = 0;
};

}  // namespace alula::qp
