// Bindings of alula/planning/corridor.hpp and alula/planning/minimum_time.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <optional>
#include <tuple>

#include "alula/planning/corridor.hpp"
#include "alula/planning/minimum_time.hpp"
#include "flight_arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace alula;
using flight::Doubles, flight::Triple, flight::triple_of, flight::vector_of;
using geometry::Vec3;

namespace {

using Longs = nb::ndarray<nb::numpy, std::int64_t>;
using Bytes = nb::ndarray<nb::numpy, std::uint8_t>;
using Hulls = std::vector<const PolytopeSet*>;
using Ellipsoids = std::vector<const EllipsoidSet*>;

std::vector<Vec3> vectors(InRows3<double> rows) {
  std::vector<Vec3> result;
  for (std::size_t i = 0; i < rows.shape(0); ++i) result.push_back(geometry::from_rows(rows.data() + 3 * i));
  return result;
}

std::tuple<Doubles, Doubles, Longs, Bytes> cells(const Hulls& hulls, const Ellipsoids& ellipsoids,
                                                 InRows3<double> start, InRows3<double> end, double radius,
                                                 double reach, Triple lower, Triple upper, unsigned jobs,
                                                 nb::object progress) {
  PythonControl control(std::move(progress));
  Corridor result;
  {
    const nb::gil_scoped_release release;
    result = corridor_cells({hulls, ellipsoids}, as_span(start), as_span(end), radius, reach,
                            {vector_of(lower), vector_of(upper)}, jobs, control);
  }
  const std::size_t rows = result.offsets.size(), count = result.is_free.size();
  return {to_numpy(std::move(result.normals), {rows, 3}), to_numpy(std::move(result.offsets), {rows}),
          to_numpy(std::move(result.start), {count + 1}), to_numpy(std::move(result.is_free), {count})};
}

std::tuple<Bytes, Doubles, std::size_t> prove_cells(const Hulls& hulls, const Ellipsoids& ellipsoids,
                                                    InRows3<double> normals, InVector<double> offsets,
                                                    InVector<std::int64_t> start, double radius, unsigned jobs,
                                                    nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<std::uint8_t> proven;
  std::vector<double> clearance;
  std::size_t pairs = 0;
  {
    const nb::gil_scoped_release release;
    for (const CellProof& proof : check_cells({hulls, ellipsoids}, as_span(normals), as_span(offsets), as_span(start),
                                              radius, jobs, control)) {
      proven.push_back(proof.proven ? 1 : 0);
      clearance.push_back(proof.clearance);
      pairs += proof.pairs;
    }
  }
  const std::size_t size = proven.size();
  return {to_numpy(std::move(proven), {size}), to_numpy(std::move(clearance), {size}), pairs};
}

std::tuple<TimeStatus, Doubles, Doubles, int> fastest(
    InRows3<double> normals, InVector<double> offsets, InVector<std::int64_t> row_start, InVector<std::uint32_t> cell,
    const MotionLimits& limits, InRows3<double> start, Triple goal, InRows3<double> joint,
    InVector<std::uint8_t> is_via, double least_duration, double gap, int most_steps, double stretch,
    std::optional<InRows3<double>> centre, std::optional<InRows3<double>> normal,
    std::optional<InVector<double>> opening, std::optional<InVector<double>> speed) {
  if (start.shape(0) != 1 && start.shape(0) != 4) throw nb::value_error("start is a position, or p, v, a and j");
  std::vector<Opening> openings;
  if (opening) {
    const std::size_t count = opening->shape(0);
    if (!centre || !normal || centre->shape(0) != count || normal->shape(0) != count)
      throw nb::value_error("openings need a centre and a normal each");
    for (std::size_t i = 0; i < count; ++i)
      openings.push_back({geometry::from_rows(centre->data() + 3 * i), geometry::from_rows(normal->data() + 3 * i),
                          opening->data()[i]});
  }
  TimeCurve curve;
  {
    const nb::gil_scoped_release release;
    const std::vector<Vec3> joints = vectors(joint), state = vectors(start);
    TimeProblem problem{as_span(normals), as_span(offsets), as_span(row_start), as_span(cell), limits, {},
                        vector_of(goal),  joints,           as_span(is_via),    least_duration};
    problem.opening = openings;
    if (speed) problem.speed = as_span(*speed);
    problem.start.p = state[0];
    if (state.size() == 4) problem.start = {state[0], state[1], state[2], state[3], true};
    curve = minimum_time(problem, {gap, most_steps, stretch});
  }
  std::vector<double> flat;
  for (const Vec3 p : curve.point) flat.insert(flat.end(), {p.x, p.y, p.z});
  const std::size_t pieces = curve.duration.size();
  return {curve.status, to_numpy(std::move(flat), {pieces, 8, 3}), to_numpy(std::move(curve.duration), {pieces}),
          curve.steps};
}

}  // namespace

