/* Safety filter for a velocity-controlled vehicle among convex polytopes, in freestanding C99.
 *
 * Obstacle k is {p : n_kl . p <= d_kl, l = 1..L_k} with unit outward normals n_kl.
 *
 *   psi_k(p) = max_l (n_kl . p - d_kl)        psi(p) = min_k psi_k(p)
 *
 * psi never exceeds the Euclidean distance to the obstacles and is 1-Lipschitz. The smooth soft-min of soft-max
 *
 *   s_k = (1/kappa) (log sum_l exp(kappa a_kl) - log L_k),  s = -(1/kappa) log sum_k exp(-kappa s_k)
 *
 * satisfies s <= psi everywhere; without the term log L_k (the printed form) it does not.
 * The filter computes the u nearest to u_nom with grad s . u >= -beta (s - r) and |u| <= v_max, and
 * then clips the step x + t u, 0 <= t <= dt, against every polytope grown by r (psi_k < r): the
 * clipped step keeps psi >= r at all times, not only at the samples. Where psi < r already, the step
 * out is clipped so that psi never decreases. With v_max dt kappa above 1 the
 * gradient turns within a step: still safe, but many steps are shortened near edges.
 *
 * Source: PolyMerge (arXiv 2606.16232), eq. 2, 3, 17; Molnar, CCTA 2025.
 * Frames and units: positions, planes and velocities in the map's frame; metres, seconds.
 * Cost: the planes of the hulls near enough to matter, and box tests: with an index, some per level
 * of the tree and near hull, otherwise of all hulls. `work` counts the operations of a call. In the worst case every
 * hull matters.
 */
#ifndef ALULA_POLYTOPE_CBF_H
#define ALULA_POLYTOPE_CBF_H

#include "alula_map.h"
#include "alula_options.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_NO_HULL 0xFFFFFFFFU
#ifndef ALULA_PLANE_ROWS
#define ALULA_PLANE_ROWS 1024U /* cached decoded planes of an image, 16 bytes each; 261 suffice for any hull */
#endif
#ifndef ALULA_KEPT_HULLS
#define ALULA_KEPT_HULLS 16U /* maximum number of hulls with cached planes; not above 31 */
#endif
#define ALULA_MAX_PLANES 16777216U /* counts must be exact in float */
#ifndef ALULA_NEAR_HULLS
#define ALULA_NEAR_HULLS 128U /* listed hulls near enough to count in a tick; with more, a tick takes longer */
#endif
#if ALULA_KEPT_HULLS > 31U || ALULA_KEPT_HULLS < 1U || ALULA_PLANE_ROWS < 7U
#error "capacities out of range"
#endif
#define ALULA_NO_LIST 0xFFFFFFFFU

/* Read-only arrays that the caller owns, in flash on a microcontroller.
 *
 * `plane` holds rows n_x, n_y, n_z, d. The offsets are moved outward such that the float value of
 * n . p - d, for any p with |p_i| <= extent_m rounded to float, is at most the true one.
 * `lower` and `upper` hold, per hull and axis, the offset of the plane of that hull with the normal
 * -e_i or e_i (as -d and d), or -FLT_MAX and FLT_MAX where there is none. So the larger of
 * lower - p and p - upper bounds psi_k from below; a box that merely contains the hull
 * would not. `slack_m` bounds the difference of two float evaluations of psi at equally rounded
 * positions. */
typedef struct {
  const float* plane;          /* plane_start[hull_count] rows of 4 */
  const uint32_t* plane_start; /* hull_count + 1 */
  const float* lower;          /* hull_count rows of 3 */
  const float* upper;          /* hull_count rows of 3 */
  uint32_t hull_count;
  float extent_m;
  float slack_m;
} alula_polytope_map;

/* Work of a call. */
typedef struct {
  uint32_t boxes;        /* tested boxes of nodes and hulls */
  uint32_t hulls;        /* evaluations of the planes of a hull */
  uint32_t planes;       /* evaluated planes in total */
  uint32_t made;         /* of these, decoded from the image */
  uint32_t exponentials; /* of planes */
} alula_polytope_work;

