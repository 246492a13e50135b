// Bindings of alula/filters/backup_policy.hpp and alula/filters/backup_flow.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <array>
#include <stdexcept>
#include <string>
#include <tuple>

#include "alula/filters/backup_flow.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

BackupKind kind_of(const std::string& name) {
  if (name == "hover") return BackupKind::hover;
  if (name == "heading-invariant") return BackupKind::heading_invariant;
  if (name == "brake") return BackupKind::brake;
  if (name == "cone-escape") return BackupKind::cone_escape;
  throw std::invalid_argument("a backup policy is hover, heading-invariant, brake or cone-escape");
}

const char* name_of(BackupKind kind) {
  constexpr std::array names{"hover", "heading-invariant", "brake", "cone-escape"};
  return names[static_cast<std::size_t>(kind)];
}

GrownEllipsoid ellipsoid_of(const Triple& centre, const In<double, nb::shape<3, 3>>& a) {
  GrownEllipsoid e{vector_of(centre), {}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) e.a[i][j] = a.data()[3 * i + j];
  return e;
}

void put(std::vector<double>& matrix, std::size_t row, std::size_t column, const Mat3& block) {
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      matrix[12 * (row + i) + column + j] = block[static_cast<int>(i)][static_cast<int>(j)];
}

Doubles jacobian_of(const BackupPolicy& policy, const State& x, Vec3 hold) {
  ClosedLoopJacobian d;
  closed_loop(policy, x, hold, d);
  std::vector<double> rows(144);
  put(rows, 0, 6, geometry::identity());
  put(rows, 3, 3, d.sigma_sigma), put(rows, 3, 9, d.sigma_omega);
  put(rows, 6, 3, d.v_sigma), put(rows, 6, 6, d.v_v);
  put(rows, 9, 3, d.omega_sigma), put(rows, 9, 6, d.omega_v), put(rows, 9, 9, d.omega_omega);
  return to_numpy(std::move(rows), {12, 12});
}

Doubles vector_array(Vec3 v) { return Rows(1).add(v).array({3}); }

std::size_t nodes_of(const BackupFlow& flow) { return static_cast<std::size_t>(flow.nodes()) + 1; }

void check_node(const BackupFlow& flow, int k) {
  if (k < 0 || k > flow.nodes()) throw std::out_of_range("no such node of the flow");
}

void bind_policy(nb::module_& m) {
  const BackupGains defaults;
  nb::class_<BackupPolicy>(m, "BackupPolicy", "Feedback that brings a quadrotor to rest within its rotors' limits.")
      .def(
          "__init__",
          [](BackupPolicy* self, const Quadrotor& vehicle, const std::string& kind, double k_vz, double k_sigma,
             double k_omega, double k_vh, double kappa, Vec4 weight, double eta_frac, double tilt_rad,
             double full_tilt_speed_m_s, double climb_rate_1_s, double attitude_rad_s, double attitude_damping,
             double yaw_damping_1_s, double torque_share, std::array<double, 3> torque_weight) {
            const BackupGains gains{.k_vz = k_vz,
                                    .k_sigma = k_sigma,
                                    .k_omega = k_omega,
                                    .k_vh = k_vh,
                                    .kappa = kappa,
                                    .weight = weight,
                                    .eta_frac = eta_frac,
                                    .tilt_rad = tilt_rad,
                                    .full_tilt_speed_m_s = full_tilt_speed_m_s,
                                    .climb_rate_1_s = climb_rate_1_s,
                                    .attitude_rad_s = attitude_rad_s,
                                    .attitude_damping = attitude_damping,
                                    .yaw_damping_1_s = yaw_damping_1_s,
                                    .torque_share = torque_share,
                                    .torque_weight = geometry::from_rows(torque_weight.data())};
            new (self) BackupPolicy(vehicle, kind_of(kind), gains);
          },
          "vehicle"_a, "kind"_a = "brake", nb::kw_only(), "k_vz"_a = defaults.k_vz, "k_sigma"_a = defaults.k_sigma,
          "k_omega"_a = defaults.k_omega, "k_vh"_a = defaults.k_vh, "kappa"_a = defaults.kappa,
          "weight"_a = defaults.weight, "eta_frac"_a = defaults.eta_frac, "tilt_rad"_a = defaults.tilt_rad,
          "full_tilt_speed_m_s"_a = defaults.full_tilt_speed_m_s, "climb_rate_1_s"_a = defaults.climb_rate_1_s,
          "attitude_rad_s"_a = defaults.attitude_rad_s, "attitude_damping"_a = defaults.attitude_damping,
          "yaw_damping_1_s"_a = defaults.yaw_damping_1_s, "torque_share"_a = defaults.torque_share,
          "torque_weight"_a =
              std::array{defaults.torque_weight.x, defaults.torque_weight.y, defaults.torque_weight.z},
          "A policy of the kind hover, heading-invariant, brake or cone-escape (which is brake as a policy). The "
          "gains "
          "k_*, kappa [N, m, s] and weight (caps of T, tau relative to each other) are those of FastBridge eq. 17-19 "
          "and shape the first two; the others shape the last two. ValueError unless braking is stable.")
      .def_prop_ro("kind", [](const BackupPolicy& self) { return name_of(self.kind()); })
      .def_prop_ro("cap_up", &BackupPolicy::cap_up, "Thrust above hover that it never exceeds [N].")
      .def_prop_ro("cap_down", &BackupPolicy::cap_down, "Thrust below hover that it never exceeds [N].")
      .def_prop_ro(
          "torque_cap",
          [](const BackupPolicy& self) {
            const Vec3 cap = self.torque_cap();
            return std::array{cap.x, cap.y, cap.z};
          },
          "Torques that it never exceeds [N m].")
      .def(
          "raw",
          [](const BackupPolicy& self, const InState& x, const Triple& hold) {
            return to_array(self.raw(state_at(x.data()), vector_of(hold)));
          },
          "state"_a, "hold"_a = Triple{}, "(T, tau) before saturation [N, N m].")
      .def(
          "__call__",
          [](const BackupPolicy& self, const InState& x, const Triple& hold) {
            return to_array(self(state_at(x.data()), vector_of(hold)));
          },
          "state"_a, "hold"_a = Triple{},
          "(T, tau) at a state (12,) = (p, sigma, v, omega), regulating about `hold` [m/s].")
      .def(
          "urgent",
          [](const BackupPolicy& self, const InState& x, const Triple& hold) {
            return to_array(self.urgent(state_at(x.data()), vector_of(hold)));
          },
          "state"_a, "hold"_a = Triple{}, "The same with all that the rotors have, for where nothing gentle is safe.")
      .def(
          "closed_loop",
          [](const BackupPolicy& self, const InState& x, const Triple& hold) {
            return to_array(closed_loop(self, state_at(x.data()), vector_of(hold)));
          },
          "state"_a, "hold"_a = Triple{}, "f + g pi_b, shape (12,).")
      .def(
          "jacobian",
          [](const BackupPolicy& self, const InState& x, const Triple& hold) {
            return jacobian_of(self, state_at(x.data()), vector_of(hold));
          },
          "state"_a, "hold"_a = Triple{}, "Derivative of `closed_loop` by the state, shape (12, 12).")
      .def(
          "drift",
          [](const BackupPolicy& self, const InState& x) { return vector_array(self.drift(state_at(x.data()))); },
          "state"_a, "How far the linear loop about hover would still move before it rests [m].")
      .def(
          "excursion", [](const BackupPolicy& self, const InState& x) { return self.excursion(state_at(x.data())); },
          "state"_a, "About how far it moves at most before it rests, whatever cancels in `drift` [m].");
}

