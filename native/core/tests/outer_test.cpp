// Outer polytopes contain their hulls, respect their number of planes and have the right corners.
#include <algorithm>
#include <stdexcept>

#include "alula/cover/cover_check.hpp"
#include "alula/cover/facet_cap.hpp"
#include "alula/cover/fitting.hpp"
#include "alula/cover/map_check.hpp"
#include "alula/cover/onboard_map.hpp"
#include "alula/cover/outer_solid.hpp"
#include "check.hpp"
#include "cover_arrays.hpp"

namespace {

using namespace alula;

std::vector<Lattice> blobs() {
  std::vector<Lattice> voxels;
  for (std::int32_t x = -14; x < 14; ++x)
    for (std::int32_t y = -10; y < 10; ++y)
      for (std::int32_t z = -9; z < 9; ++z) {
        const bool ball = (x + 7) * (x + 7) + y * y + z * z < 30;
        const bool slab = x > 0 && x + 2 * y - z > -3 && x + 2 * y - z < 4;
        if (ball || slab) voxels.push_back({x, y, z});
      }
  return voxels;
}

std::vector<Violation> violations(const Occupancy& occupancy, const Cover& cover) {
  Control control;
  return check_hulls(CoverArrays(occupancy, cover).view(true), 2, control);
}

std::size_t most_planes(const Cover& cover) {
  std::size_t most = 0;
  for (const LatticePolytope& hull : cover.hull) most = std::max(most, hull.plane.size());
  return most;
}

// Records and the check of a map do not depend on threads; without its last polytope the map lacks voxels.
void check_map(const Occupancy& occupancy, const Cover& cover) {
  std::vector<std::int32_t> vertex, lower, upper, normal;
  std::vector<std::int64_t> exact_normal, offset, vertex_start{0}, plane_start{0};
  for (const LatticePolytope& hull : cover.hull) {
    const LatticeBox box = bounds(hull.vertex);
    lower.insert(lower.end(), box.lower.begin(), box.lower.end());
    upper.insert(upper.end(), box.upper.begin(), box.upper.end());
    for (const Lattice& v : hull.vertex) vertex.insert(vertex.end(), v.begin(), v.end());
    for (const LatticePlane& p : hull.plane) {
      for (const std::int64_t n : p.normal) normal.push_back(static_cast<std::int32_t>(n));
      exact_normal.insert(exact_normal.end(), p.normal.begin(), p.normal.end());
      offset.push_back(p.offset);
    }
    vertex_start.push_back(static_cast<std::int64_t>(vertex.size() / 3));
    plane_start.push_back(static_cast<std::int64_t>(offset.size()));
  }
  Control control;
  const HullView hulls{vertex, vertex_start, exact_normal, plane_start};
  const MapRecords records = encode_map_records(hulls, {0, 0, 0}, 127, 1, control);
  CHECK(records.bytes == encode_map_records(hulls, {0, 0, 0}, 127, 4, control).bytes);
  const auto flat = std::span(reinterpret_cast<const std::int32_t*>(occupancy.voxels().data()), 3 * occupancy.size());
  CHECK(voxels_outside({lower, upper, normal, offset, plane_start}, flat, 4, control).empty());
  CHECK(polytopes_outside({lower, upper, normal, offset, plane_start}, vertex, vertex_start).empty());
  lower.resize(lower.size() - 3), upper.resize(upper.size() - 3), plane_start.pop_back();
  offset.resize(static_cast<std::size_t>(plane_start.back())), normal.resize(3 * offset.size());
  const auto outside = voxels_outside({lower, upper, normal, offset, plane_start}, flat, 1, control);
  CHECK(!outside.empty() && outside == voxels_outside({lower, upper, normal, offset, plane_start}, flat, 4, control));
}

template <class F>
bool is_refused(F&& function) {
  try {
    function();
  } catch (const std::invalid_argument&) {
    return true;
  }
  return false;
}

}  // namespace

int main() {
  const std::vector<Lattice> voxels = blobs();
  const Occupancy occupancy(voxels);
  Control control;
  const VoxelSets sets = subcover(occupancy, 1, true, 2, control);
  for (const bool tighten : {false, true}) {
    for (const Form& form : {Form{6, 0}, Form{9, 0}, Form{0, 14}, Form{0, 26}}) {
      MergeOptions options;
      options.max_hulls = 20;
      Cover cover = merge(occupancy, sets, options, 2, control);
      make_outer(occupancy, cover, Budget{0, 0, form}, tighten, 2, control);
      CHECK(violations(occupancy, cover).empty());
      CHECK(most_planes(cover) <= std::max(form.facet_cap, form.kdop));
      if (tighten) check_map(occupancy, cover);
      for (const LatticePolytope& hull : cover.hull) {
        const OuterSolid solid = outer_solid(hull.plane);
        CHECK(solid.point.size() >= 12 && solid.triangle.size() == 2 * solid.point.size() - 12);
      }
    }
  }
  for (const std::size_t planes : {std::size_t{6}, std::size_t{61}, std::size_t{300}}) {
    for (const bool is_bytes : {false, true}) {
      MergeOptions options;
      options.budget = is_bytes ? Budget{0, 78 + 5 * (planes - 6), {}} : Budget{planes, 0, {}};
      std::vector<Measured> measured, again;
      const Cover cover = fit(occupancy, sets, options, 1, control, measured);
      CHECK(cover.within_budget && options.budget.holds(cover.hull.size(), planes_of(cover.hull)));
      CHECK(violations(occupancy, cover).empty());
      CHECK(fit(occupancy, sets, options, 3, control, again).members.member == cover.members.member);
    }
  }
  CHECK(is_refused([] { kdop({{{0, 0, 0}, {1, 1, 1}}, {}}, 8); }));
  const std::vector<LatticePlane> box{{{-1, 0, 0}, 0}, {{1, 0, 0}, 4},  {{0, -1, 0}, 0},
                                      {{0, 1, 0}, 4},  {{0, 0, -1}, 0}, {{0, 0, 1}, 4}};
  CHECK(outer_solid(box).point.size() == 24 && outer_solid(box).is_lattice);
  auto with = [&](LatticePlane plane) {
    std::vector<LatticePlane> planes = box;
    planes.push_back(plane);
    return planes;
  };
  CHECK(outer_solid(with({{1, 1, 0}, 8})).triangle.size() == 36);  // touches in an edge
  CHECK(outer_solid(with({{2, 2, 2}, 7})).point.size() == 12 && !outer_solid(with({{2, 2, 2}, 7})).is_lattice);
  CHECK(is_refused([&] { outer_solid(with({{1, 1, 1}, 0})); }));
  CHECK(is_refused([&] { outer_solid(with({{1, 1, 1}, -5})); }));
  CHECK(is_refused([&] { outer_solid(with({{1 << 15, 1, 1}, 9})); }));
  CHECK(is_refused([&] { outer_solid(std::span(box).first(5)); }));
  return alula_failures != 0;
}
