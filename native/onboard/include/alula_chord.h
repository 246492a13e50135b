/* Safety filter among convex polytopes for a vehicle that follows its velocity late, in freestanding C99.
 *
 * The vehicle follows a command u with a lag tau: dv/dt = (u - v) / tau. Its lead point q = p + tau v moves with
 * dq/dt = u, and p follows it, dp/dt = (q - p) / tau. While u = 0, p comes to rest along the chord from p to q.
 *
 * Hull k is psi_k(s) = max_l a_kl(s) <= 0 with a_kl(s) = n_kl . s - d_kl (alula_polytope_cbf.h). Let
 *
 *   D_k = min over s on the chord of psi_k(s).
 *
 * By the minimax theorem there are two planes of the hull, or one, of which a convex combination
 * a(s) = n . s - d is at least D_k on the whole chord, and equal to it at the minimum. As a <= psi_k everywhere and
 * |n| <= 1, the plane a = r separates the chord from the hull grown by r = D_k. Each hull gives the row
 *
 *   n . u >= -beta (D_k - r),
 *
 * and the filter returns the u nearest to the nominal one with all rows and |u| <= v_max.
 *
 * Guarantee, in discrete time. Let all D_k >= r, and let the vehicle follow u exactly as above for dt <= 1 / beta.
 * Then a(q + dt u) >= r, so a >= r at the corners of the triangle p, q, q + dt u, hence in it, because a is affine.
 * The path of p during dt and the chord at its end lie in the triangle. So psi_k >= r along the path, and D_k >= r
 * again: no hull is ever nearer than r, however many are near and whatever was wanted. u = 0 satisfies all rows.
 * A hull whose row could not bind at the speed limit, D_k >= r + v_max / beta, is left out.
 *
 * With e = dv/dt - (u - v) / tau, q moves with u + tau e: the vehicle keeps r - tau max|e| / beta. A lag that is
 * assumed too long is safe; one too short is not. With a lag of 0 the chord is the point p.
 *
 * A chord that has entered the margin of a hull (an estimate that jumped, a gust, a take-off) is driven out again:
 *
 *   p outside the margin   by the last of the planes that the chord crosses before it is inside: q returns to the
 *                          side of p, never through a thin wall
 *   p inside the margin    by the plane with the largest value at p
 *
 * with n . u >= min((r - a(q)) max(beta, 2 / tau), v_max / 2). These rows give way to each other and to no other row.
 * With `is_taking_off`, of a hull that holds p itself the planes whose normals point down are left out: a vehicle
 * that rests on a floor is not below it, even where the underside of the hull is nearer than its top.
 *
 * Rounding: plane values are at most the true ones; rows ask for r and the map's slack.
 * Cost: the planes of the hulls within r + v_max / beta + |tau v| of p, some passes each; `work` counts them. Of more
 * than ALULA_CHORD_ROWS rows the most urgent are kept, and the others limit the speed by their least row.
 *
 * Source: the chord is new here, see chord_filter.hpp; barrier: PolyMerge (arXiv 2606.16232).
 */
#ifndef ALULA_CHORD_H
#define ALULA_CHORD_H

#include "alula_half_spaces.h"
#include "alula_polytope_cbf.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ALULA_CHORD_ROWS
#define ALULA_CHORD_ROWS 24U
#endif
#if ALULA_CHORD_ROWS < 4U
#error "capacities out of range"
#endif

/* Initialised by alula_chord_open; the fields are private, except hulls.work. */
typedef struct {
  alula_polytope_cbf hulls; /* the map, its cache of planes, and radius, beta, dt and v_max; kappa is not used */
  float lag_s;
  uint32_t count;                         /* of rows in this tick, most urgent first */
  uint32_t soft;                          /* of them, those of hulls whose margin the chord has entered */
  alula_half_space row[ALULA_CHORD_ROWS]; /* normal . u <= bound */
  float spare[ALULA_CHORD_ROWS];          /* D_k - r */
} alula_chord;

/* Checks and sets up, as alula_polytope_cbf_open. ALULA_BAD_PARAMETER also for a lag outside of [0, 5] s. */
ALULA_MUST_USE alula_status alula_chord_open(alula_chord* chord, const alula_map* image, float extent_m,
                                             const alula_polytope_cbf_config* config, float lag_s);

/* The safe velocity nearest to u_nom at position x and velocity v. Inputs that are not finite, or a chord beyond the
 * map's extent, are refused: u = 0. `margin_m` is the minimum of D_k - r, `hard_margin_m` psi - r at x, where a hull
 * can matter; `fraction` the part of u left by the speed limit. */
ALULA_MUST_USE alula_filter_status alula_chord_filter(alula_chord* chord, const float x[3], const float v[3],
                                                      const float u_nom[3], int is_taking_off,
                                                      alula_polytope_result* result);

#ifdef __cplusplus
}
#endif
#endif
