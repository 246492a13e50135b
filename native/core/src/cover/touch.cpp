#include "alula/cover/touch.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "alula/base/parallel.hpp"
#include "alula/base/require.hpp"
#include "alula/geometry/convex_distance.hpp"
#include "alula/geometry/vec3.hpp"

namespace alula {

namespace {

using geometry::Vec3;

constexpr double kTouchDemanded = 512 * std::numeric_limits<double>::epsilon() / 2;
constexpr double kShortSquare = 1e-120;  // the square of a shorter direction could underflow
constexpr std::size_t kTriangles = 256;

Vec3 cross_vectors(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
double taxicab(Vec3 a) { return std::abs(a.x) + std::abs(a.y) + std::abs(a.z); }

// Closest point of a triangle to p. Source: Ericson 2005, Real-Time Collision Detection, sec. 5.1.5.
Vec3 closest_point(const std::array<Vec3, 3>& t, Vec3 p) {
  const Vec3 ab = t[1] - t[0], ac = t[2] - t[0], ap = p - t[0];
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return t[0];
  const Vec3 bp = p - t[1];
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return t[1];
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return t[0] + (d1 / (d1 - d3)) * ab;
  const Vec3 cp = p - t[2];
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return t[2];
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return t[0] + (d2 / (d2 - d6)) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return t[1] + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (t[2] - t[1]);
  const double sum = va + vb + vc;
  if (!(sum > 0)) return t[0];  // degenerate; any of its points serves
  return t[0] + (vb / sum) * ab + (vc / sum) * ac;
}

// One triangle and the directions that may separate it from a block.
class Triangle {
 public:
  Triangle(const double* corners, double radius, double g) : radius_(radius), g_(g) {
    double far = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      corner_[k] = geometry::from_rows(&corners[3 * k]);
      for (int a = 0; a < 3; ++a) far = std::max(far, std::abs(corner_[k][a]));
    }
    pad_ = kTouchDemanded * (far + radius + 2 * g);
    const std::array<Vec3, 3> edge{corner_[1] - corner_[0], corner_[2] - corner_[1], corner_[0] - corner_[2]};
    for (int a = 0; a < 3; ++a) {
      Vec3 axis;
      axis[a] = 1;
      add(axis);
    }
    add(cross_vectors(edge[0], edge[1]));
    for (const Vec3 e : edge) add({0, -e.z, e.y}), add({e.z, 0, -e.x}), add({-e.y, e.x, 0});
  }

  // The voxels within a range that the box of the triangle and its ball touches.
  Block bounds(const CropRange& range) const {
    std::array<double, 3> lower, upper;
    for (std::size_t a = 0; a < 3; ++a) {
      lower[a] = std::floor((axis_[a].low - radius_ - pad_) / g_);
      upper[a] = std::floor((axis_[a].high + radius_ + pad_) / g_);
    }
    return clipped_block(lower, upper, range);
  }

  bool is_clear_of(const Block& block) const {
    const Vec3 lower = corner(block.lower, 0), upper = corner(block.upper, 1);
    for (std::size_t i = 0; i < axes_; ++i)
      if (separates(axis_[i], lower, upper)) return true;
    return false;
  }

  // True if the triangle's ball around one of its points holds the block; false may be wrong.
  bool holds(const Block& block) const {
    if (radius_ < g_) return false;
    const Vec3 lower = corner(block.lower, 0), upper = corner(block.upper, 1);
    const Vec3 centre = 0.5 * (lower + upper);
    return norm(closest_point(corner_, centre) - centre) + 0.5 * norm(upper - lower) <= radius_;
  }

  // After `is_clear_of`, which is complete without a ball: tests the direction between the closest points.
  bool is_far_from(const Block& block) const {
    if (radius_ == 0) return false;
    const Vec3 lower = corner(block.lower, 0), upper = corner(block.upper, 1);
    const Vec3 p = closest_point(corner_, 0.5 * (lower + upper));
    Vec3 q = p;
    for (int a = 0; a < 3; ++a) q[a] = std::clamp(p[a], lower[a], upper[a]);
    if (norm(p - q) <= radius_) return false;
    std::array<Vec3, 8> cube;
    for (unsigned c = 0; c < 8; ++c)
      cube[c] = {c & 1 ? upper.x : lower.x, c & 2 ? upper.y : lower.y, c & 4 ? upper.z : lower.z};
    const Vec3 apart = geometry::hull_distance(cube, corner_, std::numeric_limits<double>::infinity()).apart;
    return separates(axis_of(apart), lower, upper);
  }

 private:
  struct Axis {
    Vec3 n;
    double low, high;  // of the triangle
    double demanded;   // gap that proves
  };

  Vec3 corner(const Index3& i, int step) const {
    return {(double(i[0]) + step) * g_, (double(i[1]) + step) * g_, (double(i[2]) + step) * g_};
  }

  Axis axis_of(Vec3 n) const {
    const double a = dot(n, corner_[0]), b = dot(n, corner_[1]), c = dot(n, corner_[2]), length = taxicab(n);
    const bool usable = length > kShortSquare && std::isfinite(length);
    return {n, std::min({a, b, c}), std::max({a, b, c}),
            usable ? radius_ * norm(n) + pad_ * length : std::numeric_limits<double>::infinity()};
  }

  void add(Vec3 n) {
    if (taxicab(n) > kShortSquare) axis_[axes_++] = axis_of(n);
  }

  static bool separates(const Axis& axis, Vec3 lower, Vec3 upper) {
    double low = 0, high = 0;
    for (int a = 0; a < 3; ++a) {
      const double first = axis.n[a] * lower[a], second = axis.n[a] * upper[a];
      low += std::min(first, second), high += std::max(first, second);
    }
    return low - axis.high > axis.demanded || axis.low - high > axis.demanded;
  }

  std::array<Vec3, 3> corner_;
  double radius_, g_, pad_ = 0;
  std::array<Axis, 13> axis_;
  std::size_t axes_ = 0;
};

void add_block(OverlapGrid::Writer& writer, const Block& block, const Stop& stop) {
  for (std::int32_t x = block.lower[0]; x <= block.upper[0]; ++x) {
    stop.check();
    for (std::int32_t y = block.lower[1]; y <= block.upper[1]; ++y)
      writer.add({x, y, block.lower[2], block.upper[2]});
  }
}

// Marks the voxels of a block that a triangle touches.
void mark(const Triangle& triangle, const Block& block, OverlapGrid::Writer& writer, const Stop& stop) {
  stop.check();
  if (triangle.is_clear_of(block)) return;
  std::size_t longest = 0;
  for (std::size_t a = 1; a < 3; ++a)
    if (block.upper[a] - block.lower[a] > block.upper[longest] - block.lower[longest]) longest = a;
  if (block.upper[longest] == block.lower[longest]) {
    if (!triangle.is_far_from(block)) add_block(writer, block, stop);
    return;
  }
  if (triangle.holds(block)) return add_block(writer, block, stop);
  Block first = block, second = block;
  first.upper[longest] = std::midpoint(block.lower[longest], block.upper[longest]);
  second.lower[longest] = first.upper[longest] + 1;
  mark(triangle, first, writer, stop);
  mark(triangle, second, writer, stop);
}

// Marks the voxels that a ball around a point touches.
void mark(const double* point, double radius, double g, const CropRange& range, OverlapGrid::Writer& writer) {
  const Vec3 p = geometry::from_rows(point);
  const double pad = kTouchDemanded * (std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) + radius + 2 * g);
  const double reach = radius + pad;
  const auto first = [&](double x, double r) { return std::floor((x - r - pad) / g); };
  const auto last = [&](double x, double r) { return std::floor((x + r + pad) / g); };
  const Block block = clipped_block({first(p.x, radius), first(p.y, radius), first(p.z, radius)},
                                    {last(p.x, radius), last(p.y, radius), last(p.z, radius)}, range);
  const auto gap = [&](double x, std::int32_t i) { return std::max({0.0, i * g - x, x - (i + 1.0) * g}); };
  for (std::int32_t x = block.lower[0]; x <= block.upper[0]; ++x)
    for (std::int32_t y = block.lower[1]; y <= block.upper[1]; ++y) {
      const double dx = gap(p.x, x), dy = gap(p.y, y), square = reach * reach - dx * dx - dy * dy;
      if (square < 0) continue;
      const double z = std::sqrt(square);
      const double low = std::max(first(p.z, z), double(block.lower[2]));
      const double high = std::min(last(p.z, z), double(block.upper[2]));
      if (low <= high) writer.add({x, y, static_cast<std::int32_t>(low), static_cast<std::int32_t>(high)});
    }
}

void check(std::span<const double> values, std::size_t width, double radius, double g) {
  require(values.size() % width == 0, "coordinates must be rows of three");
  require(g > 0 && std::isfinite(g), "the voxel size must be positive and finite");
  require(radius >= 0 && std::isfinite(radius), "the radius must be finite and not negative");
  require(std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); }),
          "coordinates must be finite");
}

