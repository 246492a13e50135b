// Bindings of alula/geometry/ellipsoid_index.hpp, alula/filters/safety_filter.hpp and the acceleration filters.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>

#include "alula/base/constants.hpp"
#include "alula/base/parallel.hpp"
#include "alula/filters/cone_di.hpp"
#include "alula/filters/option_fields.hpp"
#include "alula/filters/safer_splat.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"
#include "python_control.hpp"
#include "python_qp.hpp"
#include "track_rows.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using flight::CommandKind;
using flight::Cone;
using flight::ConeDi;
using flight::FilterReport;
using flight::FlightState;
using flight::Nominal;
using flight::Pruning;
using flight::SaferSplat;
using flight::SafetyFilter;

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

// Velocity and sticks only of a filter that gives them, as each entry takes time in Python.
Record to_record(const FilterReport& report, CommandKind kind) {
  Record result;
  result["status"] = static_cast<int>(report.status);
  if (kind == CommandKind::velocity) result["velocity"] = array(report.velocity);
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
  result["certified_moving"] = report.certified_moving;
  if (kind == CommandKind::sticks) {
    const geometry::Vec3 rates = report.sticks.rates;
    result["sticks"] = Array4{report.sticks.throttle, rates.x, rates.y, rates.z};
  }
  return result;
}

// Arguments of `filter` other than the state and the nominal acceleration.
struct Tick {
  FlightState state;
  Nominal nominal;
  std::optional<TrackRows> tracks;
};

}  // namespace

template <>
struct fields::Python<flight::Wrench> {
  static std::string type() { return Python<Array4>::type(); }
  static flight::Wrench from(nb::handle value) { return flight::wrench_at(nb::cast<Array4>(value).data()); }
  static Array4 out(const flight::Wrench& u) { return {u.thrust, u.torque.x, u.torque.y, u.torque.z}; }
};

template <>
struct fields::Python<flight::RacerCommand> {
  static std::string type() { return Python<Array4>::type(); }
  static flight::RacerCommand from(nb::handle value) {
    const auto u = nb::cast<Array4>(value);
    return {u[0], {u[1], u[2], u[3]}};
  }
  static Array4 out(const flight::RacerCommand& u) { return {u.throttle, u.rates.x, u.rates.y, u.rates.z}; }
};

template <>
struct Choices<flight::CommandKind> {
  static constexpr std::array names{"velocity", "acceleration", "wrench", "sticks"};
};

template <>
struct Fields<Nominal> {
  static constexpr std::tuple all{
      Field{"velocity", &Nominal::velocity, "nominal velocity [m/s]"},
      Field{"wrench", &Nominal::wrench, "nominal thrust and torque [N, N m]"},
      Field{"nominal_thrust_rate", &Nominal::thrust_rate, "rate of the nominal thrust [N/s]"},
      Field{"nominal_thrust_acceleration", &Nominal::thrust_acceleration, "its second derivative [N/s^2]"},
      Field{"position_error", &Nominal::position_error, "position minus that of the reference [m]"},
      Field{"velocity_error", &Nominal::velocity_error, "velocity minus that of the reference [m/s]"},
      Field{"reference_acceleration", &Nominal::reference_acceleration, "acceleration of the reference [m/s^2]"},
      Field{"sticks", &Nominal::sticks, "throttle and body rates [rad/s]; None: the pilot is silent"}};
};

template <>
struct Fields<FlightState> {
  static constexpr std::tuple all{
      Field{"thrust", &FlightState::thrust, "last applied thrust [N]"},
      Field{"thrust_rate", &FlightState::thrust_rate, "its rate [N/s]"},
      Field{"rotors", &FlightState::rotors, "thrust of each rotor now [N]; None: the rotors hover"},
      Field{"position_variance", &FlightState::position_variance, "of the state's position, per axis [m^2]"},
      Field{"is_known", &FlightState::is_known, "false: there is no navigation, and the state means nothing"}};
};

template <>
struct Fields<Tick> {
  static constexpr std::tuple all{
      Nested{&Tick::state}, Nested{&Tick::nominal},
      Field{"tracks", &Tick::tracks,
            "what moves, predicted to now, (N, 29): id, position, velocity, the lower "
            "triangle of their covariance row by row, radius; (N, 32): acceleration too"}};
};

