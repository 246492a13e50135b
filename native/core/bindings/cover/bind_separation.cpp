// Bindings of alula/cover/separation.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include "alula/cover/separation.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_separation(nb::module_& m) {
  m.def(
      "unproven_voxels",
      [](alula::InRows3<float> mean, alula::InRows3<float> scale, alula::InRows4<float> quat_wxyz, double sigma,
         double voxel_size, double inflation, std::optional<alula::Box6> crop, std::uint32_t min_overlap,
         alula::InRows3<std::int32_t> index, unsigned jobs, nb::object progress,
         std::optional<alula::InRows3<float>> loss) {
        const alula::Splats splats{alula::as_span(mean), alula::as_span(scale), alula::as_span(quat_wxyz),
                                   alula::as_span(loss)};
        const auto voxels = alula::as_span(index);
        alula::PythonControl control(std::move(progress));
        alula::Unproven found;
        {
          const nb::gil_scoped_release release;
          found = alula::unproven_voxels(splats, {sigma, inflation}, voxel_size, crop, min_overlap, voxels, jobs,
                                         control);
        }
        const std::size_t count = found.ellipsoid.size();
        return std::make_tuple(found.total, alula::to_numpy(std::move(found.voxel), {count, 3}),
                               alula::to_numpy(std::move(found.ellipsoid), {count}));
      },
      "mean"_a, "scale"_a, "quat_wxyz"_a, "sigma"_a, "voxel_size"_a, "inflation"_a, "crop"_a.none(), "min_overlap"_a,
      "index"_a, "jobs"_a = 0, "progress"_a = nb::none(), "loss"_a = nb::none(),
      "Voxels outside `index` (M, 3) that are not proven to be touched by fewer than min_overlap ellipsoids:\n"
      "(total, the first 100 of them i32 (K, 3) in lexicographic order, an ellipsoid that touches each i64 (K,)).\n"
      "Voxel i is the closed cube [i g, (i + 1) g]; ellipsoids are at level sigma plus a ball of radius inflation\n"
      "and grown by `loss` of each; only voxels that touch the crop count. Every voxel not reported is proven by a "
      "separating plane with rigorous\n"
      "rounding bounds. Raises ValueError for malformed input, OverflowError when the memory budget is exceeded.");
}
