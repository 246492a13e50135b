/* The nearest point of half-spaces and a box in three dimensions, in freestanding C99.
 *
 *   minimise |a - a_0|^2   subject to   n_i . a <= b_i  (|n_i| = 1),  |a|_inf <= limit
 *
 * `alula_project_exact` adds the most violated constraint to a basis of at most three that are active and
 * projects on these; the distance grows with each step, so no basis comes twice. `alula_project_gauss_southwell`
 * is the iteration of DR-ACBF: it stops at a feasible point, not at the nearest, and need not get there.
 *
 * Source: Mandaokar, Rinner 2025 (DR-ACBF, arXiv 2512.00462), eq. 29, 30; Goldfarb, Idnani 1983.
 */
#ifndef ALULA_HALF_SPACES_H
#define ALULA_HALF_SPACES_H

#include "alula_onboard.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Times the limit: by how much rows are narrowed before the projection, so that it holds them as they are, rounding
 * and all. The point is then farther from a_0 than the nearest by at most margin / r times the diameter of the set,
 * where r is the radius of a ball in it; sets without a ball of that margin may be taken for empty. */
#define ALULA_HALF_SPACE_MARGIN 2.0e-5F

typedef struct {
  float normal[3]; /* of length 1 */
  float bound;
} alula_half_space;

typedef struct {
  float a[3];          /* in the box, always */
  float violation;     /* largest n_i . a - b_i, -FLT_MAX without rows */
  int feasible;        /* all rows hold: violation <= 0 in float; of Gauss-Southwell within the margin */
  uint32_t iterations; /* bounded by ALULA_PROJECTION_STEPS or the argument */
  /* Of the exact projection. Row i, or count + 2 axis + (1 for the upper face): what is active at a; without a
   * solution the constraints, four at most, that no point satisfies together (or too thin a set to tell). */
  uint32_t basis[4];
  uint32_t basis_count;
} alula_projection;

#define ALULA_PROJECTION_STEPS 64U

/* The nearest point; a_0 itself, bit by bit, when it obeys all. When there is none, `feasible` is 0 and a is the
 * point reached, cut off at the box. Rows and a_0 must be finite, limit positive; a_0 counts as no farther out than
 * 16 limits. `feasible` is checked at a, so never wrong. It is 0 for all sets that are empty, and for some without a
 * ball of radius ALULA_HALF_SPACE_MARGIN * limit. Cost: O(count) per step, about as many steps as rows are active. */
void alula_project_exact(const alula_half_space* row, uint32_t count, float limit, const float a0[3],
                         alula_projection* result);

/* At most `iterations` times a <- clip(a - omega (n_i . a - b_i) n_i) of the most violated row i. */
void alula_project_gauss_southwell(const alula_half_space* row, uint32_t count, float limit, float omega,
                                   uint32_t iterations, const float a0[3], alula_projection* result);

/* The point of the box that misses the first `soft` rows by the least, to 2 margins, while the others hold; of these
 * points the nearest to a_0. Where the others contradict each other, all rows count as soft. */
void alula_project_least_violation(const alula_half_space* row, uint32_t count, uint32_t soft, float limit,
                                   const float a0[3], alula_projection* result);

#ifdef __cplusplus
}
#endif
#endif
