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
#include "alula/filters/option_fields.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

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
  fields::bind<BackupGains>(m, "BackupGains", "Gains of a backup policy.");
  nb::class_<BackupPolicy>(m, "BackupPolicy", "Feedback that brings a quadrotor to rest within its rotors' limits.")
      .def(
          "__init__",
          [](BackupPolicy* self, const Quadrotor& vehicle, const nb::object& kind, const BackupGains& gains) {
            new (self) BackupPolicy(vehicle, fields::choice<BackupKind>(kind, "a backup policy"), gains);
          },
          "vehicle"_a, "kind"_a = "brake", "gains"_a = BackupGains{},
          nb::sig("def __init__(self, vehicle: Quadrotor, kind: str = 'brake', gains: BackupGains = ...) -> None"),
          "A policy of the kind hover, heading-invariant, brake or cone-escape (which is brake as a policy). "
          "ValueError unless braking is stable.")
      .def_prop_ro("kind", [](const BackupPolicy& self) { return fields::Python<BackupKind>::out(self.kind()); })
      .def_prop_ro("cap_up", &BackupPolicy::cap_up, "Maximum thrust above hover [N].")
      .def_prop_ro("cap_down", &BackupPolicy::cap_down, "Maximum reduction of the thrust below hover [N].")
      .def_prop_ro(
          "torque_cap",
          [](const BackupPolicy& self) {
            const Vec3 cap = self.torque_cap();
            return std::array{cap.x, cap.y, cap.z};
          },
          "Maximum torques [N m].")
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
          "state"_a, "hold"_a = Triple{},
          "The same with the rotors' full range, for states where no gentle manoeuvre is safe.")
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
          "state"_a, "Distance that the linear loop about hover would still move before it rests [m].")
      .def(
          "excursion", [](const BackupPolicy& self, const InState& x) { return self.excursion(state_at(x.data())); },
          "state"_a, "Approximate maximum distance before it rests, without the cancellation in `drift` [m].");
}

void bind_flow(nb::module_& m) {
  nb::class_<BackupFlow>(m, "BackupFlow", "Flow of a backup policy and its sensitivity to the present input.")
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
          "centre"_a, "a"_a, "k"_a, "alpha"_a, "The same row for gamma' + alpha gamma >= 0.");
}

}  // namespace
}  // namespace alula::flight

void bind_backup(nb::module_& m) {
  alula::flight::bind_policy(m);
  alula::flight::bind_flow(m);
}
