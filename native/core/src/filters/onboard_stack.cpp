#include "alula/filters/onboard_stack.hpp"

#include <stdexcept>

#include "alula/filters/polytope_map.hpp"

namespace alula::flight {

OnboardStack::OnboardStack(const OnboardStackSpec& spec)
    : hulls_(spec.hulls), stack_(std::make_unique<alula_stack>()) {
  if (spec.fence) fence_ = to_onboard(*spec.fence);
  alula_stack_config config = alula_stack_defaults();
  config.polytope_cbf = to_onboard(spec.polytope_cbf);
  config.extent_m = round_up(spec.extent_m);
  config.lag_s = static_cast<float>(spec.lag_s);
  config.dr_acbf = spec.dr_acbf;
  if (alula_stack_init(stack_.get(), &hulls_->map(), spec.fence ? &fence_ : nullptr, &config) == ALULA_READY) return;
  throw std::invalid_argument(
      "a stack needs a map, equal time steps, a lag of at least one of them, 2 v_max <= lag * a_max, a fence of a "
      "box "
      "or of faces, and parameters that each part accepts");
}

alula_stack_result OnboardStack::filter(alula_stack_input input, std::span<const alula_track> tracks) {
  input.track = tracks.data();
  input.track_count = static_cast<std::uint32_t>(tracks.size());
  alula_stack_result result;
  (void)!alula_stack_filter(stack_.get(), &input, &result);
  return result;
}

}  // namespace alula::flight
