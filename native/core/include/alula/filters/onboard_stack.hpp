// The stack of onboard filters with its map and fence, for host programs: the C code that the microcontroller runs.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "alula/cover/onboard_image.hpp"
#include "alula/filters/geofence.hpp"
#include "alula/filters/polytope_cbf.hpp"
#include "alula_stack.h"

namespace alula::flight {

struct OnboardStackSpec {
  std::shared_ptr<const OnboardImage> hulls;
  double extent_m = 0;
  PolytopeCbfConfig polytope_cbf;
  double lag_s = alula_stack_defaults().lag_s;
  alula_dr_acbf_config dr_acbf = alula_stack_defaults().dr_acbf;
  std::optional<Fence> fence;  // box and faces
};

// One copy per flight. Numbers are rounded to single precision: the radius up, the fence inward.
class OnboardStack {
 public:
  // Throws std::invalid_argument for a combination or parameters that the onboard code does not accept.
  explicit OnboardStack(const OnboardStackSpec& spec);
  OnboardStack(const OnboardStack&) = delete;
  OnboardStack& operator=(const OnboardStack&) = delete;

  void reset() { alula_stack_reset(stack_.get()); }
  // The pointer to tracks of `input` is that of the span.
  alula_stack_result filter(alula_stack_input input, std::span<const alula_track> tracks);
  const alula_stack& stack() const { return *stack_; }
  const alula_fence& fence() const { return fence_; }

 private:
  std::shared_ptr<const OnboardImage> hulls_;
  alula_fence fence_{};
  std::unique_ptr<alula_stack> stack_;
};

}  // namespace alula::flight
