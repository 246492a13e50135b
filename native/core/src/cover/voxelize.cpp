#include "alula/cover/voxelize.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <mutex>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/geometry/surfaces.hpp"

namespace alula {

namespace {

using namespace surfaces;

constexpr double kWorth = 0.25;  // excess of the first ellipsoid beyond the sum that justifies the second [voxels]
constexpr double kNear = 1e9;    // an index well within 32 bits

// A set with its outward box in whole voxels, before any clipping.
struct Boxed {
  const Bounds& set;
  double pad;
  Triple lower, upper;

  Boxed(const Bounds& bounds, double g, double inverse_g) : set(bounds), pad(kPad * set.first.extent(g)) {
    const Triple& centre = set.first.centre;
    for (std::size_t a = 0; a < 3; ++a) {
      lower[a] = std::floor((centre[a] - set.half[a] - pad) * inverse_g);
      upper[a] = std::floor((centre[a] + set.half[a] + pad) * inverse_g);
    }
  }

  // The part of the box within a range, with a fast path for the common case of the whole box.
  Block clipped(const CropRange& range) const {
    bool all = true;
    for (std::size_t a = 0; a < 3; ++a)
      all &= (lower[a] >= std::max(range.lower[a], -kNear)) & (upper[a] <= std::min(range.upper[a], kNear));
    if (!all) return clipped_block(lower, upper, range);
    Block block;
    for (std::size_t a = 0; a < 3; ++a)
      block.lower[a] = static_cast<std::int32_t>(lower[a]), block.upper[a] = static_cast<std::int32_t>(upper[a]);
    return block;
  }

  bool within(const CropRange& range) const {
    bool within = true;
    for (std::size_t a = 0; a < 3; ++a) within &= lower[a] >= range.lower[a] && upper[a] <= range.upper[a];
    return within;
  }

  // Number of axes along which the box is one voxel thick. If two, the set touches every voxel of the box.
  int thin() const { return (lower[0] == upper[0]) + (lower[1] == upper[1]) + (lower[2] == upper[2]); }
};

// Finds the voxels of sets and gives them to a writer, in runs.
template <class Writer>
class Marker {
 public:
  Marker(Writer& writer, double g, const CropRange& crop, const CropRange& range, const Stop& stop)
      : writer_(writer), g_(g), inverse_g_(1 / g), crop_(crop), range_(range), stop_(stop) {}

  // Adds the voxels of one set within the range.
  Reach mark(const Bounds& set) {
    stop_.check();
    const Boxed boxed(set, g_, inverse_g_);
    const Block block = boxed.clipped(range_);
    if (block.empty()) return Reach::kOutside;
    const bool whole = boxed.within(crop_);
    const int thin = boxed.thin();
    bool marked = true;
    if (thin >= 2) {
      for (std::int32_t x = block.lower[0]; x <= block.upper[0]; ++x) {
        stop_.check();
        for (std::int32_t y = block.lower[1]; y <= block.upper[1]; ++y)
          writer_.add({x, y, block.lower[2], block.upper[2]});
      }
    } else {
      marked = thin == 1 ? plane(boxed, block) : columns(boxed, block);
    }
    return !marked ? Reach::kOutside : whole ? Reach::kWithin : Reach::kCut;
  }

 private:
  // The second ellipsoid, where the first alone might mark many voxels more.
  const Ellipsoid* worthwhile(const Bounds& set) const {
    return set.second && set.excess > kWorth * g_ ? &*set.second : nullptr;
  }

