/* Distributionally robust acceleration barriers among moving obstacles, in freestanding C99.
 *
 * For a horizon H each approaching obstacle allows the accelerations
 *
 *   n . a <= b(H) = 2 / H^2 (d - R_eff(H) - v_cl H - lambda sigma(H))
 *   R_eff  = R + v_max D + a_max D^2 / 2 + j_max H^3 / 6 + ahat H^2 / 2      (D: latency)
 *   sigma  = sqrt(n . (Sigma_e + Sigma_i) n + (H sigma_v)^2),  lambda = sqrt((1 - alpha) / alpha)
 *
 * that keep D + H D' + H^2 / 2 D'' >= 0, where D is the range minus its uncertainty, with probability 1 - alpha,
 * where alpha is the obstacle's part of the risk budget (Cantelli). Among the horizons at which these rows and
 * |a|_inf <= a_max have a common point, the filter uses the one with the largest minimum b and projects the command
 * of the manoeuvre of alula_avoidance.h on the rows. Without such a horizon the command violates the rows by the
 * minimum possible amount. After some ticks of that the vehicle brakes and descends, as far as walls allow, unless a
 * manoeuvre is flying to the bypass point (a fast obstacle is dodged, not waited for).
 *
 * A wall (a plane with a static obstacle behind it) adds a row, with x the remaining distance, v the speed towards
 * it, both predicted by the lag L, and s = sqrt(2 a_w max(0, x)):
 *
 *   n . a <= (s - v) / (dt + L) - a_w
 *
 * L = 0: a vehicle with v <= s never reaches the wall, and a_w always satisfies the row. Proof over a tick,
 * with v' = v + n.a dt and x' = x - (v + v') dt / 2: v' <= v + (s - v) - a_w dt = s - a_w dt, as dt / (dt + L) <= 1.
 * So 2 a_w x' >= s^2 - a_w dt (2 s - a_w dt) = (s - a_w dt)^2, hence x' >= 0, and v' <= s' whether s >= a_w dt or v'
 * < 0. The row never requires n . a below -a_w, as v <= s. Within a tick x is smallest at its ends, or, for
 * v' < 0 < v, at least x - v^2 dt / (2 (v - v')) >= x - v^2 dt / (2 (v + a_w dt - s)) >= x - s^2 / (2 a_w) = 0.
 * L > 0: a command that acts L later acts on the predicted state. The same proof applies if the prediction is no
 * farther from the wall and no slower than the vehicle will be. It uses the larger of the commanded acceleration and
 * the acceleration that the jerk limit allows along n, held for latency + (a + a_w) / (2 j_max): an acceleration that
 * falls to -a_w at the rate j_max is never ahead, in v or x, of one that stays for half that time and then jumps.
 *
 * The proof covers one wall. Rows of walls that meet have a common point in the box if n_i . a <= -a_w have one: for
 * walls at right angles, in any orientation, if a_w sqrt(3) <= a_max. In narrower corners they may not, and then the
 * vehicle can hit a wall. Also, a command that waits for longer than the next tick is not stored, so with a latency
 * of many ticks the prediction may be slower than the vehicle will be; up to 0.1 s wall_room_m has compensated this.
 *
 * Limits of the guarantee: the rows bound one step of H. Alone they are recursively feasible only for closing speeds
 * below alula_dr_acbf_recursive_speed; above it, the manoeuvre avoids the collision.
 *
 * Source: Mandaokar, Rinner 2025 (DR-ACBF, arXiv 2512.00462), eq. 16 to 30.
 */
#ifndef ALULA_DR_ACBF_H
#define ALULA_DR_ACBF_H

#include "alula_avoidance.h"
#include "alula_half_spaces.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_HORIZONS 16U /* maximum of the search */

alula_dr_acbf_config alula_dr_acbf_defaults(void);

typedef void (*alula_projector)(void* context, const alula_half_space* row, uint32_t count, float limit,
                                const float a0[3], alula_projection* result);

typedef struct {
  alula_dr_acbf_config config;
  alula_avoidance avoidance;
  uint32_t failing;                                    /* ticks in a row */
  float executed[3];                                   /* the commanded acceleration, limited by the jerk limit */
  alula_half_space row[ALULA_OBSTACLES + ALULA_WALLS]; /* of obstacles, then of walls */
  uint32_t row_count;
  float lambda[ALULA_OBSTACLES];
  alula_projector projector; /* replaces the solver, for comparisons; set it after init */
  void* projector_context;
} alula_dr_acbf;

typedef struct {
  float a[3]; /* the command, in the box; for REFUSED it is 0 and must not be flown */
  alula_guidance guidance;
  float horizon_s; /* of the rows */
  int feasible;    /* the rows and the box had a common point at some horizon */
  uint32_t rows, iterations;
  float violation;  /* largest violation of the rows by a; -FLT_MAX without rows [m/s^2] */
  uint32_t failing; /* ticks in a row without a feasible horizon */
} alula_dr_acbf_result;

ALULA_MUST_USE alula_status alula_dr_acbf_init(alula_dr_acbf* filter, const alula_dr_acbf_config* config);
void alula_dr_acbf_reset(alula_dr_acbf* filter);

/* OK: the nominal command, bit by bit. FILTERED: another command; all rows hold. RECOVERING: rows are violated by the
 * minimum amount, those of walls last. REFUSED: bad input (see alula_avoidance_step); the state is unchanged. The
 * caller then brakes, or holds the last command for a tick or two if the input is expected to return, and reports the
 * flown command with alula_dr_acbf_flown: the next prediction and the rows of walls use it. */
ALULA_MUST_USE alula_filter_status alula_dr_acbf_filter(alula_dr_acbf* filter, const alula_vehicle_state* vehicle,
                                                        const alula_track* track, uint32_t count,
                                                        const alula_wall* wall, uint32_t wall_count,
                                                        const float nominal[3], alula_dr_acbf_result* result);

/* Reports the command flown in this tick if it is not the filter's: once after each refusal. Ignored unless finite.
 */
void alula_dr_acbf_flown(alula_dr_acbf* filter, const float command[3]);

/* The row of a wall for a vehicle with this velocity. The vehicle may still execute an old acceleration while a
 * command lags: towards the wall the larger of `executed` and `commanded` counts. */
alula_half_space alula_wall_row(const alula_dr_acbf_config* config, const alula_wall* wall, const float velocity[3],
                                const float executed[3], const float commanded[3]);

/* `executed` follows `command` for a tick, as fast as the jerk limit allows. */
void alula_execute(const alula_dr_acbf_config* config, const float command[3], float executed[3]);

/* The terms of a row, for filters compared with this one: effective clearance R_eff, bound b, Cantelli's lambda. */
float alula_effective_clearance(const alula_dr_acbf_config* config, const alula_encounter* encounter,
                                float horizon_s);
float alula_row_bound(const alula_dr_acbf_config* config, const alula_encounter* encounter, float horizon_s,
                      float lambda);
float alula_cantelli(float alpha);
/* Risk allocation: alpha_i of each encounter with a row; sums to the risk budget `total`. The others get 0. */
void alula_allocate_risk(const alula_encounter* encounter, uint32_t count, float total, float* alpha);

/* Closing speed below which following a row from D = v H never requires more than a_max along an axis. */
float alula_dr_acbf_recursive_speed(float a_max, float horizon_s);

#ifdef __cplusplus
}
#endif
#endif
