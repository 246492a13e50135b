// Covers built by merge() pass check_hulls(), also at the limits of the exact range.
#include <cmath>

#include "alula/cover/cover_check.hpp"
#include "alula/cover/merge.hpp"
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

}  // namespace

int main() {
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