  // A box that is one voxel thick along axis k: a voxel is touched when the shadow reaches its side.
  bool plane(const Boxed& boxed, const Block& block) {
    const std::size_t k = boxed.lower[2] == boxed.upper[2] ? 2 : boxed.lower[1] == boxed.upper[1] ? 1 : 0;
    const std::size_t i = k == 0 ? 1 : 0, j = k == 2 ? 1 : 2;
    const Ellipsoid& first_set = boxed.set.first;
    const Shadow shadow(first_set, boxed.pad, i, j, k);
    std::optional<Shadow> second;
    if (const Ellipsoid* e = worthwhile(boxed.set)) second.emplace(*e, kPad * e->extent(g_), i, j, k);
    const Triple& centre = first_set.centre;
    chords_.clear();
    for (std::int32_t v = block.lower[j]; v <= block.upper[j]; ++v) {
      const Span across = span(v, centre[j]);
      chords_.push_back({shadow.second(across), second ? second->second(across) : Shadow::Chord{}});
    }
    bool marked = false;
    Index3 at = block.lower;
    for (at[i] = block.lower[i]; at[i] <= block.upper[i]; ++at[i]) {
      stop_.check();
      const Span along = span(at[i], centre[i]);
      const Shadow::Chord chord = shadow.first(along), other = second ? second->first(along) : Shadow::Chord{};
      std::int32_t first = 0, last = -1;  // the touched voxels of a row are one run
      for (at[j] = block.lower[j]; at[j] <= block.upper[j]; ++at[j]) {
        const auto& [mine, others] = chords_[static_cast<std::size_t>(at[j] - block.lower[j])];
        if (!shadow.reaches(chord, mine) || (second && !second->reaches(other, others))) continue;
        marked = true;
        if (j == 1) {
          writer_.add({at[0], at[1], at[2], at[2]});
        } else {
          if (first > last) first = at[j];
          last = at[j];
        }
      }
      if (first <= last) writer_.add({at[0], at[1], first, last});
    }
    return marked;
  }

  // The runs in z of one ellipsoid in the columns of a block.
  class Runs {
   public:
    Runs(const Marker& marker, const Ellipsoid& e, double pad, const Block& block, std::vector<Surfaces::Edge>& y)
        : marker_(marker), e_(e), pad_(pad), surfaces_(e, pad), y_(y) {
      y_.clear();
      for (std::int32_t v = block.lower[1]; v <= block.upper[1]; ++v)
        y_.push_back(surfaces_.y_edge(marker.span(v, e.centre[1])));
    }

    void at(std::int32_t x) { x_edge_ = surfaces_.x_edge(marker_.span(x, e_.centre[0])); }

    // Clips the run of column y of the block; false when it is empty.
    bool cut(std::size_t y, double& first, double& last) const {
      const double top = surfaces_.top(x_edge_, y_[y]);
      if (top == kMiss) return false;
      const double bottom = surfaces_.bottom(x_edge_, y_[y]);
      if (bottom == kMiss) return false;
      first = std::max(std::floor((e_.centre[2] - bottom - pad_) * marker_.inverse_g_), first);
      last = std::min(std::floor((e_.centre[2] + top + pad_) * marker_.inverse_g_), last);
      return first <= last;
    }

   private:
    const Marker& marker_;
    const Ellipsoid& e_;
    double pad_;
    Surfaces surfaces_;
    std::vector<Surfaces::Edge>& y_;
    Surfaces::Edge x_edge_;
  };

  bool columns(const Boxed& boxed, const Block& block) {
    const Bounds& set = boxed.set;
    Runs runs(*this, set.first, boxed.pad, block, y_);
    std::optional<Runs> second;
    if (const Ellipsoid* e = worthwhile(set)) second.emplace(*this, *e, kPad * e->extent(g_), block, second_y_);
    bool marked = false;
    for (std::int32_t x = block.lower[0]; x <= block.upper[0]; ++x) {
      stop_.check();
      runs.at(x);
      if (second) second->at(x);
      for (std::int32_t y = block.lower[1]; y <= block.upper[1]; ++y) {
        const auto row = static_cast<std::size_t>(y - block.lower[1]);
        double first = block.lower[2], last = block.upper[2];
        if (!runs.cut(row, first, last) || (second && !second->cut(row, first, last))) continue;
        writer_.add({x, y, static_cast<std::int32_t>(first), static_cast<std::int32_t>(last)});
        marked = true;
      }
    }
    return marked;
  }