void bind_flow(nb::module_& m) {
  nb::class_<BackupFlow>(m, "BackupFlow", "The flow of a backup policy and how the input now moves it.")
      .def(nb::init<const BackupPolicy&, double, int, int, bool>(), "policy"_a, nb::kw_only(), "horizon_s"_a = 1.5,
           "nodes"_a = 20, "steps"_a = 1, "drift"_a = false,
           "`steps` RK4 steps between nodes; with `drift` the column Q f is integrated, else it is f_cl - W pi_b.")
      .def(
          "run",
          [](BackupFlow& self, const InState& x, const Triple& hold, int hold_steps) {
            self.run(state_at(x.data()), {vector_of(hold), hold_steps});
          },
          "state"_a, "hold"_a = Triple{}, "hold_steps"_a = 0,
          "Fly about `hold` [m/s] for that many RK4 steps, then to rest.")
      .def(
          "states",
          [](const BackupFlow& self) {
            Rows rows(nodes_of(self));
            for (int k = 0; k <= self.nodes(); ++k) rows.add(self.state(k));
            return rows.array({nodes_of(self), 12});
          },
          "Phi_k, shape (nodes + 1, 12).")
      .def(
          "sensitivities",
          [](const BackupFlow& self) {
            Rows rows(4 * nodes_of(self));
            for (int k = 0; k <= self.nodes(); ++k)
              for (const Vec4& row : self.sensitivity(k))
                for (const double value : row) rows.add(value);
            return rows.array({nodes_of(self), 12, 4});
          },
          "W_k = Q_k g(x), shape (nodes + 1, 12, 4).")
      .def(
          "drifts",
          [](const BackupFlow& self) {
            Rows rows(nodes_of(self));
            for (int k = 0; k <= self.nodes(); ++k)
              for (const double value : self.drift(k)) rows.add(value);
            return rows.array({nodes_of(self), 12});
          },
          "Q_k f(x), shape (nodes + 1, 12).")
      .def(
          "running_row",
          [](const BackupFlow& self, const Triple& centre, In<double, nb::shape<3, 3>> a, int k, double alpha) {
            check_node(self, k);
            const WrenchRow row = self.running_row(self.cone(ellipsoid_of(centre, a), k), k, alpha);
            return std::tuple(row.row, row.bound);
          },
          "centre"_a, "a"_a, "k"_a, "alpha"_a,
          "(a, b) of a . u >= b: h' + alpha h >= 0 of the cone of {y : (y - centre)' a (y - centre) <= 1} at node k.")
      .def(
          "clear_row",
          [](const BackupFlow& self, const Triple& centre, In<double, nb::shape<3, 3>> a, int k, double alpha) {
            check_node(self, k);
            const WrenchRow row = self.clear_row(self.cone(ellipsoid_of(centre, a), k), k, alpha);
            return std::tuple(row.row, row.bound);
          },
          "centre"_a, "a"_a, "k"_a, "alpha"_a, "The same for gamma' + alpha gamma >= 0.");
}

}  // namespace
}  // namespace alula::flight

void bind_backup(nb::module_& m) {
  alula::flight::bind_policy(m);
  alula::flight::bind_flow(m);
}
