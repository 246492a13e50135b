/* Distributionally robust acceleration barriers among moving obstacles, in freestanding C99.
 *
 * For a horizon H each obstacle that closes in allows the accelerations
 *
 *   n . a <= b(H) = 2 / H^2 (d - R_eff(H) - v_cl H - lambda sigma(H))
 *   R_eff  = R + v_max D + a_max D^2 / 2 + j_max H^3 / 6 + ahat H^2 / 2      (D: latency)
 *   sigma  = sqrt(n . (Sigma_e + Sigma_i) n + (H sigma_v)^2),  lambda = sqrt((1 - alpha) / alpha)
 *
 * that keep D + H D' + H^2 / 2 D'' >= 0 of the range less what is uncertain, with probability 1 - alpha of the
 * obstacle's share of the budget (Cantelli). Of the horizons at which these rows and |a|_inf <= a_max have a common
 * point the one with the largest least b is taken, and what the manoeuvre of alula_avoidance.h wishes is projected
 * on them. Without such a horizon the command misses the rows by the least that is possible, and after some ticks of
 * that the vehicle brakes and descends.
 *
 * A wall (a plane beyond which something static is) adds the row of its stopping distance,
 *   n . a <= (v_b - v) / dt,  v_b = sqrt(2 a_w max(0, distance - radius - room)) - a_w dt  along n towards it.
 *
 * What it does not give: the rows bound one step of H, and alone are recursively feasible only for closing speeds
 * below alula_dr_acbf_recursive_speed; beyond it the manoeuvre is what avoids.
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

#define ALULA_HORIZONS 16U /* of the search, at most */

typedef enum { ALULA_SOLVER_EXACT = 0, ALULA_SOLVER_GAUSS_SOUTHWELL } alula_dr_acbf_solver;

typedef struct {
  alula_avoidance_config avoidance;
  float v_max, j_max; /* of the vehicle, in R_eff [m/s, m/s^3] */
  float h_min_s;      /* the longest is that of `avoidance` */
  uint32_t horizons;  /* searched, evenly spaced */
  float risk;         /* alpha_total */
  float warned_risk;  /* factor of it in the tick that enters a manoeuvre, with the longest horizon */
  alula_dr_acbf_solver solver;
  uint32_t iterations;    /* of Gauss-Southwell */
  float relaxation;       /* its omega */
  float tolerance;        /* of rows, beyond which the command counts as a fallback [m/s^2] */
  uint32_t failing_ticks; /* before braking and descending */
  float descent_m_s;
  int rows_before_warning; /* 0, as printed: rows bind only in a manoeuvre. UNSAFE when the warning is late. */
  float wall_deceleration; /* a_w [m/s^2], below a_max */
} alula_dr_acbf_config;

alula_dr_acbf_config alula_dr_acbf_defaults(void);

typedef struct {
  alula_dr_acbf_config config;
  alula_avoidance avoidance;
  uint32_t failing; /* ticks in a row */
  alula_half_space row[ALULA_OBSTACLES + ALULA_WALLS];
  uint32_t row_count;
} alula_dr_acbf;

typedef struct {
  float a[3]; /* to fly; in the box in all cases but REFUSED, where it is 0 and must not be flown */
  alula_guidance guidance;
  float horizon_s; /* of the rows */
  int feasible;    /* the rows and the box had a common point at some horizon */
  uint32_t rows, iterations;
  float violation;  /* of the rows by a, -FLT_MAX without rows [m/s^2] */
  uint32_t failing; /* ticks in a row without a feasible horizon */
} alula_dr_acbf_result;

ALULA_MUST_USE alula_status alula_dr_acbf_init(alula_dr_acbf* filter, const alula_dr_acbf_config* config);
void alula_dr_acbf_reset(alula_dr_acbf* filter);

/* OK: the nominal, bit by bit. FILTERED: another command; all rows hold. RECOVERING: rows are missed, as little as
 * possible. REFUSED: bad input (see alula_avoidance_step); the state is as before. */
ALULA_MUST_USE alula_filter_status alula_dr_acbf_filter(alula_dr_acbf* filter, const alula_vehicle_state* vehicle,
                                                        const alula_track* track, uint32_t count,
                                                        const alula_wall* wall, uint32_t wall_count,
                                                        const float nominal[3], alula_dr_acbf_result* result);

/* The parts of a row, for what is compared with it. */
float alula_effective_clearance(const alula_dr_acbf_config* config, const alula_encounter* encounter,
                                float horizon_s);
float alula_row_bound(const alula_dr_acbf_config* config, const alula_encounter* encounter, float horizon_s,
                      float lambda);
float alula_cantelli(float alpha);
/* alpha_i of each active encounter; sums to `total`. The others get 0. */
void alula_allocate_risk(const alula_encounter* encounter, uint32_t count, float total, float* alpha);

/* Closing speed below which following a row from D = v H never asks for more than a_max along an axis. */
float alula_dr_acbf_recursive_speed(float a_max, float horizon_s);

#ifdef __cplusplus
}
#endif
#endif