  Span span(std::int32_t i, double centre) const { return {double(i) * g_ - centre, (double(i) + 1) * g_ - centre}; }

  Writer& writer_;
  double g_, inverse_g_;
  CropRange crop_, range_;
  const Stop& stop_;
  std::vector<Surfaces::Edge> y_, second_y_;
  std::vector<std::pair<Shadow::Chord, Shadow::Chord>> chords_;
};

constexpr std::size_t kMarkedShare = 800;  // of the time, in Share::kWhole, before voxels are listed
constexpr std::size_t kChunk = 4096;       // ellipsoids that a thread takes at once

std::int32_t floor_divided(std::int32_t a, std::int32_t b) { return a / b - (a % b < 0); }

[[noreturn]] void throw_too_many_tiles() {
  throw std::overflow_error("the scene would fall into too many tiles of this size");
}

// Marks all ellipsoids within a range.
template <class Marked>
void mark_all(const Splats& splats, const Level& level, double g, const CropRange& outer, const CropRange& range,
              OverlapGrid& grid, unsigned jobs, Control& control, Marked&& marked) {
  parallel_chunks(splats.size(), kChunk, jobs, control, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    OverlapGrid::Writer writer(grid);
    Marker marker(writer, g, outer, range, stop);
    for (std::size_t i = begin; i < end; ++i) marked(i, marker.mark(bounds_of(splats, i, level)));
    writer.finish();
  });
}

CropRange within_tile(CropRange range, const std::optional<Block>& tile) {
  for (std::size_t a = 0; tile && a < 3; ++a) {
    range.lower[a] = std::max(range.lower[a], double(tile->lower[a]));
    range.upper[a] = std::min(range.upper[a], double(tile->upper[a]));
  }
  return range;
}

}  // namespace

namespace {

// Edges, product over the axes, of a box around ellipsoid i [voxels].
double rough_box(const Splats& splats, std::size_t i, const Level& level, double g) {
  const Level grown = level_of(splats, i, level);
  const double per_scale = 2 * grown.sigma / g, rest = 2 * grown.inflation / g + 1;
  const float* s = &splats.scale[3 * i];
  return (per_scale * s[0] + rest) * (per_scale * s[1] + rest) * (per_scale * s[2] + rest);
}

}  // namespace

void check_each_budget(const Splats& splats, const Level& level, double g, const CropRange& range) {
  for (std::size_t i = 0; i < splats.size(); ++i) {
    if (rough_box(splats, i, level, g) < double(OverlapGrid::kMaxVoxels)) continue;
    const Bounds set = bounds_of(splats, i, level);
    if (Boxed(set, g, 1 / g).within(range)) check_voxel_budget(set.least_voxels(g));
  }
}

void check_budgets(const Splats& splats, const Level& level, double g, const CropRange& range, unsigned jobs,
                   Control& control) {
  double boxes = 0;
  for (std::size_t i = 0; i < splats.size(); ++i) boxes += rough_box(splats, i, level, g);
  // Skipped where the coarse pass would cost as much; values that are not finite are rejected later.
  const double worth = std::max(double(OverlapGrid::kMaxVoxels), 8 * double(splats.size()));
  if (!std::isfinite(boxes) || boxes < worth) return;
  CropRange coarse = range;
  for (std::size_t a = 0; a < 3; ++a)
    coarse.lower[a] = std::floor(range.lower[a] / 4), coarse.upper[a] = std::floor(range.upper[a] / 4);
  check_budgets(splats, level, 4 * g, coarse, jobs, control);
  OverlapGrid grid(OverlapGrid::kMaxVoxels, OverlapGrid::kMaxBricks / 4);
  InterruptOnly quiet(control);
  try {
    mark_all(splats, level, 4 * g, coarse, coarse, grid, jobs, quiet, [](std::size_t, Reach) {});
  } catch (const std::overflow_error&) {  // the count so far is a lower bound
  }
  check_brick_budget(grid.collect(std::numeric_limits<std::uint32_t>::max(), jobs, quiet).below / 2);
}

