#include "alula/cover/union_volume.hpp"

#include <algorithm>

#include "alula/base/parallel.hpp"
#include "alula/cover/union_measure.hpp"

namespace alula {

namespace {

constexpr std::size_t kCuttingShare = 900;  // of the progress; lines follow only where cutting exceeds its budget
constexpr double kManyPlanes = 1000;        // lines of hulls with more half-planes count as several
// Lines exactly through the middle would lie in diagonal planes of the lattice, and count as inside.
constexpr double kOffMiddleX = 0.53, kOffMiddleY = 0.48;

struct Interval {
  std::int32_t line;
  double low, high;
};

std::int32_t ceil_div(std::int32_t a, std::int32_t b) { return a / b + (a % b != 0 && (a < 0) == (b < 0)); }

// The box of a polytope from its planes, which may lie beyond its vertices; a side without plane uses the vertices.
LatticeBox box_of(const LatticePolytope& hull) {
  LatticeBox box = bounds(hull.vertex);
  for (const LatticePlane& plane : hull.plane) {
    for (int i = 0; i < 3; ++i) {
      if (plane.normal[(i + 1) % 3] != 0 || plane.normal[(i + 2) % 3] != 0) continue;
      (plane.normal[i] > 0 ? box.upper : box.lower)[i] = static_cast<std::int32_t>(plane.offset / plane.normal[i]);
    }
  }
  return box;
}

// The same polytopes relative to the middle of all, which keeps coordinates small.
ConvexSets convex_sets(const std::vector<LatticePolytope>& hulls, const std::vector<LatticeBox>& box) {
  LatticeBox all = LatticeBox::empty();
  for (const LatticeBox& b : box) all.add(b);
  Lattice middle;
  for (int i = 0; i < 3; ++i) middle[i] = all.lower[i] + (all.upper[i] - all.lower[i]) / 2;
  const auto local = [&](const Lattice& p) {
    return geometry::Vec3{static_cast<double>(p[0] - middle[0]), static_cast<double>(p[1] - middle[1]),
                          static_cast<double>(p[2] - middle[2])};
  };
  ConvexSets sets;
  for (std::size_t h = 0; h < hulls.size(); ++h) {
    for (const LatticePlane& plane : hulls[h].plane) {
      const auto& n = plane.normal;
      const geometry::Vec3 normal{static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2])};
      const double length = norm(normal);
      const std::int64_t offset = plane.offset - n[0] * middle[0] - n[1] * middle[1] - n[2] * middle[2];
      sets.plane.push_back(
          {{normal.x / length, normal.y / length, normal.z / length}, static_cast<double>(offset) / length});
    }
    sets.close({local(box[h].lower), local(box[h].upper)});
  }
  return sets;
}

