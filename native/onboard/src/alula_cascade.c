#include "alula_cascade.h"

#include "racer_steps.h"

#define MOST_FALL 0.95F     /* a_max / g */
#define FASTEST 1.0e6F      /* of velocities, so that no difference overflows */
#define LARGEST_GAIN 1.0e4F /* of the attitude, and 1 / lag */

alula_status alula_cascade_check(const alula_cascade_config* config) {
  if (!config) return ALULA_BAD_POINTER;
  const float a = config->a_max, g = config->model.gravity, force[3] = {a, a, g + a};
  if (!(config->lag_s * LARGEST_GAIN >= 1.0F && config->lag_s < FASTEST)) return ALULA_BAD_PARAMETER;
  if (!(config->attitude_gain > 0.0F && config->attitude_gain <= LARGEST_GAIN)) return ALULA_BAD_PARAMETER;
  if (!(a > 0.0F && g > 0.0F && g < FASTEST && a <= MOST_FALL * g)) return ALULA_BAD_PARAMETER;
  return alula_racer_thrust(&config->model, 1.0F) >= norm(force) ? ALULA_READY : ALULA_BAD_PARAMETER;
}

/* (u - v) / lag, shortened to |a|_inf <= a_max. */
static void accelerate(const alula_cascade_config* c, const float u[3], const float v[3], float a[3]) {
  float largest = 0.0F;
  for (int k = 0; k < 3; ++k) {
    a[k] = (u[k] - v[k]) / c->lag_s;
    if (absolute(a[k]) > largest) largest = absolute(a[k]);
  }
  const float scale = largest > c->a_max ? c->a_max / largest : 1.0F;
  for (int k = 0; k < 3; ++k) a[k] = clipped(scale * a[k], c->a_max);
}

static int is_usable(const float v[3]) {
  return absolute(v[0]) <= FASTEST && absolute(v[1]) <= FASTEST && absolute(v[2]) <= FASTEST; /* not for NaN */
}

alula_status alula_cascade_follow(const alula_cascade_config* config, const alula_racer_state* measured,
                                  const float u[3], float yaw_rate_rad_s, alula_racer_command* command) {
  if (!config || !command) return ALULA_BAD_POINTER;
  command->throttle = alula_racer_hover_throttle(&config->model);
  command->rates[0] = command->rates[1] = command->rates[2] = 0.0F;
  if (!measured || !u) return ALULA_BAD_POINTER;
  if (!alula_racer_state_is_valid(measured) || !is_usable(measured->velocity) || !is_usable(u) ||
      !alula_is_finite(yaw_rate_rad_s))
    return ALULA_BAD_INPUT;
  alula_racer_state state = *measured;
  float axis[3], force[3];
  accelerate(config, u, state.velocity, force);
  force[2] += config->model.gravity;
  alula_racer_normalise(&state);
  axis_of(state.attitude, axis);
  command->throttle = alula_racer_throttle_for(&config->model, dot(force, axis));
  const alula_backup_hold hold = alula_backup_hold_at(&state, 0.0F);
  const float inverse = 1.0F / norm(force); /* a_max leaves force[2] above 0 */
  const float bx = inverse * (hold.cosine * force[0] + hold.sine * force[1]);
  const float by = inverse * (hold.cosine * force[1] - hold.sine * force[0]);
  const float w = __builtin_sqrtf(0.5F + 0.5F * inverse * force[2]), half = 0.5F / w;
  /* q_d = (half_c, 0, 0, half_s) (w, -b_y / 2w, b_x / 2w, 0) */
  const float x = -half * by, y = half * bx;
  attitude_rates(config->attitude_gain, hold.half_c * w, hold.half_c * x - hold.half_s * y,
                 hold.half_c * y + hold.half_s * x, hold.half_s * w, state.attitude, command->rates);
  command->rates[2] += yaw_rate_rad_s;
  limit_command(&config->model, command);
  return ALULA_READY;
}
