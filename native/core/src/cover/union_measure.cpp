#include "alula/cover/union_measure.hpp"

#include <algorithm>
#include <cmath>
#include <deque>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

using geometry::Box;
using geometry::HalfSpace;
using geometry::Solid;
using geometry::Vec3;

constexpr double kRoundoff = 0x1p-53;
constexpr std::size_t kParts = 512;   // target number of boxes that threads process
constexpr std::size_t kLookups = 64;  // looks at a plane of a box that take about as long as a cut

// A polytope that reaches into a box, with the planes that cut the box: plane[begin .. end).
struct ReachedSet {
  std::uint32_t set, begin, end;
  std::uint32_t size() const { return end - begin; }
};

struct Part {
  Box box;
  std::vector<ReachedSet> reach;
  std::vector<std::uint32_t> plane;
};

double longest(const Box& box) {
  const Vec3 e = box.upper - box.lower;
  return std::max({e.x, e.y, e.z});
}

double area(const Box& box) {
  const Vec3 e = box.upper - box.lower;
  return 2 * (e.x * e.y + e.y * e.z + e.z * e.x);
}

double volume(const Box& box) {
  const Vec3 e = box.upper - box.lower;
  return e.x * e.y * e.z;
}

class Measurer {
 public:
  Measurer(const ConvexSets& sets, const Occupancy* voxels, const MeasureOptions& options, double extent)
      : sets_(sets), voxels_(voxels), options_(options), extent_(extent), tolerance_(16 * kRoundoff * extent) {}

  enum class Kind { kEmpty, kFull, kMixed };

  // Shrinks a box to its content, drops the polytopes and planes that do not matter there, and returns what remains.
  Kind reduce(Part& part) {
    Box hull;
    for (const ReachedSet& reach : part.reach) {
      const Box& box = sets_.box[reach.set];
      Box common;
      bool is_apart = false;
      for (int i = 0; i < 3; ++i) {
        common.lower[i] = std::max(part.box.lower[i], std::floor(box.lower[i]));
        common.upper[i] = std::min(part.box.upper[i], std::ceil(box.upper[i]));
        is_apart |= common.upper[i] <= common.lower[i];
      }
      if (!is_apart) hull.include(common);
    }
    if (!(hull.lower.x < hull.upper.x)) return Kind::kEmpty;
    part.box = hull;
    const Vec3 centre = 0.5 * (hull.lower + hull.upper), half = 0.5 * (hull.upper - hull.lower);
    std::size_t reaches = 0, planes = 0;
    for (const ReachedSet reach : part.reach) {
      const std::size_t begin = planes;
      bool is_apart = false;
      const Box& box = sets_.box[reach.set];
      for (int i = 0; i < 3; ++i) is_apart |= box.lower[i] >= hull.upper[i] || box.upper[i] <= hull.lower[i];
      for (std::uint32_t at = reach.begin; at < reach.end && !is_apart; ++at) {
        const std::uint32_t p = part.plane[at];
        const HalfSpace& plane = sets_.plane[p];
        const double middle = dot(plane.normal, centre) - plane.offset;
        const double spread =
            std::abs(plane.normal.x) * half.x + std::abs(plane.normal.y) * half.y + std::abs(plane.normal.z) * half.z;
        if (middle + spread <= tolerance_) continue;
        is_apart = middle - spread >= -tolerance_;
        part.plane[planes++] = p;
      }
      if (is_apart) {
        planes = begin;
        continue;
      }
      if (planes == begin) {
        part.reach.assign(1, {reach.set, 0, 0});
        part.plane.clear();
        return Kind::kFull;
      }
      part.reach[reaches++] = {reach.set, static_cast<std::uint32_t>(begin), static_cast<std::uint32_t>(planes)};
    }
    part.reach.resize(reaches);
    part.plane.resize(planes);
    return reaches == 0 ? Kind::kEmpty : Kind::kMixed;
  }

  // True if halving a reduced box is better than measuring it as it is.
  bool is_large(const Part& part) const {
    const double edge = longest(part.box);
    if (edge <= 1) return part.reach.size() > 4 && edge > 0.1;
    if (voxels_ != nullptr && count(part.box) > 0) return true;
    if (part.reach.size() == 1) return part.plane.size() > 60;
    if (part.reach.size() == 2) return part.plane.size() > 32;
    if (part.reach.size() == 3) return part.plane.size() > 16;
    return true;
  }

