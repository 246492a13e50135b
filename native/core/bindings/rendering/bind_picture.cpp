// Bindings of alula/rendering/picture.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/tuple.h>

#include "alula/rendering/picture.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

void bind_picture(nb::module_& m) {
  using Matrix = alula::In<double, nb::shape<3, 3>>;
  using Vector = alula::In<double, nb::shape<3>>;
  using Covariances = alula::In<float, nb::shape<-1, 3, 3>>;
  using Corners = alula::In<double, nb::shape<-1, 3, 3>>;
  using Ends = alula::In<double, nb::shape<-1, 2, 3>>;
  m.def(
      "draw_picture",
      [](Matrix rotation, Vector centre, double focal, std::size_t columns, std::size_t rows, double near,
         bool is_parallel, alula::InRows3<float> mean, Covariances covariance, alula::InRows3<std::uint8_t> color,
         alula::InVector<float> opacity, Corners corner, alula::InRows3<std::uint8_t> corner_color,
         alula::InVector<float> corner_opacity, Ends end, alula::InRows3<std::uint8_t> end_color,
         alula::InRows3<float> style, alula::InVector<std::int32_t> line, unsigned jobs, nb::object progress) {
        alula::rendering::Camera camera;
        for (int i = 0; i < 3; ++i) {
          for (int j = 0; j < 3; ++j) camera.rotation[i][j] = rotation.data()[3 * i + j];
          camera.centre[i] = centre.data()[i];
        }
        camera.focal = focal, camera.columns = columns, camera.rows = rows;
        camera.near = near, camera.is_parallel = is_parallel;
        alula::PythonControl control(std::move(progress));
        alula::rendering::Picture picture;
        {
          const nb::gil_scoped_release release;
          picture = alula::rendering::draw(
              camera,
              {alula::as_span(mean), alula::as_span(covariance), alula::as_span(color), alula::as_span(opacity)},
              {alula::as_span(corner), alula::as_span(corner_color), alula::as_span(corner_opacity)},
              {alula::as_span(end), alula::as_span(end_color), alula::as_span(style), alula::as_span(line)}, jobs,
              control);
        }
        return std::make_tuple(alula::to_numpy(std::move(picture.color), {rows, columns, 3}),
                               alula::to_numpy(std::move(picture.light), {rows, columns}),
                               alula::to_numpy(std::move(picture.depth), {rows, columns}));
      },
      "rotation"_a, "centre"_a, "focal"_a, "columns"_a, "rows"_a, "near"_a, "is_parallel"_a, "mean"_a, "covariance"_a,
      "color"_a, "opacity"_a, "corner"_a, "corner_color"_a, "corner_opacity"_a, "end"_a, "end_color"_a, "style"_a,
      "line"_a, "jobs"_a = 0, "progress"_a = nb::none(),
      "Draw Gaussians, triangles and segments of lines: (colour f32 (rows, columns, 3), 0 to 255, without what is\n"
      "behind; fraction of the background that is seen f32 (rows, columns); depth f32 (rows, columns) where half of\n"
      "the light is stopped, infinite where it is not). The camera has x right, y down, z forward: x = rotation\n"
      "(world - centre), pixel = middle + focal (x, y) / z [px], or with `is_parallel` middle + focal (x, y) "
      "[px/m].\n"
      "Gaussians: `mean` (N, 3), `covariance` (N, 3, 3), `color` (N, 3), `opacity` (N,). Triangles: `corner` (T, 3, "
      "3),\n"
      "`corner_color` (T, 3), `corner_opacity` (T,). Segments: `end` (L, 2, 3), `end_color` (L, 3), `style` (L, 3):\n"
      "width [px], opacity, and the opacity with which it shows through what hides it; `line` (L,): segments with "
      "the\n"
      "same number overlap without getting darker. World frame, metres. Values that are not finite are skipped. The\n"
      "result does not depend on `jobs`.");
}