constexpr std::size_t kMarking = 800;  // of the time, in Share::kWhole

template <class Mark>
VoxelCounts collected(std::size_t count, std::uint32_t min_count, unsigned jobs, Control& control, Mark&& mark_one) {
  Share marking(control, 0, kMarking), collecting(control, kMarking, Share::kWhole);
  OverlapGrid grid;
  parallel_chunks(count, kTriangles, jobs, marking, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    OverlapGrid::Writer writer(grid);
    for (std::size_t i = begin; i < end; ++i) {
      stop.check();
      mark_one(i, writer, stop);
    }
    writer.finish();
  });
  return grid.collect(min_count, jobs, collecting);
}

}  // namespace

VoxelCounts touched_by_triangles(std::span<const double> corners, double radius, double voxel_size,
                                 const std::optional<Box6>& crop, std::uint32_t min_count, unsigned jobs,
                                 Control& control) {
  check(corners, 9, radius, voxel_size);
  const CropRange range = crop_range(crop, voxel_size);
  return collected(corners.size() / 9, min_count, jobs, control,
                   [&](std::size_t i, OverlapGrid::Writer& writer, const Stop& stop) {
                     const Triangle triangle(&corners[9 * i], radius, voxel_size);
                     const Block block = triangle.bounds(range);
                     if (!block.empty()) mark(triangle, block, writer, stop);
                   });
}