/* Initialised by alula_polytope_cbf_init or _open; the fields are private, except `work`. */
typedef struct {
  alula_polytope_map map; /* without arrays when there is an image */
  alula_map image;        /* without data when there are arrays */
  alula_polytope_cbf_config config;
  float outward_m; /* distance by which planes of the image are moved outward */
  float inverse_kappa;
  float cutoff_m;       /* hulls this much farther than the nearest do not count */
  float max_lowering_m; /* largest log(L_k) / kappa */
  float crowd_m;        /* log(hulls) / kappa */
  int is_damaged;       /* the image has changed since it was opened */
  alula_polytope_work work;
  uint32_t near_count; /* or ALULA_NO_LIST */
  float near_base_m;   /* the list is complete for psi up to this */
  struct {
    uint32_t hull, record;
    float bound;
  } near[ALULA_NEAR_HULLS];
  uint32_t kept_count, row_count;
  uint32_t used, used_before; /* in this tick and the last: one bit per cached hull */
  struct {
    uint32_t hull, first;
  } kept[ALULA_KEPT_HULLS];
  float row[ALULA_PLANE_ROWS][4];
} alula_polytope_cbf;

typedef struct {
  float hard;        /* psi [m]; FLT_MAX without hulls */
  float smooth;      /* s [m] */
  float gradient[3]; /* of s */
  uint32_t nearest;  /* hull that attains psi, the first of equals; ALULA_NO_HULL without hulls */
} alula_polytope_value;

typedef struct {
  float u[3];
  float margin_m;      /* s - r, or a lower bound of it where the row cannot bind */
  float hard_margin_m; /* psi - r */
  float fraction;      /* of the command after the step check, 1 when unchanged */
  uint32_t active;     /* as `nearest` */
} alula_polytope_result;

/* Checks arrays and parameters and sets up a filter; one per thread. Reads the whole map once. */
ALULA_MUST_USE alula_status alula_polytope_cbf_init(alula_polytope_cbf* cbf, const alula_polytope_map* map,
                                                    const alula_polytope_cbf_config* config);

/* The same for an open image; its bytes must stay in place. Positions may lie up to extent_m from the origin
 * of each axis, and as far as the map does. ALULA_BAD_MAP when a hull has more planes than there are rows.
 *
 * A hull's planes are the six faces of its box and its oblique planes, normalised in single precision and
 * moved outward, so that their value at p is at most the true one. With u = 2^-24, E the extent, n a unit normal
 * and S = |n_1| + |n_2| + |n_3| <= sqrt 3, so that |n . p|, |d| <= sqrt 3 E:
 *
 *   normal    root, quotient and product    3 u S E        offset    integer to float, g, its product, root,
 *   position  three roundings of p          3 u S E                  quotient, product              6 u |d|
 *   value     products, two sums            3 u S E        last difference          u (|n . p| + |d|)
 *
 * together 17 sqrt 3 u E = 29.5 u E, and 2 u E for adding the outward move, which is 64 u E = 2^-18 E. The faces of
 * the box add planes but cut nothing off: they contain the cover's hull. */
ALULA_MUST_USE alula_status alula_polytope_cbf_open(alula_polytope_cbf* cbf, const alula_map* image, float extent_m,
                                                    const alula_polytope_cbf_config* config);

/* Continues on another image of the same cover with the same margin, such as the next tile (alula_tiles.h); O(1).
 * ALULA_BAD_MAP, and no change, when a hull of it has more planes than there are rows, or it reaches beyond the
 * extent of the filter. A later tick depends on the image and its inputs alone. */
ALULA_MUST_USE alula_status alula_polytope_cbf_move(alula_polytope_cbf* cbf, const alula_map* image);

/* A distance [m] such that no hull with psi_k > reach at x can change the command at x:
 *
 *   reach = r + v_max / beta + v_max dt + (18 + 2 log 261 + log 2^24) / kappa, and the rounding of these sums.
 *
 * The row binds only where s < r + v_max / beta. There psi < s + (log L + log n) / kappa, a hull counts in s only
 * with psi_k < psi + (18 + log L) / kappa, and the step is checked against hulls with psi_k < r + v_max dt. Where the
 * row does not bind, s is not computed or has no influence; margin_m, a lower bound there, may depend on other hulls.
 */
ALULA_MUST_USE float alula_polytope_cbf_reach(const alula_polytope_cbf* cbf);

/* psi, its smooth version and gradient at x; ALULA_BAD_INPUT when x is not finite or beyond extent_m. */
ALULA_MUST_USE alula_status alula_polytope_cbf_evaluate(alula_polytope_cbf* cbf, const float x[3],
                                                        alula_polytope_value* value);

/* The safe velocity nearest to u_nom. Inputs that are not finite or beyond the map are refused: u = 0. */
ALULA_MUST_USE alula_filter_status alula_polytope_cbf_filter(alula_polytope_cbf* cbf, const float x[3],
                                                             const float u_nom[3], alula_polytope_result* result);

#ifdef __cplusplus
}
#endif
#endif
