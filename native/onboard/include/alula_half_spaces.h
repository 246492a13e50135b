/* The nearest point in the intersection of half-spaces and a box in three dimensions, in freestanding C99.
 *
 *   minimise |a - a_0|^2   subject to   n_i . a <= b_i  (|n_i| = 1),  |a|_inf <= limit
 *
 * `alula_project_exact` adds the most violated constraint to a basis of at most three active ones and
 * projects on these; the distance grows with each step, so no basis repeats. `alula_project_gauss_southwell`
 * is the iteration of DR-ACBF: it stops at a feasible point, not at the nearest one, and may not reach any.
 *
 * Source: Mandaokar, Rinner 2025 (DR-ACBF, arXiv 2512.00462), eq. 29, 30; Goldfarb, Idnani 1983.
 */
#ifndef ALULA_HALF_SPACES_H
#define ALULA_HALF_SPACES_H

#include "alula_onboard.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Times the limit: the amount by which rows are tightened before the projection, so the result satisfies the original
 * rows despite rounding. The point is then farther from a_0 than the nearest by at most margin / r times the diameter
 * of the set, where r is the radius of a ball in it. Sets without a ball of that margin may count as empty. */
#define ALULA_HALF_SPACE_MARGIN 2.0e-5F

typedef struct {
  float normal[3]; /* of unit length */
  float bound;
} alula_half_space;

typedef struct {
  float a[3];          /* in the box, always */
  float violation;     /* largest n_i . a - b_i, -FLT_MAX without rows */
  int feasible;        /* all rows hold: violation <= 0 in float; for Gauss-Southwell within the margin */
  uint32_t iterations; /* bounded by ALULA_PROJECTION_STEPS or the argument */
  /* Of the exact projection: the constraints active at a, as row i, or count + 2 axis + (1 for the upper face).
   * Without a solution: the constraints, four at most, that no point satisfies together (or with too thin a set to
   * decide). */
  uint32_t basis[4];
  uint32_t basis_count;
} alula_projection;

#define ALULA_PROJECTION_STEPS 64U

/* The nearest point; a_0 itself, bit by bit, when it satisfies all constraints. When there is none, `feasible` is 0
 * and a is the point reached, clipped to the box. Rows and a_0 must be finite, limit positive; a_0 is first limited
 * to 16 limits. `feasible` is checked at a, so it is never wrong. It is 0 for all empty sets, and for some without a
 * ball of radius ALULA_HALF_SPACE_MARGIN * limit. Cost: O(count) per step, about as many steps as rows are active. */
void alula_project_exact(const alula_half_space* row, uint32_t count, float limit, const float a0[3],
                         alula_projection* result);

/* At most `iterations` times a <- clip(a - omega (n_i . a - b_i) n_i) for the most violated row i. */
void alula_project_gauss_southwell(const alula_half_space* row, uint32_t count, float limit, float omega,
                                   uint32_t iterations, const float a0[3], alula_projection* result);

/* The point of the box with the minimum violation of the first `soft` rows, to 2 margins, while the others hold;
 * among these points the nearest to a_0. Where the others contradict each other, all rows count as soft. */
void alula_project_least_violation(const alula_half_space* row, uint32_t count, uint32_t soft, float limit,
                                   const float a0[3], alula_projection* result);

#ifdef __cplusplus
}
#endif
#endif
