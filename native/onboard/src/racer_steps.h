/* The model and the backup controller, inline for the loop of alula_geofence.c. Private. */
#ifndef ALULA_ONBOARD_RACER_STEPS_H
#define ALULA_ONBOARD_RACER_STEPS_H

#include "alula_racer.h"
#include "vector.h"

#define FADE 4.0F              /* one over the zeta below the horizon at which the ramps end */
#define STEEPEST 2.0F          /* 1 / zeta of a body on its side, */
#define INVERTED (1.0F / 3.0F) /* and of one upside down */
#define QUARTER 0.707106781F   /* w of a turn of 90 degrees */

/* cos and sin(x) / x from x^2, with an error below 1e-7 up to x = 1. */
static inline float cosine_of_square(float z) {
  return 1.0F - z * (0.5F - z * (1.0F / 24.0F - z * (1.0F / 720.0F - z * (1.0F / 40320.0F))));
}

static inline float sinc_of_square(float z) {
  return 1.0F - z * (1.0F / 6.0F - z * (1.0F / 120.0F - z * (1.0F / 5040.0F - z * (1.0F / 362880.0F))));
}

static inline float between(float x, float low, float high) { return x < low ? low : (x > high ? high : x); }

static inline float thrust_of(const alula_racer_model* model, float throttle) {
  return model->thrust[0] + throttle * (model->thrust[1] + throttle * model->thrust[2]);
}

static inline void axis_of(const float q[4], float axis[3]) {
  axis[0] = 2.0F * (q[1] * q[3] + q[0] * q[2]);
  axis[1] = 2.0F * (q[2] * q[3] - q[0] * q[1]);
  axis[2] = 1.0F - 2.0F * (q[1] * q[1] + q[2] * q[2]);
}

static inline void limit_command(const alula_racer_model* model, alula_racer_command* command) {
  command->throttle = between(command->throttle, 0.0F, 1.0F);
  ALULA_UNROLL
  for (int i = 0; i < 3; ++i) command->rates[i] = clipped(command->rates[i], model->max_rate[i]);
}

static inline float steepness(float zeta) {
  if (zeta >= 1.0F / STEEPEST) return 1.0F / zeta;
  return between(STEEPEST + (STEEPEST - INVERTED) * FADE * zeta, INVERTED, STEEPEST);
}

/* omega_des = -gain e_R for the desired attitude d. (w, x, y, z) = d* q; e_R = 2 w (x, y, z) */
static inline void attitude_rates(float attitude_gain, float dw, float dx, float dy, float dz, const float q[4],
                                  float rates[3]) {
  float w = dw * q[0] + dx * q[1] + dy * q[2] + dz * q[3];
  if (absolute(w) < QUARTER) w = w < 0.0F ? -QUARTER : QUARTER;
  const float gain = -2.0F * attitude_gain * w;
  rates[0] = gain * (dw * q[1] - dx * q[0] - dy * q[3] + dz * q[2]);
  rates[1] = gain * (dw * q[2] - dy * q[0] - dz * q[1] + dx * q[3]);
  rates[2] = gain * (dw * q[3] - dz * q[0] - dx * q[2] + dy * q[1]);
}

/* `zeta` is the third component of the axis. */
static inline void backup_command(const alula_racer_model* model, const alula_backup_gains* gains,
                                  const alula_backup_hold* hold, float hover, const alula_racer_state* state,
                                  float zeta, const float v_d[3], alula_racer_command* command) {
  const float* q = state->attitude;
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
  attitude_rates(gains->attitude_gain, dw, dx, dy, dz, q, command->rates);
  command->throttle = hover * steepness(zeta) +
                      clipped(gains->height_gain * (hold->height - state->position[2]), gains->most_throttle) +
                      clipped(gains->climb_gain * (v_d[2] - state->velocity[2]), gains->most_throttle);
  limit_command(model, command);
}

/* `axis` is that of the state, before and after. */
static inline float step_racer(const alula_racer_model* model, const alula_racer_step_size* step,
                               const alula_racer_command* command, float axis[3], alula_racer_state* state) {
  float after[3], half[3], square = 0.0F, norm_square = 0.0F;
  float* q = state->attitude;
  ALULA_UNROLL
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
  ALULA_UNROLL
  for (int i = 0; i < 4; ++i) norm_square += turned[i] * turned[i];
  const float unit = 1.5F - 0.5F * norm_square; /* 1 / sqrt near 1 */
  ALULA_UNROLL
  for (int i = 0; i < 4; ++i) q[i] = turned[i] * unit;
  axis_of(q, after);
  const float thrust = thrust_of(model, command->throttle);
  ALULA_UNROLL
  for (int i = 0; i < 3; ++i) {
    const float a = 0.5F * thrust * (axis[i] + after[i]) - (i == 2 ? model->gravity : 0.0F);
    state->position[i] += step->dt * (state->velocity[i] + 0.5F * step->dt * a);
    state->velocity[i] += step->dt * a;
    axis[i] = after[i];
  }
  return thrust;
}

#endif
