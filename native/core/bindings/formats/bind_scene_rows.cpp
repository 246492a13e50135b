// Bindings of alula/formats/scene_rows.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <stdexcept>

#include "alula/formats/scene_rows.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using FiguresDict = nb::typed<nb::dict, nb::str, nb::any>;

SplatArrays arrays_of(const InRows3<float>& mean, const InRows3<float>& scale, const InRows4<float>& quat,
                      const InVector<float>& opacity) {
  return {as_span(mean), as_span(scale), as_span(quat), as_span(opacity)};
}

std::tuple<std::array<std::size_t, kRemovals>, std::size_t> screen(
    const InRows3<float>& mean, const InRows3<float>& scale, const InRows4<float>& quat,
    const InVector<float>& opacity, IntoVector<std::uint8_t> removal, float min_opacity,
    std::optional<std::array<double, 6>> crop, std::optional<std::array<double, 4>> crop_sphere,
    std::optional<float> max_scale, unsigned jobs) {
  PythonControl control{nb::none()};
  const nb::gil_scoped_release release;
  const Screened found =
      screen_rows(arrays_of(mean, scale, quat, opacity), {min_opacity, crop, crop_sphere, max_scale},
                  {removal.data(), removal.size()}, jobs, control);
  return {found.count, found.first_not_finite};
}

FiguresDict keep(const InRows3<float>& mean, const InRows3<float>& scale, const InRows4<float>& quat,
                 const InVector<float>& opacity, const InRows3<std::uint8_t>& color,
                 const InVector<std::uint8_t>& removal, float scale_floor, std::optional<IntoRows3<float>> out_mean,
                 std::optional<IntoRows3<float>> out_scale, std::optional<IntoRows4<float>> out_quat,
                 std::optional<IntoVector<float>> out_opacity, std::optional<IntoRows3<std::uint8_t>> out_color,
                 unsigned jobs) {
  const KeptArrays out{as_span(out_mean), as_span(out_scale), as_span(out_quat), as_span(out_opacity),
                       as_span(out_color)};
  PythonControl control{nb::none()};
  KeptFigures figures;
  {
    const nb::gil_scoped_release release;
    figures = keep_rows(arrays_of(mean, scale, quat, opacity), as_span(color), as_span(removal), scale_floor, out,
                        jobs, control);
  }
  FiguresDict result;
  result["lower"] = figures.lower;
  result["upper"] = figures.upper;
  result["scale_max"] = figures.scale_max;
  result["scale_median"] = figures.scale_median;
  result["opacity_median"] = figures.opacity_median;
  result["floored"] = figures.floored;
  return result;
}

std::tuple<double, std::size_t, std::size_t> map(const InRows3<float>& mean, const InRows3<float>& scale,
                                                 const InRows4<float>& quat, double factor,
                                                 const std::array<std::array<double, 3>, 3>& rotation,
                                                 const std::array<double, 3>& translation,
                                                 const std::array<double, 4>& quat_wxyz, IntoRows3<float> out_mean,
                                                 IntoRows3<float> out_scale, IntoRows4<float> out_quat,
                                                 std::optional<IntoVector<double>> out_moved, unsigned jobs) {
  PythonControl control{nb::none()};
  const MappedRows out{as_span(out_mean), as_span(out_scale), as_span(out_quat), as_span(out_moved)};
  const nb::gil_scoped_release release;
  const MappedFigures found = map_rows(as_span(mean), as_span(scale), as_span(quat),
                                       {factor, rotation, translation, quat_wxyz}, out, jobs, control);
  return {found.moved_max, found.bad_mean, found.bad_scale};
}

}  // namespace
}  // namespace alula

void bind_scene_rows(nb::module_& m) {
  using namespace alula;
  m.def("screen_rows", &screen, "mean"_a, "scale"_a, "quat"_a, "opacity"_a, "removal"_a.noconvert(), nb::kw_only(),
        "min_opacity"_a, "crop"_a.none() = nb::none(), "crop_sphere"_a.none() = nb::none(),
        "max_scale"_a.none() = nb::none(), "jobs"_a = 0,
        "Write into `removal` (N,) why each row is left out, 0 for kept; see alula/formats/scene_rows.hpp for the "
        "order of\n"
        "the reasons. Returns how many rows have each, and the first row that is not finite, N if there is none.");
  m.def("keep_rows", &keep, "mean"_a, "scale"_a, "quat"_a, "opacity"_a, "color"_a, "removal"_a, nb::kw_only(),
        "scale_floor"_a, "out_mean"_a.noconvert().none() = nb::none(), "out_scale"_a.noconvert().none() = nb::none(),
        "out_quat"_a.noconvert().none() = nb::none(), "out_opacity"_a.noconvert().none() = nb::none(),
        "out_color"_a.noconvert().none() = nb::none(), "jobs"_a = 0,
        "Copy the rows whose removal is 0 to the outputs that are given, quaternions normalised and semi-axes no\n"
        "smaller than the floor. Returns lower, upper, scale_max, scale_median (of the longest semi-axes),\n"
        "opacity_median and floored (rows with a semi-axis below the floor) of these.");
  m.def("map_rows", &map, "mean"_a, "scale"_a, "quat"_a, nb::kw_only(), "factor"_a, "rotation"_a, "translation"_a,
        "quat_wxyz"_a, "out_mean"_a.noconvert(), "out_scale"_a.noconvert(), "out_quat"_a.noconvert(),
        "out_moved"_a.noconvert().none() = nb::none(), "jobs"_a = 0,
        "Write the rows mapped by x -> factor rotation x + translation, `quat_wxyz` being the rotation, rounded to\n"
        "single precision. `out_moved` (N,) gets bounds on how far rounding moves each centre. Returns the largest\n"
        "one and the first rows whose mean and scale do not fit, N if there is none.");
}
