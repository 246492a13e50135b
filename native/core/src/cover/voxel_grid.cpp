#include "alula/cover/voxel_grid.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

constexpr double kLargestIndex = 2147483646.0;  // one less than 2^31 - 1, because i + 1 must fit too

// The high bits depend on all bits of the three coordinates.
std::uint64_t hash_of(const Index3& b) {
  const auto word = [](std::int32_t v) { return std::uint64_t{static_cast<std::uint32_t>(v)}; };
  const std::uint64_t h =
      word(b[0]) * 0x9fb21c651e98df25u ^ word(b[1]) * 0xd6e8feb86659fd93u ^ word(b[2]) * 0x9e3779b97f4a7c15u;
  return (h ^ (h >> 32)) * 0x9fb21c651e98df25u;
}

bool same(const Index3& a, const Index3& b) { return ((a[0] ^ b[0]) | (a[1] ^ b[1]) | (a[2] ^ b[2])) == 0; }

}  // namespace

CropRange crop_range(const std::optional<Box6>& crop, double g) {
  constexpr double all = std::numeric_limits<double>::infinity();
  CropRange range{{-all, -all, -all}, {all, all, all}};
  if (!crop) return range;
  for (std::size_t a = 0; a < 3; ++a) {
    const double low = (*crop)[a], high = (*crop)[a + 3];
    // Smallest i with (i + 1) g >= low, largest i with i g <= high; fma rounds once, so signs are exact.
    double i = std::ceil(low / g) - 1;
    if (std::abs(i) <= kLargestIndex) {
      while (std::fma(i, g, -low) >= 0) --i;
      while (std::fma(i + 1, g, -low) < 0) ++i;
    }
    range.lower[a] = i;
    i = std::floor(high / g);
    if (std::abs(i) <= kLargestIndex) {
      while (std::fma(i + 1, g, -high) <= 0) ++i;
      while (std::fma(i, g, -high) > 0) --i;
    }
    range.upper[a] = i;
  }
  return range;
}

Block clipped_block(const std::array<double, 3>& lower, const std::array<double, 3>& upper, const CropRange& range) {
  Block block{{0, 0, 0}, {-1, -1, -1}};
  std::array<double, 3> low, high;
  bool finite = true, empty = false, fits = true;
  for (std::size_t a = 0; a < 3; ++a) {
    finite &= std::isfinite(lower[a]) && std::isfinite(upper[a]);
    low[a] = std::max(lower[a], range.lower[a]);
    high[a] = std::min(upper[a], range.upper[a]);
    empty |= !(low[a] <= high[a]);
    fits &= low[a] >= -kLargestIndex && high[a] <= kLargestIndex;
  }
  // Infinite or NaN bounds would compare as an empty block.
  if (!finite) throw std::overflow_error("an ellipsoid has no finite bounds in double precision");
  if (empty) return block;
  if (!fits)
    throw std::overflow_error(
        "voxel indices would not fit 32 bits: an ellipsoid reaches too far for this voxel size");
  for (std::size_t a = 0; a < 3; ++a) {
    block.lower[a] = static_cast<std::int32_t>(low[a]);
    block.upper[a] = static_cast<std::int32_t>(high[a]);
  }
  return block;
}

std::size_t BrickMap::place(const Index3& brick) const {
  const std::size_t mask = slots_.size() - 1;
  std::size_t at = (hash_of(brick) >> 24) & mask;
  while (slots_[at].number != kNone && !same(slots_[at].brick, brick)) at = (at + 1) & mask;
  return at;
}

void BrickMap::prefetch(const Index3& brick) const {
  if (!slots_.empty()) __builtin_prefetch(&slots_[(hash_of(brick) >> 24) & (slots_.size() - 1)]);
}

std::uint32_t BrickMap::find(const Index3& brick) const {
  return slots_.empty() ? kNone : slots_[place(brick)].number;
}

std::uint32_t BrickMap::insert(const Index3& brick) {
  if (2 * (size_ + 1) > slots_.size()) grow();
  Slot& slot = slots_[place(brick)];
  if (slot.number == kNone) slot = {brick, static_cast<std::uint32_t>(size_++)};
  return slot.number;
}

void BrickMap::grow() {
  std::vector<Slot> old(std::max<std::size_t>(16, 2 * slots_.size()));
  old.swap(slots_);
  for (const Slot& slot : old)
    if (slot.number != kNone) slots_[place(slot.brick)] = slot;
}

namespace {

[[noreturn]] void throw_too_many(const char* qualifier, double count, const char* what = " voxels") {
  throw std::overflow_error("the scene would need " + std::string(qualifier) +
                            std::to_string(static_cast<long long>(std::min(count, 1e18))) + what);
}

constexpr const char* kBricks = " bricks of 4 x 4 x 8 voxels";

}  // namespace

void check_voxel_budget(double least_voxels) {
  if (least_voxels > double(OverlapGrid::kMaxVoxels)) throw_too_many("at least ", least_voxels);
}

void check_brick_budget(std::size_t least_bricks) {
  if (least_bricks > OverlapGrid::kMaxBricks) throw_too_many("at least ", double(least_bricks), kBricks);
}

