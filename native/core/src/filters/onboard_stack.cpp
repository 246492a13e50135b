#include "alula/filters/onboard_stack.hpp"

#include <stdexcept>

#include "alula/filters/polytope_map.hpp"

namespace alula::flight {

namespace {

alula_stack_config config_of(const OnboardStackSpec& spec) {
  alula_stack_config c = alula_stack_defaults();
  c.parts = (spec.hulls ? 1U << ALULA_STACK_POLYTOPE_CBF : 0U) | (spec.dr_acbf ? 1U << ALULA_STACK_DR_ACBF : 0U) |
            (spec.geofence != nullptr ? 1U << ALULA_STACK_GEOFENCE : 0U);
  c.takes = spec.takes;
  c.gives = spec.gives;
  c.polytope_cbf = to_onboard(spec.polytope_cbf);
  c.extent_m = round_up(spec.extent_m);
  if (spec.dr_acbf) c.dr_acbf = *spec.dr_acbf;
  if (spec.geofence != nullptr) {
    c.geofence = spec.geofence->config();
  } else {
    c.geofence.model = to_onboard(spec.model);
  }
  c.velocity_gain = static_cast<float>(spec.velocity_gain);
  c.most_walls = spec.most_walls;
  return c;
}

}  // namespace

OnboardStack::OnboardStack(const OnboardStackSpec& spec)
    : hulls_(spec.hulls),
      geofence_(spec.geofence != nullptr ? std::make_unique<const Geofence>(*spec.geofence) : nullptr),
      stack_(std::make_unique<alula_stack>()) {
  const alula_stack_config config = config_of(spec);
  const alula_status status = alula_stack_init(stack_.get(), hulls_ ? &hulls_->map() : nullptr,
                                               geofence_ ? &geofence_->onboard_fence() : nullptr, &config);
  if (status == ALULA_READY) return;
  if (status == ALULA_BAD_MAP) throw std::invalid_argument("the map is not valid");
  throw std::invalid_argument(
      "a stack needs parts between what it takes and gives, equal time steps, a velocity gain of 4 beta to 1 / dt, "
      "behind a velocity loop dr-acbf or a geofence with a map to keep polytope-cbf's hulls, thrust for every "
      "acceleration within a_max <= 0.95 g, and parameters that each part accepts");
}

alula_stack_result OnboardStack::filter(alula_stack_input input, std::span<const alula_track> tracks,
                                        std::span<const alula_wall> walls) {
  input.track = tracks.data();
  input.track_count = static_cast<std::uint32_t>(tracks.size());
  input.wall = walls.data();
  input.wall_count = static_cast<std::uint32_t>(walls.size());
  alula_stack_result result;
  (void)!alula_stack_filter(stack_.get(), &input, &result);
  return result;
}

}  // namespace alula::flight