void bind_corridor(nb::module_& m) {
  m.def("corridor_cells", &cells, "hulls"_a, "ellipsoids"_a, "start"_a, "end"_a, "radius"_a, "reach"_a, "lower"_a,
        "upper"_a, "jobs"_a = 0, "progress"_a = nb::none(),
        "Convex cells around segments, every point of which keeps `radius` from all obstacles: normals (R, 3), "
        "offsets (R,), first rows (C + 1,), and whether each segment keeps the radius (u8).");
  m.def("check_cells", &prove_cells, "hulls"_a, "ellipsoids"_a, "normals"_a, "offsets"_a, "start"_a, "radius"_a,
        "jobs"_a = 0, "progress"_a = nb::none(),
        "Prove that cells keep `radius` from all obstacles: per cell proven (u8) and clearance, then the pairs "
        "decided.");
  nb::enum_<TimeStatus>(m, "TimeStatus", "Outcome of `minimum_time`.")
      .value("solved", TimeStatus::solved)
      .value("stopped_early", TimeStatus::stopped_early)
      .value("infeasible", TimeStatus::infeasible);
  nb::class_<MotionLimits>(m, "MotionLimits", "Bounds of the derivatives of a curve at every instant, SI units.")
      .def(
          "__init__",
          [](MotionLimits* self, double speed, double acceleration, double jerk, double snap, double gravity,
             double most_thrust, double least_thrust, double tilt) {
            new (self) MotionLimits{speed, acceleration, jerk, snap, gravity, most_thrust, least_thrust, tilt};
          },
          nb::kw_only(), "speed"_a, "acceleration"_a, "jerk"_a = kUnlimited, "snap"_a = kUnlimited,
          "gravity"_a = 9.81, "most_thrust"_a = kUnlimited, "least_thrust"_a = -kUnlimited, "tilt"_a = kUnlimited,
          "`tilt` is a tangent; thrusts are per mass.")
      .def_ro("speed", &MotionLimits::speed)
      .def_ro("acceleration", &MotionLimits::acceleration)
      .def_ro("jerk", &MotionLimits::jerk)
      .def_ro("snap", &MotionLimits::snap)
      .def_ro("gravity", &MotionLimits::gravity)
      .def_ro("most_thrust", &MotionLimits::most_thrust)
      .def_ro("least_thrust", &MotionLimits::least_thrust)
      .def_ro("tilt", &MotionLimits::tilt);
  m.def("minimum_time", &fastest, "normals"_a, "offsets"_a, "row_start"_a, "cell"_a, "limits"_a, "start"_a, "goal"_a,
        "joint"_a, "is_via"_a, "least_duration"_a, "gap"_a, "most_steps"_a, "stretch"_a, "centre"_a = nb::none(),
        "normal"_a = nb::none(), "opening"_a = nb::none(), "speed"_a = nb::none(),
        "Fastest curve of degree 7 and class C4 in a corridor: status, Bernstein points (K, 8, 3), durations (K,), "
        "steps. `opening` (K - 1,) is the radius within which a via may be passed, about `centre` (K - 1, 3), or in "
        "the "
        "disc across `normal` (K - 1, 3) where that is not 0; `speed` (K,) limits single pieces.");
}
