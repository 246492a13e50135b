// Bindings of alula/planning/search.hpp and alula/planning/curve_check.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/tuple.h>

#include <array>
#include <tuple>

#include "alula/planning/curve_check.hpp"
#include "alula/planning/search.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace alula;
using geometry::Vec3;

namespace {

using Triple = std::array<double, 3>;
using InCurves = In<double, nb::shape<-1, 8, 3>>;

Vec3 vector_of(const Triple& t) { return {t[0], t[1], t[2]}; }

using Doubles = nb::ndarray<nb::numpy, double>;
using Bytes = nb::ndarray<nb::numpy, std::uint8_t>;

Doubles rows(const std::vector<Vec3>& points) {
  std::vector<double> flat;
  flat.reserve(3 * points.size());
  for (const Vec3 p : points) flat.insert(flat.end(), {p.x, p.y, p.z});
  return to_numpy(std::move(flat), {points.size(), 3});
}

std::tuple<SearchStatus, Doubles, std::size_t> find(const PolytopeSet& obstacles, Triple origin, double spacing,
                                                    std::array<std::int64_t, 3> count, Triple start, Triple goal,
                                                    double radius, double comfort, nb::object progress) {
  const Lattice lattice{vector_of(origin), spacing, {count[0], count[1], count[2]}};
  PythonControl control(std::move(progress));
  SearchResult result;
  {
    const nb::gil_scoped_release release;
    result = find_path(obstacles, lattice, vector_of(start), vector_of(goal), radius, comfort, control);
  }
  return {result.status, rows(result.path), result.expanded};
}

Doubles tighten(const PolytopeSet& obstacles, InRows3<double> path, double radius, double comfort, double spacing,
                int rounds, unsigned jobs, nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<Vec3> points;
  {
    const nb::gil_scoped_release release;
    for (std::size_t i = 0; i < path.shape(0); ++i) points.push_back(geometry::from_rows(path.data() + 3 * i));
    points = tighten_path(obstacles, points, radius, comfort, spacing, rounds, jobs, control);
  }
  return rows(points);
}

std::tuple<Bytes, Doubles, std::size_t, std::uint32_t> check(const PolytopeSet& obstacles, InCurves control_points,
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
  m.def("find_path", &find, "obstacles"_a, "origin"_a, "spacing"_a, "count"_a, "start"_a, "goal"_a, "radius"_a,
        "comfort"_a, "progress"_a = nb::none(),
        "Lattice path of a ball among polytopes: status, points (W, 3), lattice points expanded.");
  m.def("tighten_path", &tighten, "obstacles"_a, "path"_a, "radius"_a, "comfort"_a, "spacing"_a, "rounds"_a,
        "jobs"_a = 0, "progress"_a = nb::none(), "Shortcut a free path along proven straight segments.");
  m.def("check_curves", &check, "obstacles"_a, "control_points"_a, "slack"_a, "radius"_a, "max_depth"_a, "jobs"_a = 0,
        "progress"_a = nb::none(),
        "Prove that curves, shape (P, 8, 3) in Bernstein form, keep `radius` from all polytopes: per piece "
        "proven (u8) and clearance, then the pairs decided and the deepest subdivision.");
}
