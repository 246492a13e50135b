// Bindings of alula_rates.h, for tests and for flights of a flight controller's firmware.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "alula/filters/geofence.hpp"
#include "alula_rates.h"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

Triple of_axes(const alula_rates& r, float alula_rates_axis::* number) {
  return {r.axis[0].*number, r.axis[1].*number, r.axis[2].*number};
}

alula_rates make(const Triple& rc_rate, const Triple& super_rate, const Triple& expo, double middle, double low,
                 double high) {
  alula_rates r;
  for (std::size_t i = 0; i < 3; ++i)
    r.axis[i] = {static_cast<float>(rc_rate[i]), static_cast<float>(super_rate[i]), static_cast<float>(expo[i])};
  r.middle_us = static_cast<float>(middle);
  r.throttle_low_us = static_cast<float>(low), r.throttle_high_us = static_cast<float>(high);
  if (alula_rates_check(&r) != ALULA_READY) throw std::invalid_argument("rates out of range");
  return r;
}

using InFloats = InVector<float>;

template <float (*kMap)(const alula_rates_axis*, float)>
auto mapped(const alula_rates& self, int axis, const InFloats& x) {
  if (axis < 0 || axis > 2) throw std::invalid_argument("axes are 0, 1 and 2");
  std::vector<float> result;
  result.reserve(x.size());
  for (const float value : as_span(x)) result.push_back(kMap(&self.axis[axis], value));
  return to_numpy(std::move(result), {x.size()});
}

}  // namespace
}  // namespace alula::flight

void bind_rates(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  const alula_rates d = alula_rates_defaults();
  nb::class_<alula_rates>(
      m, "Rates",
      "A flight controller's rate profile (rates_type BETAFLIGHT) as the onboard code maps it, in "
      "single precision; axes are roll, pitch, yaw.")
      .def(
          "__init__",
          [](alula_rates* self, const Triple& rc_rate, const Triple& super_rate, const Triple& expo, double middle,
             double low, double high) { new (self) alula_rates(make(rc_rate, super_rate, expo, middle, low, high)); },
          nb::kw_only(), "rc_rate"_a = of_axes(d, &alula_rates_axis::rc_rate), "super_rate"_a = Triple{0.7, 0.7, 0.7},
          "expo"_a = of_axes(d, &alula_rates_axis::expo), "middle_us"_a = d.middle_us,
          "throttle_low_us"_a = d.throttle_low_us, "throttle_high_us"_a = d.throttle_high_us,
          "Create a profile; ValueError for numbers out of range.")
      .def("rate", &mapped<alula_rates_at>, "axis"_a, "deflection"_a, "Rates [rad/s] of deflections (N).")
      .def("deflection", &mapped<alula_rates_deflection>, "axis"_a, "rate"_a, "Deflections of rates (N) [rad/s].")
      .def(
          "channels",
          [](const alula_rates& self, const In<double, nb::shape<-1, 4>>& commands) {
            std::vector<std::uint16_t> pulses;
            std::vector<std::uint8_t> refused;
            for (std::size_t i = 0; i < commands.shape(0); ++i) {
              const double* row = commands.data() + 4 * i;
              const alula_racer_command u = to_onboard(RacerCommand{row[0], geometry::from_rows(row + 1)});
              std::uint16_t pulse[ALULA_CHANNELS];
              refused.push_back(alula_rates_channels(&self, &u, pulse) == ALULA_READY ? 0 : 1);
              pulses.insert(pulses.end(), pulse, pulse + ALULA_CHANNELS);
            }
            return nb::make_tuple(to_numpy(std::move(pulses), {commands.shape(0), 4}),
                                  to_numpy(std::move(refused), {commands.shape(0)}));
          },
          "commands"_a,
          nb::sig("def channels(self, commands: NDArray[numpy.float64]) -> "
                  "tuple[NDArray[numpy.uint16], NDArray[numpy.uint8]]"),
          "Pulses (N, 4) [us] of roll, pitch, throttle, yaw for commands (N, 4): throttle, rates; and which commands "
          "are "
          "refused.")
      .def(
          "commands",
          [](const alula_rates& self, const In<std::uint16_t, nb::shape<-1, 4>>& channels) {
            Rows rows(channels.shape(0));
            std::vector<std::uint8_t> refused;
            for (std::size_t i = 0; i < channels.shape(0); ++i) {
              alula_racer_command u;
              refused.push_back(alula_rates_command(&self, channels.data() + 4 * i, &u) == ALULA_READY ? 0 : 1);
              const RacerCommand made = from_onboard(u);
              rows.add(made.throttle).add(made.rates);
            }
            return nb::make_tuple(rows.array({channels.shape(0), 4}),
                                  to_numpy(std::move(refused), {channels.shape(0)}));
          },
          "channels"_a,
          nb::sig("def commands(self, channels: NDArray[numpy.uint16]) -> "
                  "tuple[NDArray[numpy.float64], NDArray[numpy.uint8]]"),
          "Commands (N, 4) for pulses (N, 4), and which pulses are refused.");
}