namespace {

Record filter_command(SafetyFilter& self, const State12& state, const Array3& acceleration,
                      const nb::kwargs& others) {
  Tick tick;
  tick.state.x = {at(state, 0), at(state, 3), at(state, 6), at(state, 9)};
  tick.nominal.acceleration = vec(acceleration);
  fields::assign(tick, others, "filter");
  if (tick.tracks) tick.state.tracks = tick.tracks->all;
  FilterReport report;
  {
    const nb::gil_scoped_release release;
    report = self.filter(tick.state, tick.nominal);
  }
  return to_record(report, self.kind());
}

geometry::Mat3 matrix(const In<double, nb::shape<3, 3>>& a) {
  geometry::Mat3 result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result[i][j] = a.data()[3 * i + j];
  return result;
}

// Terms of the cone of one ellipsoid, for the tests.
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
  const FlightState now{
      .x = {at(state, 0), at(state, 3), at(state, 6), at(state, 9)}, .thrust = thrust, .thrust_rate = thrust_rate};
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
  nb::class_<EllipsoidIndex>(
      m, "EllipsoidIndex",
      "Index of the Gaussians' ellipsoids for distance queries; each is also grown by the vehicle's sphere.")
      .def(
          "__init__",
          [](EllipsoidIndex* self, InRows3<float> mean, InRows3<float> scale, InRows4<float> quat_wxyz, double sigma,
             double radius, std::optional<InRows3<float>> loss) {
            const nb::gil_scoped_release release;
            new (self)
                EllipsoidIndex({as_span(mean), as_span(scale), as_span(quat_wxyz), as_span(loss)}, sigma, radius);
          },
          "mean"_a, "scale"_a, "quat_wxyz"_a, nb::kw_only(), "sigma"_a, "radius"_a, "loss"_a = nb::none(),
          "Copy the Gaussians; the ellipsoids are at level sigma, each grown by `loss` (N, 3).")
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

  m.def(
      "least_gamma",
      [](const EllipsoidIndex& index, const InRows3<double>& points) {
        const nb::gil_scoped_release release;
        return least_gamma(index, as_span(points));
      },
      "index"_a, "points"_a,
      "Minimum r' A r - 1 over the grown ellipsoids and the points (T, 3); below 0 inside one.");

  fields::bind<Pruning>(m, "Pruning", "Selection of the ellipsoids that become rows of a tick.");

  nb::class_<SafetyFilter>(m, "SafetyFilter", "Safety filter of one kind of command; one per thread.")
      .def("filter", &filter_command, "state"_a, "acceleration"_a, "others"_a,
           nb::sig(fields::signature(Tick{},
                                     "self, state: collections.abc.Sequence[float], "
                                     "acceleration: collections.abc.Sequence[float]",
                                     "filter", "dict[str, typing.Any]")
                       .c_str()),
           fields::documentation(
               Tick{},
               "Filter one tick at a state (p, sigma, v, omega) with the nominal acceleration [m/s^2]; "
               "returns a dict of FilterReport.")
               .c_str())
      .def("reset", &SafetyFilter::reset, "Clear warm starts and commitments before another flight.")
      .def("clone", &SafetyFilter::clone)
      .def_prop_ro(
          "kind", [](const SafetyFilter& self) { return fields::Python<flight::CommandKind>::out(self.kind()); },
          "Command that it changes and returns: velocity, acceleration, wrench or sticks.")
      .def_prop_ro("shares_state", &SafetyFilter::shares_state,
                   "Whether its clones share its state, as those of a filter in Python: flights run in one thread.");

  fields::bind<flight::ConeDiOptions>(m, "ConeDiOptions", "Options of the filter cone-di.");
  nb::class_<ConeDi, SafetyFilter>(m, "ConeDi", "The collision cone filter of a double integrator.")
      .def(
          "__init__",
          [](ConeDi* self, std::shared_ptr<EllipsoidIndex> index, const flight::ConeDiOptions& options,
             nb::object qp_backend) {
            new (self) ConeDi(std::move(index), options, qp_solver(std::move(qp_backend)));
          },
          "index"_a, "options"_a = flight::ConeDiOptions{}, nb::kw_only(), "qp_backend"_a = nb::none(),
          "qp_backend: as of QpSolver.")
      .def_prop_ro("options", &ConeDi::options);

  fields::bind<flight::SaferSplatOptions>(m, "SaferSplatOptions", "Options of the filter safer-splat.");
  nb::class_<SaferSplat, SafetyFilter>(m, "SaferSplat", "The distance filter of SAFER-Splat for a double integrator.")
      .def(
          "__init__",
          [](SaferSplat* self, std::shared_ptr<EllipsoidIndex> index, const flight::SaferSplatOptions& options,
             std::shared_ptr<ObstacleMap> near_map, std::optional<double> near_radius_m) {
            flight::Surroundings others;
            if (near_map) others = {std::move(near_map), near_radius_m.value_or(index ? index->radius() : 0)};
            new (self) SaferSplat(std::move(index), options, std::move(others));
          },
          "index"_a, "options"_a = flight::SaferSplatOptions{}, nb::kw_only(), "near_map"_a = nb::none(),
          "near_radius_m"_a = nb::none(),
          "near_map: obstacles that have rows besides those of the index; near_radius_m: the distance from them, "
          "default the radius of the index.")
      .def_prop_ro("options", &SaferSplat::options)
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
           "Numbers of the ellipsoids that may have a row that `acceleration` violates, according to the index.");

  m.def("collision_cone", &cone, "centre"_a, "a"_a, "p"_a, "v"_a, nb::kw_only(), "acceleration"_a, "jerk"_a,
        "The collision cone of {y : (y - centre)^T a (y - centre) <= 1} and its derivatives along a flight.");
  m.def("snap_rows", &snap, "body"_a, "state"_a, nb::kw_only(), "thrust"_a, "thrust_rate"_a, "centre"_a, "a"_a,
        "rate"_a,
        "Map from (T'' / m, tau) to the snap, and the rows of third and fourth order of one ellipsoid over it.");
}