  // Splits the box at the middle of its longest side, at whole coordinates as long as there are any.
  static void halve(const Part& part, Part& low, Part& high) {
    const Vec3 e = part.box.upper - part.box.lower;
    const int axis = e.x >= e.y && e.x >= e.z ? 0 : e.y >= e.z ? 1 : 2;
    double middle = 0.5 * (part.box.lower[axis] + part.box.upper[axis]);
    if (e[axis] > 1) middle = std::floor(middle);
    low.box = high.box = part.box;
    low.box.upper[axis] = high.box.lower[axis] = middle;
    low.reach = high.reach = part.reach;
    low.plane = high.plane = part.plane;
  }

  // Adds the contribution of a box that only these polytopes reach into.
  void measure(Part& part, std::size_t depth = 0) {
    lookups_ += part.plane.size() + part.reach.size();
    result.is_complete = result.is_complete && lookups_ / kLookups <= options_.cuts_per_part;
    if (!result.is_complete) return;
    const Kind kind = reduce(part);
    if (kind == Kind::kEmpty) return;
    if (kind == Kind::kFull) return add_full(part.box);
    if (is_large(part)) {
      while (part_.size() < 2 * depth + 2) part_.emplace_back();
      Part &low = part_[2 * depth], &high = part_[2 * depth + 1];
      halve(part, low, high);
      measure(low, depth + 1);
      measure(high, depth + 1);
      return;
    }
    if (solid_.empty()) solid_.emplace_back();
    solid_[0].assign(part.box);
    plane_ = part.plane;
    reach_ = part.reach;
    box_area_ = area(part.box);
    const double found = united(0, 0, reach_.size());
    result.volume += found;
    if (voxels_ == nullptr) return;
    voxel(part.box, found);
  }

  void add_full(const Box& box) {
    result.volume += volume(box);
    ++terms_;
    if (voxels_ == nullptr) return;
    const Vec3 e = box.upper - box.lower;
    if (std::min({e.x, e.y, e.z}) < 1) return voxel(box, volume(box));  // a part of one voxel
    const std::size_t held = count(box);
    result.intersection += static_cast<double>(held);
    result.whole += held;
  }

  // Rounding error of the sums in a part; no summand exceeds the volume of its box.
  double summation_error(const Box& box) const { return terms_ * kRoundoff * volume(box); }

  UnionMeasure result;

 private:
  // Adds the filled volume of the voxel that a box is, or is a part of.
  void voxel(const Box& box, double filled) {
    LatticeBox cell;
    for (int i = 0; i < 3; ++i) {
      cell.lower[i] = static_cast<std::int32_t>(std::floor(box.lower[i]));
      cell.upper[i] = cell.lower[i] + 1;
    }
    if (longest(box) > 1 || voxels_->count(cell) == 0) return;
    result.intersection += filled;
    if (cell.lower != voxel_) voxel_ = cell.lower, filled_ = 0;
    const bool was_whole = filled_ >= 1 - options_.sliver;
    filled_ += filled;
    result.whole += !was_whole && filled_ >= 1 - options_.sliver;
  }

  std::size_t count(const Box& box) const {
    LatticeBox cells;
    for (int i = 0; i < 3; ++i) {
      cells.lower[i] = static_cast<std::int32_t>(std::floor(box.lower[i]));
      cells.upper[i] = static_cast<std::int32_t>(std::ceil(box.upper[i]));
    }
    return voxels_->count(cells);
  }

  // Volume of the part of solid_[s] that the polytopes reach_[begin .. end) fill. Solids, reaches and
  // planes beyond those are scratch.
  double united(std::size_t s, std::size_t begin, std::size_t end) {
    if (!result.is_complete) return 0;
    const std::size_t reaches = reach_.size(), planes = plane_.size();
    for (std::size_t r = begin; r < end; ++r) {
      const std::uint32_t first = static_cast<std::uint32_t>(plane_.size());
      bool is_apart = false;
      for (std::uint32_t at = reach_[r].begin; at < reach_[r].end && !is_apart; ++at) {
        const Solid::Side side = solid_[s].side(sets_.plane[plane_[at]], tolerance_);
        is_apart = side == Solid::Side::kOutside;
        if (side == Solid::Side::kCut) plane_.push_back(plane_[at]);
      }
      if (is_apart) {
        plane_.resize(first);
        continue;
      }
      const std::uint32_t last = static_cast<std::uint32_t>(plane_.size());
      reach_.push_back({reach_[r].set, first, last});
      if (first == last) {
        reach_.resize(reaches), plane_.resize(planes);
        return add_solid(solid_[s]);
      }
    }
    double sum = 0;
    const std::size_t stop = reach_.size();
    for (std::size_t r = reaches; r < stop; ++r) {
      const std::size_t inner = cut(s, reach_[r]);
      if (inner == s) continue;
      sum += add_solid(solid_[inner]);
      if (r + 1 < stop) sum -= united(inner, r + 1, stop);
    }
    reach_.resize(reaches), plane_.resize(planes);
    return sum;
  }

