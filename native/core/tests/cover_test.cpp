// Covers built by merge() pass check_hulls(), also at the limits of the exact range.
#include <algorithm>
#include <array>
#include <cmath>

#include "alula/cover/cover_check.hpp"
#include "alula/cover/hull_moves.hpp"
#include "alula/cover/merge.hpp"
#include "alula/cover/refine.hpp"
#include "alula/cover/retighten.hpp"
#include "alula/cover/union_volume.hpp"
#include "check.hpp"
#include "cover_arrays.hpp"

namespace {

using namespace alula;

void check_cover(const std::vector<Lattice>& voxels, std::size_t hulls, MergeRule rule) {
  Control control;
  const Occupancy occupancy(voxels);
  MergeOptions options;
  options.rule = rule;
  options.max_hulls = hulls;
  Cover cover = merge(occupancy, subcover(occupancy, 1, true, 2, control), options, 2, control);
  CHECK(cover.within_budget);
  CHECK(cover.hull.size() <= hulls);
  for (const bool tighten : {false, true}) {
    if (tighten) retighten(occupancy, cover, {}, 2, control);
    sort_hulls(cover);
    const CoverArrays arrays(occupancy, cover);
    CHECK(check_hulls(arrays.view(), 2, control).empty());
    const auto flat = std::span(reinterpret_cast<const std::int32_t*>(voxels.data()), 3 * voxels.size());
    CHECK(check_occupied(arrays.member, arrays.member_start, flat).empty());
    const UnionVolume volume = union_excess(occupancy, cover.hull, 1, control);
    CHECK(volume.lines == 0 && volume.excess >= 0 && volume.error > 0);
    CHECK(volume.excess == union_excess(occupancy, cover.hull, 3, control).excess);
    const UnionVolume by_lines = union_excess(occupancy, cover.hull, 2, control, 0, 1e5);
    CHECK(by_lines.lines > 0 && by_lines.excess >= 0);
    if (by_lines.lines == 4) CHECK(std::abs(by_lines.excess - volume.excess) < 0.03 * (volume.excess + 1));
  }
}

// Two slanted plates that no plane across an axis separates: a voxel that one has of the other goes back.
void check_transfers() {
  Control control;
  std::vector<Lattice> voxels;
  for (std::int32_t x = 0; x < 40; ++x)
    for (std::int32_t y = 0; y < 6; ++y)
      for (std::int32_t z = 0; z < 60; ++z)
        if (x + z < 44 ? x + z >= 40 : x + z >= 52 && x + z < 56) voxels.push_back({x, y, z});
  const Occupancy occupancy(voxels);
  const auto is_upper = [](const Lattice& v) { return v[0] + v[2] >= 48; };
  std::array<std::vector<std::uint32_t>, 2> side;
  for (std::uint32_t v = 0; v < voxels.size(); ++v)
    side[is_upper(voxels[v]) && voxels[v] != Lattice{0, 0, 55}].push_back(v);
  std::vector<Piece> piece(2);
  HullMoves moves(occupancy);
  BoxTree tree;
  for (std::uint32_t i = 0; i < 2; ++i) {
    piece[i].voxels = side[i];
    moves.measure(piece[i]);
    tree.insert(i, piece[i].box);
  }
  const std::vector<Transfer> found = moves.transfers(piece, 0, tree, 1);
  CHECK(!found.empty());
  if (found.empty()) return;
  for (const Transfer& t : found) {
    CHECK(t.from == 0 && t.to == 1);
    Piece less, more;
    more.voxels = side[1];
    for (const std::uint32_t v : side[0]) {
      if (t.takes(voxels[v])) CHECK(is_upper(voxels[v]));
      (t.takes(voxels[v]) ? more : less).voxels.push_back(v);
    }
    std::sort(more.voxels.begin(), more.voxels.end());
    moves.measure(less), moves.measure(more);
    const double gain = piece[0].weight + piece[1].weight - less.weight - more.weight;
    CHECK(std::abs(gain - t.gain) < 0.05 * gain);
  }

  Cover cover;
  for (const auto& members : side) {
    cover.members.member.insert(cover.members.member.end(), members.begin(), members.end());
    cover.members.close();
  }
  refine(occupancy, cover, {}, refine_work(voxels.size()), 2, control);
  double weight = 0;
  ExcessMeter meter(occupancy);
  for (const LatticePolytope& hull : cover.hull) weight += meter(hull);
  CHECK(cover.hull.size() == 2 && weight < piece[0].weight + piece[1].weight - found[0].gain / 2);
}

// Bounds of columns that rounding cannot settle: facets through many lattice points, near and far from the origin.
void check_voxels_inside() {
  std::uint32_t state = 7;
  const auto random = [&](std::int32_t below) {
    state = state * 1664525u + 1013904223u;
    return static_cast<std::int32_t>((state >> 8) % static_cast<std::uint32_t>(below));
  };
  HullBuilder builder;
  for (const std::int32_t extent : {3, 12, 40, 1 << 18}) {
    for (int trial = 0; trial < 40; ++trial) {
      const std::int32_t place = trial % 2 == 0 ? 0 : -(1 << 19);
      std::vector<Lattice> corner;
      for (int i = 0; i < 8; ++i) corner.push_back({place + random(extent), random(extent), place + random(extent)});
      std::sort(corner.begin(), corner.end());
      builder.build_voxels(corner);
      const LatticePolytope hull = builder.polytope();
      std::vector<Lattice> voxels;
      for (int i = 0; i < 2000; ++i) {
        const Lattice &a = corner[static_cast<std::size_t>(random(8))],
                      &b = corner[static_cast<std::size_t>(random(8))];
        Lattice v;
        for (std::size_t k = 0; k < 3; ++k) v[k] = (a[k] + b[k]) / 2 + random(3) - 1;
        voxels.push_back(v);
      }
      std::sort(voxels.begin(), voxels.end());
      voxels.erase(std::unique(voxels.begin(), voxels.end()), voxels.end());
      std::vector<std::uint32_t> expected, found;
      for (std::uint32_t v = 0; v < voxels.size(); ++v)
        if (std::all_of(hull.plane.begin(), hull.plane.end(), [&](const LatticePlane& plane) {
              __int128 at = 0;
              for (std::size_t k = 0; k < 3; ++k)
                at += static_cast<__int128>(plane.normal[k]) * (voxels[v][k] + (plane.normal[k] > 0 ? 1 : 0));
              return at <= plane.offset;
            }))
          expected.push_back(v);
      voxels_inside(Occupancy(voxels), hull, found);
      CHECK(found == expected);
    }
  }
}

}  // namespace

int main() {
  check_transfers();
  check_voxels_inside();
  std::vector<Lattice> scattered;
  std::uint32_t state = 1;
  for (std::int32_t x = 0; x < 12; ++x)
    for (std::int32_t y = 0; y < 12; ++y)
      for (std::int32_t z = -6; z < 6; ++z) {
        state = state * 1664525u + 1013904223u;
        if (state >> 29 == 0) scattered.push_back({x, y, z});
      }
  const std::vector<Lattice> far{
      {-(1 << 19), 5, 5}, {0, -(1 << 19), 0}, {7, 0, (1 << 19) - 1}, {(1 << 19) - 1, 0, 0}};
  for (const MergeRule rule : {MergeRule::kPaper, MergeRule::kIncrease}) {
    for (const std::size_t hulls : {1u, 5u, 30u, 1000u}) check_cover(scattered, hulls, rule);
    for (const std::size_t hulls : {1u, 2u, 4u}) check_cover(far, hulls, rule);
  }
  return alula_failures != 0;
}
