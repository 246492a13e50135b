// Bindings of alula/geometry/ellipsoid_index.hpp, alula/filters/splat_filter.hpp and the acceleration filters.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>

#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>

#include "alula/base/parallel.hpp"
#include "alula/filters/cone_di.hpp"
#include "alula/filters/safer_splat.hpp"
#include "arrays.hpp"
#include "python_control.hpp"
#include "python_qp.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using flight::Cone;
using flight::ConeDi;
using flight::FilterReport;
using flight::FlightState;
using flight::Nominal;
using flight::Pruning;
using flight::SaferSplat;
using flight::SplatFilter;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

using Array3 = std::array<double, 3>;
using Array4 = std::array<double, 4>;
using State12 = std::array<double, 12>;
using Record = nb::typed<nb::dict, nb::str, nb::any>;

geometry::Vec3 vec(const Array3& a) { return {a[0], a[1], a[2]}; }
Array3 array(geometry::Vec3 a) { return {a.x, a.y, a.z}; }
geometry::Vec3 at(const State12& x, std::size_t i) { return {x[i], x[i + 1], x[i + 2]}; }

using Indices = nb::ndarray<nb::numpy, std::int64_t>;
using Doubles = nb::ndarray<nb::numpy, double>;

std::tuple<Indices, Doubles> nearest(const EllipsoidIndex& self, const Array3& a, const Array3& b, double reach,
                                     std::size_t count) {
  std::vector<Found> found;
  {
    const nb::gil_scoped_release release;
    self.nearest(vec(a), vec(b), reach, count, found);
  }
  std::vector<std::int64_t> item;
  std::vector<double> distance;
  for (const Found& f : found) item.push_back(f.item), distance.push_back(f.distance);
  const std::size_t n = found.size();
  return {to_numpy(std::move(item), {n}), to_numpy(std::move(distance), {n})};
}

Doubles clearance(const EllipsoidIndex& self, const InRows3<double>& points, double cap, unsigned jobs,
                  nb::object progress) {
  std::vector<double> result(points.shape(0));
  PythonControl control(std::move(progress));
  {
    const nb::gil_scoped_release release;
    parallel_chunks(result.size(), 256, jobs, control, [&](std::size_t first, std::size_t last) {
      std::uint32_t hint = 0;
      for (std::size_t i = first; i < last; ++i)
        result[i] = self.clearance(geometry::from_rows(points.data() + 3 * i), cap, hint);
    });
  }
  const std::size_t n = result.size();
  return to_numpy(std::move(result), {n});
}

std::tuple<Doubles, Doubles> grown(const EllipsoidIndex& self) {
  const std::size_t n = self.size();
  std::vector<double> centre(3 * n), a(9 * n);
  for (std::size_t i = 0; i < n; ++i) {
    const GrownEllipsoid& e = self.grown(static_cast<std::uint32_t>(i));
    for (int j = 0; j < 3; ++j) {
      centre[3 * i + static_cast<std::size_t>(j)] = e.centre[j];
      for (int k = 0; k < 3; ++k) a[9 * i + static_cast<std::size_t>(3 * j + k)] = e.a[j][k];
    }
  }
  return {to_numpy(std::move(centre), {n, 3}), to_numpy(std::move(a), {n, 3, 3})};
}

Record to_record(const FilterReport& report) {
  Record result;
  result["status"] = static_cast<int>(report.status);
  result["acceleration"] = array(report.acceleration);
  const geometry::Vec3 torque = report.wrench.torque;
  result["wrench"] = Array4{report.wrench.thrust, torque.x, torque.y, torque.z};
  result["thrust_rate"] = report.thrust_rate;
  result["margin"] = report.margin;
  result["active"] = report.active;
  result["gate_m"] = report.gate_m;
  result["candidates"] = report.candidates;
  result["rows"] = report.rows;
  result["iterations"] = report.iterations;
  result["capped"] = report.capped;
  result["infeasible"] = report.infeasible;
  result["certified"] = report.certified;
  return result;
}

Record filter(SplatFilter& self, const State12& state, const Array3& acceleration, const Array4& wrench,
              double thrust, double thrust_rate, double nominal_thrust_rate, double nominal_thrust_acceleration,
              const Array3& position_error, const Array3& velocity_error, const Array3& reference_acceleration,
              const std::optional<Array4>& rotors) {
  const FlightState now{{at(state, 0), at(state, 3), at(state, 6), at(state, 9)}, thrust, thrust_rate, rotors};
  const Nominal nominal{vec(acceleration),          {wrench[0], {wrench[1], wrench[2], wrench[3]}},
                        nominal_thrust_rate,        nominal_thrust_acceleration,
                        vec(position_error),        vec(velocity_error),
                        vec(reference_acceleration)};
  FilterReport report;
  {
    const nb::gil_scoped_release release;
    report = self.filter(now, nominal);
  }
  return to_record(report);
}

