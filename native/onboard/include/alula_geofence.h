/* Geofencing by an implicit control barrier function (implicit CBF, h_I) and a regulation function (lambda): no
 * gradient, no optimisation, in freestanding C99.
 *
 * With phi_k(x) the flow under the backup controller u_B (alula_racer.h, alula_fence.h):
 *
 *   h_I(x) = min( min_k h(phi_k(x)), h_B(phi_N(x)) ),  h_B = 40 (v_B - |v|)                               (7, 18)
 *   u = lambda u_des + (1 - lambda) u_B(x),  lambda = 0 where h_I <= 0                                     (8, 9)
 *   lambda = 1 - exp(-beta min_c max(h_c, 0) / v_c),  v_c = cut(speed towards c, 1, 10)                 (10, 19)
 *
 * lambda is the regulation function. c runs over the faces of the fence, the map and, with v_c = 1, h_B; h_c is the
 * minimum of c along the flow. With one face this is (19); with several it does not jump where another face becomes
 * the nearest. v_c = 1 for all gives (10). When lambda rounds to 1 the pilot's command is returned bit by bit. h_B
 * enters as h_B min(1, beta h_B / 16): less than (10) while lambda would not round to 1, and flat at 0. With its
 * factor of 40, h_B can change by 1 in a tick, and lambda would otherwise oscillate between pilot and backup.
 *
 * Hold. u_B steers to a height and a yaw that are frozen at the start of the flow, so they are state. They are frozen
 * again in every tick with h_I > 0. Once h_I <= 0 the last ones are kept, so the flight with lambda = 0 follows
 * the flow that was found safe, not another one that starts in every tick.
 *
 * Margin. The flow is integrated with steps dt and, in parallel, 2 dt. The command is extrapolated to the middle of
 * the step, so the method is of second order, and of first where a limit of u_B becomes active or inactive. Then the
 * error of the fine flow is |fine - coarse| / 3 or / 1 to leading order. The margin subtracted at every node is
 *
 *   max over the nodes so far of |p_fine - p_coarse| + 2 dt |v_fine - v_coarse|
 *                     the full difference, including velocities and the maximum because the two flows may cross. A
 *                     flow that was upside down is far from leading order (a turn of almost 180 degrees has no
 *                     preferred axis): there it counts up to five times, from 0.25 of the axis below the horizon on
 *   (T + g) dt^2 / 8  maximum distance of the flow from the chord between nodes
 *   |v| dt_s          u_B is held for a tick: at any time it is at most a tick old, as if the flow had
 *                     begun that much later
 *   (2 N + 64) u (E + 3 V)   each node adds a term with two roundings, u = 2^-24; E: coordinates, V: speed
 *
 * With this margin h_I is below the value of the true flow, h_true. h_true does not decrease along u_B. A command
 * with weight lambda <= beta h_I / v_c lowers it in a tick by at most lambda D, where D is the decrease by the pilot
 * alone in a tick (some centimetres). So h_true >= h_I (1 - beta D / v_c) >= 0 in the tick in which u_B takes over.
 *
 * Conditions. The argument needs two, which alula_geofence_init checks by flows of the model in free space:
 *
 *   rest              the horizon is long enough for u_B, and its gains are such, that what is left of the motion at
 *                     its end dies out: from v_B (at least 1 m/s), forward, up and down, less than half is left in
 *                     the last quarter of the horizon, and from upside down zeta is above 0.8 there. Otherwise a flow
 *                     that ends inside with |v| < v_B, as (18) demands, may leave after its end.
 *   beta D / v_c <= 1 D is the decrease of the reach by a tick of the pilot: at slow_m_s, fast_m_s and its multiples
 *                     from which the horizon suffices, forward (level, and tilted as far as u_B tilts, both ways), up
 *                     and down, by no or full throttle and no or full pitch rate.
 *
 * These are samples of an upright vehicle, not a bound. Upside down D can be some metres, because a turn of almost
 * 180 degrees has no preferred axis; and at high speed a tick can raise |v_N| above v_B. The conditions exclude
 * neither: that the fence holds there is shown by random flights only.
 *
 * Effects that the model omits (mass, wind, delay) must be covered by `reserve_m`. The bound is to leading order, not
 * an enclosure.
 *
 * Without a pilot (null, or a number that is not finite) u_B is flown, with the hold from the time of the loss.
 * Without navigation (null, or not plausible) the model predicts from the last state, and the bound of the prediction
 * error, e = s t + a t^2 / 2, is added to the margin. After stale_limit_s the outcome is HAND_OVER: a level attitude
 * and slightly too little throttle to hover, without a fence, until navigation returns.
 *
 * Source: Singletary, Swann, Chen, Ames 2022 (arXiv 2201.04331). Cost: 3 N / 2 steps of the model per tick, the
 * faces, and psi near a map.
 */
#ifndef ALULA_GEOFENCE_H
#define ALULA_GEOFENCE_H