struct OverlapGrid::Budget {
  std::size_t max_voxels = 0, max_bricks = 0;
  std::atomic<std::size_t> bricks{0};
};

struct OverlapGrid::Shard {
  static constexpr std::int32_t kX = 1 << kShiftXY, kZ = 1 << kShiftZ;
  using Row = std::array<std::uint32_t, kZ>;
  using Brick = std::array<Row, kX * kX>;  // (x * 4) + y
  static constexpr std::size_t kPage = 8;

  // Part of a run within a brick: first ... last of a row.
  struct Piece {
    std::uint32_t brick, column;  // position in `touched`
    std::int32_t first, last;
  };
  struct Touched {
    Index3 key;
    Brick* brick;
  };

  std::mutex mutex;
  BrickMap map;
  std::vector<std::unique_ptr<Brick[]>> pages;
  std::vector<Piece> pieces;
  std::vector<Touched> touched;
  Budget* budget = nullptr;

  Brick& brick(std::uint32_t number) const { return pages[number / kPage][number % kPage]; }

  Brick& brick_at(const Index3& key) {
    const std::uint32_t number = map.insert(key);
    while (number >= pages.size() * kPage) {
      if ((budget->bricks += kPage) > budget->max_bricks)
        throw_too_many("more than ", double(budget->max_bricks), kBricks);
      pages.push_back(std::make_unique<Brick[]>(kPage));
    }
    return brick(number);
  }

  // Memory is prefetched well before its use: first all slots of the map, then all rows.
  void apply(std::span<const Run> runs) {
    const std::lock_guard lock(mutex);
    pieces.clear(), touched.clear();
    recent.fill(0);
    for (const Run& run : runs) cut(run);
    for (Touched& t : touched) t.brick = &brick_at(t.key);
    for (const Piece& piece : pieces) __builtin_prefetch(&(*touched[piece.brick].brick)[piece.column], 1);
    for (const Piece& piece : pieces) count((*touched[piece.brick].brick)[piece.column], piece);
  }

 private:
  void cut(const Run& run) {
    const auto column = static_cast<std::uint32_t>((run.x & (kX - 1)) * kX + (run.y & (kX - 1)));
    const std::int32_t x = run.x >> kShiftXY, y = run.y >> kShiftXY, end = run.last >> kShiftZ;
    for (std::int32_t z = run.first >> kShiftZ; z <= end; ++z) {
      std::uint32_t& guess = recent[static_cast<std::size_t>(x + 2 * y + 4 * z) % recent.size()];
      const Index3 key{x, y, z};
      if (guess >= touched.size() || !same(touched[guess].key, key)) {
        guess = static_cast<std::uint32_t>(touched.size());
        touched.push_back({key, nullptr});
        map.prefetch(key);
      }
      const std::int32_t base = z * kZ;
      pieces.push_back({guess, column, std::max(run.first - base, 0), std::min(run.last - base, kZ - 1)});
    }
  }

  // Without branches, so it compiles to a few wide instructions.
  static void count(Row& row, const Piece& piece) {
    const Row &from = kFrom[static_cast<std::size_t>(piece.first)],
              &to = kFrom[static_cast<std::size_t>(piece.last + 1)];
    for (std::size_t i = 0; i < from.size(); ++i) row[i] += from[i] - to[i];
  }

  // Row i: 1 from position i on.
  static constexpr auto kFrom = [] {
    std::array<Row, kZ + 1> rows{};
    for (std::size_t i = 0; i < rows.size(); ++i)
      for (std::size_t j = i; j < rows[i].size(); ++j) rows[i][j] = 1;
    return rows;
  }();

  std::array<std::uint32_t, 16> recent{};  // positions in `touched`, for finding neighbours without the map
};

OverlapGrid::OverlapGrid(std::size_t max_voxels, std::size_t max_bricks) : budget_(std::make_unique<Budget>()) {
  budget_->max_voxels = max_voxels;
  budget_->max_bricks = max_bricks;
  for (auto& shard : shards_) {
    shard = std::make_unique<Shard>();
    shard->budget = budget_.get();
  }
}

OverlapGrid::~OverlapGrid() = default;

std::size_t OverlapGrid::shard_of(const Column& column) {
  return static_cast<std::size_t>(hash_of({column.x, column.y, 0}) >> 58);
}

void OverlapGrid::Writer::flush(std::size_t shard) {
  grid_.shards_[shard]->apply({&pending_[shard * kFull], size_[shard]});
  size_[shard] = 0;
}

void OverlapGrid::Writer::finish() {
  for (std::size_t s = 0; s < kShards; ++s)
    if (size_[s] > 0) flush(s);
}