flight::SaferHessian hessian_of(const std::string& name) {
  if (name == "correct") return flight::SaferHessian::correct;
  if (name == "published") return flight::SaferHessian::published;
  throw std::invalid_argument("hessian must be 'correct' or 'published'");
}

flight::SaferRows rows_of(const std::string& name) {
  if (name == "all") return flight::SaferRows::all;
  if (name == "nearest") return flight::SaferRows::nearest;
  throw std::invalid_argument("rows must be 'all' or 'nearest'");
}

geometry::Mat3 matrix(const In<double, nb::shape<3, 3>>& a) {
  geometry::Mat3 result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result[i][j] = a.data()[3 * i + j];
  return result;
}

// What the cone of one ellipsoid is made of, for the tests.
Record cone(const Array3& centre, const In<double, nb::shape<3, 3>>& a, const Array3& p, const Array3& v,
            const Array3& acceleration, const Array3& jerk) {
  const GrownEllipsoid e{vec(centre), matrix(a)};
  const Cone c = flight::collision_cone(e, vec(p), vec(v));
  const flight::ConeRates d = flight::cone_rates(e, c, vec(acceleration), vec(jerk));
  Record result;
  result["beta"] = c.beta, result["gamma"] = c.gamma, result["delta"] = c.delta, result["h"] = c.h;
  result["w"] = array(c.w), result["grad_p"] = array(c.grad_p()), result["gamma_grad_p"] = array(c.gamma_grad_p());
  result["is_met"] = c.is_met(), result["contact_time"] = c.contact_time(), result["is_inside"] = c.is_inside();
  result["w1"] = array(d.w1), result["w2"] = array(d.w2);
  result["h1"] = d.h1, result["h2"] = d.h2, result["phi"] = d.phi;
  result["gamma1"] = d.gamma1, result["gamma2"] = d.gamma2, result["gamma3"] = d.gamma3;
  result["gamma_phi"] = d.gamma_phi;
  return result;
}

Record snap(const flight::Quadrotor& body, const State12& state, double thrust, double thrust_rate,
            const Array3& centre, const In<double, nb::shape<3, 3>>& a, double rate) {
  const FlightState now{{at(state, 0), at(state, 3), at(state, 6), at(state, 9)}, thrust, thrust_rate};
  const flight::SnapMap map = flight::snap_map(body, now);
  const GrownEllipsoid e{vec(centre), matrix(a)};
  const Cone c = flight::collision_cone(e, now.x.p, now.x.v);
  const flight::ConeRates d = flight::cone_rates(e, c, map.acceleration, map.jerk);
  const flight::SnapRow ecbf = flight::ecbf_row(c, d, map, rate), escape = flight::snap_escape_row(c, d, map, rate);
  Record result;
  result["acceleration"] = array(map.acceleration), result["jerk"] = array(map.jerk);
  result["drift"] = array(map.drift), result["per_thrust"] = array(map.per_thrust);
  result["per_torque"] =
      std::array{array(map.per_torque.row(0)), array(map.per_torque.row(1)), array(map.per_torque.row(2))};
  result["psi"] = flight::ecbf_psi(c, d, rate);
  result["ecbf_row"] = ecbf.row, result["ecbf_bound"] = ecbf.bound;
  result["escape_row"] = escape.row, result["escape_bound"] = escape.bound;
  return result;
}

Indices unsure(const SaferSplat& self, const Array3& p, const Array3& v, const Array3& acceleration) {
  const flight::DistanceRowBound bound(self.law(), self.index().radius(), vec(p), vec(v), vec(acceleration));
  std::vector<geometry::Bvh::Pending> heap;
  std::vector<std::int64_t> item;
  const double limit = 0;
  self.index().visit_least(heap, limit, bound, [&](std::uint32_t found) { item.push_back(found); });
  const std::size_t n = item.size();
  return to_numpy(std::move(item), {n});
}

}  // namespace
}  // namespace alula