VoxelCounts touched_by_points(std::span<const double> points, double radius, double voxel_size,
                              const std::optional<Box6>& crop, std::uint32_t min_count, unsigned jobs,
                              Control& control) {
  check(points, 3, radius, voxel_size);
  const CropRange range = crop_range(crop, voxel_size);
  return collected(points.size() / 3, min_count, jobs, control,
                   [&](std::size_t i, OverlapGrid::Writer& writer, const Stop&) {
                     mark(&points[3 * i], radius, voxel_size, range, writer);
                   });
}

VoxelCounts voxels_of_blocks(std::span<const std::int32_t> lower, std::span<const std::int32_t> upper,
                             double voxel_size, const std::optional<Box6>& crop, unsigned jobs, Control& control) {
  require(lower.size() == upper.size() && lower.size() % 3 == 0, "blocks must have two corners");
  const CropRange range = crop_range(crop, voxel_size);
  return collected(lower.size() / 3, 1, jobs, control,
                   [&](std::size_t i, OverlapGrid::Writer& writer, const Stop& stop) {
                     std::array<double, 3> low, high;
                     for (std::size_t a = 0; a < 3; ++a) low[a] = lower[3 * i + a], high[a] = upper[3 * i + a];
                     add_block(writer, clipped_block(low, high, range), stop);
                   });
}

