// Bindings of alula/filters/shield.hpp, alula/filters/cone_escape.hpp, alula/filters/cone_ecbf.hpp and
// alula/filters/cone_backup.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>

#include "alula/filters/cone_backup.hpp"
#include "alula/filters/cone_ecbf.hpp"
#include "flight_arrays.hpp"
#include "python_qp.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

using Record = nb::typed<nb::dict, nb::str, nb::any>;
using Index = std::shared_ptr<EllipsoidIndex>;

Record certify(Shield& self, const InState& x, const std::optional<Vec4>& first, const Triple& hold, int hold_ticks,
               std::optional<double> margin_m, bool thorough) {
  const State state = state_at(x.data());
  const Wrench u = first ? wrench_at(first->data()) : Wrench{};
  Certificate result;
  {
    const nb::gil_scoped_release release;
    result = self.certify(state, {vector_of(hold), hold_ticks}, margin_m.value_or(self.options().margin_m),
                          first ? &u : nullptr, thorough);
  }
  Record record;
  record["safe"] = result.safe, record["rests"] = result.rests;
  record["clearance_m"] = result.clearance, record["time_s"] = result.time_s;
  return record;
}

std::tuple<Doubles, Doubles> escapes(const EllipsoidIndex& index, const Triple& p, const Triple& v, double reach,
                                     std::size_t count, double slack_rad) {
  std::vector<Found> found;
  index.nearest(vector_of(p), vector_of(p), reach, count, found);
  const Escapes result = escape_velocities(index, found, vector_of(p), vector_of(v), {.slack_rad = slack_rad});
  Rows velocity(result.count), turn(result.count);
  for (std::size_t i = 0; i < result.count; ++i) velocity.add(result.velocity[i]), turn.add(result.turn[i]);
  return {velocity.array({result.count, 3}), turn.array({result.count})};
}

void bind_shield(nb::module_& m) {
  const ShieldOptions o;
  nb::class_<ShieldOptions>(m, "ShieldOptions", "How a manoeuvre to rest is checked.")
      .def(
          "__init__",
          [](ShieldOptions* self, double tick_s, int substeps, double margin_m, double max_time_s,
             double escape_time_s, int escape_tries, int line_search, double rest_speed_m_s, double rest_rate_rad_s,
             double rest_tilt_rad, double rest_drift_m, double motor_time_constant_s) {
            new (self) ShieldOptions{tick_s,          substeps,      margin_m,     max_time_s,
                                     escape_time_s,   escape_tries,  line_search,  rest_speed_m_s,
                                     rest_rate_rad_s, rest_tilt_rad, rest_drift_m, motor_time_constant_s};
          },
          nb::kw_only(), "tick_s"_a = o.tick_s, "substeps"_a = o.substeps, "margin_m"_a = o.margin_m,
          "max_time_s"_a = o.max_time_s, "escape_time_s"_a = o.escape_time_s, "escape_tries"_a = o.escape_tries,
          "line_search"_a = o.line_search, "rest_speed_m_s"_a = o.rest_speed_m_s,
          "rest_rate_rad_s"_a = o.rest_rate_rad_s, "rest_tilt_rad"_a = o.rest_tilt_rad,
          "rest_drift_m"_a = o.rest_drift_m, "motor_time_constant_s"_a = o.motor_time_constant_s,
          "tick_s: for which an input is held, of substeps RK4 "
          "steps; margin_m: kept beyond the radius;\n"
          "max_time_s: not at rest by then is not safe; escape_time_s: for which cone-escape holds a velocity,\n"
          "escape_tries: how many of them; line_search: bisections between backup and a refused input;\n"
          "rest_*: at rest is below all of these, with rest_drift_m left to drift;\n"
          "motor_time_constant_s: of rotors that follow a command, 0 for at once.")
      .def_ro("tick_s", &ShieldOptions::tick_s)
      .def_ro("substeps", &ShieldOptions::substeps)
      .def_ro("margin_m", &ShieldOptions::margin_m)
      .def_ro("max_time_s", &ShieldOptions::max_time_s)
      .def_ro("escape_time_s", &ShieldOptions::escape_time_s)
      .def_ro("escape_tries", &ShieldOptions::escape_tries)
      .def_ro("line_search", &ShieldOptions::line_search)
      .def_ro("rest_speed_m_s", &ShieldOptions::rest_speed_m_s)
      .def_ro("rest_rate_rad_s", &ShieldOptions::rest_rate_rad_s)
      .def_ro("rest_tilt_rad", &ShieldOptions::rest_tilt_rad)
      .def_ro("rest_drift_m", &ShieldOptions::rest_drift_m)
      .def_ro("motor_time_constant_s", &ShieldOptions::motor_time_constant_s);

  nb::class_<Shield>(m, "Shield", "Checks that a safe manoeuvre to rest is known: alula/filters/shield.hpp.")
      .def(
          "__init__",
          [](Shield* self, const BackupPolicy& policy, Index index, const ShieldOptions& options) {
            new (self) Shield(policy, std::move(index), options);
          },
          "policy"_a, "index"_a, "options"_a = ShieldOptions{})
      .def_prop_ro("ends_early", &Shield::ends_early,
                   "Whether rollouts for a verdict end where the policy's excursion is free all around.")
      .def("certify", &certify, "state"_a, nb::kw_only(), "first"_a = nb::none(), "hold"_a = Triple{},
           "hold_ticks"_a = 0, "margin_m"_a = nb::none(), "thorough"_a = false,
           "Fly one tick of the wrench `first`, if given, then about `hold` [m/s] for hold_ticks, then to rest: a "
           "dict "
           "of safe, rests, clearance_m (least seen, less the radius) and time_s.")
      .def(
          "after",
          [](const Shield& self, const InState& x, const Vec4& u) {
            return to_array(self.after(state_at(x.data()), wrench_at(u.data())));
          },
          "state"_a, "wrench"_a, "The state a tick later.")
      .def("see", &Shield::see, "rotors"_a, "What each rotor gives in the states that are asked about next [N].");

  m.def("escape_velocities", &escapes, "index"_a, "p"_a, "v"_a, nb::kw_only(), "reach"_a, "count"_a = 64,
        "slack_rad"_a = EscapeOptions{}.slack_rad,
        "Velocities (N, 3) of the same speed that meet no cone of the ellipsoids within reach, and the angles [rad] "
        "they are turned by, least first.");
}

