#include "alula/cover/separation.hpp"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/cover/voxelize.hpp"

namespace alula {

namespace {

constexpr double kUnit = kEps / 2;
constexpr double kSeparationDemanded = 64 * kUnit;
constexpr double kGrown = 256 * kUnit;
constexpr double kShortAxis = 0x1p-60;

double scalar_product(const Triple& a, const Triple& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
double norm(const Triple& a) { return std::sqrt(scalar_product(a, a)); }

// R times a unit vector: ((w^2 - v.v) e + 2 v (v.e) + 2 w v x e) / |q|^2 for q = (w, v).
Triple rotated_axis(const float* q, std::size_t axis) {
  const double w = q[0];
  const Triple v{q[1], q[2], q[3]};
  Triple e{};
  e[axis] = 1;
  const Triple cross{v[1] * e[2] - v[2] * e[1], v[2] * e[0] - v[0] * e[2], v[0] * e[1] - v[1] * e[0]};
  const double vv = scalar_product(v, v);
  Triple out;
  for (std::size_t a = 0; a < 3; ++a)
    out[a] = ((w * w - vv) * e[a] + 2 * v[a] * v[axis] + 2 * w * cross[a]) / (w * w + vv);
  return out;
}

// The rigorous part: the result relies only on the proofs of this class.
class SeparationProver {
 public:
  SeparationProver(const Splats& splats, std::size_t i, const Level& all, double g) : g_(g) {
    const Level level = level_of(splats, i, all);
    r_ = level.inflation;
    double reach = r_, far = 0;
    for (std::size_t j = 0; j < 3; ++j) {
      centre_[j] = splats.mean[3 * i + j];
      semi_axis_[j] = level.sigma * splats.scale[3 * i + j];
      axis_[j] = rotated_axis(&splats.quat_wxyz[4 * i], j);
      reach += semi_axis_[j];
      far = std::max(far, std::abs(centre_[j]));
    }
    demanded_ = kSeparationDemanded * (far + reach + g);
  }

  // Outward bounds of the set: no voxel beyond them is touched.
  Triple lower() const { return bound(-1); }
  Triple upper() const { return bound(1); }

  // True if n separates the set from the block; n may have any length.
  bool separates(Triple n, const Block& block) const {
    const double largest = std::max({std::abs(n[0]), std::abs(n[1]), std::abs(n[2])});
    if (!(largest > 0) || !std::isfinite(largest)) return false;
    double nearest = 0, length = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      n[a] /= largest;
      if (std::abs(n[a]) < kShortAxis) n[a] = 0;
      length += std::abs(n[a]);
      const double corner = n[a] > 0 ? double(block.lower[a]) : double(block.upper[a]) + 1;
      nearest += n[a] * (corner * g_ - centre_[a]);
    }
    return nearest - support(n) > demanded_ * length;
  }

 private:
  // max of n.(x - c) over the set.
  double support(const Triple& n) const {
    const Triple u{semi_axis_[0] * scalar_product(axis_[0], n), semi_axis_[1] * scalar_product(axis_[1], n),
                   semi_axis_[2] * scalar_product(axis_[2], n)};
    return norm(u) + (r_ > 0 ? r_ * norm(n) : 0);
  }

  Triple bound(double sign) const {
    Triple out;
    for (std::size_t a = 0; a < 3; ++a) {
      Triple n{};
      n[a] = 1;
      out[a] = centre_[a] + sign * (support(n) + demanded_);
    }
    return out;
  }

  double g_, r_, demanded_;
  Triple centre_, semi_axis_;
  std::array<Triple, 3> axis_;  // columns of R
};

// The heuristic part: candidate directions, from one ellipsoid around the set.
class Directions {
 public:
  Directions(const SeparationProver& prover, const Ellipsoid& outer, double g)
      : prover_(prover), outer_(outer), grown_(kGrown * outer.extent(g)) {
    // The metric |inv(A) x|^2; column j of A has the length of semi-axis j.
    for (std::size_t j = 0; j < 3; ++j) {
      const Triple column{outer_.row[0][j], outer_.row[1][j], outer_.row[2][j]};
      const double square = scalar_product(column, column);
      for (std::size_t a = 0; a < 3; ++a)
        for (std::size_t b = 0; b < 3; ++b) metric_[a][b] += (column[a] / square) * (column[b] / square);
    }
  }

  // True if the set is proven clear of the block, which is lower ... upper relative to the centre.
  bool separate(const Block& block, const Triple& lower, const Triple& upper, bool single) {
    const Verdict verdict = descend(block, lower, upper);
    if (verdict != Verdict::kUnknown || !single) return verdict == Verdict::kSeparated;
    return by_features(block, lower, upper);
  }

 private:
  enum class Verdict { kSeparated, kTouching, kUnknown };

