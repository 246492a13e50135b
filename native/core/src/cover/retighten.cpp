#include "alula/cover/retighten.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

std::int64_t floor_div(std::int64_t a, std::int64_t b) {
  const std::int64_t q = a / b;
  return q - (a % b != 0 && (a < 0) != (b < 0));
}

// The voxels of lattice columns inside a polytope, in integers.
class ColumnRanges {
 public:
  ColumnRanges(const LatticePolytope& hull, const LatticeBox& box) : hull_(hull), box_(box) {
    double largest = 0;  // of the numbers that a bound is computed from
    for (const LatticePlane& plane : hull.plane) {
      const auto& n = plane.normal;
      std::int64_t offset = plane.offset;
      double sum = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        offset -= n[i] * box.lower[i] + std::max<std::int64_t>(n[i], 0);
        sum += std::abs(static_cast<double>(n[i])) * (box.upper[i] - box.lower[i]);
      }
      sum += std::abs(static_cast<double>(offset));
      is_exact_ = is_exact_ && sum < 0x1p52;
      largest = std::max(largest, sum / std::max(1.0, std::abs(static_cast<double>(n[2]))));
      plane_.push_back({static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2]),
                        static_cast<double>(offset)});
    }
    tolerance_ = 0x1p-49 * largest;
    bounds_.assign(plane_, box);
  }

  // Finds the ranges [low, high] of z of the columns at (x, y[k]); empty where low > high.
  void row(std::int32_t x, std::span<const std::int32_t> y) {
    low.resize(y.size()), high.resize(y.size());
    if (!is_exact_ || tolerance_ > 0.25) {
      for (std::size_t k = 0; k < y.size(); ++k) std::tie(low[k], high[k]) = range(x, y[k]);
      return;
    }
    y_.resize(y.size()), least_.resize(y.size()), most_.resize(y.size());
    for (std::size_t k = 0; k < y.size(); ++k) y_[k] = y[k] - box_.lower[1];
    bounds_.row(x - box_.lower[0], y_, least_.data(), most_.data());
    for (std::size_t k = 0; k < y.size(); ++k) {
      if (most_[k] < least_[k] - 2 * tolerance_) {
        low[k] = 1, high[k] = 0;
        continue;
      }
      // A bound so near to an integer that rounding decides is settled by that integer's voxel.
      const double first = std::ceil(least_[k] - tolerance_), last = std::floor(most_[k] + tolerance_);
      low[k] = box_.lower[2] + static_cast<std::int64_t>(first);
      high[k] = std::min<std::int64_t>(box_.lower[2] + static_cast<std::int64_t>(last), box_.upper[2] - 1);
      if (first < least_[k] + tolerance_ && !contains({x, y[k], static_cast<std::int32_t>(low[k])})) ++low[k];
      if (last > most_[k] - tolerance_ && !contains({x, y[k], static_cast<std::int32_t>(high[k])})) --high[k];
    }
  }

  std::vector<std::int64_t> low, high;

 private:
  bool contains(const Lattice& v) const {
    double at[3];
    for (std::size_t i = 0; i < 3; ++i) at[i] = v[i] - box_.lower[i];
    for (const auto& plane : plane_)  // exact, as all numbers are below 2^53
      if (plane.x * at[0] + plane.y * at[1] + plane.z * at[2] > plane.offset) return false;
    return true;
  }

  std::pair<std::int64_t, std::int64_t> range(std::int32_t x, std::int32_t y) const {
    std::int64_t least = box_.lower[2], most = box_.upper[2] - 1;
    for (const LatticePlane& plane : hull_.plane) {
      const auto& n = plane.normal;
      std::int64_t room = plane.offset - n[0] * x - n[1] * y;
      for (const std::int64_t c : n) room -= std::max<std::int64_t>(c, 0);
      if (n[2] > 0) {
        most = std::min(most, floor_div(room, n[2]));
      } else if (n[2] < 0) {
        least = std::max(least, -floor_div(room, -n[2]));
      } else if (room < 0) {
        most = least - 1;
      }
      if (least > most) break;
    }
    return {least, most};
  }

  const LatticePolytope& hull_;
  LatticeBox box_;
  bool is_exact_ = true;  // all numbers are exact in double
  double tolerance_;      // bound on the rounding error of a bound of z
  std::vector<HullBuilder::LocalPlane> plane_;
  ZBounds bounds_;
  std::vector<double> y_, least_, most_;
};

}  // namespace

