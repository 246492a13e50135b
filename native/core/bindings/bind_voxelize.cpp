// Bindings of alula/voxelize.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include "alula/voxelize.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_voxelize(nb::module_& m) {
  m.def(
      "voxelize",
      [](alula::InRows3<float> mean, alula::InRows3<float> scale, alula::InRows4<float> quat_wxyz, double sigma,
         double voxel_size, double inflation, std::optional<alula::Box6> crop, unsigned jobs, nb::object progress) {
        const alula::Splats splats{alula::as_span(mean), alula::as_span(scale), alula::as_span(quat_wxyz)};
        alula::PythonControl control(std::move(progress));
        alula::Voxelized found;
        {
          const nb::gil_scoped_release release;
          found = alula::voxelize(splats, {sigma, inflation}, voxel_size, crop, jobs, control);
        }
        const std::size_t count = found.voxels.count.size();
        return std::make_tuple(alula::to_numpy(std::move(found.voxels.index), {count, 3}),
                               alula::to_numpy(std::move(found.voxels.count), {count}), found.outside, found.cut);
      },
      "mean"_a, "scale"_a, "quat_wxyz"_a, "sigma"_a, "voxel_size"_a, "inflation"_a = 0.0, "crop"_a = nb::none(),
      "jobs"_a = 0, "progress"_a = nb::none(),
      "Voxels that ellipsoids touch: (index i32 (M, 3) sorted, overlap u32 (M,), ellipsoids outside the crop,\n"
      "ellipsoids that the crop cuts). Voxel i is the closed cube [i g, (i + 1) g]; ellipsoids are at level\n"
      "sigma, grown by a ball of radius inflation (outer ellipsoid), all lengths in the unit of mean.\n"
      "Every touched voxel is marked; a voxel farther than 2e-13 of the coordinates' size is not.\n"
      "Raises ValueError for malformed input, OverflowError when the voxels exceed the memory budget.");
}
