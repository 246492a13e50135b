#include "alula/tracking/assignment.hpp"

#include <cmath>
#include <stdexcept>

#include "alula/base/constants.hpp"
#include "alula/tracking/tracker.hpp"

namespace alula::flight {
namespace {

constexpr double kLargest = 1e100;  // largest cost; sums of prices must stay finite

bool is_cost(double c) { return std::abs(c) <= kLargest; }

// Cost of a row without a column; without a gate, more than any exchange of assignments can save.
double idle_cost(std::span<const double> cost, double gate) {
  if (is_cost(gate)) return gate;
  double sum = 1;
  for (const double c : cost)
    if (is_cost(c)) sum += 2 * std::abs(c);
  return sum;
}

}  // namespace

void Assignment::reserve(std::size_t rows, std::size_t columns) {
  const std::size_t all = columns + rows + 1;
  row_price_.reserve(rows + 1), column_price_.reserve(all), slack_.reserve(all);
  owner_.reserve(all), from_.reserve(all), is_reached_.reserve(all), column_.reserve(rows);
}

// Every row also has a column of its own, which means no assignment. Rows and columns count from 1; column 0 holds
// the row being assigned. Prices keep all reduced costs at least 0 and those of assigned pairs 0.
std::span<const int> Assignment::solve(std::span<const double> cost, std::size_t rows, std::size_t columns,
                                       double gate) {
  const double idle = idle_cost(cost, gate);
  const std::size_t all = columns + rows;
  const auto cost_of = [&](std::size_t i, std::size_t j) {
    if (j > columns) return j - columns == i ? idle : kInfinity;
    const double c = cost[(i - 1) * columns + j - 1];
    return is_cost(c) && c <= gate ? c : kInfinity;
  };
  row_price_.assign(rows + 1, 0), column_price_.assign(all + 1, 0);
  owner_.assign(all + 1, 0), from_.assign(all + 1, 0);
  for (std::size_t row = 1; row <= rows; ++row) {
    slack_.assign(all + 1, kInfinity), is_reached_.assign(all + 1, 0);
    owner_[0] = static_cast<int>(row);
    std::size_t at = 0;
    do {
      is_reached_[at] = 1;
      const auto i = static_cast<std::size_t>(owner_[at]);
      std::size_t next = 0;
      double smallest = kInfinity;
      for (std::size_t j = 1; j <= all; ++j) {
        if (is_reached_[j]) continue;
        const double reduced = cost_of(i, j) - row_price_[i] - column_price_[j];
        if (reduced < slack_[j]) slack_[j] = reduced, from_[j] = static_cast<int>(at);
        if (slack_[j] < smallest) smallest = slack_[j], next = j;
      }
      for (std::size_t j = 0; j <= all; ++j) {
        if (is_reached_[j]) {
          row_price_[static_cast<std::size_t>(owner_[j])] += smallest, column_price_[j] -= smallest;
        } else {
          slack_[j] -= smallest;
        }
      }
      at = next;  // not 0: the row's own column is free, or that of its owner is reachable
    } while (owner_[at] != 0);
    for (; at != 0; at = static_cast<std::size_t>(from_[at]))
      owner_[at] = owner_[static_cast<std::size_t>(from_[at])];
  }
  column_.assign(rows, -1);
  for (std::size_t j = 1; j <= columns; ++j)
    if (owner_[j] != 0) column_[static_cast<std::size_t>(owner_[j] - 1)] = static_cast<int>(j - 1);
  return column_;
}

void assign(std::span<const double> cost, std::size_t rows, std::size_t columns, double gate,
            std::vector<int>& column) {
  if (cost.size() != rows * columns) throw std::invalid_argument("costs must be rows x columns");
  if (!(gate >= 0)) throw std::invalid_argument("the gate must be at least 0");
  Assignment method;
  const std::span<const int> result = method.solve(cost, rows, columns, gate);
  column.assign(result.begin(), result.end());
}

}  // namespace alula::flight
