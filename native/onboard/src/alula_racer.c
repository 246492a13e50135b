#include "alula_racer.h"

#include "racer_steps.h"

#define LARGEST_POSITION 1.0e5F
#define LARGEST_SPEED 200.0F
#define LARGEST_RATE 100.0F
#define SHORT 1.0e-6F /* squared length below which a direction is undefined */

alula_backup_gains alula_backup_defaults(void) {
  const alula_backup_gains gains = ALULA_BACKUP_GAINS_DEFAULTS;
  return gains;
}

alula_racer_step_size alula_racer_step_of(const alula_racer_model* model, float dt) {
  alula_racer_step_size step;
  step.dt = dt;
  step.gain = 1.0F - alula_expf(-model->rate_gain * dt);
  step.mean = step.gain / (model->rate_gain * dt);
  return step;
}

/* 2 c / (b + sqrt(b^2 + 4 a c)) avoids cancellation and the division by a small a. */
float alula_racer_throttle_for(const alula_racer_model* model, float thrust) {
  const float c = thrust - model->thrust[0], b = model->thrust[1];
  if (!(c > 0.0F)) return 0.0F;
  const float root = __builtin_sqrtf(b * b + 4.0F * model->thrust[2] * c);
  return 2.0F * c / (b + root);
}

float alula_racer_hover_throttle(const alula_racer_model* model) {
  return alula_racer_throttle_for(model, model->gravity);
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

void alula_racer_normalise(alula_racer_state* state) {
  float* q = state->attitude;
  const float inverse = 1.0F / __builtin_sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int i = 0; i < 4; ++i) q[i] *= inverse;
}

int alula_racer_command_is_finite(const alula_racer_command* command) {
  return alula_is_finite(command->throttle) && alula_is_finite(command->rates[0]) &&
         alula_is_finite(command->rates[1]) && alula_is_finite(command->rates[2]);
}

/* yaw_0 is the turn about z of q = (turn about z) (turn about a horizontal axis). Its only singularity is upside
 * down, where any yaw is equally good. */
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

float alula_racer_thrust(const alula_racer_model* model, float throttle) { return thrust_of(model, throttle); }

void alula_racer_axis(const float attitude[4], float axis[3]) { axis_of(attitude, axis); }

void alula_racer_limit(const alula_racer_model* model, alula_racer_command* command) {
  limit_command(model, command);
}

void alula_backup_command(const alula_racer_model* model, const alula_backup_gains* gains,
                          const alula_backup_hold* hold, float hover, const alula_racer_state* state,
                          const float v_d[3], alula_racer_command* command) {
  float axis[3];
  axis_of(state->attitude, axis);
  backup_command(model, gains, hold, hover, state, axis[2], v_d, command);
}

float alula_racer_step(const alula_racer_model* model, const alula_racer_step_size* step,
                       const alula_racer_command* command, alula_racer_state* state) {
  float axis[3];
  axis_of(state->attitude, axis);
  return step_racer(model, step, command, axis, state);
}
