// The Hungarian method of `assign` in tracker.hpp, with memory that is kept between calls.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace alula::flight {

class Assignment {
 public:
  // Reserves memory for this many rows and columns; smaller problems allocate nothing.
  void reserve(std::size_t rows, std::size_t columns);
  // The column of each row, or -1; valid until the next call. As `assign`, without its checks.
  std::span<const int> solve(std::span<const double> cost, std::size_t rows, std::size_t columns, double gate);

 private:
  std::vector<double> row_price_, column_price_, slack_;
  std::vector<int> owner_, from_, column_;
  std::vector<char> is_reached_;
};

}  // namespace alula::flight