Voxelized voxelize(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
                   const std::optional<Block>& tile, std::uint32_t min_overlap, unsigned jobs, Control& control) {
  check_splats(splats, level, voxel_size);
  const CropRange outer = crop_range(crop, voxel_size), range = within_tile(outer, tile);
  Voxelized out;
  out.reach.resize(splats.size());
  Share marking(control, 0, kMarkedShare), collecting(control, kMarkedShare, Share::kWhole);
  check_each_budget(splats, level, voxel_size, outer);
  check_budgets(splats, level, voxel_size, range, jobs, marking);
  OverlapGrid grid;
  mark_all(splats, level, voxel_size, outer, range, grid, jobs, marking,
           [&](std::size_t i, Reach reach) { out.reach[i] = static_cast<std::uint8_t>(reach); });
  out.voxels = grid.collect(min_overlap, jobs, collecting);
  return out;
}

namespace {

constexpr double kShortestAxis = 1e-6,
                 kLongestAxis = 1e4;  // semi-axes [cells]; longer ones reach across the box anyway
constexpr double kFarthest = 1e6;     // cells; centres beyond cannot reach the box

// Raises the cells of a box to the rank of the present ellipsoid; many threads write to the same cells.
struct RankWriter {
  std::span<std::uint8_t> cell;
  const Index3& size;
  std::uint8_t rank = 0;

  void add(const OverlapGrid::Run& run) {
    const std::size_t row = (std::size_t(run.x) * std::size_t(size[1]) + std::size_t(run.y)) * std::size_t(size[2]);
    for (std::size_t i = row + std::size_t(run.first); i <= row + std::size_t(run.last); ++i) {
      std::atomic_ref<std::uint8_t> now(cell[i]);
      for (std::uint8_t old = now.load(std::memory_order_relaxed); old < rank;)
        if (now.compare_exchange_weak(old, rank, std::memory_order_relaxed)) break;
    }
  }
};

}  // namespace

OpacityTally tally_opacity(const Splats& splats, std::span<const float> opacity, std::span<const float> limit,
                           const Triple& origin, double edge, const Index3& size, unsigned jobs, Control& control) {
  const std::size_t n = splats.size(), ranks = limit.size() + 1;
  if (splats.mean.size() != 3 * n || splats.scale.size() != 3 * n || splats.quat_wxyz.size() != 4 * n ||
      opacity.size() != n)
    throw std::invalid_argument("mean, scale, quat_wxyz and opacity do not have the same number of rows");
  if (!std::is_sorted(limit.begin(), limit.end()) || ranks > 255)
    throw std::invalid_argument("limits are not ascending, or too many");
  if (!(edge > 0) || *std::min_element(size.begin(), size.end()) < 1 ||
      double(size[0]) * size[1] * size[2] > double(OpacityTally::kMaxCells))
    throw std::invalid_argument("the box has no cells, or too many");
  std::vector<std::uint8_t> cell(std::size_t(size[0]) * std::size_t(size[1]) * std::size_t(size[2]), 0);
  CropRange range;
  for (std::size_t a = 0; a < 3; ++a) range.lower[a] = 0, range.upper[a] = size[a] - 1;
  OpacityTally tally{std::vector<std::int64_t>(ranks, 0), std::vector<std::int64_t>(ranks, 0)};
  std::mutex mutex;
  parallel_chunks(n, kChunk, jobs, control, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    RankWriter writer{cell, size};
    Marker marker(writer, 1.0, range, range, stop);
    std::vector<std::int64_t> gaussians(ranks, 0);
    for (std::size_t i = begin; i < end; ++i) {
      std::array<float, 3> place, semi;  // in cells
      double squared = 0;
      bool is_finite = std::isfinite(opacity[i]), is_far = false;
      for (std::size_t a = 0; a < 3; ++a) {
        const double centre = (double(splats.mean[3 * i + a]) - origin[a]) / edge, s = splats.scale[3 * i + a];
        is_finite &= std::isfinite(centre) && std::isfinite(s);
        is_far |= std::abs(centre) >= kFarthest;
        place[a] = static_cast<float>(centre);
        semi[a] = static_cast<float>(std::clamp(s / edge, kShortestAxis, kLongestAxis));
      }
      for (std::size_t a = 0; a < 4; ++a) {
        const double q = splats.quat_wxyz[4 * i + a];
        squared += q * q;
      }
      if (!is_finite || !std::isfinite(squared) || squared == 0) continue;
      const auto rank = std::upper_bound(limit.begin(), limit.end(), opacity[i]) - limit.begin();
      ++gaussians[static_cast<std::size_t>(rank)];
      if (is_far) continue;
      writer.rank = static_cast<std::uint8_t>(rank + 1);
      marker.mark(bounds_of({place, semi, splats.quat_wxyz.subspan(4 * i, 4), {}}, 0, {}));
    }
    const std::lock_guard lock(mutex);
    for (std::size_t r = 0; r < ranks; ++r) tally.gaussians[r] += gaussians[r];
  });
  for (const std::uint8_t rank : cell)
    if (rank > 0) ++tally.cells[rank - 1u];
  return tally;
}

