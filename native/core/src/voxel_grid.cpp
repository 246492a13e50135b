#include "alula/voxel_grid.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "alula/parallel.hpp"

namespace alula {

namespace {

constexpr double kLargestIndex = 2147483646.0;  // one less than 2^31 - 1, so that i + 1 fits too

std::uint64_t mixed(std::uint64_t h) {
  h ^= h >> 32;
  h *= 0x9fb21c651e98df25u;
  h ^= h >> 29;
  h *= 0xd6e8feb86659fd93u;
  return h ^ (h >> 32);
}

std::uint64_t hash_of(const Index3& b) {
  const auto word = [](std::int32_t v) { return std::uint64_t{static_cast<std::uint32_t>(v)}; };
  return mixed((word(b[0]) | word(b[1]) << 32) ^ (word(b[2]) * 0x9e3779b97f4a7c15u));
}

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

Block clipped_block(const std::array<double, 3>& lower, const std::array<double, 3>& upper, double g,
                    const CropRange& crop) {
  Block block{{0, 0, 0}, {-1, -1, -1}};
  std::array<double, 3> low, high;
  for (std::size_t a = 0; a < 3; ++a) {
    // What has no bounds would compare as lying nowhere.
    if (!std::isfinite(lower[a]) || !std::isfinite(upper[a]))
      throw std::overflow_error("an ellipsoid has no finite bounds in double precision");
    low[a] = std::max(std::floor(lower[a] / g), crop.lower[a]);
    high[a] = std::min(std::floor(upper[a] / g), crop.upper[a]);
    if (!(low[a] <= high[a])) return block;
  }
  for (std::size_t a = 0; a < 3; ++a) {
    if (low[a] < -kLargestIndex || high[a] > kLargestIndex)
      throw std::overflow_error(
          "voxel indices would not fit 32 bits: an ellipsoid reaches too far for this voxel size");
    block.lower[a] = static_cast<std::int32_t>(low[a]);
    block.upper[a] = static_cast<std::int32_t>(high[a]);
  }
  return block;
}

std::size_t BrickMap::place(const Index3& brick) const {
  const std::size_t mask = slots_.size() - 1;
  std::size_t at = hash_of(brick) & mask;
  while (slots_[at].number != kNone && slots_[at].brick != brick) at = (at + 1) & mask;
  return at;
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

[[noreturn]] void throw_too_many(const char* qualifier, double voxels) {
  throw std::overflow_error("the scene would need " + std::string(qualifier) + " " +
                            std::to_string(static_cast<long long>(std::min(voxels, 1e18))) + " voxels");
}

}  // namespace

void check_voxel_budget(double least_voxels) {
  if (least_voxels > double(OverlapGrid::kMaxVoxels)) throw_too_many("at least", least_voxels);
}

struct OverlapGrid::Budget {
  std::size_t max_voxels = 0, max_bricks = 0;
  std::atomic<std::size_t> voxels{0}, bricks{0};
};

// Bricks that share a column of bricks are in one shard.
struct OverlapGrid::Shard {
  static constexpr int kShiftXY = 2, kShiftZ = 3;
  static constexpr std::int32_t kX = 1 << kShiftXY, kZ = 1 << kShiftZ;
  using Brick = std::array<std::uint32_t, kX * kX * kZ>;  // ((x * 4) + y) * 8 + z
  static constexpr std::size_t kPage = 64;

  std::mutex mutex;
  BrickMap map;
  std::vector<std::unique_ptr<Brick[]>> pages;
  Budget* budget = nullptr;

  Brick& brick(std::uint32_t number) const { return pages[number / kPage][number % kPage]; }

  Brick& brick_at(const Index3& key) {
    const std::uint32_t number = map.insert(key);
    while (number >= pages.size() * kPage) {
      if ((budget->bricks += kPage) > budget->max_bricks) throw_too_many("more than", double(budget->voxels));
      pages.push_back(std::make_unique<Brick[]>(kPage));
    }
    return brick(number);
  }

