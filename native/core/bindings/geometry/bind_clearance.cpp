// Bindings of alula/geometry/clearance.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>

#include <array>
#include <memory>
#include <tuple>
#include <utility>

#include "alula/geometry/clearance.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace alula;

namespace {

template <class Set>
nb::ndarray<nb::numpy, double> clearance(const Set& obstacles, InRows3<double> start, InRows3<double> end, double cap,
                                         unsigned jobs, nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<double> result;
  {
    const nb::gil_scoped_release release;
    result = segment_clearance(obstacles, as_span(start), as_span(end), cap, jobs, control);
  }
  const std::size_t size = result.size();
  return to_numpy(std::move(result), {size});
}

constexpr const char* kClearanceDoc =
    "Signed distance of each segment start[i]..end[i] to the nearest obstacle, at most `cap`; negative "
    "inside.";

}  // namespace

void bind_clearance(nb::module_& m) {
  nb::class_<PolytopeSet>(m, "PolytopeSet", "Convex polytopes in a bounding-volume hierarchy.")
      .def(
          "__init__",
          [](PolytopeSet* self, InRows3<double> normals, InVector<double> offsets, InVector<std::int64_t> plane_start,
             InRows3<double> vertices, InVector<std::int64_t> vertex_start) {
            new (self) PolytopeSet(as_span(normals), as_span(offsets), as_span(plane_start), as_span(vertices),
                                   as_span(vertex_start));
          },
          "normals"_a, "offsets"_a, "plane_start"_a, "vertices"_a, "vertex_start"_a,
          "Copy the polytopes {x : normal . x <= offset}, unit normals, with their vertices.")
      .def("__len__", &PolytopeSet::size)
      .def(
          "bounds",
          [](const PolytopeSet& self) {
            const geometry::Box box = self.size() > 0 ? *self.tree().bounds() : geometry::Box{{}, {}};
            return std::pair(std::array{box.lower.x, box.lower.y, box.lower.z},
                             std::array{box.upper.x, box.upper.y, box.upper.z});
          },
          "Lower and upper corner of the box around all polytopes; zeros when there are none.")
      .def("clearance", &clearance<PolytopeSet>, "start"_a, "end"_a, "cap"_a, "jobs"_a = 0, "progress"_a = nb::none(),
           kClearanceDoc);
  nb::class_<EllipsoidSet>(m, "EllipsoidSet", "Ellipsoids of Gaussians in a bounding-volume hierarchy.")
      .def(
          "__init__",
          [](EllipsoidSet* self, InRows3<float> mean, InRows3<float> scale, InRows4<float> quat_wxyz, double k,
             std::optional<InRows3<float>> loss) {
            using Arrays = std::tuple<InRows3<float>, InRows3<float>, InRows4<float>, std::optional<InRows3<float>>>;
            auto arrays = std::make_shared<const Arrays>(mean, scale, quat_wxyz, loss);
            const nb::gil_scoped_release release;
            new (self)
                EllipsoidSet(as_span(mean), as_span(scale), as_span(quat_wxyz), as_span(loss), k, std::move(arrays));
          },
          "mean"_a, "scale"_a, "quat_wxyz"_a, "k"_a, "loss"_a = nb::none(),
          "Hold the arrays, which must not change; the ellipsoids are at level k, each grown by `loss` (N, 3).")
      .def("__len__", &EllipsoidSet::size)
      .def("clearance", &clearance<EllipsoidSet>, "start"_a, "end"_a, "cap"_a, "jobs"_a = 0,
           "progress"_a = nb::none(), kClearanceDoc);
}