  // Coordinate descent to the point of the block that is nearest in the metric.
  Verdict descend(const Block& block, const Triple& lower, const Triple& upper) const {
    Triple x;
    for (std::size_t a = 0; a < 3; ++a) x[a] = std::clamp(0.0, lower[a], upper[a]);
    for (int sweep = 0; sweep < 3; ++sweep) {
      Triple n;
      double scale = 0;  // sum of the magnitudes of the terms of n.x, for its rounding error
      for (std::size_t a = 0; a < 3; ++a) n[a] = scalar_product(metric_[a], x), scale += metric_[a][a] * x[a] * x[a];
      if (scalar_product(n, x) + 16 * kEps * scale <= 1) return Verdict::kTouching;
      Triple pushed = n;
      for (std::size_t a = 0; a < 3; ++a)
        if ((n[a] > 0 && x[a] > lower[a]) || (n[a] < 0 && x[a] < upper[a])) pushed[a] = 0;
      if (prover_.separates(pushed, block)) return Verdict::kSeparated;
      for (std::size_t a = 0; a < 3; ++a)
        x[a] = std::clamp(x[a] - scalar_product(metric_[a], x) / metric_[a][a], lower[a], upper[a]);
    }
    return Verdict::kUnknown;
  }

  // Normals at all vertices, edges and faces of the grown voxel.
  bool by_features(const Block& block, Triple lower, Triple upper) {
    if (!factored_) factor();
    for (std::size_t a = 0; a < 3; ++a) lower[a] -= grown_, upper[a] += grown_;
    for (unsigned corner = 0; corner < 8; ++corner) {
      const Triple d{corner & 1 ? upper[0] : lower[0], corner & 2 ? upper[1] : lower[1],
                     corner & 4 ? upper[2] : lower[2]};
      const Factor& f = whole_;
      const double u1 = d[0] / f.l11, u2 = (d[1] - f.l21 * u1) / f.l22;
      const double u3 = (d[2] - f.l31 * u1 - f.l32 * u2) / f.l33;
      if (u1 * u1 + u2 * u2 + u3 * u3 <= 1) return false;
      const double n3 = u3 / f.l33, n2 = (u2 - f.l32 * n3) / f.l22;
      if (prover_.separates({(u1 - f.l21 * n2 - f.l31 * n3) / f.l11, n2, n3}, block)) return true;
    }
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t i = (k + 1) % 3, j = (k + 2) % 3;
      const Factor& f = pair_[k];
      for (unsigned corner = 0; corner < 4; ++corner) {
        const double u1 = (corner & 1 ? upper[i] : lower[i]) / f.l11;
        const double u2 = ((corner & 2 ? upper[j] : lower[j]) - f.l21 * u1) / f.l22;
        Triple n{};
        n[j] = u2 / f.l22;
        n[i] = (u1 - f.l21 * n[j]) / f.l11;
        if (prover_.separates(n, block)) return true;
      }
    }
    for (std::size_t a = 0; a < 3; ++a)
      for (const double sign : {1.0, -1.0}) {
        Triple n{};
        n[a] = sign;
        if (prover_.separates(n, block)) return true;
      }
    return false;
  }

  void factor() {
    const double floor = kEps * outer_.reach;
    whole_ = lower_factor(outer_.row[0], outer_.row[1], outer_.row[2], floor);
    for (std::size_t k = 0; k < 3; ++k)
      pair_[k] = lower_factor(outer_.row[(k + 1) % 3], outer_.row[(k + 2) % 3], outer_.row[k], floor);
    factored_ = true;
  }

  const SeparationProver& prover_;
  const Ellipsoid& outer_;
  double grown_;
  std::array<Triple, 3> metric_{};
  bool factored_ = false;
  Factor whole_{};
  std::array<Factor, 3> pair_{};
};

// Decides for one set whether blocks are proven clear of it.
class Search {
 public:
  Search(const Splats& splats, std::size_t i, const Level& level, double g)
      : prover_(splats, i, level, g), set_(bounds_of(splats, i, level)), first_(prover_, set_.first, g), g_(g) {
    if (set_.second) second_.emplace(prover_, *set_.second, g);
  }
  Search(const Search&) = delete;
  Search& operator=(const Search&) = delete;

  // The voxels of a range that may be touched; none beyond them is.
  Block bounds(const CropRange& range) const {
    Triple lower = prover_.lower(), upper = prover_.upper();
    for (std::size_t a = 0; a < 3; ++a) lower[a] = std::floor(lower[a] / g_), upper[a] = std::floor(upper[a] / g_);
    return clipped_block(lower, upper, range);
  }

