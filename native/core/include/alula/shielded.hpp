// How the filters of a quadrotor end a tick, with or without a shield.
#pragma once

#include "alula/shield.hpp"

namespace alula::flight {

inline bool is_usable(const FlightState& state, const Nominal& nominal) {
  return is_finite(state.x) && std::isfinite(state.thrust) && std::isfinite(state.thrust_rate) &&
         is_finite(nominal.wrench) && std::isfinite(nominal.thrust_rate) &&
         std::isfinite(nominal.thrust_acceleration) && geometry::is_finite(nominal.position_error) &&
         geometry::is_finite(nominal.velocity_error) && geometry::is_finite(nominal.reference_acceleration);
}

// Hover, for numbers that are not finite.
inline FilterReport refused(const Quadrotor& vehicle) {
  FilterReport report;
  report.status = SplatFilterStatus::refused;
  report.wrench = {vehicle.hover_thrust(), {}};
  return report;
}

// `wrench` holds all rows: returned as `certified_status` when the shield accepts it, or as `bare_status` unchecked
// without a shield. report.thrust_rate is that of `wrench`, and 0 when another is flown.
inline void finish(Shield* shield, const State& x, const Wrench& wrench, SplatFilterStatus bare_status,
                   SplatFilterStatus certified_status, std::span<const Found> near, FilterReport& report) {
  if (shield == nullptr) {
    report.wrench = wrench, report.status = bare_status;
  } else if (!shield->decide(x, wrench, certified_status, near, report)) {
    report.thrust_rate = 0;
  }
}

// No input holds all rows: the backup policy, or with `nominal` what the shield accepts between it and that.
inline void fly_backup(Shield* shield, const BackupPolicy& policy, const State& x, const Wrench* nominal,
                       std::span<const Found> near, FilterReport& report) {
  report.thrust_rate = 0;
  if (shield == nullptr) {
    report.wrench = policy(x), report.status = SplatFilterStatus::backup;
  } else if (nominal != nullptr) {
    shield->decide(x, policy.vehicle().limited(*nominal), SplatFilterStatus::backup, near, report);
  } else {
    shield->fall_back(x, near, report);
  }
}

}  // namespace alula::flight
