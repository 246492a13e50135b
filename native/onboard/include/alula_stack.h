/* Safety filter among the hulls of a map, inside a fence and among moving obstacles, for a vehicle that follows its
 * velocity late, in freestanding C99.
 *
 * All rows are rows of one velocity u, and one projection finds the u nearest to the wanted one. The vehicle follows
 * with the lag tau, dv/dt = (u - v) / tau:
 *
 *   hulls       n . u >= -beta (D - r)       the rows of alula_chord.h, from the chord p to q = p + tau v
 *   fence       n . u <= beta (d - n . q - r)  each face of a box and of a polytope, as such a row
 *   obstacles   n . u <= n . v + k b         the row n . a <= b of alula_dr_acbf.h, with a = (u - v) / tau
 *   speed       |u| <= v_max
 *
 * a decays while u is held, so k = tau if b >= 0, and k = T / (1 - exp(-T / tau)) if b < 0: a is then at most b at
 * the start of the tick, or its mean over the tick T is.
 *
 * The rows of hulls and fence come first: u = 0 satisfies them all, unless the chord has entered a margin, and they
 * never give way to an obstacle. Where no horizon has a u for all rows, the rows of obstacles give way, by the
 * minimum violation in the box |u|_inf <= v_max, and the result is shortened to v_max. From inside a margin the
 * vehicle then drives out as if there were none.
 *
 * Guarantee. A vehicle of this lag that begins with its chord clear of all margins never comes nearer than `radius_m`
 * of polytope_cbf to a hull or to the fence, whatever is wanted and whatever flies around (proof: alula_chord.h; a
 * face is a plane that always separates). Each row of an obstacle holds, if the status is not RECOVERING, with
 * probability 1 - alpha over one horizon, under the conditions of alula_dr_acbf.h. A vehicle that is not of first
 * order keeps r - tau max|e| / beta, with e as there.
 *
 * Warning and manoeuvre are those of alula_avoidance.h: a manoeuvre's acceleration a means u = v + tau a. Its
 * directions count the chord's rows, the most urgent ALULA_WALLS of them, as walls.
 *
 * What is flown where no u is known:
 *
 *   the nominal command is not finite            as for a nominal command of zero: REFUSED
 *   tracks, covariance or too many obstacles     zero velocity, or out of the margin that the chord has entered;
 *     cannot be used                             obstacles are unknown: REFUSED
 *   position or velocity cannot be used, the     zero velocity: REFUSED
 *     map is damaged, too many hulls are near
 *   rows of obstacles that cannot hold           as above: RECOVERING; after `failing_ticks`, without a manoeuvre,
 *                                                `descent_m_s` downwards, as far as hulls and fence allow
 *
 * Each tick costs that of alula_chord_filter and of alula_dr_acbf_filter, and at most 7 projections on planes for
 * each horizon. One inertial frame, z up, the map's; SI units. All memory is in the struct.
 *
 * Source: the composition is new here; PolyMerge (arXiv 2606.16232), DR-ACBF (arXiv 2512.00462).
 */
#ifndef ALULA_STACK_H
#define ALULA_STACK_H

#include "alula_chord.h"
#include "alula_dr_acbf.h"
#include "alula_fence.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_STACK_CUTS 6U /* planes that replace the sphere |u| <= v_max where rows of obstacles are active */

typedef struct {
  alula_polytope_cbf_config polytope_cbf; /* radius, beta, dt and v_max; kappa is not used */
  float extent_m;                         /* as of alula_chord_open */
  float lag_s;                            /* tau */
  alula_dr_acbf_config dr_acbf;
} alula_stack_config;

/* For the Crazyflie: a lag of 0.35 s, 1 m/s. */
alula_stack_config alula_stack_defaults(void);

/* Initialised by alula_stack_init; the fields are private, except chord.hulls.work. */
typedef struct {
  int is_ready;
  float braking_lag_s; /* k for b < 0 */
  const alula_fence* fence;
  alula_chord chord;
  alula_dr_acbf dr_acbf;
  alula_half_space row[ALULA_OBSTACLES + ALULA_CHORD_ROWS + ALULA_STACK_CUTS];
} alula_stack;

typedef struct {
  float position[3], velocity[3];
  float covariance[6]; /* of the position: xx, xy, xz, yy, yz, zz */
  const alula_track* track;
  uint32_t track_count;
  float nominal[3];
  int is_taking_off; /* as of alula_chord_filter */
} alula_stack_input;

typedef struct {
  alula_filter_status status;
  float velocity[3];           /* the command */
  alula_polytope_result chord; /* its margins; faces of the fence count */
  alula_guidance guidance;     /* 0 where the obstacles are unknown */
  float horizon_s;             /* of the obstacles' rows */
  float violation_m_s;         /* the largest of the obstacles' rows; -FLT_MAX without one */
  uint32_t rows, obstacle_rows, failing;
} alula_stack_result;

/* `fence` is null, or lives as long as the stack; the hulls are those of the map, so it has no `keep_out`.
 *
 * Returns the status of alula_chord_open, alula_dr_acbf_init or alula_fence_check; ALULA_BAD_PARAMETER also for a
 * fence with a map, time steps that differ, a lag below a time step, and a vehicle that cannot follow as the lag
 * says, because 2 v_max > tau a_max. */
ALULA_MUST_USE alula_status alula_stack_init(alula_stack* stack, const alula_map* hulls, const alula_fence* fence,
                                             const alula_stack_config* config);

/* Continues on another image of the same cover, such as the next tile (alula_tiles.h); O(1). Status as
 * alula_polytope_cbf_move; no change unless it is ALULA_READY. */
ALULA_MUST_USE alula_status alula_stack_move(alula_stack* stack, const alula_map* hulls);

/* To before the first tick. */
void alula_stack_reset(alula_stack* stack);

/* One tick: call it once per time step, also without obstacles. Returns result->status. */
ALULA_MUST_USE alula_filter_status alula_stack_filter(alula_stack* stack, const alula_stack_input* input,
                                                      alula_stack_result* result);

#ifdef __cplusplus
}
#endif
#endif