#include "alula_fence.h"
#include "alula_racer.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_GEOFENCE_STEPS 400U  /* maximum of a flow */
#define ALULA_GEOFENCE_LATENCY 32U /* maximum, in ticks */
#define ALULA_GEOFENCE_NONE 0xFFFFFFFFU
#define ALULA_GEOFENCE_END 0xFFFFFFFEU /* h_B decides */

/* The published numbers with the model of the published flight code, 400 Hz. */
alula_geofence_config alula_geofence_defaults(void);

typedef enum {
  ALULA_GEOFENCE_PASSED = 0, /* the pilot's command, bit by bit */
  ALULA_GEOFENCE_BLENDED,
  ALULA_GEOFENCE_BACKUP,    /* h_I <= 0: u_B alone */
  ALULA_GEOFENCE_NO_PILOT,  /* u_B alone, with the hold from the time of the loss */
  ALULA_GEOFENCE_HAND_OVER, /* navigation is too old: level, sinking slowly; the fence is not enforced */
  ALULA_GEOFENCE_REFUSED    /* no navigation so far, or no filter: the command is 0 and must not be flown */
} alula_geofence_status;

/* Initialised by alula_geofence_init; the fields are private. */
typedef struct {
  alula_geofence_config config;
  const alula_fence* fence;
  float hover;
  float extent; /* largest coordinate of the fence */
  alula_racer_step_size fine, coarse, tick;
  uint32_t latency;
  alula_racer_command sent[ALULA_GEOFENCE_LATENCY + 1U]; /* ring buffer of the last commands */
  uint32_t newest;
  alula_racer_state state; /* last received, or predicted */
  alula_backup_hold hold;
  int has_state, has_hold, silent;
  uint32_t stale;      /* ticks */
  alula_map_near near; /* affects the cost of a tick, never its result */
} alula_geofence;

typedef struct {
  alula_racer_command command;
  float lambda;
  float h_i;         /* [m] with all margins subtracted; -FLT_MAX when it was not evaluated */
  float distance_m;  /* current h, minus the radius and the reserve */
  float margin_m;    /* subtracted at the last node */
  uint32_t deciding; /* constraint with the minimum h_c / v_c, ALULA_GEOFENCE_END or ALULA_GEOFENCE_NONE */
  float v_towards;   /* its v_c */
  float stale_s;
} alula_geofence_result;

/* The terms of h_I; `first` is u_B at the start of the flow, `push` its v_d. */
typedef struct {
  float h_i, end, margin_m;
  float exponent; /* min_c h_c / v_c */
  uint32_t deciding;
  float v_towards;
  float distance_m;
  alula_racer_command first;
  float push[3];
} alula_geofence_value;

/* What the two conditions of the guarantee depend on, from flows of the model in free space. */
typedef struct {
  float rest_m_s, most_rest_m_s; /* speed left in the last quarter of the horizon, from the end speed; its limit */
  float upright, least_upright;  /* zeta reached by that time, from upside down; its limit */
  float lost_s;                  /* maximum of D / v_c: decrease of h_c by the pilot alone in a tick, over v_c */
  float most_beta;               /* 1 / lost_s, the limit of beta */
} alula_geofence_conditions;

/* Examines parameters: about 220 flows, as long as 150 ticks. Returns ALULA_BAD_PARAMETER unless all numbers are in
 * range, ALULA_NO_REST unless rest_m_s < most_rest_m_s and upright > least_upright, ALULA_TOO_LATE unless beta <=
 * most_beta; with the last two, `conditions` is valid. */
ALULA_MUST_USE alula_status alula_geofence_examine(const alula_geofence_config* config,
                                                   alula_geofence_conditions* conditions);

/* Returns ALULA_BAD_PARAMETER unless all numbers are in range, ALULA_NO_REST or ALULA_TOO_LATE unless the conditions
 * hold, see alula_geofence_examine; `fence` must live as long as the filter. */
ALULA_MUST_USE alula_status alula_geofence_init(alula_geofence* filter, const alula_fence* fence,
                                                const alula_geofence_config* config);
void alula_geofence_reset(alula_geofence* filter); /* to before the first tick */

/* Call it after `keep_out` of the fence was set to another image of the same cover, such as the next tile
 * (alula_tiles.h); O(1). */
void alula_geofence_move(alula_geofence* filter);

/* h_I of a state with a hold; `extra` is subtracted as well. Changes only the cached part of the map. */
void alula_geofence_evaluate(alula_geofence* filter, const alula_racer_state* state, const alula_backup_hold* hold,
                             float extra, alula_geofence_value* value);

/* The hold of a flow that starts here: this yaw, and this height moved by the push of (17). */
alula_backup_hold alula_geofence_hold(alula_geofence* filter, const alula_racer_state* state);

/* One tick. `navigation` and `pilot` may be null. A pilot's command outside the limits is clipped to them first. */
ALULA_MUST_USE alula_geofence_status alula_geofence_filter(alula_geofence* filter,
                                                           const alula_racer_state* navigation,
                                                           const alula_racer_command* pilot,
                                                           alula_geofence_result* result);

#ifdef __cplusplus
}
#endif
#endif