UnionVolume by_lines(const Occupancy& occupancy, const std::vector<LatticePolytope>& hulls,
                     const std::vector<LatticeBox>& box, double most_lines, unsigned jobs, Control& control) {
  LatticeBox all = LatticeBox::empty();
  std::vector<ZBounds> shape(hulls.size());
  double area = 0, rows = 0;
  for (std::size_t h = 0; h < hulls.size(); ++h) {
    shape[h].assign(hulls[h], box[h]);
    all.add(box[h]);
    const double row = static_cast<double>(box[h].upper[0]) - box[h].lower[0];
    rows += row;
    area += row * (static_cast<double>(box[h].upper[1]) - box[h].lower[1]) *
            std::max(1.0, static_cast<double>(hulls[h].plane.size()) / kManyPlanes);
  }
  UnionVolume result{0, 0, 4, 1};
  while (result.lines > 1 && area * result.lines * result.lines > most_lines) result.lines /= 2;
  while (area / (static_cast<double>(result.stride) * result.stride) > most_lines ||
         rows / result.stride > most_lines)
    ++result.stride;

  // Sampled columns have x = all.lower + offset + stride * i; likewise y.
  const std::int32_t stride = result.stride, lines = result.lines, offset = stride / 2;
  const std::int32_t origin_x = all.lower[0] + offset, origin_y = all.lower[1] + offset;
  auto first = [&](std::int32_t lower, std::int32_t origin) { return std::max(0, ceil_div(lower - origin, stride)); };
  const std::int32_t slabs = first(all.upper[0], origin_x);
  std::vector<std::vector<std::size_t>> starting(static_cast<std::size_t>(slabs));
  for (std::size_t h = 0; h < hulls.size(); ++h) {
    for (std::int32_t i = first(box[h].lower[0], origin_x); i < first(box[h].upper[0], origin_x); ++i)
      starting[static_cast<std::size_t>(i)].push_back(h);
  }
  std::vector<double> excess(static_cast<std::size_t>(slabs), 0.0);
  parallel_chunks(excess.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    std::vector<Interval> interval;
    std::vector<double> y, low, high;
    for (std::size_t slab = begin; slab < end; ++slab) {
      const std::int32_t column_x = origin_x + stride * static_cast<std::int32_t>(slab);
      for (std::int32_t sub = 0; sub < lines; ++sub) {
        const double x = column_x + (sub + kOffMiddleX) / lines;
        interval.clear();
        for (const std::size_t h : starting[slab]) {
          const std::int32_t from = first(box[h].lower[1], origin_y), to = first(box[h].upper[1], origin_y);
          if (to <= from) continue;
          y.resize(static_cast<std::size_t>((to - from) * lines)), low.resize(y.size()), high.resize(y.size());
          for (std::size_t k = 0; k < y.size(); ++k) {
            const std::int32_t at = static_cast<std::int32_t>(k);
            y[k] = origin_y + stride * (from + at / lines) + (at % lines + kOffMiddleY) / lines - box[h].lower[1];
          }
          shape[h].row(x - box[h].lower[0], y, low.data(), high.data());
          for (std::size_t k = 0; k < y.size(); ++k) {
            if (high[k] > low[k])
              interval.push_back(
                  {from * lines + static_cast<std::int32_t>(k), box[h].lower[2] + low[k], box[h].lower[2] + high[k]});
          }
        }
        std::sort(interval.begin(), interval.end(), [](const Interval& a, const Interval& b) {
          if (a.line != b.line) return a.line < b.line;
          return a.low != b.low ? a.low < b.low : a.high < b.high;
        });
        for (std::size_t i = 0; i < interval.size();) {
          const std::int32_t line = interval[i].line;
          double length = 0, top = interval[i].low;
          for (; i < interval.size() && interval[i].line == line; ++i) {
            length += std::max(0.0, interval[i].high - std::max(top, interval[i].low));
            top = std::max(top, interval[i].high);
          }
          const Occupancy::Column* column = occupancy.find(column_x, origin_y + stride * (line / lines));
          if (column != nullptr) length -= column->end - column->begin;
          excess[slab] += std::max(0.0, length);
        }
      }
    }
  });
  for (const double e : excess) result.excess += e;
  result.excess *= static_cast<double>(stride) * stride / (static_cast<double>(lines) * lines);
  return result;
}

}  // namespace

UnionVolume union_excess(const Occupancy& occupancy, const std::vector<LatticePolytope>& hulls, unsigned jobs,
                         Control& control, std::size_t most_cuts, double most_lines) {
  std::vector<LatticeBox> box;
  for (const LatticePolytope& hull : hulls) box.push_back(box_of(hull));
  Share cutting(control, 0, kCuttingShare), sampling(control, kCuttingShare, Share::kWhole);
  MeasureOptions options;
  options.cuts_per_part = most_cuts;
  const UnionMeasure found = union_measure(convex_sets(hulls, box), nullptr, options, jobs, cutting);
  if (!found.is_complete) return by_lines(occupancy, hulls, box, most_lines, jobs, sampling);
  control.poll(Share::kWhole, Share::kWhole);
  return {std::max(0.0, found.volume - static_cast<double>(occupancy.size())), found.error, 0, 0};
}

}  // namespace alula
