// Bindings of alula/cover/touch.hpp, alula/cover/touch_check.hpp and alula/formats/octree.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include "alula/cover/touch.hpp"
#include "alula/cover/touch_check.hpp"
#include "alula/formats/octree.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Corners = alula::In<double, nb::shape<-1, 3, 3>>;
using Crop = std::optional<alula::Box6>;

auto arrays_of(alula::VoxelCounts&& found) {
  const std::size_t count = found.count.size();
  return std::make_tuple(alula::to_numpy(std::move(found.index), {count, 3}),
                         alula::to_numpy(std::move(found.count), {count}), found.below, found.most);
}

auto arrays_of(alula::Unproven&& found) {
  const std::size_t listed = found.ellipsoid.size();
  return std::make_tuple(found.total, alula::to_numpy(std::move(found.voxel), {listed, 3}),
                         alula::to_numpy(std::move(found.ellipsoid), {listed}));
}

// Calls a function of (control) without the GIL, and returns its result as arrays.
template <class Call>
auto released(nb::object progress, Call&& call) {
  alula::PythonControl control(std::move(progress));
  auto found = [&] {
    const nb::gil_scoped_release release;
    return call(control);
  }();
  return arrays_of(std::move(found));
}

}  // namespace

void bind_touch(nb::module_& m) {
  m.def(
      "touched_by_triangles",
      [](Corners corners, double radius, double voxel_size, Crop crop, std::uint32_t min_count, unsigned jobs,
         nb::object progress) {
        return released(std::move(progress), [&](alula::Control& control) {
          return alula::touched_by_triangles(alula::as_span(corners), radius, voxel_size, crop, min_count, jobs,
                                             control);
        });
      },
      "corners"_a, "radius"_a, "voxel_size"_a, "crop"_a = nb::none(), "min_count"_a = 1, "jobs"_a = 0,
      "progress"_a = nb::none(),
      "Find the voxels that triangles (T, 3, 3), each plus a ball, touch: (index i32 (M, 3) sorted, number of\n"
      "triangles u32 (M,), voxels that fewer than min_count touch and that are left out, the highest number).\n"
      "Voxel i is the closed cube [i g, (i + 1) g]. Every touched voxel is marked; one that is farther than the\n"
      "radius by 1e-13 of the coordinates' size is not. Raises ValueError for malformed input, OverflowError when\n"
      "the voxels exceed the memory budget.");
  m.def(
      "touched_by_points",
      [](alula::InRows3<double> points, double radius, double voxel_size, Crop crop, std::uint32_t min_count,
         unsigned jobs, nb::object progress) {
        return released(std::move(progress), [&](alula::Control& control) {
          return alula::touched_by_points(alula::as_span(points), radius, voxel_size, crop, min_count, jobs, control);
        });
      },
      "points"_a, "radius"_a, "voxel_size"_a, "crop"_a = nb::none(), "min_count"_a = 1, "jobs"_a = 0,
      "progress"_a = nb::none(), "Find the voxels that balls around points (N, 3) touch, as `touched_by_triangles`.");
  m.def(
      "voxels_of_blocks",
      [](alula::InRows3<std::int32_t> lower, alula::InRows3<std::int32_t> upper, double voxel_size, Crop crop,
         unsigned jobs, nb::object progress) {
        return released(std::move(progress), [&](alula::Control& control) {
          return alula::voxels_of_blocks(alula::as_span(lower), alula::as_span(upper), voxel_size, crop, jobs,
                                         control);
        });
      },
      "lower"_a, "upper"_a, "voxel_size"_a, "crop"_a = nb::none(), "jobs"_a = 0, "progress"_a = nb::none(),
      "List the voxels of blocks lower ... upper, inclusive, as `touched_by_triangles`.");
  m.def(
      "with_inside",
      [](alula::InRows3<std::int32_t> index, alula::InVector<std::uint32_t> count, Corners corners, double voxel_size,
         Crop crop, unsigned jobs, nb::object progress) {
        const auto voxels = alula::as_span(index);
        const auto counts = alula::as_span(count);
        return released(std::move(progress), [&](alula::Control& control) {
          alula::VoxelCounts touched;
          touched.index.assign(voxels.begin(), voxels.end());
          touched.count.assign(counts.begin(), counts.end());
          return alula::with_inside(touched, alula::as_span(corners), voxel_size, crop, jobs, control);
        });
      },
      "index"_a, "count"_a, "corners"_a, "voxel_size"_a, "crop"_a = nb::none(), "jobs"_a = 0,
      "progress"_a = nb::none(),
      "Add to the voxels that a closed oriented surface touches all that it encloses, with a count of 0, and keep\n"
      "those that touch the crop; as `touched_by_triangles`. Raises ValueError if the surface is not closed.");
  m.def(
      "unproven_triangles",
      [](Corners corners, double radius, double voxel_size, Crop crop, std::uint32_t min_count,
         alula::InRows3<std::int32_t> index, unsigned jobs, nb::object progress) {
        return released(std::move(progress), [&](alula::Control& control) {
          return alula::unproven_triangles(alula::as_span(corners), radius, voxel_size, crop, min_count,
                                           alula::as_span(index), jobs, control);
        });
      },
      "corners"_a, "radius"_a, "voxel_size"_a, "crop"_a, "min_count"_a, "index"_a, "jobs"_a = 0,
      "progress"_a = nb::none(),
      "Prove by planes that voxels outside of `index` are touched by fewer than min_count triangles, each plus a\n"
      "ball: (number without a proof, the first of them i32 (K, 3), the first triangle of each i64 (K,)).");
  m.def(
      "unproven_outside",
      [](Corners corners, double voxel_size, Crop crop, alula::InRows3<std::int32_t> index, unsigned jobs,
         nb::object progress) {
        return released(std::move(progress), [&](alula::Control& control) {
          return alula::unproven_outside(alula::as_span(corners), voxel_size, crop, alula::as_span(index), jobs,
                                         control);
        });
      },
      "corners"_a, "voxel_size"_a, "crop"_a, "index"_a, "jobs"_a = 0, "progress"_a = nb::none(),
      "Prove by rays that voxels outside of `index`, none of which a closed oriented surface touches, lie outside\n"
      "of it; as `unproven_triangles`, with -1 for the triangle.");
  m.def(
      "octree_leaves",
      [](alula::InVector<std::uint8_t> body, bool is_binary, std::size_t payload) {
        alula::OctreeLeaves found;
        {
          const nb::gil_scoped_release release;
          found = alula::octree_leaves(alula::as_span(body), is_binary, payload);
        }
        const std::size_t count = found.edge.size();
        return std::make_tuple(alula::to_numpy(std::move(found.lower), {count, 3}),
                               alula::to_numpy(std::move(found.edge), {count}),
                               alula::to_numpy(std::move(found.state), {count}), found.nodes);
      },
      "body"_a, "is_binary"_a, "payload"_a = 0,
      "Read the nodes of OctoMap's trees: cubes (lower i32 (N, 3) from -2^15, edge i32 (N,), state u8 (N,): 0\n"
      "unknown, 1 free, 2 occupied; number of nodes). Raises ValueError if the bytes are no tree.");
}
