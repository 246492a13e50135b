#include "alula/cover/occupancy.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "alula/base/wide.hpp"

namespace alula {

namespace {

std::size_t hash_column(std::int32_t x, std::int32_t y) {
  const std::uint64_t key = std::uint64_t{static_cast<std::uint32_t>(x)} << 32 | static_cast<std::uint32_t>(y);
  return static_cast<std::size_t>((key * 0x9E3779B97F4A7C15u) >> 20);
}

constexpr std::size_t kDense = 4;  // cells of the bounding rectangle per column, up to which each cell has an entry

}  // namespace

int sample_lines(std::int32_t extent, int most) {
  if (extent <= 3) return 4 * extent;
  if (extent <= 8) return 2 * extent;
  return std::min(extent, most);
}

Occupancy::Occupancy(std::span<const Lattice> voxels) : voxel_(voxels.begin(), voxels.end()) {
  if (voxel_.size() >= std::numeric_limits<std::uint32_t>::max()) throw std::invalid_argument("too many voxels");
  for (std::size_t i = 0; i < voxel_.size(); ++i) {
    for (const std::int32_t c : voxel_[i])
      if (c < -kLatticeLimit || c >= kLatticeLimit) throw std::invalid_argument("a voxel lies out of range");
    if (i > 0 && voxel_[i - 1] >= voxel_[i]) throw std::invalid_argument("voxels are not sorted and unique");
  }
  for (std::uint32_t i = 0; i < voxel_.size();) {
    Column column{voxel_[i][0], voxel_[i][1], i, i, 0, 0, 0};
    while (column.end < voxel_.size() && voxel_[column.end][0] == column.x && voxel_[column.end][1] == column.y)
      ++column.end;
    column.first_word = voxel_[i][2] >> 6;
    const std::uint32_t words = static_cast<std::uint32_t>((voxel_[column.end - 1][2] >> 6) - column.first_word + 1);
    if (words <= column.end - column.begin + 1) {
      column.word = static_cast<std::uint32_t>(word_.size());
      column.words = words;
      word_.resize(word_.size() + words, Word{0, 0});
      for (std::uint32_t v = i; v < column.end; ++v) {
        const std::int32_t z = voxel_[v][2];
        word_[column.word + static_cast<std::uint32_t>((z >> 6) - column.first_word)].bits |= std::uint64_t{1}
                                                                                              << (z & 63);
      }
      std::uint32_t before = 0;
      for (std::uint32_t w = column.word; w < word_.size(); ++w) {
        word_[w].before = before;
        before += static_cast<std::uint32_t>(std::popcount(word_[w].bits));
      }
    }
    i = column.end;
    column_.push_back(column);
  }
  index_columns();
}

void Occupancy::index_columns() {
  if (column_.empty()) return;
  std::int32_t low = column_[0].y, high = low;
  for (const Column& c : column_) low = std::min(low, c.y), high = std::max(high, c.y);
  low_x_ = column_[0].x, low_y_ = low;
  rows_ = static_cast<std::size_t>(column_.back().x - low_x_) + 1, width_ = static_cast<std::size_t>(high - low) + 1;
  if (rows_ * width_ <= kDense * column_.size() + 1024) {
    table_.assign(rows_ * width_, 0);
    for (std::uint32_t c = 0; c < column_.size(); ++c)
      table_[static_cast<std::size_t>(column_[c].x - low_x_) * width_ +
             static_cast<std::size_t>(column_[c].y - low_y_)] = c + 1;
    return;
  }
  if (rows_ <= 4 * column_.size() + 1024) {
    row_.assign(rows_ + 1, static_cast<std::uint32_t>(column_.size()));
    for (std::size_t c = column_.size(); c-- > 0;)
      row_[static_cast<std::size_t>(column_[c].x - low_x_)] = static_cast<std::uint32_t>(c);
    for (std::size_t r = rows_; r-- > 0;) row_[r] = std::min(row_[r], row_[r + 1]);
  }
  rows_ = width_ = 0;
  table_.assign(std::bit_ceil(2 * column_.size() + 1), 0);
  for (std::uint32_t c = 0; c < column_.size(); ++c) {
    std::size_t slot = hash_column(column_[c].x, column_[c].y);
    while (table_[slot & (table_.size() - 1)] != 0) ++slot;
    table_[slot & (table_.size() - 1)] = c + 1;
  }
}

const Occupancy::Column* Occupancy::find(std::int32_t x, std::int32_t y) const {
  if (column_.empty()) return nullptr;
  if (rows_ > 0) {
    const std::size_t row = static_cast<std::size_t>(std::int64_t{x} - low_x_);
    const std::size_t at = static_cast<std::size_t>(std::int64_t{y} - low_y_);
    if (row >= rows_ || at >= width_) return nullptr;
    const std::uint32_t entry = table_[row * width_ + at];
    return entry == 0 ? nullptr : &column_[entry - 1];
  }
  for (std::size_t slot = hash_column(x, y);; ++slot) {
    const std::uint32_t entry = table_[slot & (table_.size() - 1)];
    if (entry == 0) return nullptr;
    const Column& column = column_[entry - 1];
    if (column.x == x && column.y == y) return &column;
  }
}

void Occupancy::find_row(std::int32_t x, std::int32_t y, std::span<const Column*> found) const {
  if (rows_ > 0) {
    const std::size_t row = static_cast<std::size_t>(std::int64_t{x} - low_x_);
    const std::int64_t first = std::int64_t{y} - low_y_;
    for (std::size_t k = 0; k < found.size(); ++k) {
      const std::size_t at = static_cast<std::size_t>(first) + k;  // below zero it is beyond the width
      const std::uint32_t entry = row < rows_ && at < width_ ? table_[row * width_ + at] : 0;
      found[k] = entry == 0 ? nullptr : &column_[entry - 1];
    }
    return;
  }
  std::fill(found.begin(), found.end(), nullptr);
  if (column_.empty()) return;
  auto begin = column_.begin(), end = column_.end();
  if (!row_.empty()) {
    const std::int64_t row = std::int64_t{x} - low_x_;
    if (row < 0 || row + 1 >= static_cast<std::int64_t>(row_.size())) return;
    end = begin + row_[static_cast<std::size_t>(row) + 1];
    begin += row_[static_cast<std::size_t>(row)];
  }
  begin = std::partition_point(begin, end, [&](const Column& c) { return c.x < x || (c.x == x && c.y < y); });
  for (; begin != end && begin->x == x; ++begin) {
    const std::size_t at = static_cast<std::size_t>(std::int64_t{begin->y} - y);
    if (at >= found.size()) return;
    found[at] = &*begin;
  }
}

std::uint32_t Occupancy::lower(const Column& column, std::int32_t z) const {
  if (column.words > 0) {
    const std::int64_t w = std::int64_t{z >> 6} - column.first_word;
    if (w < 0) return column.begin;
    if (w >= column.words) return column.end;
    const Word& word = word_[column.word + static_cast<std::uint32_t>(w)];
    const std::uint64_t below = (std::uint64_t{1} << (z & 63)) - 1;
    return column.begin + word.before + static_cast<std::uint32_t>(std::popcount(word.bits & below));
  }
  const auto begin = voxel_.begin() + column.begin, end = voxel_.begin() + column.end;
  const auto found = std::partition_point(begin, end, [z](const Lattice& v) { return v[2] < z; });
  return static_cast<std::uint32_t>(found - voxel_.begin());
}

std::size_t Occupancy::count(const LatticeBox& box) const {
  std::size_t total = 0;
  auto column = column_.begin();
  for (std::int32_t x = box.lower[0]; x < box.upper[0]; ++x) {
    column = std::partition_point(column, column_.end(),
                                  [&](const Column& c) { return c.x < x || (c.x == x && c.y < box.lower[1]); });
    if (column == column_.end()) break;
    for (; column != column_.end() && column->x == x && column->y < box.upper[1]; ++column)
      total += lower(*column, box.upper[2]) - lower(*column, box.lower[2]);
  }
  return total;
}

double Occupancy::filled_sparse(const Column& column, std::int32_t k, double fraction) const {
  const std::uint32_t at = lower(column, k);
  const double whole = static_cast<double>(at - column.begin);
  return at < column.end && voxel_[at][2] == k ? whole + fraction : whole;
}

void ZBounds::add(double x, double y, double z, double offset) {
  if (z > 0) {
    upper_.push_back({-x / z, -y / z, offset / z});
  } else if (z < 0) {
    lower_.push_back({-x / z, -y / z, offset / z});
  } else {
    upright_.push_back({x, y, offset});
  }
}

void ZBounds::assign(std::span<const HullBuilder::LocalPlane> planes, const LatticeBox& box) {
  height_ = box.upper[2] - box.lower[2];
  upper_.clear(), lower_.clear(), upright_.clear();
  for (const auto& plane : planes) add(plane.x, plane.y, plane.z, plane.offset);
}

void ZBounds::assign(const LatticePolytope& polytope, const LatticeBox& box) {
  height_ = box.upper[2] - box.lower[2];
  upper_.clear(), lower_.clear(), upright_.clear();
  for (const LatticePlane& plane : polytope.plane) {
    std::int64_t offset = plane.offset;
    for (int i = 0; i < 3; ++i) offset -= plane.normal[i] * box.lower[i];
    add(static_cast<double>(plane.normal[0]), static_cast<double>(plane.normal[1]),
        static_cast<double>(plane.normal[2]), static_cast<double>(offset));
  }
}

void ZBounds::assign(std::span<const HullBuilder::LocalPlane> planes, const LatticeBox& own, const LatticeBox& box) {
  height_ = box.upper[2] - box.lower[2];
  upper_.clear(), lower_.clear(), upright_.clear();
  const double x = box.lower[0] - own.lower[0], y = box.lower[1] - own.lower[1], z = box.lower[2] - own.lower[2];
  for (const auto& plane : planes)
    add(plane.x, plane.y, plane.z, plane.offset - plane.x * x - plane.y * y - plane.z * z);
}

namespace {

using Four __attribute__((vector_size(32))) = double;

// Bounds for `Vectors` times four lines at once, which stay in registers for all planes.
template <int Vectors, class Slopes>
[[gnu::always_inline]] inline void bound_lines(const Slopes& upper, const Slopes& lower, const Slopes& upright,
                                               double height, double x, const double* y, double* low, double* high) {
  Four at[Vectors], bound[Vectors];
  std::memcpy(at, y, sizeof at);
  for (int v = 0; v < Vectors; ++v) bound[v] = Four{} + height;
  for (const auto& s : upper) {
    const double base = s.offset + s.x * x;
    for (int v = 0; v < Vectors; ++v) {
      const Four z = base + s.y * at[v];
      bound[v] = z < bound[v] ? z : bound[v];
    }
  }
  for (const auto& s : upright) {
    const double room = s.offset - s.x * x;
    for (int v = 0; v < Vectors; ++v) bound[v] = s.y * at[v] > room ? Four{} - 1.0 : bound[v];
  }
  std::memcpy(high, bound, sizeof bound);
  for (int v = 0; v < Vectors; ++v) bound[v] = Four{};
  for (const auto& s : lower) {
    const double base = s.offset + s.x * x;
    for (int v = 0; v < Vectors; ++v) {
      const Four z = base + s.y * at[v];
      bound[v] = z > bound[v] ? z : bound[v];
    }
  }
  std::memcpy(low, bound, sizeof bound);
}

}  // namespace

ALULA_WIDE void ZBounds::row(double x, std::span<const double> y, double* low, double* high) const {
  const std::size_t whole = y.size() / 4;
  std::size_t v = 0;
  const auto at = [&](std::size_t k) { return k * 4; };
  for (; v + 3 <= whole; v += 3)
    bound_lines<3>(upper_, lower_, upright_, height_, x, &y[at(v)], low + at(v), high + at(v));
  for (; v < whole; ++v) bound_lines<1>(upper_, lower_, upright_, height_, x, &y[at(v)], low + at(v), high + at(v));
  if (at(v) == y.size()) return;
  std::array<double, 4> rest{}, rest_low, rest_high;
  std::copy(y.begin() + static_cast<std::ptrdiff_t>(at(v)), y.end(), rest.begin());
  bound_lines<1>(upper_, lower_, upright_, height_, x, rest.data(), rest_low.data(), rest_high.data());
  std::copy_n(rest_low.begin(), y.size() - at(v), low + at(v));
  std::copy_n(rest_high.begin(), y.size() - at(v), high + at(v));
}

double ExcessMeter::operator()(const HullBuilder& hull, double limit) {
  bounds_.assign(hull.local_planes(), hull.box());
  return measure(hull.box(), hull.is_box(), limit);
}

double ExcessMeter::operator()(const LatticePolytope& polytope) {
  const LatticeBox box = bounds(polytope.vertex);
  bounds_.assign(polytope, box);
  return measure(box, polytope.plane.size() == 6, std::numeric_limits<double>::infinity());
}

double ExcessMeter::within(std::span<const HullBuilder::LocalPlane> planes, const LatticeBox& own,
                           const LatticeBox& box) {
  bounds_.assign(planes, own, box);
  return sampled(box, std::numeric_limits<double>::infinity());
}

double ExcessMeter::measure(const LatticeBox& box, bool is_box, double limit) {
  // A hull of voxels has a facet on each side of its bounding box; six facets are that box.
  if (is_box) return volume(box) - static_cast<double>(occupancy_->count(box));
  const double total = sampled(box, limit);
  if (total >= kLeast) return total;
  return static_cast<double>(occupancy_->count(box)) == volume(box) ? 0 : kLeast;
}

double ExcessMeter::sampled(const LatticeBox& box, double limit) {
  const std::int32_t ex = box.upper[0] - box.lower[0], ey = box.upper[1] - box.lower[1];
  const int nx = sample_lines(ex, most_lines_), ny = sample_lines(ey, most_lines_);
  const double step_x = static_cast<double>(ex) / nx, step_y = static_cast<double>(ey) / ny;
  y_.resize(static_cast<std::size_t>(ny)), low_.resize(y_.size()), high_.resize(y_.size());
  const double last_y = (ny - 0.5) * step_y;
  column_.resize(static_cast<std::size_t>(last_y) + 1);
  for (int j = 0; j < ny; ++j) y_[static_cast<std::size_t>(j)] = (j + 0.5) * step_y;
  at_.resize(y_.size()), line_.resize(y_.size());
  for (std::size_t j = 0; j < y_.size(); ++j) at_[j] = static_cast<std::uint32_t>(y_[j]);
  double total = 0;
  std::int32_t known_x = INT32_MIN;
  for (int i = 0; i < nx; ++i) {
    const double x = (i + 0.5) * step_x;
    const std::int32_t column_x = box.lower[0] + static_cast<std::int32_t>(x);
    if (column_x != known_x) {
      known_x = column_x;
      occupancy_->find_row(column_x, box.lower[1], column_);
      for (std::size_t j = 0; j < y_.size(); ++j) line_[j] = column_[at_[j]];
    }
    bounds_.row(x, y_, low_.data(), high_.data());
    double sum = 0;
    for (std::size_t j = 0; j < y_.size(); ++j) {
      if (high_[j] <= low_[j]) continue;
      sum += high_[j] - low_[j];
      const Occupancy::Column* column = line_[j];
      if (column != nullptr)
        sum -= occupancy_->filled(*column, box.lower[2] + high_[j]) -
               occupancy_->filled(*column, box.lower[2] + low_[j]);
    }
    total += sum;
    if (total * step_x * step_y > limit) break;
  }
  return total * step_x * step_y;
}

}  // namespace alula
