// Bindings of alula/cover/voxelize.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "alula/cover/voxelize.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_voxelize(nb::module_& m) {
  using Floats3 = alula::InRows3<float>;
  using Floats4 = alula::InRows4<float>;
  m.attr("MAX_VOXELS") = alula::OverlapGrid::kMaxVoxels;
  m.def(
      "voxelize",
      [](Floats3 mean, Floats3 scale, Floats4 quat_wxyz, double sigma, double voxel_size, double inflation,
         std::optional<alula::Box6> crop, std::optional<std::pair<alula::Index3, alula::Index3>> tile,
         std::uint32_t min_overlap, unsigned jobs, nb::object progress, std::optional<alula::InRows3<float>> loss) {
        const alula::Splats splats{alula::as_span(mean), alula::as_span(scale), alula::as_span(quat_wxyz),
                                   alula::as_span(loss)};
        std::optional<alula::Block> block;
        if (tile) block = {tile->first, tile->second};
        alula::PythonControl control(std::move(progress));
        alula::Voxelized found;
        {
          const nb::gil_scoped_release release;
          found = alula::voxelize(splats, {sigma, inflation}, voxel_size, crop, block, min_overlap, jobs, control);
        }
        alula::VoxelCounts& voxels = found.voxels;
        const std::size_t count = voxels.count.size(), rows = found.reach.size();
        return std::make_tuple(alula::to_numpy(std::move(voxels.index), {count, 3}),
                               alula::to_numpy(std::move(voxels.count), {count}),
                               alula::to_numpy(std::move(found.reach), {rows}), voxels.below, voxels.most);
      },
      "mean"_a, "scale"_a, "quat_wxyz"_a, "sigma"_a, "voxel_size"_a, "inflation"_a = 0.0, "crop"_a = nb::none(),
      "tile"_a = nb::none(), "min_overlap"_a = 1, "jobs"_a = 0, "progress"_a = nb::none(), "loss"_a = nb::none(),
      "Find the voxels that ellipsoids touch: (index i32 (M, 3) sorted, overlap u32 (M,), reach u8 (N,): 0 where an\n"
      "ellipsoid marks nothing, 2 where its box exceeds the crop, else 1; voxels that fewer than min_overlap\n"
      "touch, which are left out; the highest overlap). Voxel i is the closed cube [i g, (i + 1) g];\n"
      "ellipsoids are at level sigma, grown by a ball of radius inflation (outer bounds) and by `loss`\n"
      "(N, 3) of each: error of the centre, relative error of the semi-axes, error of the rotation; all lengths in "
      "the\n"
      "unit of mean. Every touched voxel is marked; a voxel farther than 3e-13 of the coordinates' size is\n"
      "not. With a tile (lowest index, highest index) only its voxels. Raises ValueError for malformed input,\n"
      "OverflowError when the voxels exceed the memory budget.");
  m.def(
      "tally_opacity",
      [](Floats3 mean, Floats3 scale, Floats4 quat_wxyz, alula::InVector<float> opacity,
         alula::InVector<float> limits, alula::Triple origin, double edge, alula::Index3 size, unsigned jobs) {
        const alula::Splats splats{alula::as_span(mean), alula::as_span(scale), alula::as_span(quat_wxyz), {}};
        alula::PythonControl control{nb::none()};
        alula::OpacityTally tally;
        {
          const nb::gil_scoped_release release;
          tally = alula::tally_opacity(splats, alula::as_span(opacity), alula::as_span(limits), origin, edge, size,
                                       jobs, control);
        }
        return std::make_pair(tally.gaussians, tally.cells);
      },
      "mean"_a, "scale"_a, "quat_wxyz"_a, "opacity"_a, "limits"_a, "origin"_a, "edge"_a, "size"_a, "jobs"_a = 0,
      "Tally what one-sigma ellipsoids mark by their opacity, for ascending limits (L,): two lists of L + 1 counts, "
      "of\n"
      "the rows by rank, the number of limits not above their opacity, and of the cells by the highest rank of the\n"
      "rows that touch them. Cells have the edge `edge` and the indices 0 ... size - 1 from `origin`. Rows that are\n"
      "not finite do not count. Raises ValueError for malformed input.");
  m.def(
      "tiles_of",
      [](Floats3 mean, Floats3 scale, Floats4 quat_wxyz, double sigma, double voxel_size, double inflation,
         std::optional<alula::Box6> crop, std::int32_t edge, nb::object progress,
         std::optional<alula::InRows3<float>> loss) {
        const alula::Splats splats{alula::as_span(mean), alula::as_span(scale), alula::as_span(quat_wxyz),
                                   alula::as_span(loss)};
        alula::PythonControl control(std::move(progress));
        alula::Tiles found;
        {
          const nb::gil_scoped_release release;
          found = alula::tiles_of(splats, {sigma, inflation}, voxel_size, crop, edge, control);
        }
        const std::size_t tiles = found.tile.size() / 3, rows = found.row.size();
        return std::make_tuple(alula::to_numpy(std::move(found.tile), {tiles, 3}),
                               alula::to_numpy(std::move(found.start), {tiles + 1}),
                               alula::to_numpy(std::move(found.row), {rows}));
      },
      "mean"_a, "scale"_a, "quat_wxyz"_a, "sigma"_a, "voxel_size"_a, "inflation"_a, "crop"_a, "edge"_a,
      "progress"_a = nb::none(), "loss"_a = nb::none(),
      "Find the tiles of edge^3 voxels that ellipsoids may touch, by their boxes: (tile i32 (T, 3) sorted, start "
      "i64\n"
      "(T + 1), row u32): tile t holds the voxels t edge ... t edge + edge - 1. Raises OverflowError for more\n"
      "than 2^20 tiles or 2^27 rows.");
  m.def(
      "joined_voxels",
      [](alula::InRows3<std::int32_t> index, alula::InVector<std::uint32_t> count,
         alula::InVector<std::int64_t> start) {
        const auto starts = alula::as_span(start);
        std::int64_t last = 0;
        for (const std::int64_t s : starts) {
          if (s < last || s > static_cast<std::int64_t>(count.size()))
            throw nb::value_error("start is not ascending");
          last = s;
        }
        if (index.size() != 3 * count.size()) throw nb::value_error("index and count differ in length");
        alula::VoxelCounts all;
        {
          const nb::gil_scoped_release release;
          all = alula::joined(alula::as_span(index), alula::as_span(count), starts);
        }
        const std::size_t rows = all.count.size();
        return std::make_pair(alula::to_numpy(std::move(all.index), {rows, 3}),
                              alula::to_numpy(std::move(all.count), {rows}));
      },
      "index"_a, "count"_a, "start"_a,
      "Merge disjoint sorted lists of voxels into one sorted list (index, count): rows start[i] ... start[i + 1] - "
      "1.");
}
