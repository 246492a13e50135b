// Bindings of alula/planning/search.hpp, passage.hpp and curve_check.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <array>
#include <optional>
#include <tuple>

#include "alula/planning/curve_check.hpp"
#include "alula/planning/passage.hpp"
#include "alula/planning/search.hpp"
#include "flight_arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace alula;
using flight::Doubles, flight::Triple, flight::triple_of, flight::vector_of;

namespace {

using InCurves = In<double, nb::shape<-1, 8, 3>>;

using Bytes = nb::ndarray<nb::numpy, std::uint8_t>;

Doubles rows(const std::vector<geometry::Vec3>& points) {
  std::vector<double> flat;
  flat.reserve(3 * points.size());
  for (const geometry::Vec3 p : points) flat.insert(flat.end(), {p.x, p.y, p.z});
  return to_numpy(std::move(flat), {points.size(), 3});
}

std::tuple<SearchStatus, Doubles, std::size_t> find(const ObstacleMap& map, Triple origin, double spacing,
                                                    std::array<std::int64_t, 3> count, Triple start, Triple goal,
                                                    double radius, double comfort, nb::object progress) {
  const Lattice lattice{vector_of(origin), spacing, {count[0], count[1], count[2]}};
  PythonControl control(std::move(progress));
  SearchResult result;
  {
    const nb::gil_scoped_release release;
    result = find_path(map, lattice, vector_of(start), vector_of(goal), radius, comfort, control);
  }
  return {result.status, rows(result.path), result.expanded};
}

Doubles tighten(const ObstacleMap& map, InRows3<double> path, double radius, double comfort, double spacing,
                int rounds, nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<geometry::Vec3> points;
  {
    const nb::gil_scoped_release release;
    for (std::size_t i = 0; i < path.shape(0); ++i) points.push_back(geometry::from_rows(path.data() + 3 * i));
    points = tighten_path(map, points, radius, comfort, spacing, rounds, control);
  }
  return rows(points);
}

std::tuple<double, double, Doubles, Triple, std::size_t> widest(const ObstacleMap& map, Triple lower, Triple upper,
                                                                Triple start, Triple goal, double enough,
                                                                double tolerance, std::size_t most_cells,
                                                                nb::object progress) {
  PythonControl control(std::move(progress));
  Passage found;
  {
    const nb::gil_scoped_release release;
    found = widest_passage(map, vector_of(lower), vector_of(upper), vector_of(start), vector_of(goal),
                           {enough, tolerance, most_cells}, control);
  }
  return {found.lower, found.upper, rows(found.path), triple_of(found.narrowest), found.cells};
}

std::optional<Triple> nearest(const ObstacleMap& map, Triple lower, Triple upper, Triple point, double radius,
                              double tolerance, std::size_t most_cells, nb::object progress) {
  PythonControl control(std::move(progress));
  geometry::Vec3 found;
  const nb::gil_scoped_release release;
  if (!nearest_free(map, vector_of(lower), vector_of(upper), vector_of(point), radius, tolerance, most_cells, found,
                    control))
    return std::nullopt;
  return triple_of(found);
}

template <class Obstacles>
std::tuple<Bytes, Doubles, std::size_t, std::uint32_t> check(const Obstacles& obstacles, InCurves control_points,
                                                             InVector<double> slack, double radius,
                                                             std::uint32_t max_depth, unsigned jobs,
                                                             nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<std::uint8_t> proven;
  std::vector<double> clearance;
  std::size_t pairs = 0;
  std::uint32_t depth = 0;
  {
    const nb::gil_scoped_release release;
    for (const CurveProof& proof :
         check_curves(obstacles, as_span(control_points), as_span(slack), radius, max_depth, jobs, control)) {
      proven.push_back(proof.proven ? 1 : 0);
      clearance.push_back(proof.clearance);
      pairs += proof.pairs;
      depth = std::max(depth, proof.depth);
    }
  }
  const std::size_t size = proven.size();
  return {to_numpy(std::move(proven), {size}), to_numpy(std::move(clearance), {size}), pairs, depth};
}

}  // namespace

void bind_search(nb::module_& m) {
  nb::enum_<SearchStatus>(m, "SearchStatus", "Outcome of `find_path`.")
      .value("found", SearchStatus::found)
      .value("no_path", SearchStatus::no_path)
      .value("start_isolated", SearchStatus::start_isolated)
      .value("goal_isolated", SearchStatus::goal_isolated);
  m.attr("MAX_LATTICE_POINTS") = Lattice::kMaxCells;
  m.def("find_path", &find, "map"_a, "origin"_a, "spacing"_a, "count"_a, "start"_a, "goal"_a, "radius"_a, "comfort"_a,
        "progress"_a = nb::none(),
        "Lattice path of a ball in an obstacle map: status, points (W, 3), lattice points expanded.");
  m.def("tighten_path", &tighten, "map"_a, "path"_a, "radius"_a, "comfort"_a, "spacing"_a, "rounds"_a,
        "progress"_a = nb::none(), "Shortcut a free path along proven straight segments.");
  m.def(
      "widest_passage", &widest, "map"_a, "lower"_a, "upper"_a, "start"_a, "goal"_a, "enough"_a, "tolerance"_a,
      "most_cells"_a, "progress"_a = nb::none(),
      "Bounds on the radius of a ball that passes within a box: (radius that passes along the returned path, radius "
      "above which none passes or `enough`, path (W, 3), its narrowest point, cells made).");
  m.def(
      "nearest_free", &nearest, "map"_a, "lower"_a, "upper"_a, "point"_a, "radius"_a, "tolerance"_a, "most_cells"_a,
      "progress"_a = nb::none(),
      "The point of a box with a distance of at least `radius` that is nearest to `point`, up to the tolerance; None "
      "if none was found.");
  constexpr const char* kCheck =
      "Prove that curves, shape (P, 8, 3) in Bernstein form, keep `radius` from all obstacles: per piece proven (u8) "
      "and clearance, then the pairs decided and the deepest subdivision.";
  m.def("check_curves", &check<PolytopeSet>, "obstacles"_a, "control_points"_a, "slack"_a, "radius"_a, "max_depth"_a,
        "jobs"_a = 0, "progress"_a = nb::none(), kCheck);
  m.def("check_curves", &check<ObstacleMap>, "obstacles"_a, "control_points"_a, "slack"_a, "radius"_a, "max_depth"_a,
        "jobs"_a = 0, "progress"_a = nb::none(), kCheck);
}
