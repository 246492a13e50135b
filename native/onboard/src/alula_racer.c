#include "alula_racer.h"

#include "vector.h"

#define LARGEST_POSITION 1.0e5F
#define LARGEST_SPEED 200.0F
#define LARGEST_RATE 100.0F
#define SHORT 1.0e-6F   /* of a squared length: no direction */
#define FADE 4.0F       /* one over the zeta below the horizon at which what jumped has faded */
#define STEEPEST 2.0F   /* 1 / zeta of a body on its side, */
#define INVERTED (1.0F / 3.0F) /* and of one upside down */

alula_backup_gains alula_backup_defaults(void) {
  alula_backup_gains gains;
  gains.tilt_gain = 0.15F;
  gains.max_tilt = 1.49599650F; /* pi / 2.1 */
  gains.attitude_gain = 10.0F;
  gains.height_gain = 0.1F;
  gains.climb_gain = 0.05F;
  gains.most_throttle = 0.3F;
  return gains;
}

/* cos and sin(x) / x from x^2; below 1e-7 off up to x = 1. */
static float cosine_of_square(float z) {
  return 1.0F - z * (0.5F - z * (1.0F / 24.0F - z * (1.0F / 720.0F - z * (1.0F / 40320.0F))));
}

static float sinc_of_square(float z) {
  return 1.0F - z * (1.0F / 6.0F - z * (1.0F / 120.0F - z * (1.0F / 5040.0F - z * (1.0F / 362880.0F))));
}

static float between(float x, float low, float high) { return x < low ? low : (x > high ? high : x); }

alula_racer_step_size alula_racer_step_of(const alula_racer_model* model, float dt) {
  alula_racer_step_size step;
  step.dt = dt;
  step.gain = 1.0F - alula_expf(-model->rate_gain * dt);
  step.mean = step.gain / (model->rate_gain * dt);
  return step;
}

float alula_racer_thrust(const alula_racer_model* model, float throttle) {
  return model->thrust[0] + throttle * (model->thrust[1] + throttle * model->thrust[2]);
}

/* 2 c / (b + sqrt(b^2 + 4 a c)) has no cancellation, and no division by a small a. */
float alula_racer_hover_throttle(const alula_racer_model* model) {
  const float c = model->gravity - model->thrust[0], b = model->thrust[1];
  const float root = __builtin_sqrtf(b * b + 4.0F * model->thrust[2] * c);
  return 2.0F * c / (b + root);
}

void alula_racer_axis(const float q[4], float axis[3]) {
  axis[0] = 2.0F * (q[1] * q[3] + q[0] * q[2]);
  axis[1] = 2.0F * (q[2] * q[3] - q[0] * q[1]);
  axis[2] = 1.0F - 2.0F * (q[1] * q[1] + q[2] * q[2]);
}

void alula_racer_limit(const alula_racer_model* model, alula_racer_command* command) {
  command->throttle = between(command->throttle, 0.0F, 1.0F);
  for (int i = 0; i < 3; ++i) command->rates[i] = clipped(command->rates[i], model->max_rate[i]);
}

int alula_racer_state_is_valid(const alula_racer_state* state) {
  float square = 0.0F;
  for (int i = 0; i < 3; ++i) { /* written so that NaN fails */
    if (!(absolute(state->position[i]) <= LARGEST_POSITION)) return 0;
    if (!(absolute(state->velocity[i]) <= LARGEST_SPEED)) return 0;
    if (!(absolute(state->rates[i]) <= LARGEST_RATE)) return 0;
  }
  for (int i = 0; i < 4; ++i) square += state->attitude[i] * state->attitude[i];
  return square >= 0.9025F && square <= 1.1025F;
}

int alula_racer_command_is_finite(const alula_racer_command* command) {
  return alula_is_finite(command->throttle) && alula_is_finite(command->rates[0]) &&
         alula_is_finite(command->rates[1]) && alula_is_finite(command->rates[2]);
}

/* yaw_0 is the turn about z of q = (turn about z) (turn about a horizontal axis): it has no singularity but upside
 * down, where any yaw is as good. */
alula_backup_hold alula_backup_hold_at(const alula_racer_state* state, float climb) {
  alula_backup_hold hold;
  const float* q = state->attitude;
  const float square = q[0] * q[0] + q[3] * q[3];
  hold.height = state->position[2] + climb;
  hold.half_c = 1.0F;
  hold.half_s = 0.0F;
  if (square > SHORT) {
    const float inverse = 1.0F / __builtin_sqrtf(square);
    hold.half_c = q[0] * inverse;
    hold.half_s = q[3] * inverse;
  }
  hold.cosine = hold.half_c * hold.half_c - hold.half_s * hold.half_s;
  hold.sine = 2.0F * hold.half_c * hold.half_s;
  return hold;
}

