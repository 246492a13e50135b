// Onboard geofence for host programs, and the fence itself in double precision for judging flights.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "alula/dynamics/racer.hpp"
#include "alula/geometry/clearance.hpp"
#include "alula_geofence.h"

namespace alula::flight {

// Allowed region: in the box, in the polytope, outside the hulls of a map; at least one of them is given.
struct Fence {
  std::optional<geometry::Box> box;
  std::vector<std::array<double, 4>> faces;                // n . p <= d inside, unit n
  std::shared_ptr<const std::vector<std::uint8_t>> image;  // image of an onboard map, read by the filter
  const PolytopeSet* keep_out = nullptr;                   // the same polytopes, for judging; not owned

  // Minimum distance of the segment a..b from the box, the faces and the polytopes; negative outside the fence.
  double clearance(Vec3 a, Vec3 b) const;

  // The constraint that a vehicle at p with velocity v brakes for: `deciding` of the filter's result, or where no
  // face and no map decides, the face that a straight flight meets first; ALULA_GEOFENCE_NONE when it meets none.
  std::uint32_t braked_for(std::uint32_t deciding, Vec3 p, Vec3 v) const;
  // Distance of p from a constraint, numbered as in alula_fence.h; from the nearest one for ALULA_GEOFENCE_NONE.
  double distance_to(std::uint32_t constraint, Vec3 p) const;
};

// Box and faces for the onboard code, rounded to the safe side as below; without the map.
alula_fence to_onboard(const Fence& fence);

struct GeofenceReport {
  alula_geofence_status status = ALULA_GEOFENCE_REFUSED;
  RacerCommand command;  // the pilot's, bit by bit, when PASSED
  alula_geofence_result detail{};
};

alula_racer_model to_onboard(const RacerModel& model);
alula_racer_state to_onboard(const RacerState& x);
alula_racer_command to_onboard(const RacerCommand& u);
RacerCommand from_onboard(const alula_racer_command& u);

// Why the onboard code does not accept parameters, in one line with the limit that they violate; empty when it does.
std::string refusal(const alula_geofence_config& config);

// Copies share the map and each has its own state: use one copy per thread, also for evaluation. Numbers are rounded
// to the safe side: the box inward, faces by the float rounding error of their normals and of positions up to 1 km.
// Throws std::invalid_argument for a fence or parameters that the onboard code does not accept.
class Geofence {
 public:
  Geofence(const Fence& fence, const alula_geofence_config& config);
  Geofence(const Geofence& other) : Geofence(other.fence_, other.filter_.config) {}
  Geofence& operator=(const Geofence&) = delete;

  void reset() { alula_geofence_reset(&filter_); }
  GeofenceReport filter(const RacerState* navigation, const RacerCommand* pilot);

  // h_I of a flow that begins here. Throws std::invalid_argument for a state that the filter would refuse.
  alula_geofence_value evaluate(const RacerState& x) const;

  const alula_geofence_config& config() const { return filter_.config; }
  const Fence& fence() const { return fence_; }
  const alula_fence& onboard_fence() const { return onboard_; }  // as passed to the firmware
  double hover_throttle() const { return filter_.hover; }

 private:
  Fence fence_;
  alula_map map_{};
  alula_fence onboard_{};
  mutable alula_geofence filter_{};  // mutable: evaluation updates its map cache
};

}  // namespace alula::flight
