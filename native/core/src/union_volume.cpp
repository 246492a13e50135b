#include <algorithm>

#include "alula/merge.hpp"
#include "alula/parallel.hpp"

namespace alula {

namespace {

constexpr double kMostLines = 2e7;  // times about 30 half-planes: a fraction of a second

struct Interval {
  std::int32_t line;
  double low, high;
};

std::int32_t ceil_div(std::int32_t a, std::int32_t b) { return a / b + (a % b != 0 && (a < 0) == (b < 0)); }

}  // namespace

UnionVolume union_excess(const Occupancy& occupancy, const std::vector<LatticePolytope>& hulls, unsigned jobs,
                         Control& control) {
  LatticeBox all = LatticeBox::empty();
  std::vector<LatticeBox> box;
  std::vector<ZBounds> shape(hulls.size());
  double area = 0;
  for (std::size_t h = 0; h < hulls.size(); ++h) {
    box.push_back(bounds(hulls[h].vertex));
    shape[h].assign(hulls[h], box[h]);
    all.add(box[h]);
    area += (static_cast<double>(box[h].upper[0]) - box[h].lower[0]) * (box[h].upper[1] - box[h].lower[1]);
  }
  UnionVolume result{0, 4, 1};
  while (result.lines > 1 && area * result.lines * result.lines > kMostLines) result.lines /= 2;
  while (area / (static_cast<double>(result.stride) * result.stride) > kMostLines) ++result.stride;
  if (hulls.empty()) return result;

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
  InterruptOnly quiet(control);
  parallel_chunks(excess.size(), 1, jobs, quiet, [&](std::size_t begin, std::size_t end) {
    std::vector<Interval> interval;
    std::vector<double> y, low, high;
    for (std::size_t slab = begin; slab < end; ++slab) {
      const std::int32_t column_x = origin_x + stride * static_cast<std::int32_t>(slab);
      for (std::int32_t sub = 0; sub < lines; ++sub) {
        const double x = column_x + (sub + 0.5) / lines;
        interval.clear();
        for (const std::size_t h : starting[slab]) {
          const std::int32_t from = first(box[h].lower[1], origin_y), to = first(box[h].upper[1], origin_y);
          if (to <= from) continue;
          y.resize(static_cast<std::size_t>((to - from) * lines)), low.resize(y.size()), high.resize(y.size());
          for (std::size_t k = 0; k < y.size(); ++k) {
            const std::int32_t at = static_cast<std::int32_t>(k);
            y[k] = origin_y + stride * (from + at / lines) + (at % lines + 0.5) / lines - box[h].lower[1];
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

}  // namespace alula
