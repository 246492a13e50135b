// Field list of simulated pilots.
#pragma once

#include "alula/flight/geofence_pilot.hpp"
#include "fields.hpp"

namespace alula {
template <>
struct Choices<flight::PilotKind> {
  static constexpr std::array names{"straight", "diagonal", "fall", "sticks", "aggressive", "silent", "repeated"};
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

}  // namespace alula
