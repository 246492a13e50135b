/* Geofencing by an implicit control barrier function: no gradient, no optimisation, in freestanding C99.
 *
 * With phi_k(x) the flow under the backup controller u_B (alula_racer.h, alula_fence.h):
 *
 *   h_I(x) = min( min_k h(phi_k(x)), h_B(phi_N(x)) ),  h_B = 40 (v_B - |v|)                               (7, 18)
 *   u = lambda u_des + (1 - lambda) u_B(x),  lambda = 0 where h_I <= 0                                     (8, 9)
 *   lambda = 1 - exp(-beta min_c max(h_c, 0) / v_c),  v_c = cut(speed towards c, 1, 10)                 (10, 19)
 *
 * c counts the faces of the fence, the map and, with v_c = 1, h_B, and h_c is the least of c along the flow. With one
 * face that is (19); with several it has no jump where another face becomes the nearest. v_c = 1 for all gives (10).
 * When lambda rounds to 1 the pilot's command is returned bit by bit. Of h_B counts h_B min(1, beta h_B / 16): less
 * than (10) while lambda would not round to 1, and flat at 0. A tick can change h_B, with its factor of 40, by 1;
 * lambda would go to and fro between pilot and backup.
 *
 * Hold. u_B steers to a height and a yaw frozen where the flow began; so they are state. They are frozen anew in
 * every tick with h_I > 0; as soon as h_I <= 0 the last ones are kept, so that what is flown with lambda = 0 is the
 * flow that was found safe, not another that begins again in every tick.
 *
 * Margin. The flow is integrated with steps dt and, beside it, 2 dt. The command is extrapolated to the middle of the
 * step, so the method is of second order, and of first where a limit of u_B begins or ends to act. Then the error of
 * the fine flow is |fine - coarse| / 3 or / 1 to leading order. Taken off at every node is
 *
 *   max over the nodes so far of |p_fine - p_coarse| + 2 dt |v_fine - v_coarse|
 *                     the full difference; with the velocities, and the maximum, as the two flows may cross. A flow
 *                     that was upside down is far from leading order (a turn of almost 180 degrees has no preferred
 *                     axis): there it counts up to five times, from 0.25 of the axis below the horizon on
 *   (T + g) dt^2 / 8  a node's chord may be left by that much
 *   |v| dt_s          u_B is held for a tick: at any time it is the one of at most a tick ago, as if the flow had
 *                     begun that much later
 *   (2 N + 64) u (E + 3 V)   each node is a sum of one with two roundings, u = 2^-24; E: coordinates, V: speed
 *
 * With these h_I is below that of the flow as flown, h_true. As h_true does not fall along u_B, and a command with
 * weight lambda <= beta h_I / v_c lowers it in a tick by at most lambda D, D = what the pilot alone could do in a
 * tick (some centimetres), h_true >= h_I (1 - beta D / v_c) > 0 in the tick in which u_B takes over. What the model
 * leaves out (mass, wind, delay) is for `reserve_m`. The bound is to leading order, not an enclosure.
 *
 * Without a pilot (null, or a number that is not finite) u_B is flown, with the hold of when he fell silent. Without
 * navigation (null, or not plausible) the model takes the last state on, and what it may be off by,
 * e = s t + a t^2 / 2, is taken off the margin; after stale_limit_s the outcome is HAND_OVER: a level attitude and
 * slightly too little throttle to hover, no fence any more, until navigation comes back.
 *
 * Source: Singletary, Swann, Chen, Ames 2022 (arXiv 2201.04331). Cost: 3 N / 2 steps of the model per tick, and the
 * faces; with a map psi near it.
 */
#ifndef ALULA_GEOFENCE_H
#define ALULA_GEOFENCE_H

#include "alula_fence.h"
#include "alula_racer.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_GEOFENCE_STEPS 400U  /* of a flow, at most */
#define ALULA_GEOFENCE_LATENCY 32U /* ticks, at most */
#define ALULA_GEOFENCE_NONE 0xFFFFFFFFU
#define ALULA_GEOFENCE_END 0xFFFFFFFEU /* h_B decides */

/* The published numbers with the model of the published flight code, 400 Hz. */
alula_geofence_config alula_geofence_defaults(void);

typedef enum {
  ALULA_GEOFENCE_PASSED = 0, /* the pilot's command, bit by bit */
  ALULA_GEOFENCE_BLENDED,
  ALULA_GEOFENCE_BACKUP,    /* h_I <= 0: u_B alone */
  ALULA_GEOFENCE_NO_PILOT,  /* u_B alone, with the hold of when he fell silent */
  ALULA_GEOFENCE_HAND_OVER, /* navigation is too old: level, sinking slowly; the fence is not guarded */
  ALULA_GEOFENCE_REFUSED    /* never any navigation, or no filter: the command is 0 and must not be flown */
} alula_geofence_status;

/* Made by alula_geofence_init; the fields are not for the caller. */
typedef struct {
  alula_geofence_config config;
  const alula_fence* fence;
  float hover;
  float extent; /* largest coordinate of the fence */
  alula_racer_step_size fine, coarse, tick;
  uint32_t latency;
  alula_racer_command sent[ALULA_GEOFENCE_LATENCY + 1U]; /* the last ones, as a ring */
  uint32_t newest;
  alula_racer_state state; /* as last known, or predicted */
  alula_backup_hold hold;
  int has_state, has_hold, silent;
  uint32_t stale;      /* ticks */
  alula_map_near near; /* decides what a tick costs, never what it gives */
} alula_geofence;

typedef struct {
  alula_racer_command command;
  float lambda;
  float h_i;         /* [m] with all margins off; -FLT_MAX when it was not evaluated */
  float distance_m;  /* h here, less the radius and the reserve */
  float margin_m;    /* taken off at the last node */
  uint32_t deciding; /* constraint with the least h_c / v_c, ALULA_GEOFENCE_END or ALULA_GEOFENCE_NONE */
  float v_towards;   /* its v_c */
  float stale_s;
} alula_geofence_result;

/* What h_I is made of; `first` is u_B at the start of the flow, `push` its v_d. */
typedef struct {
  float h_i, end, margin_m;
  float exponent; /* min_c h_c / v_c */
  uint32_t deciding;
  float v_towards;
  float distance_m;
  alula_racer_command first;
  float push[3];
} alula_geofence_value;

/* ALULA_BAD_PARAMETER unless all numbers mean something; `fence` lives as long as the filter. */
ALULA_MUST_USE alula_status alula_geofence_init(alula_geofence* filter, const alula_fence* fence,
                                                const alula_geofence_config* config);
void alula_geofence_reset(alula_geofence* filter); /* to before the first tick */

/* h_I of a state with a hold; `extra` is taken off as well. Changes nothing but what is remembered of the map. */
void alula_geofence_evaluate(alula_geofence* filter, const alula_racer_state* state, const alula_backup_hold* hold,
                             float extra, alula_geofence_value* value);

/* The hold a flow from here begins with: this yaw, and this height moved by the push of (17). */
alula_backup_hold alula_geofence_hold(alula_geofence* filter, const alula_racer_state* state);

/* One tick. `navigation` and `pilot` may be null. A pilot's command outside the limits is cut to them first. */
ALULA_MUST_USE alula_geofence_status alula_geofence_filter(alula_geofence* filter,
                                                           const alula_racer_state* navigation,
                                                           const alula_racer_command* pilot,
                                                           alula_geofence_result* result);

#ifdef __cplusplus
}
#endif
#endif