  void apply(std::span<const Run> runs) {
    const std::lock_guard lock(mutex);
    Index3 at{};
    Brick* last = nullptr;
    std::size_t fresh = 0;
    for (const Run& run : runs) {
      const std::int32_t column = ((run.x & (kX - 1)) * kX + (run.y & (kX - 1))) * kZ;
      for (std::int32_t z = run.first; z <= run.last;) {
        const std::int32_t stop = std::min(run.last, z | (kZ - 1));
        const Index3 key{run.x >> kShiftXY, run.y >> kShiftXY, z >> kShiftZ};
        if (last == nullptr || key != at) last = &brick_at(key), at = key;
        std::uint32_t* counts = last->data() + column;
        for (std::int32_t i = z & (kZ - 1), end = stop & (kZ - 1); i <= end; ++i) fresh += counts[i]++ == 0;
        z = stop + 1;
      }
    }
    if ((budget->voxels += fresh) > budget->max_voxels) throw_too_many("more than", double(budget->max_voxels));
  }
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

void OverlapGrid::Writer::add(const Run& run) {
  constexpr std::size_t full = 256;
  const std::size_t s = hash_of({run.x >> Shard::kShiftXY, run.y >> Shard::kShiftXY, 0}) >> 58;
  std::vector<Run>& runs = pending_[s];
  if (runs.empty()) runs.reserve(full);
  runs.push_back(run);
  if (runs.size() == full) {
    grid_.shards_[s]->apply(runs);
    runs.clear();
  }
}

void OverlapGrid::Writer::finish() {
  for (std::size_t s = 0; s < pending_.size(); ++s) {
    if (!pending_[s].empty()) grid_.shards_[s]->apply(pending_[s]);
    pending_[s].clear();
  }
}

VoxelCounts OverlapGrid::collect(std::uint32_t min_count, unsigned jobs, Control& control) const {
  struct Entry {
    Index3 key;
    const Shard::Brick* brick;
  };
  std::vector<Entry> entries;
  for (const auto& shard : shards_)
    shard->map.each(
        [&](const Index3& key, std::uint32_t number) { entries.push_back({key, &shard->brick(number)}); });
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.key < b.key; });

  // Slabs of equal brick x; within a slab lexicographic order interleaves the bricks' columns.
  std::vector<std::size_t> slab{0};
  for (std::size_t i = 1; i <= entries.size(); ++i)
    if (i == entries.size() || entries[i].key[0] != entries[i - 1].key[0]) slab.push_back(i);
  const std::size_t slabs = slab.size() - 1;
  std::vector<std::size_t> start(slabs + 1, 0);
  Control quiet;
  parallel_chunks(slabs, 1, jobs, quiet, [&](std::size_t s, std::size_t) {
    std::size_t total = 0;
    for (std::size_t i = slab[s]; i < slab[s + 1]; ++i)
      for (const std::uint32_t count : *entries[i].brick) total += count >= min_count && count > 0;
    start[s + 1] = total;
  });
  for (std::size_t s = 0; s < slabs; ++s) start[s + 1] += start[s];

  VoxelCounts out;
  out.index.resize(3 * start[slabs]);
  out.count.resize(start[slabs]);
  parallel_chunks(slabs, 1, jobs, control, [&](std::size_t s, std::size_t) {
    std::size_t to = start[s];
    for (std::int32_t x = 0; x < Shard::kX; ++x)
      for (std::size_t row = slab[s], end; row < slab[s + 1]; row = end) {
        for (end = row + 1; end < slab[s + 1] && entries[end].key[1] == entries[row].key[1];) ++end;
        for (std::int32_t y = 0; y < Shard::kX; ++y)
          for (std::size_t i = row; i < end; ++i) {
            const auto& [key, brick] = entries[i];
            for (std::int32_t z = 0; z < Shard::kZ; ++z) {
              const std::uint32_t count = (*brick)[static_cast<std::size_t>((x * Shard::kX + y) * Shard::kZ + z)];
              if (count < min_count || count == 0) continue;
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
