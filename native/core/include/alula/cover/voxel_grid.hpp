// Sparse sets and counts of voxels. Voxel i of a grid with edge g is the closed cube [i g, (i + 1) g].
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

using Index3 = std::array<std::int32_t, 3>;
using Box6 = std::array<double, 6>;  // xmin ymin zmin xmax ymax zmax

// Integer bounds, both inclusive; empty when a lower one exceeds an upper one.
struct Block {
  Index3 lower, upper;
  bool empty() const { return lower[0] > upper[0] || lower[1] > upper[1] || lower[2] > upper[2]; }
};

// Index range of the voxels with closed cubes that touch a box, as doubles because indices may exceed 32 bits;
// exact where they do not. Without a box the range is unlimited.
struct CropRange {
  std::array<double, 3> lower, upper;
};
CropRange crop_range(const std::optional<Box6>& crop, double voxel_size);

// The part of the voxels lower ... upper (whole numbers) within the range. Throws std::overflow_error when
// it does not fit 32-bit indices, or when a bound is infinite or NaN.
Block clipped_block(const std::array<double, 3>& lower, const std::array<double, 3>& upper, const CropRange& range);

// Open-addressing map from brick coordinates to consecutive numbers 0, 1, 2, ...
class BrickMap {
 public:
  static constexpr std::uint32_t kNone = 0xffffffffu;
  std::uint32_t find(const Index3& brick) const;
  // The number of a brick; a new brick gets the next unused one.
  std::uint32_t insert(const Index3& brick);
  // Prefetches the memory that a search for the brick will read.
  void prefetch(const Index3& brick) const;
  std::size_t size() const { return size_; }
  // Calls visit(brick, number) for all bricks, in no particular order.
  template <class Visit>
  void each(Visit&& visit) const {
    for (const Slot& slot : slots_)
      if (slot.number != kNone) visit(slot.brick, slot.number);
  }

 private:
  struct Slot {
    Index3 brick{};
    std::uint32_t number = kNone;
  };
  std::size_t place(const Index3& brick) const;
  void grow();
  std::vector<Slot> slots_;
  std::size_t size_ = 0;
};

// Voxels in lexicographic order with their counts: those of all counted voxels that reach a minimum count.
struct VoxelCounts {
  std::vector<std::int32_t> index;  // (M, 3)
  std::vector<std::uint32_t> count;
  std::size_t below = 0;   // voxels with a lower count
  std::uint32_t most = 0;  // highest count of all
};

// Merges lists of voxels, (M_i, 3), each in lexicographic order and disjoint from the others, into one.
VoxelCounts joined(std::span<const std::int32_t> index, std::span<const std::uint32_t> count,
                   std::span<const std::int64_t> start);

// Counts how often each voxel was added, in sparse bricks of 4 x 4 x 8 counters. Runs may be added from
// several threads; sums, and so the result, do not depend on their order.
class OverlapGrid {
 public:
  // 2^27 voxels (2 GiB as index and count) and 2^22 bricks (2 GiB): beyond, std::overflow_error.
  static constexpr std::size_t kMaxVoxels = std::size_t{1} << 27;
  static constexpr std::size_t kMaxBricks = std::size_t{1} << 22;
  static constexpr int kShiftXY = 2, kShiftZ = 3;  // of a brick

  // A column of bricks. It lies in one shard, so threads rarely wait for each other.
  struct Column {
    std::int32_t x = 0, y = 0;
    bool operator==(const Column&) const = default;
  };
  static constexpr std::size_t kShards = 64;
  static std::size_t shard_of(const Column& column);

  // Voxels (x, y, first) ... (x, y, last).
  struct Run {
    std::int32_t x, y, first, last;
  };

  // Collects the runs of one thread; `finish` must be called at the end.
  class Writer {
   public:
    explicit Writer(OverlapGrid& grid)
        : grid_(grid), pending_(std::make_unique_for_overwrite<Run[]>(kShards * kFull)) {}
    void add(const Run& run) {
      // Neighbours share a column of bricks, and so a shard.
      if (const Column column{run.x >> kShiftXY, run.y >> kShiftXY}; column != column_)
        column_ = column, shard_ = shard_of(column);
      std::uint32_t& size = size_[shard_];
      pending_[shard_ * kFull + size] = run;
      if (++size == kFull) flush(shard_);
    }
    void finish();

   private:
    static constexpr std::size_t kFull = 64;
    void flush(std::size_t shard);

    OverlapGrid& grid_;
    Column column_{};
    std::size_t shard_ = shard_of(Column{});
    std::array<std::uint32_t, kShards> size_{};
    std::unique_ptr<Run[]> pending_;
  };

  explicit OverlapGrid(std::size_t max_voxels = kMaxVoxels, std::size_t max_bricks = kMaxBricks);
  ~OverlapGrid();
  // All voxels added at least `min_count` times.
  VoxelCounts collect(std::uint32_t min_count, unsigned jobs, Control& control) const;

 private:
  struct Shard;
  struct Budget;
  std::unique_ptr<Budget> budget_;
  std::array<std::unique_ptr<Shard>, kShards> shards_;
};

// Throws std::overflow_error when one ellipsoid alone exceeds OverlapGrid::kMaxVoxels.
void check_voxel_budget(double least_voxels);

// Throws std::overflow_error when there would be more than OverlapGrid::kMaxBricks.
void check_brick_budget(std::size_t least_bricks);

// A set of voxels, stored as bricks of 8 x 8 x 8 bits.
class VoxelSet {
 public:
  static constexpr int kEdge = 8;
  // Bit 8 y + z of word x; coordinates within the brick.
  using Bits = std::array<std::uint64_t, 8>;

  explicit VoxelSet(std::span<const std::int32_t> index);  // (M, 3), in any order
  // The bits of a brick (voxel coordinates >> 3), or nullptr when it has none.
  const Bits* brick(const Index3& brick) const {
    const std::uint32_t number = map_.find(brick);
    return number == BrickMap::kNone ? nullptr : &bits_[number];
  }

 private:
  BrickMap map_;
  std::vector<Bits> bits_;
};

}  // namespace alula