VoxelCounts OverlapGrid::collect(std::uint32_t min_count, unsigned jobs, Control& control) const {
  const std::uint32_t minimum = std::max(min_count, 1u);
  struct Entry {
    Index3 key;
    const Shard::Brick* brick;
  };
  std::vector<Entry> entries;
  for (const auto& shard : shards_)
    shard->map.each([&](const Index3& key, std::uint32_t number) {
      // A brick refused by the budget has a number, but no counters.
      if (number < shard->pages.size() * Shard::kPage) entries.push_back({key, &shard->brick(number)});
    });
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.key < b.key; });

  // Slabs of equal brick x; within a slab lexicographic order interleaves the bricks' columns.
  std::vector<std::size_t> slab{0};
  for (std::size_t i = 1; i <= entries.size(); ++i)
    if (i == entries.size() || entries[i].key[0] != entries[i - 1].key[0]) slab.push_back(i);
  const std::size_t slabs = slab.size() - 1;
  std::vector<std::size_t> start(slabs + 1, 0), below(slabs, 0);
  std::vector<std::uint32_t> most(slabs, 0);
  Control quiet;
  parallel_chunks(slabs, 1, jobs, quiet, [&](std::size_t s, std::size_t) {
    std::size_t all = 0, kept = 0;
    std::uint32_t highest = 0;
    for (std::size_t i = slab[s]; i < slab[s + 1]; ++i) {
      std::uint32_t any = 0, enough = 0;
      for (const Shard::Row& row : *entries[i].brick)
        for (const std::uint32_t count : row)
          any += count > 0, enough += count >= minimum, highest = std::max(highest, count);
      all += any, kept += enough;
    }
    start[s + 1] = kept, below[s] = all - kept, most[s] = highest;
  });
  for (std::size_t s = 0; s < slabs; ++s) start[s + 1] += start[s];
  if (start[slabs] > budget_->max_voxels) throw_too_many("", double(start[slabs]));

  VoxelCounts out;
  out.index.resize(3 * start[slabs]);
  out.count.resize(start[slabs]);
  out.below = std::accumulate(below.begin(), below.end(), std::size_t{0});
  out.most = slabs == 0 ? 0 : *std::max_element(most.begin(), most.end());
  parallel_chunks(slabs, 1, jobs, control, [&](std::size_t s, std::size_t) {
    std::size_t to = start[s];
    for (std::int32_t x = 0; x < Shard::kX; ++x)
      for (std::size_t row = slab[s], end; row < slab[s + 1]; row = end) {
        for (end = row + 1; end < slab[s + 1] && entries[end].key[1] == entries[row].key[1];) ++end;
        for (std::int32_t y = 0; y < Shard::kX; ++y)
          for (std::size_t i = row; i < end; ++i) {
            const auto& [key, brick] = entries[i];
            const Shard::Row& counts = (*brick)[static_cast<std::size_t>(x * Shard::kX + y)];
            for (std::int32_t z = 0; z < Shard::kZ; ++z) {
              const std::uint32_t count = counts[static_cast<std::size_t>(z)];
              if (count < minimum) continue;
              out.index[3 * to] = key[0] * Shard::kX + x;
              out.index[3 * to + 1] = key[1] * Shard::kX + y;
              out.index[3 * to + 2] = key[2] * Shard::kZ + z;
              out.count[to++] = count;
            }
          }
      }
  });
  return out;
}

VoxelCounts joined(std::span<const std::int32_t> index, std::span<const std::uint32_t> count,
                   std::span<const std::int64_t> start) {
  struct Head {
    std::size_t at, end;
  };
  const auto before = [&](std::size_t a, std::size_t b) {
    return std::lexicographical_compare(&index[3 * a], &index[3 * a] + 3, &index[3 * b], &index[3 * b] + 3);
  };
  const auto later = [&](const Head& a, const Head& b) { return before(b.at, a.at); };
  std::vector<Head> heads;  // a heap, first list on top
  for (std::size_t i = 0; i + 1 < start.size(); ++i)
    if (start[i] < start[i + 1])
      heads.push_back({static_cast<std::size_t>(start[i]), static_cast<std::size_t>(start[i + 1])});
  std::make_heap(heads.begin(), heads.end(), later);
  VoxelCounts out;
  out.index.reserve(index.size());
  out.count.reserve(count.size());
  while (!heads.empty()) {
    std::pop_heap(heads.begin(), heads.end(), later);
    Head& first = heads.back();
    do {
      out.index.insert(out.index.end(), &index[3 * first.at], &index[3 * first.at] + 3);
      out.count.push_back(count[first.at]);
    } while (++first.at < first.end && (heads.size() == 1 || before(first.at, heads.front().at)));
    if (first.at == first.end)
      heads.pop_back();
    else
      std::push_heap(heads.begin(), heads.end(), later);
  }
  return out;
}

VoxelSet::VoxelSet(std::span<const std::int32_t> index) {
  Index3 at{};
  Bits* last = nullptr;
  for (std::size_t i = 0; i + 2 < index.size(); i += 3) {
    const Index3 key{index[i] >> 3, index[i + 1] >> 3, index[i + 2] >> 3};
    if (last == nullptr || key != at) {
      const std::uint32_t number = map_.insert(key);
      if (number == bits_.size()) bits_.push_back({});
      last = &bits_[number];
      at = key;
    }
    (*last)[static_cast<std::size_t>(index[i] & 7)] |= std::uint64_t{1}
                                                       << ((index[i + 1] & 7) * kEdge + (index[i + 2] & 7));
  }
}

}  // namespace alula