void bind_splat_filters(nb::module_& m) {
  using namespace alula;
  nb::class_<EllipsoidIndex>(m, "EllipsoidIndex",
                             "Ellipsoids of Gaussians, found by distance, and each grown by a vehicle's sphere.")
      .def(
          "__init__",
          [](EllipsoidIndex* self, InRows3<float> mean, InRows3<float> scale, InRows4<float> quat_wxyz, double sigma,
             double radius, std::optional<InRows3<float>> loss) {
            const nb::gil_scoped_release release;
            new (self)
                EllipsoidIndex({as_span(mean), as_span(scale), as_span(quat_wxyz), as_span(loss)}, sigma, radius);
          },
          "mean"_a, "scale"_a, "quat_wxyz"_a, nb::kw_only(), "sigma"_a, "radius"_a, "loss"_a = nb::none(),
          "Copy the Gaussians; the ellipsoids are at level sigma, each grown by what `loss` (N, 3) says.")
      .def("__len__", &EllipsoidIndex::size)
      .def_prop_ro("radius", &EllipsoidIndex::radius)
      .def("nearest", &nearest, "a"_a, "b"_a, nb::kw_only(), "reach"_a, "count"_a,
           "Numbers and signed distances of the `count` ungrown ellipsoids nearest to the segment a..b, of those "
           "nearer than `reach`, nearest first.")
      .def("clearance", &clearance, "points"_a, nb::kw_only(), "cap"_a = kInfinity, "jobs"_a = 0,
           "progress"_a = nb::none(),
           "Signed distance of each point (N, 3) to the nearest ungrown ellipsoid, at most `cap`.")
      .def("grown", &grown,
           "Centres (N, 3) and matrices A (N, 3, 3) of the grown ellipsoids {y : (y - c)^T A (y - c) <= 1}.");

  nb::class_<Pruning>(m, "Pruning", "Which ellipsoids become rows of a tick.")
      .def(
          "__init__",
          [](Pruning* self, double reaction_time_s, double max_deceleration, double floor_m, std::uint32_t count,
             bool gate, bool approach, bool sweep) {
            new (self) Pruning{reaction_time_s, max_deceleration, floor_m, count, gate, approach, sweep};
          },
          nb::kw_only(), "reaction_time_s"_a = Pruning{}.reaction_time_s,
          "max_deceleration"_a = Pruning{}.max_deceleration, "floor_m"_a = Pruning{}.floor_m,
          "count"_a = Pruning{}.count, "gate"_a = Pruning{}.gate, "approach"_a = Pruning{}.approach,
          "sweep"_a = Pruning{}.sweep,
          "reaction_time_s and max_deceleration: of the distance gate v^2 / (2 a) + v t + radius, at least floor_m;\n"
          "count: nearest k, 0 for all within the gate; gate: False for every ellipsoid of the map;\n"
          "approach: only ellipsoids with r^T A v >= 0; sweep: nearest to the path of braking, not to the place.")
      .def_ro("reaction_time_s", &Pruning::reaction_time_s)
      .def_ro("max_deceleration", &Pruning::max_deceleration)
      .def_ro("floor_m", &Pruning::floor_m)
      .def_ro("count", &Pruning::count)
      .def_ro("gate", &Pruning::gate)
      .def_ro("approach", &Pruning::approach)
      .def_ro("sweep", &Pruning::sweep);

  const Array3 zero3{};
  nb::class_<SplatFilter>(m, "SplatFilter", "A filter that flies among ellipsoids; one per thread.")
      .def("filter", &filter, "state"_a, "acceleration"_a, nb::kw_only(), "wrench"_a = Array4{}, "thrust"_a = 0.0,
           "thrust_rate"_a = 0.0, "nominal_thrust_rate"_a = 0.0, "nominal_thrust_acceleration"_a = 0.0,
           "position_error"_a = zero3, "velocity_error"_a = zero3, "reference_acceleration"_a = zero3,
           "rotors"_a = nb::none(),
           "One tick: state (p, sigma, v, omega), the nominal acceleration [m/s^2] and wrench (T, tau), thrust and "
           "its "
           "rate as last applied [N, N/s]; rotors: what each gives now [N], hovering when not said. A dict of "
           "FilterReport.")
      .def("reset", &SplatFilter::reset, "Before another flight: forget warm starts and commitments.")
      .def("clone", &SplatFilter::clone)
      .def_prop_ro("gives_wrench", [](const SplatFilter& self) { return self.kind() == flight::InputKind::wrench; });

  const flight::ConeDiOptions cone_di;
  nb::class_<ConeDi, SplatFilter>(m, "ConeDi", "The collision cone filter of a double integrator.")
      .def(
          "__init__",
          [](ConeDi* self, std::shared_ptr<EllipsoidIndex> index, double alpha, double recovery, double swell,
             double escape_rate, double min_speed, double max_acceleration, double max_braking, double lateral_bias,
             double clf_weight, double clf_rate, double clf_kp, double clf_kv, const Pruning& pruning,
             nb::object qp_backend) {
            new (self) ConeDi(std::move(index),
                              {alpha, recovery, swell, escape_rate, min_speed, max_acceleration, max_braking,
                               lateral_bias, clf_weight, clf_rate, clf_kp, clf_kv, pruning},
                              qp_solver(std::move(qp_backend)));
          },
          "index"_a, nb::kw_only(), "alpha"_a = cone_di.alpha, "recovery"_a = cone_di.recovery,
          "swell"_a = cone_di.swell, "escape_rate"_a = cone_di.escape_rate, "min_speed"_a = cone_di.min_speed,
          "max_acceleration"_a = cone_di.max_acceleration, "max_braking"_a = cone_di.max_braking,
          "lateral_bias"_a = cone_di.lateral_bias, "clf_weight"_a = cone_di.clf_weight,
          "clf_rate"_a = cone_di.clf_rate, "clf_kp"_a = cone_di.clf_kp, "clf_kv"_a = cone_di.clf_kv,
          "pruning"_a = cone_di.pruning, "qp_backend"_a = nb::none(),
          "alpha: of h' >= -alpha h [1/s], and at least recovery over the time to contact;\n"
          "swell: rows are of ellipsoids longer by this part; escape_rate: double pole "
          "of the rows on gamma [1/s];\n"
          "min_speed: below it rows on gamma [m/s]; max_acceleration: of each axis, max_braking: of the fallback,\n"
          "lateral_bias: of a head-on nominal [m/s^2]; clf_weight: of the tracking row's slack, 0 for no row;\n"
          "clf_rate [1/s], clf_kp [1/s^2], clf_kv [1/s]: of that row; qp_backend: as of QpSolver.");

  const flight::SaferSplatOptions safer;
  nb::class_<SaferSplat, SplatFilter>(m, "SaferSplat", "The distance filter of SAFER-Splat for a double integrator.")
      .def(
          "__init__",
          [](SaferSplat* self, std::shared_ptr<EllipsoidIndex> index, double alpha, double beta,
             const std::string& hessian, const std::string& rows, bool brute, double max_braking,
             double max_acceleration, const Pruning& pruning) {
            new (self) SaferSplat(std::move(index), {alpha, beta, hessian_of(hessian), rows_of(rows), brute,
                                                     max_braking, max_acceleration, pruning});
          },
          "index"_a, nb::kw_only(), "alpha"_a = safer.alpha, "beta"_a = safer.beta, "hessian"_a = "correct",
          "rows"_a = "all", "brute"_a = safer.brute, "max_braking"_a = safer.max_braking,
          "max_acceleration"_a = safer.max_acceleration, "pruning"_a = Pruning{},
          "alpha, beta: poles of the barrier phi d^2 - r^2 [1/s]; hessian: 'correct' or 'published';\n"
          "rows: 'all', of every ellipsoid of the map, or 'nearest', of the candidates of `pruning`, whose gates of\n"
          "approach and sweep are ignored; brute: measure every ellipsoid instead of asking the index;\n"
          "max_braking: of the fallback, max_acceleration: of each axis [m/s^2].")
      .def(
          "barrier",
          [](const SaferSplat& self, std::uint32_t item, const Array3& p, const Array3& v) {
            if (item >= self.index().size()) throw nb::index_error("no such ellipsoid");
            const flight::DistanceBarrier barrier =
                flight::distance_barrier(self.index(), self.law(), item, vec(p), vec(v));
            return std::tuple(barrier.h, array(barrier.row.row), barrier.row.bound);
          },
          "item"_a, "p"_a, "v"_a, "h, row and bound of one ellipsoid: row . a >= bound.")
      .def("unsure", &unsure, "p"_a, "v"_a, "acceleration"_a,
           "Numbers of the ellipsoids that the index says may have a row that `acceleration` violates.");

  m.def("collision_cone", &cone, "centre"_a, "a"_a, "p"_a, "v"_a, nb::kw_only(), "acceleration"_a, "jerk"_a,
        "The collision cone of {y : (y - centre)^T a (y - centre) <= 1} and its derivatives along a flight.");
  m.def("snap_rows", &snap, "body"_a, "state"_a, nb::kw_only(), "thrust"_a, "thrust_rate"_a, "centre"_a, "a"_a,
        "rate"_a,
        "How (T'' / m, tau) reach the snap, and the rows of third and fourth order of one ellipsoid over it.");
}
