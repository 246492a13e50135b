// Bindings of alula/filters/geofence.hpp and of the simulated pilots and starts in a geofence.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <map>
#include <stdexcept>
#include <string>
#include <utility>

#include "alula/filters/backup_qp.hpp"
#include "alula/filters/option_fields.hpp"
#include "alula/flight/fence_metrics.hpp"
#include "alula/flight/geofence_pilot.hpp"
#include "fields.hpp"
#include "filters/geofence_fields.hpp"
#include "filters/onboard_inputs.hpp"
#include "racer_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace flight {
namespace {

using LogDict = nb::typed<nb::dict, nb::str, nb::any>;
using Corners = std::pair<Triple, Triple>;

geometry::Box box_of(const Corners& c) {
  geometry::Box box;
  box.lower = vector_of(c.first), box.upper = vector_of(c.second);
  return box;
}

nb::bytes to_bytes(const void* from, std::size_t size) { return nb::bytes(from, size); }

const char* name_of(alula_geofence_status status) {
  static constexpr const char* kNames[] = {"passed", "blended", "backup", "no-pilot", "hand-over", "refused"};
  return kNames[status];
}

alula_geofence_config config_of(const RacerModel& model, const std::map<std::string, double>& given) {
  alula_geofence_config c = alula_geofence_defaults();
  c.model = to_onboard(model);
  assign_numbers(c, given, "a geofence");
  return c;
}

LogDict detail_of(const GeofenceReport& report) {
  const alula_geofence_result& r = report.detail;
  LogDict result;
  result["lambda"] = r.lambda;
  result["h_i"] = r.h_i;
  result["distance_m"] = r.distance_m;
  result["margin_m"] = r.margin_m;
  result["deciding"] = r.deciding;
  result["v_towards"] = r.v_towards;
  result["stale_s"] = r.stale_s;
  return result;
}

void bind_fence(nb::module_& m) {
  nb::class_<Fence>(m, "Fence", "Allowed region: in a box, in a polytope, outside the hulls of an onboard map.")
      .def(
          "__init__",
          [](Fence* self, const std::optional<Corners>& box, const std::optional<InRows4<double>>& faces,
             const std::optional<nb::bytes>& image, const PolytopeSet* keep_out) {
            Fence fence;
            if (box) fence.box = box_of(*box);
            if (faces) {
              for (std::size_t l = 0; l < faces->shape(0); ++l) {
                const double* row = faces->data() + 4 * l;
                fence.faces.push_back({row[0], row[1], row[2], row[3]});
              }
            }
            if (image) {
              const auto* begin = static_cast<const std::uint8_t*>(image->data());
              fence.image = std::make_shared<const std::vector<std::uint8_t>>(begin, begin + image->size());
            }
            fence.keep_out = keep_out;
            new (self) Fence(std::move(fence));
          },
          nb::kw_only(), "box"_a = nb::none(), "faces"_a = nb::none(), "image"_a = nb::none(),
          "keep_out"_a.none() = nb::none(), nb::keep_alive<1, 5>(),
          "`box` (lower, upper); `faces` (L, 4), rows n, d with n . p <= d inside and |n| = 1; `image` of an onboard "
          "map for the filter, `keep_out` the same polytopes for judging flights.")
      .def(
          "clearance",
          [](const Fence& self, const Triple& a, const Triple& b) {
            return self.clearance(vector_of(a), vector_of(b));
          },
          "a"_a, "b"_a, "Minimum distance of a segment from the forbidden region; negative inside it.")
      .def(
          "braking_distance",
          [](const Fence& self, std::uint32_t deciding, const Triple& p, const Triple& v) {
            const Vec3 at = vector_of(p);
            return self.distance_to(self.braked_for(deciding, at, vector_of(v)), at);
          },
          "deciding"_a, "p"_a, "v"_a,
          "Distance of a point from the constraint that decides a filter's result; where no face and no map decides, "
          "from the face that a straight flight with this velocity meets first.");
}

void bind_filter(nb::module_& m) {
  nb::class_<Geofence>(
      m, "Geofence",
      "The onboard geofence: an implicit control barrier function by simulating the backup controller."
      "\n\nParameters by name, see alula_geofence_config; ValueError for those it does not accept.")
      .def(
          "__init__",
          [](Geofence* self, const Fence& fence, const RacerModel& model,
             const std::map<std::string, double>& parameters) {
            new (self) Geofence(fence, config_of(model, parameters));
          },
          "fence"_a, "model"_a = RacerModel{}, "parameters"_a = std::map<std::string, double>{},
          nb::keep_alive<1, 2>())
      .def_static(
          "conditions",
          [](const RacerModel& model, const std::map<std::string, double>& parameters) {
            const alula_geofence_config config = config_of(model, parameters);
            alula_geofence_conditions found;
            if (alula_geofence_examine(&config, &found) == ALULA_BAD_PARAMETER) {
              throw std::invalid_argument(refusal(config));
            }
            return std::map<std::string, double>{{"rest_m_s", found.rest_m_s}, {"most_rest_m_s", found.most_rest_m_s},
                                                 {"upright", found.upright},   {"least_upright", found.least_upright},
                                                 {"lost_s", found.lost_s},     {"most_beta", found.most_beta}};
          },
          "model"_a = RacerModel{}, "parameters"_a = std::map<std::string, double>{},
          "Conditions of the guarantee, see alula_geofence_conditions, also where they do not hold.")
      .def_prop_ro("hover_throttle", &Geofence::hover_throttle)
      .def_prop_ro(
          "config_words", [](const Geofence& self) { return to_bytes(&self.config(), sizeof self.config()); },
          nb::sig("def config_words(self) -> bytes"), "The bytes of its alula_geofence_config.")
      .def_prop_ro(
          "fence_words", [](const Geofence& self) { return words_of(self.onboard_fence()); },
          nb::sig("def fence_words(self) -> bytes"),
          "The bytes of its alula_fence: has_box, lower (3), upper (3), face_count, and the faces (4 each).")
      .def_prop_ro(
          "parameters",
          [](const Geofence& self) {
            alula_geofence_config config = self.config();
            std::map<std::string, double> result;
            each_field<alula_geofence_config>(
                config, [&](const std::string& name, const auto&, const auto& value) { result[name] = value; });
            return result;
          },
          "All of them by name, as the filter holds them: in single precision.")
      .def("reset", &Geofence::reset, "Reset to the state before the first tick.")
      .def(
          "filter",
          [](Geofence& self, const std::optional<InRacer>& navigation, const std::optional<InCommand>& pilot) {
            RacerState x;
            RacerCommand u;
            if (navigation) x = racer_at(navigation->data());
            if (pilot) u = command_at(pilot->data());
            const GeofenceReport report = self.filter(navigation ? &x : nullptr, pilot ? &u : nullptr);
            return nb::make_tuple(to_array(report.command), name_of(report.status), detail_of(report));
          },
          "navigation"_a.none(), "pilot"_a.none(),
          nb::sig("def filter(self, navigation: NDArray[numpy.float64] | None, pilot: NDArray[numpy.float64] | None)"
                  " -> tuple[NDArray[numpy.float64], str, dict[str, float]]"),
          "One tick: command (4), status and details. None: no navigation, or no pilot.")
      .def(
          "evaluate",
          [](const Geofence& self, const InRacers& states) {
            const std::size_t count = states.shape(0);
            std::vector<double> values, first;
            {
              const nb::gil_scoped_release release;
              values.reserve(5 * count), first.reserve(4 * count);
              for (std::size_t i = 0; i < count; ++i) {
                const alula_geofence_value v = self.evaluate(racer_at(states.data() + kRacerNumbers * i));
                values.insert(values.end(), {v.h_i, v.exponent, v.margin_m, v.distance_m, v.end});
                const RacerCommand u = from_onboard(v.first);
                first.insert(first.end(), {u.throttle, u.rates.x, u.rates.y, u.rates.z});
              }
            }
            return nb::make_tuple(to_numpy(std::move(values), {count, 5}), to_numpy(std::move(first), {count, 4}));
          },
          "states"_a,
          nb::sig("def evaluate(self, states: NDArray[numpy.float64]) -> "
                  "tuple[NDArray[numpy.float64], NDArray[numpy.float64]]"),
          "Flows that begin at states (N, 13): (h_I, min h_c / v_c, margin, distance, h_B) (N, 5), and u_B (N, "
          "4).");
}

void bind_backup_qp(nb::module_& m) {
  nb::class_<BackupQp>(m, "BackupQp",
                       "The backup-set barrier with gradients, by a quadratic program, with the flow of a Geofence.")
      .def(nb::init<const Geofence&, double>(), "geofence"_a, "alpha"_a = BackupQpOptions{}.alpha)
      .def_prop_ro("alpha", &BackupQp::alpha, "Gain [1/s].")
      .def("reset", &BackupQp::reset, "Reset to the state before the first tick.")
      .def(
          "filter",
          [](BackupQp& self, const InRacers& states, const In<double, nb::shape<-1, 4>>& pilots) {
            const std::size_t count = states.shape(0);
            require_rows(pilots.shape(0), count);
            std::vector<double> commands, h_i;
            std::vector<std::int64_t> rows;
            std::vector<std::uint8_t> infeasible;
            {
              const nb::gil_scoped_release release;
              for (std::size_t i = 0; i < count; ++i) {
                const BackupQpReport r =
                    self.filter(racer_at(states.data() + kRacerNumbers * i), command_at(pilots.data() + 4 * i));
                commands.insert(commands.end(),
                                {r.command.throttle, r.command.rates.x, r.command.rates.y, r.command.rates.z});
                h_i.push_back(r.h_i);
                rows.push_back(static_cast<std::int64_t>(r.rows));
                infeasible.push_back(r.is_infeasible ? 1 : 0);
              }
            }
            return nb::make_tuple(to_numpy(std::move(commands), {count, 4}), to_numpy(std::move(h_i), {count}),
                                  to_numpy(std::move(rows), {count}), to_numpy(std::move(infeasible), {count}));
          },
          "states"_a, "pilots"_a,
          nb::sig(
              "def filter(self, states: NDArray[numpy.float64], pilots: NDArray[numpy.float64]) -> "
              "tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.int64], NDArray[numpy.uint8]]"),
          "Ticks at states (N, 13) with pilots (N, 4): commands (N, 4), h_I, rows of the program, and whether it had "
          "no solution.");
}

void bind_pilots(nb::module_& m) {
  nb::class_<Pilot>(m, "Pilot", "A simulated pilot.")
      .def(
          "__init__",
          [](Pilot* self, const nb::object& kind, const nb::kwargs& others) {
            Pilot made;
            made.kind = fields::choice<PilotKind>(kind, "a pilot");
            fields::assign(made, others, "Pilot");
            check(made);
            new (self) Pilot(made);
          },
          "kind"_a, "others"_a, nb::sig(fields::signature(Pilot{}, "self, kind: str").c_str()),
          fields::documentation(
              Pilot{}, "straight, diagonal, fall, sticks, aggressive, silent or repeated; ValueError for others.")
              .c_str());
  nb::class_<PilotHand>(m, "PilotHand", "A pilot in one flight, as simulated flights have him.")
      .def(
          "__init__",
          [](PilotHand* self, const Pilot& pilot, const RacerModel& model, double start_height, std::uint64_t seed,
             std::uint32_t trial) { new (self) PilotHand(pilot, model, RandomStream{seed, trial}, start_height); },
          "pilot"_a, "model"_a, "start_height"_a, nb::kw_only(), "seed"_a = 0, "trial"_a = 0)
      .def(
          "command",
          [](PilotHand& self, double time, const InRacer& x) -> std::optional<Doubles> {
            const auto u = self(time, racer_at(x.data()));
            if (!u) return {};
            return to_array(*u);
          },
          "time"_a, "x"_a,
          nb::sig("def command(self, time: float, x: NDArray[numpy.float64]) -> NDArray[numpy.float64] | None"),
          "His command (4) at a state (13); None: no radio.");
  m.def(
      "safe_racer_start",
      [](const Geofence& geofence, const Corners& box, double speed, double tilt, std::uint64_t seed,
         std::uint32_t trial, const ObstacleMap* others) {
        return to_array(safe_start(geofence, {box_of(box), speed, tilt}, RandomStream{seed, trial}, others));
      },
      "geofence"_a, "box"_a, nb::kw_only(), "speed_m_s"_a = RacerStarts{}.speed_m_s,
      "tilt_rad"_a = RacerStarts{}.tilt_rad, "seed"_a = 0, "trial"_a = 0, "others"_a.none() = nb::none(),
      nb::sig("def safe_racer_start(geofence: Geofence, box: tuple[collections.abc.Sequence[float], "
              "collections.abc.Sequence[float]], *, speed_m_s: float = 10.0, tilt_rad: float = 1.0, seed: int = 0, "
              "trial: int = 0, others: ObstacleMap | None = None) -> NDArray[numpy.float64]"),
      "Random start (13) in a box (lower, upper) with h_I > 0 and clear of other obstacles, at most so fast [m/s] "
      "and\n"
      "tilted [rad].");
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_geofence(nb::module_& m) {
  alula::flight::bind_fence(m);
  alula::flight::bind_filter(m);
  alula::flight::bind_backup_qp(m);
  alula::flight::bind_pilots(m);
}
