// Rows a . u >= b of a barrier's quadratic program, without the rows that every input within its limits satisfies.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "alula/qp/qp.hpp"

namespace alula {

template <std::size_t M>
class BarrierRows {
 public:
  using Input = std::array<double, M>;

  // Starts with the rows of the input limits.
  void begin(const Input& low, const Input& high) {
    low_ = low, high_ = high;
    row_.clear(), bound_.clear();
    for (std::size_t j = 0; j < M; ++j) {
      Input unit{};
      unit[j] = 1, push(unit, low[j]);
      unit[j] = -1, push(unit, -high[j]);
    }
  }

  // d/dt h + alpha h >= 0, where h changes with `drift` without an input and `along[j]` for each unit of input j.
  // The row is left out when the minimum of its left side over the limits satisfies it: then it cannot bind.
  void add(double h, double drift, const Input& along, double alpha) {
    const double bound = -(drift + alpha * h);
    double least = 0;
    for (std::size_t j = 0; j < M; ++j) least += along[j] * (along[j] > 0 ? low_[j] : high_[j]);
    if (!(least >= bound)) push(along, bound);
  }

  // The input nearest to `target` in units of `scale` that satisfies all rows.
  QpResult nearest(const Input& target, const Input& scale) {
    std::array<double, M * M> hessian{};
    std::array<double, M> gradient{};
    for (std::size_t j = 0; j < M; ++j) {
      hessian[j * M + j] = 1 / (scale[j] * scale[j]);
      gradient[j] = -target[j] * hessian[j * M + j];
    }
    return solver_.solve({M, hessian, gradient, row_, bound_});
  }

  std::size_t size() const { return bound_.size(); }

 private:
  void push(const Input& row, double bound) {
    row_.insert(row_.end(), row.begin(), row.end());
    bound_.push_back(bound);
  }

  Input low_{}, high_{};
  std::vector<double> row_, bound_;
  QpSolver solver_;
};

}  // namespace alula