static float steepness(float zeta) {
  if (zeta >= 1.0F / STEEPEST) return 1.0F / zeta;
  return between(STEEPEST + (STEEPEST - INVERTED) * FADE * zeta, INVERTED, STEEPEST);
}

void alula_backup_command(const alula_racer_model* model, const alula_backup_gains* gains,
                          const alula_backup_hold* hold, float hover, const alula_racer_state* state,
                          const float v_d[3], alula_racer_command* command) {
  const float* q = state->attitude;
  const float zeta = 1.0F - 2.0F * (q[1] * q[1] + q[2] * q[2]);
  const float ex = v_d[0] - state->velocity[0], ey = v_d[1] - state->velocity[1];
  float tx = gains->tilt_gain * (hold->cosine * ex + hold->sine * ey);
  float ty = gains->tilt_gain * (hold->cosine * ey - hold->sine * ex);
  float square = tx * tx + ty * ty, scale = between(1.0F + FADE * zeta, 0.0F, 1.0F);
  if (square > gains->max_tilt * gains->max_tilt) scale *= gains->max_tilt / __builtin_sqrtf(square);
  tx *= scale;
  ty *= scale;
  square *= scale * scale;
  /* q_d = (half_c, 0, 0, half_s) (c, -s t_y, s t_x, 0) */
  const float c = cosine_of_square(0.25F * square), s = 0.5F * sinc_of_square(0.25F * square);
  const float dw = hold->half_c * c, dz = hold->half_s * c;
  const float dx = -s * (hold->half_c * ty + hold->half_s * tx);
  const float dy = s * (hold->half_c * tx - hold->half_s * ty);
  /* (w, x, y, z) = q_d* q; e_R = 2 w (x, y, z) */
  const float w = dw * q[0] + dx * q[1] + dy * q[2] + dz * q[3];
  const float gain = -2.0F * gains->attitude_gain * w;
  command->rates[0] = gain * (dw * q[1] - dx * q[0] - dy * q[3] + dz * q[2]);
  command->rates[1] = gain * (dw * q[2] - dy * q[0] - dz * q[1] + dx * q[3]);
  command->rates[2] = gain * (dw * q[3] - dz * q[0] - dx * q[2] + dy * q[1]);
  command->throttle = hover * steepness(zeta) +
                      clipped(gains->height_gain * (hold->height - state->position[2]), gains->most_throttle) +
                      clipped(gains->climb_gain * (v_d[2] - state->velocity[2]), gains->most_throttle);
  alula_racer_limit(model, command);
}

float alula_racer_step(const alula_racer_model* model, const alula_racer_step_size* step,
                       const alula_racer_command* command, alula_racer_state* state) {
  float before[3], after[3], half[3], square = 0.0F, norm_square = 0.0F;
  float* q = state->attitude;
  alula_racer_axis(q, before);
  for (int i = 0; i < 3; ++i) {
    const float away = state->rates[i] - command->rates[i];
    half[i] = 0.5F * step->dt * (command->rates[i] + away * step->mean);
    state->rates[i] -= away * step->gain;
    square += half[i] * half[i];
  }
  const float c = cosine_of_square(square), s = sinc_of_square(square);
  const float x = s * half[0], y = s * half[1], z = s * half[2];
  const float turned[4] = {q[0] * c - q[1] * x - q[2] * y - q[3] * z, q[0] * x + q[1] * c + q[2] * z - q[3] * y,
                           q[0] * y - q[1] * z + q[2] * c + q[3] * x, q[0] * z + q[1] * y - q[2] * x + q[3] * c};
  for (int i = 0; i < 4; ++i) norm_square += turned[i] * turned[i];
  const float unit = 1.5F - 0.5F * norm_square; /* 1 / sqrt near 1 */
  for (int i = 0; i < 4; ++i) q[i] = turned[i] * unit;
  alula_racer_axis(q, after);
  const float thrust = alula_racer_thrust(model, command->throttle);
  for (int i = 0; i < 3; ++i) {
    const float a = 0.5F * thrust * (before[i] + after[i]) - (i == 2 ? model->gravity : 0.0F);
    state->position[i] += step->dt * (state->velocity[i] + 0.5F * step->dt * a);
    state->velocity[i] += step->dt * a;
  }
  return thrust;
}
