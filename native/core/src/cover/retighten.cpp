#include "alula/cover/retighten.hpp"

#include <algorithm>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

std::int64_t floor_div(std::int64_t a, std::int64_t b) {
  const std::int64_t q = a / b;
  return q - (a % b != 0 && (a < 0) != (b < 0));
}

}  // namespace

void voxels_inside(const Occupancy& occupancy, const LatticePolytope& hull, std::vector<std::uint32_t>& inside) {
  inside.clear();
  const LatticeBox box = bounds(hull.vertex);
  const auto columns = occupancy.columns();
  auto column = columns.begin();
  for (std::int32_t x = box.lower[0]; x < box.upper[0]; ++x) {
    column = std::partition_point(column, columns.end(), [&](const Occupancy::Column& c) {
      return c.x < x || (c.x == x && c.y < box.lower[1]);
    });
    if (column == columns.end()) return;
    if (column->x > x) x = std::min(column->x, box.upper[0]) - 1;
    for (; column != columns.end() && column->x == x && column->y < box.upper[1]; ++column) {
      std::int64_t low = box.lower[2], high = box.upper[2] - 1;
      for (const LatticePlane& plane : hull.plane) {
        const auto& n = plane.normal;
        std::int64_t room = plane.offset - n[0] * x - n[1] * column->y;
        for (const std::int64_t c : n) room -= std::max<std::int64_t>(c, 0);
        if (n[2] > 0) {
          high = std::min(high, floor_div(room, n[2]));
        } else if (n[2] < 0) {
          low = std::max(low, -floor_div(room, -n[2]));
        } else if (room < 0) {
          high = low - 1;
        }
        if (low > high) break;
      }
      if (low > high) continue;
      const std::uint32_t first = occupancy.lower(*column, static_cast<std::int32_t>(low));
      for (std::uint32_t v = first; v < column->end && occupancy.voxels()[v][2] <= high; ++v) inside.push_back(v);
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
