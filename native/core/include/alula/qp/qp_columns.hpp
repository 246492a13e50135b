// The scaled rows (c_i, d_i) of qp_dual.hpp, transposed so that several are looked at at once.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

#include "alula/qp/qp_check.hpp"

namespace alula::qp {

// Two numbers side by side: what the oldest supported x86-64 and every ARMv8 processor has.
using Pair = double __attribute__((vector_size(16)));

inline Pair load_pair(const double* from) {
  Pair v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline void store_pair(double* to, Pair v) { std::memcpy(to, &v, sizeof v); }

enum class Prepared : std::uint8_t { good, extreme, not_finite, impossible };

// A view of the solver's workspace.
class Columns {
 public:
  static std::size_t stride_for(std::size_t rows) {
    const std::size_t stride = (rows + 3) / 4 * 4;
    return stride % 512 == 0 ? stride + 4 : stride;  // columns a page apart share cache lines
  }
  static std::size_t size_for(std::size_t rows, std::size_t n) { return stride_for(rows) * (n + 1); }

  Columns() = default;
  Columns(double* memory, std::size_t rows) : d_(memory), stride_(stride_for(rows)), c_(memory + stride_) {}

  // Fills all rows; `lower` is L in rows of `pitch`. `extreme`: a row is too large or too small for double
  // precision; `impossible`: row `bad` is zero and asks for more than that.
  template <int N>
  Prepared fill(const QpProblem& p, const double* lower, const double* inverse, std::size_t pitch,
                std::uint32_t& bad) {
    const std::size_t n = N > 0 ? static_cast<std::size_t>(N) : p.n, m = p.bounds.size();
    Prepared prepared = Prepared::good;
    for (std::size_t i = 0; i < stride_; i += 2) {
      if (i >= m) {
        for (std::size_t j = 0; j < n; ++j) store_pair(c_ + j * stride_ + i, Pair{0, 0});
        store_pair(d_ + i, Pair{kNever, kNever});
        continue;
      }
      const std::size_t other = i + 1 < m ? i + 1 : i;
      const double *first = p.rows.data() + i * n, *second = p.rows.data() + other * n;
      std::array<Pair, (N > 0 ? static_cast<std::size_t>(N) : kQpMaxVariables)> c;
      Pair squares = {0, 0};
      for (std::size_t j = 0; j < n; ++j) {
        Pair sum = {first[j], second[j]};
        for (std::size_t k = 0; k < j; ++k) sum -= lower[j * pitch + k] * c[k];
        c[j] = sum * inverse[j];
        squares += c[j] * c[j];
      }
      const Pair norm = {std::sqrt(squares[0]), std::sqrt(squares[1])};
      const Pair scale = 1.0 / norm;
      const Pair d = Pair{p.bounds[i], p.bounds[other]} * scale;
      for (std::size_t j = 0; j < n; ++j) store_pair(c_ + j * stride_ + i, c[j] * scale);
      store_pair(d_ + i, d);
      for (std::size_t lane = 0; lane < 2 && i + lane < stride_; ++lane) {
        if (squares[lane] > 1e-280 && squares[lane] < 1e280 && std::fabs(d[lane]) < 1e280) continue;
        if (i + lane >= m) continue;
        for (std::size_t j = 0; j < n; ++j) c_[j * stride_ + i + lane] = 0;
        hide(static_cast<std::uint32_t>(i + lane));
        const Prepared found = judge(p, i + lane);
        if (found == Prepared::impossible && prepared != Prepared::impossible)
          bad = static_cast<std::uint32_t>(i + lane);
        if (found > prepared && prepared != Prepared::not_finite) prepared = found;
        if (found == Prepared::not_finite) prepared = found;
      }
      if (other == i) hide(static_cast<std::uint32_t>(i + 1));
    }
    return prepared;
  }

  // Active rows are not looked at.
  void hide(std::uint32_t row) { d_[row] = kNever; }
  void restore(std::uint32_t row, double d) { d_[row] = d; }

  // Largest d_i - c_i . z above the tolerance, the lowest i among equals; kNone when there is none.
  template <int N>
  std::uint32_t most_violated(std::size_t variables, const double* z, double tolerance) const {
    const std::size_t n = N > 0 ? static_cast<std::size_t>(N) : variables;
    std::array<Pair, 2> best = {Pair{tolerance, tolerance}, Pair{tolerance, tolerance}};
    std::array<Pair, 2> at = {Pair{-1, -1}, Pair{-1, -1}}, index = {Pair{0, 1}, Pair{2, 3}};
    for (std::size_t i = 0; i < stride_; i += 4) {
      for (std::size_t half = 0; half < 2; ++half) {
        Pair v = load_pair(d_ + i + 2 * half);
        for (std::size_t j = 0; j < n; ++j) v -= load_pair(c_ + j * stride_ + i + 2 * half) * z[j];
        const auto better = v > best[half];
        best[half] = better ? v : best[half];
        at[half] = better ? index[half] : at[half];
        index[half] += 4.0;
      }
    }
    double greatest = tolerance, row = -1;
    for (std::size_t lane = 0; lane < 4; ++lane) {
      const double value = best[lane / 2][lane % 2], where = at[lane / 2][lane % 2];
      if (where >= 0 && (value > greatest || (value == greatest && where < row))) {
        greatest = value;
        row = where;
      }
    }
    return row >= 0 ? static_cast<std::uint32_t>(row) : kNone;
  }

  std::uint32_t first_violated(std::size_t n, const double* z, double tolerance) const {
    for (std::size_t i = 0; i < stride_; ++i) {
      double v = d_[i];
      for (std::size_t j = 0; j < n; ++j) v -= c_[j * stride_ + i] * z[j];
      if (v > tolerance) return static_cast<std::uint32_t>(i);
    }
    return kNone;
  }

  // Why a row has no scaled form; good: it is zero and asks for nothing.
  static Prepared judge(const QpProblem& p, std::size_t i) {
    bool zero = true, finite = std::isfinite(p.bounds[i]);
    for (std::size_t j = 0; j < p.n; ++j) {
      zero = zero && p.rows[i * p.n + j] == 0;
      finite = finite && std::isfinite(p.rows[i * p.n + j]);
    }
    if (!finite) return Prepared::not_finite;
    if (!zero) return Prepared::extreme;
    return p.bounds[i] > 0 ? Prepared::impossible : Prepared::good;
  }

 private:
  static constexpr double kNever = -std::numeric_limits<double>::infinity();

  double* d_ = nullptr;
  std::size_t stride_ = 0;
  double* c_ = nullptr;  // column j starts at j * stride_
};

}  // namespace alula::qp
