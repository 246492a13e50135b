#include "alula/filters/shield_filter.hpp"

#include <limits>
#include <utility>

namespace alula::flight {
namespace {

constexpr double kSeen = 1;  // clearances beyond this are not measured [m]

}  // namespace

ShieldFilter::ShieldFilter(const BackupPolicy& policy, Surroundings surroundings, const ShieldFilterOptions& options)
    : options_(options), shield_(policy, std::move(surroundings), options.shield_options) {}

FilterReport ShieldFilter::filter(const FlightState& state, const Nominal& nominal) {
  FilterReport report;
  const Quadrotor& vehicle = shield_.policy().vehicle();
  if (!is_usable(state, nominal)) return refused(vehicle);
  shield_.see(state);
  const double seen = shield_.radius() + kSeen, distance = shield_.distance(state.x.p, seen);
  report.margin = distance < seen ? distance - shield_.radius() : std::numeric_limits<double>::infinity();
  const bool admissible = vehicle.admissible(nominal.wrench);
  report.thrust_rate = nominal.thrust_rate;
  finish(&shield_, state.x, admissible ? nominal.wrench : vehicle.limited(nominal.wrench), SafetyStatus::ok,
         admissible ? SafetyStatus::ok : SafetyStatus::filtered, {}, report);
  return report;
}

}  // namespace alula::flight