void bind_wish(nb::module_& m) {
  const SmoothWishOptions o;
  nb::class_<SmoothWishOptions>(m, "SmoothWishOptions", "What a filter of wrenches asks for while it holds.")
      .def(
          "__init__",
          [](SmoothWishOptions* self, double release_rad_s, double release_growth_1_s, double wish_attitude_rad_s,
             double wish_position_rad_s, double wish_catch_up_m_s, double wish_acceleration, double wish_speed_m_s,
             double wish_cone_rate_1_s) {
            new (self)
                SmoothWishOptions{release_rad_s,     release_growth_1_s, wish_attitude_rad_s, wish_position_rad_s,
                                  wish_catch_up_m_s, wish_acceleration,  wish_speed_m_s,      wish_cone_rate_1_s};
          },
          nb::kw_only(), "release_rad_s"_a = o.release_rad_s, "release_growth_1_s"_a = o.release_growth_1_s,
          "wish_attitude_rad_s"_a = o.wish_attitude_rad_s, "wish_position_rad_s"_a = o.wish_position_rad_s,
          "wish_catch_up_m_s"_a = o.wish_catch_up_m_s, "wish_acceleration"_a = o.wish_acceleration,
          "wish_speed_m_s"_a = o.wish_speed_m_s, "wish_cone_rate_1_s"_a = o.wish_cone_rate_1_s,
          "release_rad_s: pole of the acceleration while held, 0 for the nominal input as it is; it grows by\n"
          "e^{release_growth_1_s t} up to wish_attitude_rad_s, the second pole; wish_position_rad_s: double pole of\n"
          "the position; wish_catch_up_m_s, wish_acceleration [m/s^2]: the most that errors ask for; all three grow\n"
          "with the reference's speed above wish_speed_m_s;\n"
          "wish_cone_rate_1_s: of the rows that keep the wish out of the cones.")
      .def_ro("release_rad_s", &SmoothWishOptions::release_rad_s)
      .def_ro("release_growth_1_s", &SmoothWishOptions::release_growth_1_s)
      .def_ro("wish_attitude_rad_s", &SmoothWishOptions::wish_attitude_rad_s)
      .def_ro("wish_position_rad_s", &SmoothWishOptions::wish_position_rad_s)
      .def_ro("wish_catch_up_m_s", &SmoothWishOptions::wish_catch_up_m_s)
      .def_ro("wish_acceleration", &SmoothWishOptions::wish_acceleration)
      .def_ro("wish_speed_m_s", &SmoothWishOptions::wish_speed_m_s)
      .def_ro("wish_cone_rate_1_s", &SmoothWishOptions::wish_cone_rate_1_s);
}

