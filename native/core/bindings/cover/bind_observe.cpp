// Bindings of alula/cover/observe.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <cmath>

#include "alula/cover/observe.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

constexpr std::int64_t kMaxPixels = 1 << 14;  // along an axis

std::vector<alula::Pinhole> cameras_of(alula::In<double, nb::shape<-1, 3, 3>> rotation, alula::InRows3<double> centre,
                                       alula::InRows4<double> image,
                                       alula::In<std::int64_t, nb::shape<-1, 2>> pixels) {
  const std::size_t count = centre.size() / 3;
  if (rotation.size() != 9 * count || image.size() != 4 * count || pixels.size() != 2 * count)
    throw nb::value_error("rotation, centre, image and pixels do not have the same number of rows");
  std::vector<alula::Pinhole> cameras(count);
  const double *r = rotation.data(), *c = centre.data(), *b = image.data();
  const std::int64_t* n = pixels.data();
  for (std::size_t i = 0; i < count; ++i) {
    alula::Pinhole& camera = cameras[i];
    bool good = true;
    for (std::size_t a = 0; a < 3; ++a) {
      camera.centre[a] = c[3 * i + a];
      good &= std::isfinite(camera.centre[a]);
      for (std::size_t j = 0; j < 3; ++j) {
        camera.rotation[a][j] = r[9 * i + 3 * a + j];
        good &= std::isfinite(camera.rotation[a][j]);
      }
    }
    camera.left = b[4 * i], camera.top = b[4 * i + 1], camera.right = b[4 * i + 2], camera.bottom = b[4 * i + 3];
    good &= std::isfinite(camera.left) && camera.left < camera.right && std::isfinite(camera.right);
    good &= std::isfinite(camera.top) && camera.top < camera.bottom && std::isfinite(camera.bottom);
    good &= n[2 * i] >= 1 && n[2 * i] <= kMaxPixels && n[2 * i + 1] >= 1 && n[2 * i + 1] <= kMaxPixels;
    if (!good) throw nb::value_error("a camera is not finite, or its image is empty or too large");
    camera.columns = static_cast<std::size_t>(n[2 * i]), camera.rows = static_cast<std::size_t>(n[2 * i + 1]);
  }
  return cameras;
}

}  // namespace

void bind_observe(nb::module_& m) {
  using Rotations = alula::In<double, nb::shape<-1, 3, 3>>;
  using Pixels = alula::In<std::int64_t, nb::shape<-1, 2>>;
  nb::class_<alula::Occluders>(
      m, "Occluders",
      "Ellipsoids at level sigma, grown by a ball of radius inflation (outer bounds) and by\n"
      "`loss` (N, 3) of each, prepared for the depth images of many cameras.")
      .def(
          "__init__",
          [](alula::Occluders* self, alula::InRows3<float> mean, alula::InRows3<float> scale,
             alula::InRows4<float> quat_wxyz, double sigma, double inflation, double worth, unsigned jobs,
             nb::object progress, std::optional<alula::InRows3<float>> loss) {
            const alula::Splats splats{alula::as_span(mean), alula::as_span(scale), alula::as_span(quat_wxyz),
                                       alula::as_span(loss)};
            alula::PythonControl control(std::move(progress));
            const nb::gil_scoped_release release;
            new (self) alula::Occluders(splats, {sigma, inflation}, worth, jobs, control);
          },
          "mean"_a, "scale"_a, "quat_wxyz"_a, "sigma"_a, "inflation"_a = 0.0, "worth"_a = 0.01, "jobs"_a = 0,
          "progress"_a = nb::none(), "loss"_a = nb::none(),
          "An ellipsoid whose bound exceeds its sum with the ball by more than `worth` gets a second bound.")
      .def(
          "depth",
          [](const alula::Occluders& self, Rotations rotation, alula::InRows3<double> centre,
             alula::InRows4<double> image, Pixels pixels, double near, double range) {
            const std::vector<alula::Pinhole> cameras = cameras_of(rotation, centre, image, pixels);
            if (cameras.size() != 1) throw nb::value_error("a depth image is of one camera");
            alula::Depth depth;
            {
              const nb::gil_scoped_release release;
              depth = self.depth(cameras[0], {near, range});
            }
            return std::make_pair(alula::to_numpy(std::move(depth.nearness), {cameras[0].rows, cameras[0].columns}),
                                  depth.blind);
          },
          "rotation"_a, "centre"_a, "image"_a, "pixels"_a, "near"_a, "range"_a,
          "Depth image of one camera, given as by `observe`: (1 / z f32 (rows, columns), an upper bound for every\n"
          "surface in the pixel's pyramid, 1 / range without one; whether an ellipsoid touches the camera).");
  m.def(
      "observe",
      [](const alula::Occluders& occluders, Rotations rotation, alula::InRows3<double> centre,
         alula::InRows4<double> image, Pixels pixels, double near, double range, double voxel_size,
         alula::Index3 lower, alula::In<std::uint8_t, nb::shape<-1, -1, -1>> blocked, double margin, unsigned jobs,
         nb::object progress) {
        const std::vector<alula::Pinhole> cameras = cameras_of(rotation, centre, image, pixels);
        const std::array<std::size_t, 3> size{blocked.shape(0), blocked.shape(1), blocked.shape(2)};
        alula::PythonControl control(std::move(progress));
        alula::Views views;
        {
          const nb::gil_scoped_release release;
          views = alula::observe(occluders, cameras, {near, range}, {voxel_size, lower, size},
                                 alula::as_span(blocked), margin, jobs, control);
        }
        const std::size_t count = cameras.size();
        return std::make_tuple(alula::to_numpy(std::move(views.count), {size[0], size[1], size[2]}),
                               alula::to_numpy(std::move(views.seen), {count}),
                               alula::to_numpy(std::move(views.blind), {count}));
      },
      "occluders"_a, "rotation"_a, "centre"_a, "image"_a, "pixels"_a, "near"_a, "range"_a, "voxel_size"_a, "lower"_a,
      "blocked"_a, "margin"_a = 0.0, "jobs"_a = 0, "progress"_a = nb::none(),
      "Count the cameras that see each voxel of a box wholly: (u16 like `blocked`; u64 (K,): voxels that each "
      "camera\n"
      "sees; u8 (K,): 1 where an ellipsoid touches the camera, which then sees nothing). Cameras are pinholes: x =\n"
      "rotation (world - centre), x right, y down, z forward; `image` (K, 4) has the smallest x/z and y/z and the\n"
      "largest x/z and y/z, `pixels` (K, 2) the columns and rows. Voxels in `blocked`, u8 (X, Y, Z) from voxel\n"
      "`lower`, are never seen, and hide what lies behind them. `margin` grows voxels at the image's border and at\n"
      "the depth `near`. The result does not depend on `jobs`.");
}
