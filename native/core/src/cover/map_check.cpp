#include "alula/cover/map_check.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <stdexcept>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

using Cell = std::array<std::int64_t, 3>;

constexpr std::int64_t kMostNormal = std::int64_t{1} << 15, kMostOffset = std::int64_t{1} << 50;

Cell triple(std::span<const std::int32_t> rows, std::size_t i) {
  return {rows[3 * i], rows[3 * i + 1], rows[3 * i + 2]};
}

std::int64_t floored_quotient(std::int64_t a, std::int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

bool is_partition(std::span<const std::int64_t> start, std::size_t rows) {
  return !start.empty() && start.front() == 0 && start.back() == static_cast<std::int64_t>(rows) &&
         std::is_sorted(start.begin(), start.end());
}

void require_sound(const MapView& map) {
  if (map.normal.size() != 3 * map.offset.size() || !is_partition(map.plane_start, map.offset.size()) ||
      map.lower.size() != 3 * (map.plane_start.size() - 1) || map.upper.size() != map.lower.size())
    throw std::invalid_argument("the arrays of the map do not fit together");
  for (const std::int64_t n : map.normal)
    if (n < -kMostNormal || n > kMostNormal) throw std::invalid_argument("a normal is out of range");
  for (const std::int64_t d : map.offset)
    if (d < -kMostOffset || d > kMostOffset) throw std::invalid_argument("an offset is out of range");
}

// The voxels [low, high] of the column (x, y) inside hull h; none when low > high.
struct Run {
  std::int64_t low, high;
};

Run run_inside(const MapView& map, std::size_t h, std::int64_t x, std::int64_t y) {
  Run run{map.lower[3 * h + 2], std::int64_t{map.upper[3 * h + 2]} - 1};
  const std::size_t end = static_cast<std::size_t>(map.plane_start[h + 1]);
  for (std::size_t l = static_cast<std::size_t>(map.plane_start[h]); l < end && run.low <= run.high; ++l) {
    const auto [nx, ny, nz] = triple(map.normal, l);
    const std::int64_t rest = map.offset[l] - nx * (x + (nx > 0)) - ny * (y + (ny > 0));
    if (nz > 0) run.high = std::min(run.high, floored_quotient(rest, nz) - 1);  // nz (z + 1) <= rest
    if (nz < 0) run.low = std::max(run.low, -floored_quotient(rest, -nz));      // -nz z >= -rest
    if (nz == 0 && rest < 0) run.high = run.low - 1;
  }
  return run;
}

struct Voxel {
  std::int32_t x, y, z;
  std::int64_t row;
  auto operator<=>(const Voxel&) const = default;
};

// Marks the voxels of one slab of equal x that hull h contains.
void mark(const MapView& map, std::size_t h, std::span<const Voxel> slab, std::span<std::uint8_t> is_inside) {
  const std::int32_t y_low = map.lower[3 * h + 1], y_high = map.upper[3 * h + 1];
  auto column = std::lower_bound(slab.begin(), slab.end(), y_low, [](const Voxel& v, auto y) { return v.y < y; });
  while (column != slab.end() && column->y < y_high) {
    const std::int32_t y = column->y;
    const auto end = std::upper_bound(column, slab.end(), y, [](auto at, const Voxel& v) { return at < v.y; });
    const Run run = run_inside(map, h, column->x, y);
    auto v = std::lower_bound(column, end, run.low, [](const Voxel& a, auto z) { return a.z < z; });
    for (; v != end && v->z <= run.high; ++v) is_inside[static_cast<std::size_t>(v - slab.begin())] = 1;
    column = end;
  }
}

}  // namespace

std::vector<std::int64_t> voxels_outside(const MapView& map, std::span<const std::int32_t> voxel, unsigned jobs,
                                         Control& control) {
  require_sound(map);
  if (voxel.size() % 3 != 0) throw std::invalid_argument("voxels are not triples");
  std::vector<Voxel> sorted(voxel.size() / 3);
  for (std::size_t i = 0; i < sorted.size(); ++i)
    sorted[i] = {voxel[3 * i], voxel[3 * i + 1], voxel[3 * i + 2], static_cast<std::int64_t>(i)};
  if (!std::is_sorted(sorted.begin(), sorted.end())) std::sort(sorted.begin(), sorted.end());
  std::vector<std::size_t> slab{0};  // indices at which x changes
  for (std::size_t i = 1; i <= sorted.size(); ++i)
    if (i == sorted.size() || sorted[i].x != sorted[i - 1].x) slab.push_back(i);
  if (sorted.empty()) return {};

  const std::size_t hulls = map.plane_start.size() - 1;
  std::vector<std::uint8_t> is_inside(sorted.size(), 0);
  parallel_chunks(slab.size() - 1, 4, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t s = begin; s < end; ++s) {
      const std::size_t first = slab[s], count = slab[s + 1] - first;
      const std::int32_t x = sorted[first].x;
      for (std::size_t h = 0; h < hulls; ++h) {
        if (map.lower[3 * h] <= x && x < map.upper[3 * h])
          mark(map, h, std::span(sorted).subspan(first, count), std::span(is_inside).subspan(first, count));
      }
    }
  });
  std::vector<std::int64_t> outside;
  for (std::size_t i = 0; i < sorted.size(); ++i)
    if (is_inside[i] == 0) outside.push_back(sorted[i].row);
  std::sort(outside.begin(), outside.end());
  return outside;
}

std::vector<std::int64_t> polytopes_outside(const MapView& map, std::span<const std::int32_t> vertex,
                                            std::span<const std::int64_t> vertex_start) {
  require_sound(map);
  if (!is_partition(vertex_start, vertex.size() / 3)) throw std::invalid_argument("starts do not partition the rows");
  std::map<std::array<Cell, 2>, std::vector<std::size_t>> by_box;
  for (std::size_t h = 0; h + 1 < map.plane_start.size(); ++h)
    by_box[{triple(map.lower, h), triple(map.upper, h)}].push_back(h);

  std::vector<std::int64_t> outside;
  for (std::size_t p = 0; p + 1 < vertex_start.size(); ++p) {
    const std::size_t first = static_cast<std::size_t>(vertex_start[p]);
    const std::size_t end = static_cast<std::size_t>(vertex_start[p + 1]);
    std::array<Cell, 2> box{Cell{INT32_MAX, INT32_MAX, INT32_MAX}, Cell{INT32_MIN, INT32_MIN, INT32_MIN}};
    for (std::size_t v = first; v < end; ++v) {
      for (std::size_t i = 0; i < 3; ++i) {
        box[0][i] = std::min<std::int64_t>(box[0][i], vertex[3 * v + i]);
        box[1][i] = std::max<std::int64_t>(box[1][i], vertex[3 * v + i]);
      }
    }
    auto holds = [&](std::size_t h) {
      for (std::int64_t l = map.plane_start[h]; l < map.plane_start[h + 1]; ++l) {
        const auto [nx, ny, nz] = triple(map.normal, static_cast<std::size_t>(l));
        for (std::size_t v = first; v < end; ++v) {
          const auto [x, y, z] = triple(vertex, v);
          if (nx * x + ny * y + nz * z > map.offset[static_cast<std::size_t>(l)]) return false;
        }
      }
      return true;
    };
    const auto same = by_box.find(box);
    if (same == by_box.end() || std::none_of(same->second.begin(), same->second.end(), holds))
      outside.push_back(static_cast<std::int64_t>(p));
  }
  return outside;
}

}  // namespace alula