ThrustCascade cascade_of(const std::string& name) {
  if (name == "extension") return ThrustCascade::extension;
  if (name == "difference") return ThrustCascade::difference;
  throw std::invalid_argument("cascade must be 'extension' or 'difference'");
}

BackupSolver solver_of(const std::string& name) {
  if (name == "active-set") return BackupSolver::active_set;
  if (name == "interpolation") return BackupSolver::interpolation;
  throw std::invalid_argument("solver must be 'active-set' or 'interpolation'");
}

void bind_filters(nb::module_& m) {
  const ConeEcbfOptions e;
  nb::class_<ConeEcbf, SplatFilter>(m, "ConeEcbf", "The exponential collision cone filter of a quadrotor.")
      .def(
          "__init__",
          [](ConeEcbf* self, const BackupPolicy& policy, Index index, double lambda, double lambda_max,
             double return_time, double escape_rate, double min_speed_m_s, const std::string& cascade,
             double bandwidth, double damping, double max_rate, double least_thrust, double lateral_bias,
             double clf_weight, double clf_rate, double clf_kp, double clf_kv, bool shield, double room_m,
             bool try_nominal, const SmoothWishOptions& wish_options, const ShieldOptions& shield_options,
             const Pruning& pruning, nb::object qp_backend) {
            new (self) ConeEcbf(policy, std::move(index),
                                {.lambda = lambda,
                                 .lambda_max = lambda_max,
                                 .return_time = return_time,
                                 .escape_rate = escape_rate,
                                 .min_speed_m_s = min_speed_m_s,
                                 .cascade = cascade_of(cascade),
                                 .thrust_bandwidth_rad_s = bandwidth,
                                 .thrust_damping = damping,
                                 .max_thrust_rate_n_s = max_rate,
                                 .least_thrust = least_thrust,
                                 .lateral_bias = lateral_bias,
                                 .wish = wish_options,
                                 .tracking = {clf_weight, clf_rate, clf_kp, clf_kv},
                                 .shielded = shield,
                                 .room_m = room_m,
                                 .try_nominal = try_nominal,
                                 .shield = shield_options,
                                 .pruning = pruning},
                                qp_solver(std::move(qp_backend)));
          },
          "policy"_a, "index"_a, nb::kw_only(), "lambda_"_a = e.lambda, "lambda_max"_a = e.lambda_max,
          "return_time"_a = e.return_time, "escape_rate"_a = e.escape_rate, "min_speed_m_s"_a = e.min_speed_m_s,
          "cascade"_a = "extension", "thrust_bandwidth_rad_s"_a = e.thrust_bandwidth_rad_s,
          "thrust_damping"_a = e.thrust_damping, "max_thrust_rate_n_s"_a = e.max_thrust_rate_n_s,
          "least_thrust"_a = e.least_thrust, "lateral_bias"_a = e.lateral_bias, "clf_weight"_a = e.tracking.weight,
          "clf_rate"_a = e.tracking.rate, "clf_kp"_a = e.tracking.kp, "clf_kv"_a = e.tracking.kv,
          "shield"_a = e.shielded, "room_m"_a = e.room_m, "try_nominal"_a = e.try_nominal, "wish_options"_a = e.wish,
          "shield_options"_a = e.shield, "pruning"_a = e.pruning, "qp_backend"_a = nb::none(),
          "lambda_: triple pole of the rows [1/s], moved left up to lambda_max when a row starts beyond its safe "
          "set;\n"
          "return_time: pole of a row with h < 0, times the time to its ellipsoid;\n"
          "escape_rate: pole of the rows on gamma, of all ellipsoids below min_speed_m_s; cascade: 'extension' (the "
          "variable is\n"
          "T''/m) or 'difference' (T); thrust_*: how T follows the nominal; max_thrust_rate_n_s: of |T'|;\n"
          "least_thrust: share of hover; lateral_bias: torque of a head-on nominal, share of the largest;\n"
          "clf_*: soft row on tracking errors, off at weight 0; shield: return only inputs after which a safe\n"
          "manoeuvre to rest is known; room_m: what rows keep beyond the radius then; try_nominal: without a "
          "solution, look between backup and nominal; qp_backend: as of QpSolver.");

  m.def("ecbf_pole", &ecbf_pole, "h"_a, "h1"_a, "h2"_a, "lambda_"_a, "most"_a,
        "The least pole from lambda_ to most at which psi_1 and psi_2 are not negative; lambda_ when there is none.");

  const ConeBackupOptions b;
  nb::class_<ConeBackup, SplatFilter>(m, "ConeBackup", "The collision cone backup filter of a quadrotor.")
      .def(
          "__init__",
          [](ConeBackup* self, const BackupPolicy& policy, Index index, double horizon_s, int nodes, int first_node,
             int steps, double alpha_running, double alpha_terminal, double min_speed_m_s, double far,
             const std::string& solver, double lateral_bias, double clf_weight, double clf_rate, double clf_kp,
             double clf_kv, bool shield, double room_m, bool try_nominal, const ShieldOptions& shield_options,
             const Pruning& pruning, nb::object qp_backend) {
            new (self) ConeBackup(policy, std::move(index),
                                  {.horizon_s = horizon_s,
                                   .nodes = nodes,
                                   .first_node = first_node,
                                   .steps = steps,
                                   .alpha_running = alpha_running,
                                   .alpha_terminal = alpha_terminal,
                                   .min_speed_m_s = min_speed_m_s,
                                   .far = far,
                                   .solver = solver_of(solver),
                                   .lateral_bias = lateral_bias,
                                   .tracking = {clf_weight, clf_rate, clf_kp, clf_kv},
                                   .shielded = shield,
                                   .room_m = room_m,
                                   .try_nominal = try_nominal,
                                   .shield = shield_options,
                                   .pruning = pruning},
                                  qp_solver(std::move(qp_backend)));
          },
          "policy"_a, "index"_a, nb::kw_only(), "horizon_s"_a = b.horizon_s, "nodes"_a = b.nodes,
          "first_node"_a = b.first_node, "steps"_a = b.steps, "alpha_running"_a = b.alpha_running,
          "alpha_terminal"_a = b.alpha_terminal, "min_speed_m_s"_a = b.min_speed_m_s, "far"_a = b.far,
          "solver"_a = "active-set", "lateral_bias"_a = b.lateral_bias, "clf_weight"_a = b.tracking.weight,
          "clf_rate"_a = b.tracking.rate, "clf_kp"_a = b.tracking.kp, "clf_kv"_a = b.tracking.kv,
          "shield"_a = b.shielded, "room_m"_a = b.room_m, "try_nominal"_a = b.try_nominal,
          "shield_options"_a = ShieldOptions{}, "pruning"_a = Pruning{}, "qp_backend"_a = nb::none(),
          "horizon_s, nodes: of the backup flow; first_node: of the running rows, 0 as printed; steps: RK4 steps "
          "between nodes, 0 to fit the policy's rates;\n"
          "alpha_running, alpha_terminal: of h' >= -alpha h [1/s] at the nodes and of gamma at the last;\n"
          "min_speed_m_s: nodes slower than that have no running rows; far: rows with h / beta beyond it are left\n"
          "out; solver: 'active-set' or 'interpolation' between the backup and the nominal input; lateral_bias,\n"
          "clf_*, shield, room_m, try_nominal, qp_backend as of ConeEcbf.");
}

}  // namespace
}  // namespace alula::flight

void bind_wrench_filters(nb::module_& m) {
  alula::flight::bind_shield(m);
  alula::flight::bind_wish(m);
  alula::flight::bind_filters(m);
}