Tiles tiles_of(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
               std::int32_t edge, Control& control) {
  check_splats(splats, level, voxel_size);
  if (edge < 1) throw std::invalid_argument("a tile has no voxels");
  const CropRange range = crop_range(crop, voxel_size);
  const double inverse_g = 1 / voxel_size;
  struct Entry {
    std::uint32_t tile, row;
  };
  std::vector<Entry> entries;
  BrickMap map;
  for (std::size_t i = 0; i < splats.size(); ++i) {
    if (i % kChunk == 0) control.poll(i, splats.size());
    const Bounds set = bounds_of(splats, i, level);
    const Block block = Boxed(set, voxel_size, inverse_g).clipped(range);
    if (block.empty()) continue;
    Index3 first, last;
    double count = 1;
    for (std::size_t a = 0; a < 3; ++a) {
      first[a] = floor_divided(block.lower[a], edge), last[a] = floor_divided(block.upper[a], edge);
      count *= double(last[a]) - double(first[a]) + 1;
    }
    if (double(entries.size()) + count > double(Tiles::kMaxEntries)) throw_too_many_tiles();
    for (std::int32_t x = first[0]; x <= last[0]; ++x)
      for (std::int32_t y = first[1]; y <= last[1]; ++y)
        for (std::int32_t z = first[2]; z <= last[2]; ++z) {
          entries.push_back({map.insert({x, y, z}), static_cast<std::uint32_t>(i)});
          if (map.size() > Tiles::kMaxTiles) throw_too_many_tiles();
        }
  }
  control.poll(splats.size(), splats.size());

  std::vector<std::pair<Index3, std::uint32_t>> tiles;
  map.each([&](const Index3& tile, std::uint32_t number) { tiles.emplace_back(tile, number); });
  std::sort(tiles.begin(), tiles.end());
  std::vector<std::uint32_t> place(tiles.size());
  Tiles out;
  for (std::uint32_t t = 0; t < tiles.size(); ++t) {
    place[tiles[t].second] = t;
    out.tile.insert(out.tile.end(), tiles[t].first.begin(), tiles[t].first.end());
  }
  out.start.assign(tiles.size() + 1, 0);
  for (const Entry& entry : entries) ++out.start[place[entry.tile] + 1];
  std::partial_sum(out.start.begin(), out.start.end(), out.start.begin());
  std::vector<std::int64_t> next(out.start.begin(), out.start.end() - 1);
  out.row.resize(entries.size());
  for (const Entry& entry : entries) out.row[static_cast<std::size_t>(next[place[entry.tile]]++)] = entry.row;
  return out;
}

}  // namespace alula