void voxels_inside(const Occupancy& occupancy, const LatticePolytope& hull, std::vector<std::uint32_t>& inside) {
  inside.clear();
  const LatticeBox box = bounds(hull.vertex);
  ColumnRanges ranges(hull, box);
  std::vector<std::int32_t> y;
  const auto columns = occupancy.columns();
  auto column = columns.begin();
  for (std::int32_t x = box.lower[0]; x < box.upper[0]; ++x) {
    column = std::partition_point(column, columns.end(), [&](const Occupancy::Column& c) {
      return c.x < x || (c.x == x && c.y < box.lower[1]);
    });
    if (column == columns.end()) return;
    if (column->x > x) x = std::min(column->x, box.upper[0]) - 1;
    y.clear();
    for (auto c = column; c != columns.end() && c->x == x && c->y < box.upper[1]; ++c) y.push_back(c->y);
    if (y.empty()) continue;
    ranges.row(x, y);
    for (std::size_t k = 0; k < y.size(); ++k, ++column) {
      if (ranges.low[k] > ranges.high[k]) continue;
      const std::uint32_t first = occupancy.lower(*column, static_cast<std::int32_t>(ranges.low[k]));
      for (std::uint32_t v = first; v < column->end && occupancy.voxels()[v][2] <= ranges.high[k]; ++v)
        inside.push_back(v);
    }
  }
}

Containment containment(const Occupancy& occupancy, std::span<const LatticePolytope> hulls, unsigned jobs,
                        Control& control) {
  const std::size_t count = hulls.size();
  Containment found{std::vector<std::uint32_t>(occupancy.size(), 0), std::vector<double>(count),
                    std::vector<std::vector<std::uint32_t>>(count), std::vector<std::size_t>(count)};
  parallel_chunks(count, 16, jobs, control, [&](std::size_t begin, std::size_t end) {
    ExcessMeter meter(occupancy);
    for (std::size_t h = begin; h < end; ++h) {
      voxels_inside(occupancy, hulls[h], found.inside[h]);
      found.inside[h].shrink_to_fit();
      found.excess[h] = meter(hulls[h]);
    }
  });
  for (std::size_t h = 0; h < count; ++h) {
    for (const std::uint32_t v : found.inside[h]) ++found.holders[v];
    found.order[h] = h;
  }
  const std::vector<double>& excess = found.excess;
  std::sort(found.order.begin(), found.order.end(),
            [&](std::size_t a, std::size_t b) { return excess[a] != excess[b] ? excess[a] > excess[b] : a < b; });
  return found;
}

std::vector<std::size_t> retighten(const Occupancy& occupancy, Cover& cover, const Budget& budget, unsigned jobs,
                                   Control& control) {
  const std::size_t count = cover.hull.size();
  Share measuring(control, 0, Share::kWhole / 2), shrinking(control, Share::kWhole / 2, Share::kWhole);
  auto [holders, excess, inside, order] = containment(occupancy, cover.hull, jobs, measuring);
  std::size_t planes = 0, kept = count;
  for (const LatticePolytope& hull : cover.hull) planes += hull.plane.size();

  HullBuilder builder;
  std::vector<Lattice> needed;
  std::vector<std::uint32_t> shrunk;
  std::vector<bool> is_tight(count, true);
  std::size_t done = 0;
  for (const std::size_t h : order) {
    shrinking.poll(done++, count);
    needed.clear();
    for (const std::uint32_t v : inside[h])
      if (holders[v] == 1) needed.push_back(occupancy.voxels()[v]);
    if (needed.size() == inside[h].size() && !needed.empty()) continue;  // it is the hull of the voxels inside
    LatticePolytope tight;
    if (!needed.empty()) {
      builder.build_voxels(needed);
      tight = builder.polytope();
    }
    const std::size_t after = planes - cover.hull[h].plane.size() + tight.plane.size();
    const std::size_t left = kept - (needed.empty() ? 1 : 0);
    if (after > planes && !budget.holds(left, after)) {
      is_tight[h] = false;
      continue;
    }
    planes = after, kept = left;
    shrunk.clear();
    if (!needed.empty()) voxels_inside(occupancy, tight, shrunk);
    for (const std::uint32_t v : inside[h]) --holders[v];
    for (const std::uint32_t v : shrunk) ++holders[v];
    inside[h] = shrunk;
    cover.hull[h] = std::move(tight);
  }

  // A voxel that a tight hull needs is in no other hull, so each hull is still the hull of its members;
  // a hull that was kept gets all its voxels as members.
  std::vector<bool> is_taken(occupancy.size(), false);
  std::vector<LatticePolytope> hulls;
  VoxelSets members;
  std::vector<std::size_t> remaining;
  for (std::size_t h = 0; h < count; ++h) {
    if (cover.hull[h].plane.empty()) continue;
    for (const std::uint32_t v : inside[h]) {
      if (!is_tight[h] || !is_taken[v]) members.member.push_back(v);
      is_taken[v] = true;
    }
    members.close();
    hulls.push_back(std::move(cover.hull[h]));
    remaining.push_back(h);
  }
  cover.hull = std::move(hulls);
  cover.members = std::move(members);
  return remaining;
}

}  // namespace alula
