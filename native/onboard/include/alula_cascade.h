/* Throttle and body rates with which a racing drone follows a velocity with a lag, in freestanding C99.
 *
 *   a = (u - v) / lag, shortened to |a|_inf <= a_max;  thrust along the body's z axis: (a + g e3) . z
 *   omega_des = -gain e_R towards the attitude whose z axis is a + g e3, at the current yaw; plus the yaw rate
 *
 * The attitude itself takes time, so the vehicle's velocity follows later than by the lag alone: measure the lag of
 * the whole. e_R is that of alula_racer.h.
 */
#ifndef ALULA_CASCADE_H
#define ALULA_CASCADE_H

#include "alula_racer.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
  alula_racer_model model;
  float attitude_gain; /* [1/s] */
  float lag_s, a_max;
} alula_cascade_config;

/* Returns ALULA_BAD_PARAMETER unless the model's thrust can fly all accelerations: at least |(a_max, a_max, g +
 * a_max)| with a_max <= 0.95 g, where the thrust of a fall is well defined. */
ALULA_MUST_USE alula_status alula_cascade_check(const alula_cascade_config* config);

/* Returns ALULA_BAD_INPUT for a state that is not valid, or numbers that are not finite: hover throttle, no rates. */
ALULA_MUST_USE alula_status alula_cascade_follow(const alula_cascade_config* config, const alula_racer_state* state,
                                                 const float u[3], float yaw_rate_rad_s,
                                                 alula_racer_command* command);

#ifdef __cplusplus
}
#endif
#endif