namespace {

// Voxels first ... last of a column between touched ones; those below and above all touched ones are no gaps.
struct ColumnGap {
  std::int32_t x, y, first, last;
  bool is_open = false;  // shares a face with a voxel that lies outside of every column's touched voxels
};

// Numbers that are joined to groups; the lowest number of a group stands for it.
class Groups {
 public:
  explicit Groups(std::size_t count) : parent_(count) { std::iota(parent_.begin(), parent_.end(), std::size_t{0}); }
  std::size_t of(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::size_t a, std::size_t b) {
    a = of(a), b = of(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::size_t> parent_;
};

// A column of touched voxels: rows of `index`, its gaps, and its lowest and highest touched voxel.
struct Column {
  std::int32_t x, y;
  std::size_t gap, gap_end;
  std::int32_t lowest, highest;
};

struct Gaps {
  std::vector<ColumnGap> gap;
  std::vector<Column> column;
};

Gaps gaps_of(std::span<const std::int32_t> index) {
  Gaps out;
  for (std::size_t i = 0; i + 2 < index.size(); i += 3) {
    const std::int32_t x = index[i], y = index[i + 1], z = index[i + 2];
    if (out.column.empty() || out.column.back().x != x || out.column.back().y != y)
      out.column.push_back({x, y, out.gap.size(), out.gap.size(), z, z});
    Column& column = out.column.back();
    if (z > column.highest + 1) out.gap.push_back({x, y, column.highest + 1, z - 1});
    column.highest = z;
    column.gap_end = out.gap.size();
  }
  return out;
}

// Joins the gaps that share a face, and opens those next to a voxel outside of all touched ones.
void join_neighbours(Gaps& gaps, Groups& groups) {
  const std::vector<Column>& columns = gaps.column;
  const auto before = [](const Column& a, const std::array<std::int32_t, 2>& b) {
    return a.x != b[0] ? a.x < b[0] : a.y < b[1];
  };
  constexpr std::array<std::array<std::int32_t, 2>, 4> kSteps{{{1, 0}, {-1, 0}, {0, 1}, {0, -1}}};
  for (const Column& mine : columns) {
    if (mine.gap == mine.gap_end) continue;
    for (const auto& step : kSteps) {
      const std::array<std::int32_t, 2> place{mine.x + step[0], mine.y + step[1]};
      const auto found = std::lower_bound(columns.begin(), columns.end(), place, before);
      const bool is_empty = found == columns.end() || found->x != place[0] || found->y != place[1];
      for (std::size_t i = mine.gap, j = is_empty ? 0 : found->gap; i < mine.gap_end; ++i) {
        ColumnGap& gap = gaps.gap[i];
        if (is_empty || gap.first < found->lowest || gap.last > found->highest) gap.is_open = true;
        if (is_empty) continue;
        while (j < found->gap_end && gaps.gap[j].last < gap.first) ++j;
        for (std::size_t k = j; k < found->gap_end && gaps.gap[k].first <= gap.last; ++k) groups.join(i, k);
      }
    }
  }
}

// Winding number of a closed surface around a point: solid angles over 4 pi.
// Source: Van Oosterom and Strackee 1983, eq. 8.
double winding(std::span<const double> corners, Vec3 p, const Stop& stop) {
  double sum = 0;
  for (std::size_t t = 0; t < corners.size() / 9; ++t) {
    if (t % 4096 == 0) stop.check();
    const double* row = &corners[9 * t];
    const Vec3 a = geometry::from_rows(row) - p, b = geometry::from_rows(row + 3) - p,
               c = geometry::from_rows(row + 6) - p;
    const double la = norm(a), lb = norm(b), lc = norm(c);
    sum += std::atan2(dot(a, cross_vectors(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb);
  }
  return sum / (2 * std::numbers::pi);
}

}  // namespace

VoxelCounts with_inside(const VoxelCounts& touched, std::span<const double> corners, double voxel_size,
                        const std::optional<Box6>& crop, unsigned jobs, Control& control) {
  check(corners, 9, 0, voxel_size);
  require(touched.index.size() == 3 * touched.count.size(), "index and count differ in length");
  Gaps gaps = gaps_of(touched.index);
  Groups groups(gaps.gap.size());
  join_neighbours(gaps, groups);
  std::vector<char> is_open(gaps.gap.size(), 0);
  for (std::size_t i = 0; i < gaps.gap.size(); ++i)
    if (gaps.gap[i].is_open) is_open[groups.of(i)] = 1;
  std::vector<std::size_t> enclosed;  // the groups that need a winding number
  for (std::size_t i = 0; i < gaps.gap.size(); ++i)
    if (groups.of(i) == i && !is_open[i]) enclosed.push_back(i);
  std::vector<char> is_inside(gaps.gap.size(), 0);
  parallel_chunks(enclosed.size(), 1, jobs, control, [&](std::size_t begin, std::size_t, const Stop& stop) {
    const ColumnGap& gap = gaps.gap[enclosed[begin]];
    const double g = voxel_size;
    const double found = winding(corners, {(gap.x + 0.5) * g, (gap.y + 0.5) * g, (gap.first + 0.5) * g}, stop);
    require(std::abs(found - std::round(found)) < 1e-6, "the surface is not closed");
    is_inside[enclosed[begin]] = std::round(found) != 0;
  });

  const CropRange range = crop_range(crop, voxel_size);
  VoxelCounts out;
  out.most = touched.most;
  const auto add = [&](std::int32_t x, std::int32_t y, std::int32_t z, std::uint32_t count) {
    if (x < range.lower[0] || x > range.upper[0] || y < range.lower[1] || y > range.upper[1] || z < range.lower[2] ||
        z > range.upper[2])
      return;
    out.index.insert(out.index.end(), {x, y, z});
    out.count.push_back(count);
    if (out.count.size() > OverlapGrid::kMaxVoxels)
      throw std::overflow_error("the solid would need more than " + std::to_string(OverlapGrid::kMaxVoxels) +
                                " voxels");
  };
  std::size_t next = 0;  // gap
  for (std::size_t i = 0; i < touched.count.size(); ++i) {
    const std::int32_t x = touched.index[3 * i], y = touched.index[3 * i + 1], z = touched.index[3 * i + 2];
    if (next < gaps.gap.size() && gaps.gap[next].x == x && gaps.gap[next].y == y && gaps.gap[next].last + 1 == z) {
      const ColumnGap& gap = gaps.gap[next];
      if (is_inside[groups.of(next++)])
        for (std::int32_t inner = gap.first; inner <= gap.last; ++inner) add(x, y, inner, 0);
    }
    add(x, y, z, touched.count[i]);
  }
  return out;
}

}  // namespace alula
