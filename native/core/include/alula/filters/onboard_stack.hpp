// The stack of onboard filters with its map and fence, for host programs: the C code that the microcontroller runs.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "alula/cover/onboard_image.hpp"
#include "alula/dynamics/racer.hpp"
#include "alula/filters/geofence.hpp"
#include "alula/filters/polytope_cbf.hpp"
#include "alula_stack.h"

namespace alula::flight {

// Parts are on when they are given. Defaults as those of alula_stack_defaults.
struct OnboardStackSpec {
  alula_stack_command takes = ALULA_STACK_VELOCITY, gives = ALULA_STACK_STICKS;
  std::shared_ptr<const OnboardImage> hulls;  // polytope-cbf
  double extent_m = 0;
  PolytopeCbfConfig polytope_cbf;
  std::optional<alula_dr_acbf_config> dr_acbf;
  const Geofence* geofence = nullptr;  // copied
  RacerModel model;                    // of the cascade without a geofence
  double velocity_gain = alula_stack_defaults().velocity_gain;
  std::uint32_t most_walls = alula_stack_defaults().most_walls;
};

// One copy per flight. Numbers are rounded to single precision: the radius up, the fence inward.
class OnboardStack {
 public:
  // Throws std::invalid_argument for a combination or parameters that the onboard code does not accept.
  explicit OnboardStack(const OnboardStackSpec& spec);
  OnboardStack(const OnboardStack&) = delete;
  OnboardStack& operator=(const OnboardStack&) = delete;

  void reset() { alula_stack_reset(stack_.get()); }
  // The pointers of `input` are those of the spans.
  alula_stack_result filter(alula_stack_input input, std::span<const alula_track> tracks,
                            std::span<const alula_wall> walls);
  const alula_stack_config& config() const { return stack_->config; }
  std::span<const alula_wall> walls(const alula_stack_result& result) const { return {stack_->wall, result.walls}; }

 private:
  std::shared_ptr<const OnboardImage> hulls_;
  std::unique_ptr<const Geofence> geofence_;  // owns the fence
  std::unique_ptr<alula_stack> stack_;
};

}  // namespace alula::flight
