// Bindings of alula/filters/onboard_stack.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <array>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "alula/filters/onboard_stack.hpp"
#include "alula/filters/option_fields.hpp"
#include "fields.hpp"
#include "filters/onboard_inputs.hpp"
#include "racer_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Choices<alula_stack_command> {
  static constexpr std::array names{"velocity", "acceleration", "sticks"};
};

namespace flight {
namespace {

using Result = alula_stack_result;

OnboardStackSpec spec_of(nb::handle takes, nb::handle gives, const std::optional<nb::bytes>& image, double extent_m,
                         const std::optional<PolytopeCbfConfig>& polytope_cbf, const std::optional<Numbers>& dr_acbf,
                         const Geofence* geofence, const RacerModel& model, double velocity_gain,
                         std::uint32_t most_walls) {
  OnboardStackSpec spec;
  spec.takes = fields::choice<alula_stack_command>(takes, "what a stack takes");
  spec.gives = fields::choice<alula_stack_command>(gives, "what a stack gives");
  if (image) {
    const auto* first = static_cast<const std::uint8_t*>(image->data());
    spec.hulls = std::make_shared<const OnboardImage>(std::vector<std::uint8_t>(first, first + image->size()));
  }
  spec.extent_m = extent_m;
  if (polytope_cbf) {
    spec.polytope_cbf = *polytope_cbf;
  } else {
    const alula_polytope_cbf_config plain = alula_stack_defaults().polytope_cbf;
    spec.polytope_cbf.beta = static_cast<double>(plain.beta);
  }
  if (dr_acbf) {
    spec.dr_acbf = alula_stack_defaults().dr_acbf;
    assign_numbers(*spec.dr_acbf, *dr_acbf, "dr-acbf");
  }
  spec.geofence = geofence;
  spec.model = model;
  spec.velocity_gain = velocity_gain;
  spec.most_walls = most_walls;
  return spec;
}

// The nominal command has 4 numbers for sticks, else 3.
Result filter_racer(OnboardStack& self, const InRacer& state, const InVector<double>& nominal, const Tracks& tracks,
                    const InRows4<double>& walls, const std::array<double, 6>& covariance, double yaw_rate_rad_s) {
  alula_stack_input in{};
  in.kind = self.config().takes;
  const bool has_sticks = in.kind == ALULA_STACK_STICKS;
  if (nominal.size() != (has_sticks ? 4U : 3U)) {
    throw std::invalid_argument("a nominal command has 3 numbers, sticks 4: throttle, rates");
  }
  in.state = to_onboard(racer_at(state.data()));
  if (has_sticks) in.sticks = to_onboard(command_at(nominal.data()));
  for (std::size_t k = 0; k < 3 && !has_sticks; ++k) in.nominal[k] = static_cast<float>(nominal.data()[k]);
  for (std::size_t k = 0; k < 6; ++k) in.covariance[k] = static_cast<float>(covariance[k]);
  in.yaw_rate_rad_s = static_cast<float>(yaw_rate_rad_s);
  const auto all = tracks_of(tracks);
  const auto planes = walls_of(walls);
  const nb::gil_scoped_release release;
  return self.filter(in, all, planes);
}

Doubles triple(const float* v) { return Rows(1).add(Vec3{v[0], v[1], v[2]}).array({3}); }

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_onboard_stack(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  nb::class_<Result>(m, "OnboardStackResult", "Report of a stack of onboard filters for one tick.")
      .def_prop_ro(
          "status", [](const Result& r) { return static_cast<int>(r.status); },
          "The worst of the parts: 0 nominal, 1 filtered, 2 shortened, 3 recovering, 4 refused.")
      .def_prop_ro(
          "parts", [](const Result& r) { return std::array<int, 3>{r.part[0], r.part[1], r.part[2]}; },
          "Statuses of polytope-cbf, dr-acbf and the geofence; 0 for a part that is off.")
      .def_prop_ro(
          "velocity", [](const Result& r) { return triple(r.velocity); }, nb::rv_policy::move, "Velocity (3) [m/s].")
      .def_prop_ro(
          "acceleration", [](const Result& r) { return triple(r.acceleration); }, nb::rv_policy::move,
          "Acceleration (3) [m/s^2].")
      .def_prop_ro(
          "sticks", [](const Result& r) { return to_array(from_onboard(r.sticks)); }, nb::rv_policy::move,
          "Throttle, and body rates [rad/s] (4).")
      .def_prop_ro(
          "walls", [](const Result& r) { return r.walls; }, "Number of walls that dr-acbf was given.")
      .def_prop_ro(
          "walls_are_full", [](const Result& r) { return r.walls_are_full != 0; },
          "Other walls that could bind may have been left out.")
      .def_prop_ro(
          "margin_m", [](const Result& r) { return static_cast<double>(r.polytope_cbf.margin_m); },
          "Margin of polytope-cbf's smooth psi [m]; 0 when it is off.")
      .def_prop_ro(
          "mode", [](const Result& r) { return static_cast<int>(r.dr_acbf.guidance.mode); },
          "0 nominal, 1 avoid, 2 hover, of dr-acbf.")
      .def_prop_ro(
          "rows", [](const Result& r) { return r.dr_acbf.rows; }, "Number of rows of dr-acbf.")
      .def_prop_ro(
          "h_i", [](const Result& r) { return static_cast<double>(r.geofence.h_i); }, "h_I of the geofence [m].")
      .def_prop_ro(
          "regulation", [](const Result& r) { return static_cast<double>(r.geofence.lambda); },
          "Regulation function of the geofence.")
      .def_prop_ro(
          "outcome", [](const Result& r) { return static_cast<int>(r.outcome); },
          "Number of the geofence's status, see alula_geofence_status.");
  const alula_stack_config plain = alula_stack_defaults();
  nb::class_<OnboardStack>(
      m, "OnboardStack",
      "The onboard filters one after the other, as on a microcontroller: polytope-cbf if `image` is given, dr-acbf\n"
      "if its options are, and the geofence if one is. See alula_stack.h.\n\n"
      "`takes` and `gives` are velocity, acceleration or sticks. ValueError for a combination that it refuses.")
      .def(
          "__init__",
          [](OnboardStack* self, nb::handle takes, nb::handle gives, const std::optional<nb::bytes>& image,
             double extent_m, const std::optional<PolytopeCbfConfig>& polytope_cbf,
             const std::optional<Numbers>& dr_acbf, const Geofence* geofence, const RacerModel& model,
             double velocity_gain, std::uint32_t most_walls) {
            new (self) OnboardStack(spec_of(takes, gives, image, extent_m, polytope_cbf, dr_acbf, geofence, model,
                                            velocity_gain, most_walls));
          },
          "takes"_a, "gives"_a, nb::kw_only(), "image"_a = nb::none(), "extent_m"_a = 0.0,
          "polytope_cbf"_a = nb::none(), "dr_acbf"_a = nb::none(), "geofence"_a.none() = nb::none(),
          "model"_a = RacerModel{}, "velocity_gain"_a = static_cast<double>(plain.velocity_gain),
          "most_walls"_a = plain.most_walls,
          nb::sig(
              "def __init__(self, takes: str, gives: str, *, image: bytes | None = None, extent_m: float = 0.0, "
              "polytope_cbf: PolytopeCbfConfig | None = None, dr_acbf: collections.abc.Mapping[str, float] | None "
              "= None, geofence: Geofence | None = None, model: RacerModel = ..., velocity_gain: float = 2.5, "
              "most_walls: int = 8) -> None"))
      .def("reset", &OnboardStack::reset, "Reset to the state before the first tick.")
      .def("filter", &filter_racer, "state"_a, "nominal"_a, "tracks"_a, "walls"_a, nb::kw_only(),
           "covariance"_a = std::array<double, 6>{}, "yaw_rate_rad_s"_a = 0.0,
           "Filter one tick: `state` (13), nominal velocity or acceleration (3) or sticks (4), tracks (n, 29) and "
           "walls\n"
           "(m, 4) as of MovingFilter, covariance of the position, and the yaw rate of the cascade.")
      .def(
          "walls",
          [](const OnboardStack& self, const Result& result) {
            std::vector<double> rows;
            for (const alula_wall& wall : self.walls(result)) {
              rows.insert(rows.end(), wall.normal, wall.normal + 3);
              rows.push_back(wall.distance_m);
            }
            const std::size_t count = rows.size() / 4;
            return to_numpy(std::move(rows), {count, 4});
          },
          "result"_a, "Walls (m, 4) of the last tick: normal, distance; the caller's first.");
}
