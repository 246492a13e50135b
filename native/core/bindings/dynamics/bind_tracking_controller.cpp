// Bindings of alula/planning/reference_curve.hpp and alula/dynamics/tracking_controller.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <optional>

#include "alula/dynamics/tracking_controller.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Fields<flight::TrackingGains> {
  using Gains = flight::TrackingGains;
  static constexpr std::tuple all{
      Field{"kp", &Gains::kp, "gain of the position error [1/s^2]"},
      Field{"kv", &Gains::kv, "gain of the velocity error [1/s]"},
      Field{"k_r", &Gains::k_r, "gains of the attitude error [N m]"},
      Field{"k_omega", &Gains::k_omega, "gains of the rate error [N m s]"},
      Field{"catch_up_m_s", &Gains::catch_up_m_s, "limit of kp |e_p| / kv [m/s]"},
      Field{"max_tilt_rad", &Gains::max_tilt_rad, "maximum tilt of the commanded force [rad]"},
      Field{"max_thrust_share", &Gains::max_thrust_share,
            "maximum commanded force, as a fraction of the rotors' thrust"},
      Field{"uses_acceleration", &Gains::uses_acceleration,
            "errors of acceleration and jerk enter the derivatives of the force"}};
};

namespace flight {
namespace {

using Thrusts = std::optional<InVector<double>>;
using Terms = nb::typed<nb::dict, nb::str, nb::ndarray<nb::numpy, double>>;

double thrust_at(const Thrusts& thrust, std::size_t i) { return thrust ? thrust->data()[i] : own_thrust; }

std::vector<Tracking> track_rows(const Quadrotor& quadrotor, const TrackingGains& gains, const InStates& x,
                                 const InReferences& reference, const Thrusts& thrust) {
  require_rows(reference.shape(0), x.shape(0));
  if (thrust) require_rows(thrust->shape(0), x.shape(0));
  std::vector<Tracking> all(x.shape(0));
  for (std::size_t i = 0; i < all.size(); ++i)
    all[i] = track_in_detail(quadrotor, gains, state_at(x.data() + 12 * i), reference_at(reference.data() + 18 * i),
                             thrust_at(thrust, i));
  return all;
}

Terms track_terms(const Quadrotor& quadrotor, const TrackingGains& gains, const InStates& x,
                  const InReferences& reference, const Thrusts& thrust) {
  std::vector<Tracking> all;
  {
    const nb::gil_scoped_release release;
    all = track_rows(quadrotor, gains, x, reference, thrust);
  }
  Terms result;
  const auto put = [&](const char* name, std::size_t width, auto&& of) {
    Rows rows(all.size());
    for (const Tracking& one : all) rows.add(of(one));
    result[name] = width == 0 ? rows.array({all.size()}) : rows.array({all.size(), width});
  };
  put("wrench", 4, [](const Tracking& t) { return t.nominal.wrench; });
  put("acceleration", 3, [](const Tracking& t) { return t.nominal.acceleration; });
  put("thrust_rate", 0, [](const Tracking& t) { return t.nominal.thrust_rate; });
  put("thrust_acceleration", 0, [](const Tracking& t) { return t.nominal.thrust_acceleration; });
  put("position_error", 3, [](const Tracking& t) { return t.nominal.position_error; });
  put("velocity_error", 3, [](const Tracking& t) { return t.nominal.velocity_error; });
  put("force", 3, [](const Tracking& t) { return t.force.value; });
  put("force_rate", 3, [](const Tracking& t) { return t.force.rate; });
  put("force_acceleration", 3, [](const Tracking& t) { return t.force.acceleration; });
  put("omega_d", 3, [](const Tracking& t) { return t.omega_d; });
  put("omega_d_rate", 3, [](const Tracking& t) { return t.omega_d_rate; });
  put("e_r", 3, [](const Tracking& t) { return t.e_r; });
  put("e_omega", 3, [](const Tracking& t) { return t.e_omega; });
  return result;
}

Doubles realise_rows(const Quadrotor& quadrotor, const TrackingGains& gains, const InStates& x,
                     const InReferences& reference, const InRows3<double>& acceleration, const Thrusts& thrust) {
  require_rows(acceleration.shape(0), x.shape(0));
  Rows rows(x.shape(0));
  {
    const nb::gil_scoped_release release;
    const std::vector<Tracking> all = track_rows(quadrotor, gains, x, reference, thrust);
    for (std::size_t i = 0; i < all.size(); ++i)
      rows.add(realise(quadrotor, gains, state_at(x.data() + 12 * i), reference_at(reference.data() + 18 * i),
                       all[i].nominal, geometry::from_rows(acceleration.data() + 3 * i), thrust_at(thrust, i)));
  }
  return rows.array({x.shape(0), 4});
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_tracking(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  nb::class_<ReferenceCurve>(m, "ReferenceCurve",
                             "Pieces of degree 7 of (x, y, z, yaw), as in `alula/plan`; at rest beyond its ends.")
      .def(
          "__init__",
          [](ReferenceCurve* self, const InVector<double>& time, const In<double, nb::shape<-1, 4, 8>>& coefficient) {
            new (self) ReferenceCurve(as_span(time), as_span(coefficient));
          },
          "time"_a, "coefficient"_a)
      .def(
          "at",
          [](const ReferenceCurve& self, const InVector<double>& t) {
            Rows rows(t.size());
            for (std::size_t i = 0; i < t.size(); ++i) rows.add(self.at(t.data()[i]));
            return rows.array({t.size(), 18});
          },
          "t"_a, "Rows (p, v, a, j, s, yaw, yaw', yaw'') at times (N,), shape (N, 18).")
      .def_prop_ro("duration_s", &ReferenceCurve::duration);

  fields::bind<TrackingGains>(
      m, "TrackingGains", "Gains and limits of the geometric controller: alula/dynamics/tracking_controller.hpp.");

  m.def("track", &track_terms, "quadrotor"_a, "gains"_a, "x"_a, "reference"_a, nb::kw_only(),
        "applied_thrust"_a = nb::none(),
        "The geometric controller at states (N, 12) and references (N, 18): per row its wrench, acceleration, "
        "derivatives of the thrust and all intermediate terms.");
  m.def(
      "track_point",
      [](const TrackingGains& gains, const InStates& x, const InReferences& reference) {
        require_rows(reference.shape(0), x.shape(0));
        Rows rows(x.shape(0));
        for (std::size_t i = 0; i < x.shape(0); ++i)
          rows.add(
              track_point(gains, state_at(x.data() + 12 * i), reference_at(reference.data() + 18 * i)).acceleration);
        return rows.array({x.shape(0), 3});
      },
      "gains"_a, "x"_a, "reference"_a, "Accelerations (N, 3) of the controller of a point [m/s^2].");
  m.def("realise", &realise_rows, "quadrotor"_a, "gains"_a, "x"_a, "reference"_a, "acceleration"_a, nb::kw_only(),
        "applied_thrust"_a = nb::none(), "Wrenches (N, 4) that make accelerations (N, 3) through the attitude loop.");
  m.def(
      "body_rates",
      [](const Quadrotor& quadrotor, const InStates& x, const InWrenches& u, double dt_s, const Triple& max_rate) {
        require_rows(u.shape(0), x.shape(0));
        Rows rows(x.shape(0));
        for (std::size_t i = 0; i < x.shape(0); ++i)
          rows.add(body_rates(quadrotor, state_at(x.data() + 12 * i), wrench_at(u.data() + 4 * i), {dt_s, dt_s, dt_s},
                              vector_of(max_rate)));
        return rows.array({x.shape(0), 3});
      },
      "quadrotor"_a, "x"_a, "u"_a, nb::kw_only(), "dt_s"_a, "max_rate_rad_s"_a,
      "Commanded rates (N, 3) for a rate loop [rad/s].");
}
