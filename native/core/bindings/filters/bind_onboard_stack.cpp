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
#include <vector>

#include "alula/filters/onboard_stack.hpp"
#include "alula/filters/option_fields.hpp"
#include "fields.hpp"
#include "filters/onboard_inputs.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

using Result = alula_stack_result;
OnboardStackSpec spec_of(const nb::bytes& image, const PolytopeCbfConfig& polytope_cbf, double lag_s, double extent_m,
                         const Numbers& dr_acbf, const Fence* fence) {
  OnboardStackSpec spec;
  const auto* first = static_cast<const std::uint8_t*>(image.data());
  spec.hulls = std::make_shared<const OnboardImage>(std::vector<std::uint8_t>(first, first + image.size()));
  spec.extent_m = extent_m;
  spec.polytope_cbf = polytope_cbf;
  spec.lag_s = lag_s;
  assign_numbers(spec.dr_acbf, dr_acbf, "dr-acbf");
  if (fence != nullptr) spec.fence = *fence;
  return spec;
}

Result filter_tick(OnboardStack& self, const Triple& x, const Triple& v, const Triple& nominal, const Tracks& tracks,
                   const std::array<double, 6>& covariance, bool is_taking_off) {
  alula_stack_input in{};
  for (std::size_t k = 0; k < 3; ++k) {
    in.position[k] = static_cast<float>(x[k]);
    in.velocity[k] = static_cast<float>(v[k]);
    in.nominal[k] = static_cast<float>(nominal[k]);
  }
  for (std::size_t k = 0; k < 6; ++k) in.covariance[k] = static_cast<float>(covariance[k]);
  in.is_taking_off = is_taking_off;
  const auto all = tracks_of(tracks);
  const nb::gil_scoped_release release;
  return self.filter(in, all);
}

// Rows (n, 5) of the last tick: normal, bound, kind (0 obstacle, 1 hull or face, 2 one whose margin is entered).
auto rows_of_tick(const OnboardStack& self, const Result& result) {
  const alula_stack& stack = self.stack();
  std::vector<double> rows;
  const auto add = [&rows](const alula_half_space& row, double kind) {
    rows.insert(rows.end(), row.normal, row.normal + 3);
    rows.push_back(row.bound);
    rows.push_back(kind);
  };
  for (std::uint32_t i = 0; i < result.obstacle_rows; ++i) add(stack.row[i], 0);
  for (std::uint32_t i = 0; i < stack.chord.count; ++i) add(stack.chord.row[i], i < stack.chord.soft ? 2 : 1);
  const std::size_t count = rows.size() / 5;
  return to_numpy(std::move(rows), {count, 5});
}

Doubles triple(const float* v) { return Rows(1).add(Vec3{v[0], v[1], v[2]}).array({3}); }

}  // namespace
}  // namespace alula::flight

void bind_onboard_stack(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  nb::class_<Result>(m, "OnboardStackResult", "Report of the stack of onboard filters for one tick.")
      .def_prop_ro(
          "status", [](const Result& r) { return static_cast<int>(r.status); },
          "0 nominal, 1 filtered, 2 shortened, 3 recovering, 4 refused.")
      .def_prop_ro(
          "velocity", [](const Result& r) { return triple(r.velocity); }, nb::rv_policy::move, "Velocity (3) [m/s].")
      .def_prop_ro(
          "margin_m", [](const Result& r) { return static_cast<double>(r.chord.margin_m); },
          "Minimum of D - r over hulls and faces [m].")
      .def_prop_ro(
          "mode", [](const Result& r) { return static_cast<int>(r.guidance.mode); },
          "0 nominal, 1 avoid, 2 hover, of dr-acbf.")
      .def_prop_ro(
          "horizon_s", [](const Result& r) { return static_cast<double>(r.horizon_s); },
          "Horizon of the obstacles' rows [s].")
      .def_prop_ro(
          "violation_m_s", [](const Result& r) { return static_cast<double>(r.violation_m_s); },
          "Largest violation of an obstacle's row [m/s]; a huge negative number without one.")
      .def_prop_ro(
          "rows", [](const Result& r) { return r.rows; }, "Number of rows.")
      .def_prop_ro(
          "obstacle_rows", [](const Result& r) { return r.obstacle_rows; }, "Of them, those of obstacles.")
      .def_prop_ro("failing", [](const Result& r) { return r.failing; }, "Ticks in a row whose rows did not hold.");
  const alula_stack_config plain = alula_stack_defaults();
  nb::class_<OnboardStack>(
      m, "OnboardStack",
      "The onboard filter among hulls and moving obstacles, in a fence, of a vehicle that follows "
      "velocities with a\nlag: alula_stack.h. ValueError for a combination that it refuses.")
      .def(
          "__init__",
          [](OnboardStack* self, const nb::bytes& image, const PolytopeCbfConfig& polytope_cbf, double lag_s,
             double extent_m, const Numbers& dr_acbf, const Fence* fence) {
            new (self) OnboardStack(spec_of(image, polytope_cbf, lag_s, extent_m, dr_acbf, fence));
          },
          "image"_a, "polytope_cbf"_a, "lag_s"_a = static_cast<double>(plain.lag_s), "extent_m"_a = 0.0,
          nb::kw_only(), "dr_acbf"_a = Numbers{}, "fence"_a.none() = nb::none(),
          nb::sig("def __init__(self, image: bytes, polytope_cbf: PolytopeCbfConfig, lag_s: float = 0.35, "
                  "extent_m: float = 0.0, *, dr_acbf: collections.abc.Mapping[str, float] = {}, "
                  "fence: Fence | None = None) -> None"))
      .def("reset", &OnboardStack::reset, "Reset to the state before the first tick.")
      .def("filter", &filter_tick, "x"_a, "v"_a, "u_nom"_a, "tracks"_a, nb::kw_only(),
           "covariance"_a = std::array<double, 6>{}, "is_taking_off"_a = false,
           "Filter one tick: position, velocity, nominal velocity (3), tracks (n, 29) as of MovingFilter, covariance "
           "of the\nposition.")
      .def(
          "rows", &rows_of_tick, "result"_a,
          "Rows (n, 5) of the last tick: unit normal and bound of normal . u <= bound; 0 of an obstacle, 1 of a hull "
          "or face, 2 of\none whose margin the chord has entered.")
      .def(
          "work",
          [](const OnboardStack& self) {
            const alula_chord& chord = self.stack().chord;
            const alula_polytope_work& w = chord.hulls.work;
            return std::array<std::uint32_t, 6>{w.boxes, w.hulls, w.planes, w.made, chord.count, chord.soft};
          },
          "Of the last call: boxes, hulls, values of planes, decoded planes, rows, those inside margins.")
      .def_prop_ro(
          "fence_words", [](const OnboardStack& self) { return words_of(self.fence()); },
          nb::sig("def fence_words(self) -> bytes"), "The bytes of its alula_fence, as those of a geofence.");
}