  bool separated(const Block& block, bool single) {
    Triple lower, upper;
    bool around = true;
    for (std::size_t a = 0; a < 3; ++a) {
      lower[a] = double(block.lower[a]) * g_ - set_.first.centre[a];
      upper[a] = (double(block.upper[a]) + 1) * g_ - set_.first.centre[a];
      around &= lower[a] <= 0 && upper[a] >= 0;
    }
    if (around) return false;
    return first_.separate(block, lower, upper, single) ||
           (second_ && second_->separate(block, lower, upper, single));
  }

 private:
  SeparationProver prover_;
  Bounds set_;
  Directions first_;
  std::optional<Directions> second_;
  double g_;
};

// The voxels of a block of one brick that are not in the set, as bits; shrinks the block to them.
// Returns false when there are none.
bool shrink_to_missing(const VoxelSet::Bits& present, Block& block) {
  std::int32_t x0 = -1, x1 = 0;
  std::uint64_t all = 0;
  const unsigned ys = unsigned(block.lower[1]) & 7, ye = unsigned(block.upper[1]) & 7;
  const unsigned zs = unsigned(block.lower[2]) & 7, ze = unsigned(block.upper[2]) & 7;
  const std::uint64_t row = ((0xffu >> (7 - ze)) & (0xffu << zs)) & 0xffu;
  const std::uint64_t rows = (~std::uint64_t{0} >> (8 * (7 - ye))) & (~std::uint64_t{0} << (8 * ys));
  const std::uint64_t mask = (row * 0x0101010101010101u) & rows;
  for (std::int32_t x = block.lower[0]; x <= block.upper[0]; ++x) {
    const std::uint64_t missing = ~present[unsigned(x) & 7] & mask;
    if (missing == 0) continue;
    if (x0 < 0) x0 = x - block.lower[0];
    x1 = x - block.lower[0];
    all |= missing;
  }
  if (all == 0) return false;
  std::uint64_t columns = all;
  columns |= columns >> 32, columns |= columns >> 16, columns |= columns >> 8;
  const auto byte = static_cast<std::uint8_t>(columns);
  const Index3 base{block.lower[0], block.lower[1] & ~7, block.lower[2] & ~7};
  block.lower = {base[0] + x0, base[1] + std::countr_zero(all) / 8, base[2] + std::countr_zero(byte)};
  block.upper = {base[0] + x1, base[1] + 7 - std::countl_zero(all) / 8, base[2] + 7 - std::countl_zero(byte)};
  return true;
}

// Calls touched(voxel) for every voxel of the block outside the set that is not proven clear.
template <class Touched>
class Visitor {
 public:
  Visitor(const VoxelSet& set, Search& search, const Stop& stop, Touched touched)
      : set_(set), search_(search), stop_(stop), touched_(touched) {}

  void visit(Block block) {
    stop_.check();
    const auto [axis, cut] = brick_cut(block);
    if (axis == 3) {
      static constexpr VoxelSet::Bits kNothing{};
      const VoxelSet::Bits* bits = set_.brick({block.lower[0] >> 3, block.lower[1] >> 3, block.lower[2] >> 3});
      visit_brick(bits == nullptr ? kNothing : *bits, block);
      return;
    }
    // A block of few bricks is cut before it is tested: its bricks may all be in the set.
    if (count(block) > 4096 && search_.separated(block, false)) return;
    Block upper = block;
    block.upper[axis] = cut - 1;
    upper.lower[axis] = cut;
    visit(block);
    visit(upper);
  }

 private:
  // The brick boundary nearest the middle of the axis with most bricks; axis 3 when there is none.
  static std::pair<std::size_t, std::int32_t> brick_cut(const Block& block) {
    std::size_t axis = 3;
    std::int32_t most = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      const std::int32_t bricks = (block.upper[a] >> 3) - (block.lower[a] >> 3);
      if (bricks > most) most = bricks, axis = a;
    }
    if (axis == 3) return {3, 0};
    return {axis, ((block.lower[axis] >> 3) + (most + 1) / 2) * 8};
  }

  static double count(const Block& b) {
    double product = 1;
    for (std::size_t a = 0; a < 3; ++a) product *= double(b.upper[a]) - double(b.lower[a]) + 1;
    return product;
  }

  void visit_brick(const VoxelSet::Bits& bits, Block block) {
    if (!shrink_to_missing(bits, block)) return;
    const bool single = block.lower == block.upper;
    if (search_.separated(block, single)) return;
    if (single) {
      touched_(block.lower);
      return;
    }
    std::size_t axis = 0;
    for (std::size_t a = 1; a < 3; ++a)
      if (block.upper[a] - block.lower[a] > block.upper[axis] - block.lower[axis]) axis = a;
    Block upper = block;
    block.upper[axis] = block.lower[axis] + (block.upper[axis] - block.lower[axis]) / 2;
    upper.lower[axis] = block.upper[axis] + 1;
    visit_brick(bits, block);
    visit_brick(bits, upper);
  }

  const VoxelSet& set_;
  Search& search_;
  const Stop& stop_;
  Touched touched_;
};

