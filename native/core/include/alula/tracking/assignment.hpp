// The method behind `assign` of tracker.hpp, with memory that is kept between calls.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace alula::flight {

class Assignment {
 public:
  // Room for this many rows and columns, so that nothing is allocated up to there.
  void reserve(std::size_t rows, std::size_t columns);
  // For each row its column or -1; valid until the next call. As `assign`, without its checks.
  std::span<const int> solve(std::span<const double> cost, std::size_t rows, std::size_t columns, double gate);

 private:
  std::vector<double> row_price_, column_price_, slack_;
  std::vector<int> owner_, from_, column_;
  std::vector<char> is_reached_;
};

}  // namespace alula::flight
