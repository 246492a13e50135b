#include "teensy_velocity.h"

#define WHOLE 1.0e-3F /* tolerance of the number of periods in a time step */

alula_teensy_velocity_config alula_teensy_velocity_defaults(void) {
  const alula_geofence_config fence = alula_geofence_defaults();
  alula_teensy_velocity_config config;
  config.stack = alula_stack_defaults();
  config.stack.polytope_cbf.dt_s = config.stack.dr_acbf.avoidance.dt_s = 0.02F;
  config.stack.polytope_cbf.radius_m = 0.5F;
  config.stack.dr_acbf.avoidance.radius_m = 0.25F;
  config.cascade.model = fence.model;
  config.cascade.attitude_gain = fence.backup.attitude_gain;
  config.cascade.lag_s = 0.22F;
  config.cascade.a_max = config.stack.dr_acbf.avoidance.a_max;
  config.speed_m_s = config.climb_m_s = config.stack.polytope_cbf.v_max;
  return config;
}

alula_status alula_teensy_velocity_init(alula_teensy_velocity* velocity, const alula_map* hulls,
                                        const alula_fence* fence, float tick_s,
                                        const alula_teensy_velocity_config* config) {
  if (!velocity || !hulls || !fence || !config) return ALULA_BAD_POINTER;
  const float periods = config->stack.polytope_cbf.dt_s / tick_s;
  if (!(periods >= 1.0F - WHOLE && periods <= 1000.0F)) return ALULA_BAD_PARAMETER;
  velocity->period = (uint32_t)(periods + 0.5F);
  const float off = periods - (float)velocity->period;
  if (!(off <= WHOLE && off >= -WHOLE)) return ALULA_BAD_PARAMETER;
  if (!(config->speed_m_s >= 0.0F && config->speed_m_s <= 100.0F)) return ALULA_BAD_PARAMETER;
  if (!(config->climb_m_s >= 0.0F && config->climb_m_s <= 100.0F)) return ALULA_BAD_PARAMETER;
  velocity->config = *config;
  velocity->fence = *fence;
  velocity->fence.keep_out = 0;
  const int has_faces = fence->has_box || fence->face_count > 0U;
  alula_status status = alula_cascade_check(&config->cascade);
  if (status == ALULA_READY)
    status = alula_stack_init(&velocity->stack, hulls, has_faces ? &velocity->fence : 0, &config->stack);
  if (status != ALULA_READY) return status;
  velocity->track = 0;
  velocity->track_count = 0U;
  alula_teensy_velocity_reset(velocity);
  return ALULA_READY;
}

void alula_teensy_velocity_reset(alula_teensy_velocity* velocity) {
  velocity->has_state = velocity->has_command = 0;
  velocity->ticks = velocity->age = 0U;
  alula_stack_reset(&velocity->stack);
}

static void filter(alula_teensy_velocity* velocity, const float stick[3]) {
  const alula_teensy_velocity_config* c = &velocity->config;
  const alula_backup_hold yaw = alula_backup_hold_at(&velocity->state, 0.0F);
  const float ahead = c->speed_m_s * stick[0], right = c->speed_m_s * stick[1];
  alula_stack_input in;
  for (int k = 0; k < 3; ++k) {
    in.position[k] = velocity->state.position[k];
    in.velocity[k] = velocity->state.velocity[k];
  }
  for (int k = 0; k < 6; ++k) in.covariance[k] = 0.0F; /* the radius has the errors of position */
  in.track = velocity->track;
  in.track_count = velocity->track_count;
  in.nominal[0] = yaw.cosine * ahead + yaw.sine * right;
  in.nominal[1] = yaw.sine * ahead - yaw.cosine * right;
  in.nominal[2] = c->climb_m_s * stick[2];
  in.is_taking_off = 0;
  (void)!alula_stack_filter(&velocity->stack, &in, &velocity->result); /* refused: zero velocity */
  for (int k = 0; k < 3; ++k) velocity->u[k] = velocity->result.velocity[k];
}

const alula_racer_command* alula_teensy_velocity_tick(alula_teensy_velocity* velocity,
                                                      const alula_racer_state* navigation, const float stick[3],
                                                      float yaw_rate_rad_s) {
  ++velocity->age;
  if (navigation && alula_racer_state_is_valid(navigation)) {
    velocity->state = *navigation;
    velocity->has_state = 1;
    velocity->age = 0U;
  }
  if (!velocity->has_state || velocity->age > velocity->period) {
    velocity->has_command = 0;
    velocity->ticks = 0U;
    return 0;
  }
  if (velocity->ticks == 0U) filter(velocity, stick);
  velocity->ticks = (velocity->ticks + 1U) % velocity->period;
  if (velocity->age == 0U || !velocity->has_command)
    velocity->has_command = alula_cascade_follow(&velocity->config.cascade, &velocity->state, velocity->u,
                                                 yaw_rate_rad_s, &velocity->command) == ALULA_READY;
  return velocity->has_command ? &velocity->command : 0;
}