// Limits of the touched voxels that the set lacks, counted once per ellipsoid: beyond, the set belongs to other
// ellipsoids. Fewer than `min_overlap` ellipsoids may touch a voxel that is missing rightly.
class MissingBudget {
 public:
  static constexpr std::size_t kWrong = std::size_t{1} << 25;  // a few seconds; more would find nothing new

  explicit MissingBudget(std::uint32_t min_overlap)
      : most_(kWrong + (min_overlap - 1) * std::size_t{4} * OverlapGrid::kMaxVoxels) {}

  void add(std::size_t touched) {
    if ((found_ += touched) > most_)
      throw std::overflow_error("the ellipsoids touch more than " + std::to_string(most_) +
                                " times a voxel that is not there");
  }

 private:
  std::size_t most_;
  std::atomic<std::size_t> found_{0};
};

constexpr std::size_t kSearchedShare = 980;  // of the progress; few voxels remain to be assigned an ellipsoid

// Finds for each of a few voxels the first ellipsoid that is not proven clear of it.
std::vector<std::int64_t> first_touching(const Splats& splats, const Level& level, double g,
                                         std::span<const std::int32_t> voxel, unsigned jobs, Control& control) {
  std::vector<std::atomic<std::int64_t>> first(voxel.size() / 3);
  const Triple one{double(voxel[0]), double(voxel[1]), double(voxel[2])};
  CropRange listed{one, one};
  for (std::size_t v = 0; v < first.size(); ++v) {
    first[v] = static_cast<std::int64_t>(splats.size());
    for (std::size_t a = 0; a < 3; ++a) {
      listed.lower[a] = std::min(listed.lower[a], double(voxel[3 * v + a]));
      listed.upper[a] = std::max(listed.upper[a], double(voxel[3 * v + a]));
    }
  }
  parallel_chunks(splats.size(), 1024, jobs, control, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    for (std::size_t i = begin; i < end; ++i) {
      stop.check();
      Search search(splats, i, level, g);
      const Block bounds = search.bounds(listed);
      if (bounds.empty()) continue;
      for (std::size_t v = 0; v < first.size(); ++v) {
        const Index3 at{voxel[3 * v], voxel[3 * v + 1], voxel[3 * v + 2]};
        bool within = true;
        for (std::size_t a = 0; a < 3; ++a) within &= bounds.lower[a] <= at[a] && at[a] <= bounds.upper[a];
        if (!within || search.separated({at, at}, true)) continue;
        const auto mine = static_cast<std::int64_t>(i);
        for (std::int64_t old = first[v]; mine < old && !first[v].compare_exchange_weak(old, mine);) {
        }
      }
    }
  });
  return {first.begin(), first.end()};
}

}  // namespace

Unproven unproven_voxels(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
                         std::uint32_t min_overlap, std::span<const std::int32_t> index, unsigned jobs,
                         Control& control) {
  check_splats(splats, level, voxel_size);
  const CropRange range = crop_range(crop, voxel_size);
  check_each_budget(splats, level, voxel_size, range);
  InterruptOnly unreported(control);
  // A larger set may have been made tile by tile, and voxels that fewer ellipsoids touch may be missing.
  if (min_overlap <= 1 && index.size() / 3 <= OverlapGrid::kMaxBricks)
    check_budgets(splats, level, voxel_size, range, jobs, unreported);
  const VoxelSet set(index);
  OverlapGrid grid;
  MissingBudget missing_budget(std::max(min_overlap, 1u));
  Share searching(control, 0, kSearchedShare), naming(control, kSearchedShare, Share::kWhole);
  parallel_chunks(splats.size(), 1024, jobs, searching, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    OverlapGrid::Writer writer(grid);
    std::size_t pending = 0;  // not yet in the budget, so that threads rarely meet there
    const auto touched = [&](const Index3& v) {
      writer.add({v[0], v[1], v[2], v[2]});
      if (++pending == 4096) missing_budget.add(std::exchange(pending, 0));
    };
    for (std::size_t i = begin; i < end; ++i) {
      stop.check();
      Search search(splats, i, level, voxel_size);
      const Block block = search.bounds(range);
      if (block.empty()) continue;
      Visitor(set, search, stop, touched).visit(block);
    }
    missing_budget.add(pending);
    writer.finish();
  });
  InterruptOnly quiet(naming);
  VoxelCounts missing = grid.collect(std::max(min_overlap, 1u), jobs, quiet);
  Unproven result;
  result.total = missing.count.size();
  missing.index.resize(3 * std::min(result.total, Unproven::kMaxListed));
  result.voxel = std::move(missing.index);
  if (result.total > 0) result.ellipsoid = first_touching(splats, level, voxel_size, result.voxel, jobs, naming);
  control.poll(splats.size(), splats.size());
  return result;
}

}  // namespace alula