  // Cuts solid_[s] by the planes of a polytope; returns the number of the remaining solid, or s when none remains.
  std::size_t cut(std::size_t s, const ReachedSet& reach) {
    while (solid_.size() < s + 3) solid_.emplace_back();
    std::size_t from = s, to = s + 1;
    for (std::uint32_t at = reach.begin; at < reach.end; ++at) {
      const Solid::Side side = solid_[from].side(sets_.plane[plane_[at]], tolerance_);
      if (side == Solid::Side::kOutside) return s;
      if (side == Solid::Side::kInside) continue;
      solid_[to].assign_cut(solid_[from]);
      ++result.cuts;
      if (from == s) {
        from = s + 1, to = s + 2;
      } else {
        std::swap(from, to);
      }
    }
    if (from == s + 2) std::swap(solid_[s + 1], solid_[s + 2]);
    return s + 1;
  }

  double add_solid(const Solid& solid) {
    terms_ += 2;  // one in united() and one in the total
    result.error += (48 + 8.0 * solid.cuts()) * kRoundoff * extent_ * box_area_;
    result.is_complete = result.is_complete && result.cuts <= options_.cuts_per_part;
    return solid.volume();
  }

  const ConvexSets& sets_;
  const Occupancy* voxels_;
  MeasureOptions options_;
  double extent_, tolerance_, box_area_ = 0;
  double terms_ = 0;
  std::size_t lookups_ = 0;
  std::deque<Part> part_;
  std::deque<Solid> solid_;
  std::vector<ReachedSet> reach_;
  std::vector<std::uint32_t> plane_;
  Lattice voxel_{INT32_MIN, INT32_MIN, INT32_MIN};
  double filled_ = 0;
};

}  // namespace

UnionMeasure union_measure(const ConvexSets& sets, const Occupancy* voxels, const MeasureOptions& options,
                           unsigned jobs, Control& control) {
  double extent = 1;
  Part all;
  for (std::uint32_t h = 0; h < sets.box.size(); ++h) {
    const Box& box = sets.box[h];
    if (!(volume(box) > 0)) continue;
    all.reach.push_back({h, 0, 0});
    all.reach.back().begin = static_cast<std::uint32_t>(all.plane.size());
    for (std::uint32_t p = sets.start[h]; p < sets.start[h + 1]; ++p) all.plane.push_back(p);
    all.reach.back().end = static_cast<std::uint32_t>(all.plane.size());
    Box whole;
    for (int i = 0; i < 3; ++i) {
      whole.lower[i] = std::floor(box.lower[i]), whole.upper[i] = std::ceil(box.upper[i]);
      extent = std::max({extent, std::abs(whole.lower[i]), std::abs(whole.upper[i])});
    }
    all.box.include(whole);
  }
  if (all.reach.empty()) return {};

  Measurer top(sets, voxels, options, extent);
  std::vector<Part> parts{std::move(all)}, halves;
  for (std::size_t level = 0; parts.size() < kParts && level < 3 * 21; ++level) {
    halves.clear();
    for (Part& part : parts) {
      const auto kind = top.reduce(part);
      if (kind == Measurer::Kind::kEmpty) continue;
      if (kind == Measurer::Kind::kFull || !top.is_large(part) || longest(part.box) <= 1) {
        halves.push_back(std::move(part));
        continue;
      }
      Part low, high;
      Measurer::halve(part, low, high);
      halves.push_back(std::move(low)), halves.push_back(std::move(high));
    }
    parts.swap(halves);
  }

  std::vector<UnionMeasure> found(parts.size());
  parallel_chunks(parts.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Measurer measurer(sets, voxels, options, extent);
      const Box box = parts[i].box;
      measurer.measure(parts[i]);
      found[i] = measurer.result;
      found[i].error += measurer.summation_error(box);
    }
  });
  UnionMeasure result;
  for (const UnionMeasure& part : found) {
    result.volume += part.volume;
    result.intersection += part.intersection;
    result.whole += part.whole;
    result.error += part.error;
    result.cuts += part.cuts;
    result.is_complete = result.is_complete && part.is_complete;
  }
  result.error += static_cast<double>(parts.size()) * kRoundoff * result.volume;
  return result;
}

}  // namespace alula
