// Multipliers y > 0 on their way to a proof that no x obeys all rows: y^T A = 0, y^T b > 0.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "alula/qp/qp_check.hpp"

namespace alula::qp {

class Certificate {
 public:
  void append(const QpProblem& p, std::uint32_t row, Wide y) { terms_[size_++] = {row, y, y * row_norm(p, row)}; }

  // Without the rows that weigh nothing beside the others.
  Certificate without_noise() const {
    Wide greatest = 0;
    for (std::size_t k = 0; k < size_; ++k) greatest = std::max(greatest, terms_[k].weight);
    Certificate kept;
    for (std::size_t k = 0; k < size_; ++k) {
      if (terms_[k].weight > kCertain * greatest) kept.terms_[kept.size_++] = terms_[k];
    }
    return kept;
  }

  // Least squares for relative changes e_k of y that make y^T A zero, each column measured by the sum of its
  // terms: a column of small entries counts as much as one of large ones that cancel.
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
      for (std::size_t k = 1; k < size_ && count < p.n; ++k) {  // all but one: y has a scale to keep
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

  // Rounded to double and scaled, is it one? Then it is the result.
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
