// Bindings of alula/filters/shield.hpp, alula/filters/shield_filter.hpp, alula/filters/cone_escape.hpp,
// alula/filters/cone_ecbf.hpp and alula/filters/cone_backup.hpp.
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
#include "alula/filters/option_fields.hpp"
#include "alula/filters/shield_filter.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"
#include "python_qp.hpp"
#include "track_rows.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

using Record = nb::typed<nb::dict, nb::str, nb::any>;
using Index = std::shared_ptr<EllipsoidIndex>;
using Map = std::shared_ptr<ObstacleMap>;

// Those given, or none, for the ellipsoids of the index.
Surroundings surroundings(Map map, std::optional<double> radius_m, const Index& index) {
  if (!map && radius_m) throw std::invalid_argument("radius_m is for a map");
  if (!map) return {};
  if (!radius_m && !index) throw std::invalid_argument("a map needs radius_m");
  return {std::move(map), radius_m.value_or(index->radius())};
}

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
  record["clears_tubes"] = result.clears_tubes;
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
  fields::bind<ShieldOptions>(m, "ShieldOptions", "Options of the check of a manoeuvre to rest.");

  nb::class_<Shield>(m, "Shield", "Checks that a safe manoeuvre to rest exists: alula/filters/shield.hpp.")
      .def(
          "__init__",
          [](Shield* self, const BackupPolicy& policy, Index index, const ShieldOptions& options) {
            new (self) Shield(policy, Surroundings::of(index), options, index);
          },
          "policy"_a, "index"_a, "options"_a = ShieldOptions{}, "For the ellipsoids of an index and its radius.")
      .def(
          "__init__",
          [](Shield* self, const BackupPolicy& policy, Map map, double radius_m, const ShieldOptions& options) {
            new (self) Shield(policy, {std::move(map), radius_m}, options);
          },
          "policy"_a, "map"_a, "radius_m"_a, "options"_a = ShieldOptions{}, "For a ball of radius_m in any map.")
      .def_prop_ro("ends_early", &Shield::ends_early,
                   "True when rollouts for a verdict end where the policy's excursion is free all around.")
      .def("certify", &certify, "state"_a, nb::kw_only(), "first"_a = nb::none(), "hold"_a = Triple{},
           "hold_ticks"_a = 0, "margin_m"_a = nb::none(), "thorough"_a = false,
           "Fly one tick of the wrench `first`, if given, then about `hold` [m/s] for hold_ticks, then to rest: a "
           "dict "
           "of safe, rests, clearance_m (minimum distance minus the radius), time_s and clears_tubes.")
      .def(
          "after",
          [](const Shield& self, const InState& x, const Vec4& u) {
            return to_array(self.after(state_at(x.data()), wrench_at(u.data())));
          },
          "state"_a, "wrench"_a, "State one tick later.")
      .def(
          "see",
          [](Shield& self, const std::optional<Vec4>& rotors, const std::optional<Tracks>& tracks,
             const Triple& position_variance, const Triple& disturbance) {
            const std::vector<alula_track> all = tracks ? tracks_of(*tracks) : std::vector<alula_track>{};
            FlightState state;
            state.level = Level(vector_of(disturbance), self.policy().vehicle().gravity());
            state.rotors = rotors, state.tracks = all, state.position_variance = vector_of(position_variance);
            self.see(state);
          },
          "rotors"_a = nb::none(), "tracks"_a = nb::none(), "position_variance"_a = Triple{},
          "disturbance_m_s2"_a = Triple{},
          "Set the thrust of each rotor [N] for the next states, the tracks from now on, as of MovingFilter, the "
          "variance of the position [m^2], and the disturbance [m/s^2] for which the attitudes of states are "
          "levelled.");

  m.def("escape_velocities", &escapes, "index"_a, "p"_a, "v"_a, nb::kw_only(), "reach"_a, "count"_a = 64,
        "slack_rad"_a = EscapeOptions{}.slack_rad,
        "Velocities (N, 3) of the same speed that meet no cone of the ellipsoids within reach, and the angles [rad] "
        "by which they are turned, smallest first.");
}

template <class Filter, class Options>
void bind_filter(nb::module_& m, const char* name, const char* doc) {
  nb::class_<Filter, SafetyFilter>(m, name, doc)
      .def(
          "__init__",
          [](Filter* self, const BackupPolicy& policy, Index index, const Options& options, nb::object qp_backend,
             Map map, std::optional<double> radius_m, Map near_map, std::optional<double> near_radius_m) {
            Surroundings kept = surroundings(std::move(map), radius_m, index);
            Surroundings others = surroundings(std::move(near_map), near_radius_m, index);
            new (self) Filter(policy, std::move(index), options, qp_solver(std::move(qp_backend)), std::move(kept),
                              std::move(others));
          },
          "policy"_a, "index"_a, "options"_a = Options{}, nb::kw_only(), "qp_backend"_a = nb::none(),
          "map"_a = nb::none(), "radius_m"_a = nb::none(), "near_map"_a = nb::none(), "near_radius_m"_a = nb::none(),
          "qp_backend: as of QpSolver. map: what the shield certifies against, default the index; radius_m: the "
          "radius of its ball, default that of the index. near_map: obstacles around which rows steer, besides the "
          "index; near_radius_m: the radius for them, default that of the index.")
      .def_prop_ro("options", &Filter::options);
}

void bind_filters(nb::module_& m) {
  fields::bind<SmoothNominalOptions>(m, "SmoothNominalOptions",
                                     "The smooth nominal input of a filter of wrenches while rows hold the vehicle.");
  fields::bind<ConeEcbfOptions>(m, "ConeEcbfOptions", "Options of the filter cone-ecbf.");
  bind_filter<ConeEcbf, ConeEcbfOptions>(m, "ConeEcbf", "The exponential collision cone filter of a quadrotor.");
  fields::bind<ConeBackupOptions>(m, "ConeBackupOptions", "Options of the filter cone-backup.");
  bind_filter<ConeBackup, ConeBackupOptions>(m, "ConeBackup", "The collision cone backup filter of a quadrotor.");

  fields::bind<ShieldFilterOptions>(m, "ShieldFilterOptions", "Options of the filter shield.");
  nb::class_<ShieldFilter, SafetyFilter>(m, "ShieldFilter", "The shield alone: the nominal wrench where it is safe.")
      .def(
          "__init__",
          [](ShieldFilter* self, const BackupPolicy& policy, Map map, double radius_m,
             const ShieldFilterOptions& options) {
            new (self) ShieldFilter(policy, {std::move(map), radius_m}, options);
          },
          "policy"_a, "map"_a, "radius_m"_a, "options"_a = ShieldFilterOptions{})
      .def_prop_ro("options", &ShieldFilter::options);

  m.def("ecbf_pole", &ecbf_pole, "h"_a, "h1"_a, "h2"_a, "lambda_"_a, "most"_a,
        "The smallest pole from lambda_ to most at which psi_1 and psi_2 are not negative; lambda_ when there is "
        "none.");
}

}  // namespace
}  // namespace alula::flight

void bind_wrench_filters(nb::module_& m) {
  alula::flight::bind_shield(m);
  alula::flight::bind_filters(m);
}
