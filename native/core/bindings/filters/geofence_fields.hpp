// Field lists of pilots, rules and specifications of flights in a geofence.
#pragma once

#include <nanobind/stl/pair.h>

#include <optional>
#include <string>
#include <utility>

#include "alula/flight/geofence_flight.hpp"
#include "fields.hpp"
#include "racer_arrays.hpp"

namespace alula {
namespace flight {

// A specification with an optional box.
struct GeofenceArguments : GeofenceSpec {
  std::optional<geometry::Box> box;
};

}  // namespace flight

template <>
struct Choices<flight::PilotKind> {
  static constexpr std::array names{"straight", "diagonal", "fall", "sticks", "aggressive", "silent", "repeated"};
};

template <>
struct Choices<flight::FenceRule> {
  static constexpr std::array names{"none", "geofence", "backup-qp"};
};

template <>
struct Fields<flight::Pilot> {
  using Pilot = flight::Pilot;
  static constexpr std::tuple all{
      Field{"heading_rad", &Pilot::heading_rad,
            "heading of straight and repeated; diagonal is 45 degrees to the left [rad]"},
      Field{"tilt_rad", &Pilot::tilt_rad, "commanded tilt [rad]"},
      Field{"climb_m_s2", &Pilot::climb_m_s2, "commanded vertical acceleration of diagonal [m/s^2]"},
      Field{"silent_after_s", &Pilot::silent_after_s,
            "minimum time until silent stops transmitting; the maximum is twice that [s]"}};
};

template <>
struct Fields<flight::GeofenceRules> {
  using Rules = flight::GeofenceRules;
  static constexpr std::tuple all{
      Field{"duration_s", &Rules::duration_s, "duration of a flight [s]"},
      Field{"plant_steps", &Rules::plant_steps, "steps of the plant per tick of the filter"},
      Field{"rule", &Rules::rule, "none, geofence or backup-qp"},
      Field{"alpha", &Rules::alpha, "gain of backup-qp [1/s]"},
      Field{"stale_from_s", &Rules::stale_from_s, "start of an outage of the navigation [s]"},
      Field{"stale_for_s", &Rules::stale_for_s, "duration of that outage [s]"},
      Field{"radio_from_s", &Rules::radio_from_s, "start of an outage of the radio [s]"},
      Field{"radio_for_s", &Rules::radio_for_s, "duration of that outage [s]"}};
};

template <>
struct Fields<flight::GeofenceArguments> {
  using Spec = flight::GeofenceArguments;
  static constexpr std::tuple all{
      Field{"model", &Spec::model, "model of plant and pilot"},
      Field{"options", &Spec::options, "disturbances of the plant that the model omits"},
      Field{"pilot", &Spec::pilot, "the pilot"},
      Field{"rules", &Spec::rules, "times and outages"},
      Field{"start", &Spec::start, "state (13) at the start"},
      Field{"start_box", &Spec::box, "without a start: box (lower, upper) of random starts with h_I > 0 [m]"},
      Field{"start_speed_m_s", &Spec::start_speed_m_s, "maximum speed of a random start [m/s]"},
      Field{"start_tilt_rad", &Spec::start_tilt_rad, "maximum tilt of a random start [rad]"}};
};

namespace fields {

template <>
struct Python<flight::RacerState> {
  static std::string type() { return "NDArray[numpy.float64]"; }
  static flight::RacerState from(nb::handle value) {
    return flight::racer_at(nb::cast<flight::InRacer>(value).data());
  }
  static flight::Doubles out(const flight::RacerState& x) { return flight::to_array(x); }
};

template <>
struct Python<geometry::Box> {
  using Corners = std::pair<flight::Triple, flight::Triple>;
  static std::string type() { return "tuple[collections.abc.Sequence[float], collections.abc.Sequence[float]]"; }
  static geometry::Box from(nb::handle value) {
    const auto corners = nb::cast<Corners>(value);
    geometry::Box box;
    box.lower = flight::vector_of(corners.first), box.upper = flight::vector_of(corners.second);
    return box;
  }
  static Corners out(const geometry::Box& box) {
    return {flight::triple_of(box.lower), flight::triple_of(box.upper)};
  }
};

}  // namespace fields

}  // namespace alula
