/* Safety filter for a velocity-controlled vehicle among convex polytopes, in freestanding C99.
 *
 * Obstacle k is {p : n_kl . p <= d_kl, l = 1..L_k} with unit outward normals n_kl.
 *
 *   psi_k(p) = max_l (n_kl . p - d_kl)        psi(p) = min_k psi_k(p)
 *
 * psi never exceeds the Euclidean distance to the obstacles and is 1-Lipschitz. The smooth version
 *
 *   s_k = (1/kappa) (log sum_l exp(kappa a_kl) - log L_k),  s = -(1/kappa) log sum_k exp(-kappa s_k)
 *
 * satisfies s <= psi everywhere; without the term log L_k (the printed form) it does not.
 * The filter returns the u nearest to u_nom with grad s . u >= -beta (s - r) and |u| <= v_max, and
 * then clips the step x + t u, 0 <= t <= dt, against every polytope grown by r (psi_k < r): what
 * is left of it keeps psi >= r at all times, not only at the samples. Where psi < r already, the step
 * out is clipped so that psi never becomes smaller than it is. With v_max dt kappa above 1 the
 * gradient turns within a step: still safe, but many steps are cut short near edges.
 *
 * Source: PolyMerge (arXiv 2606.16232), eq. 2, 3, 17; Molnar, CCTA 2025.
 * Frames and units: positions, planes and velocities in the map's frame; metres, seconds.
 * Cost: the planes of the hulls near enough to matter, and box tests: of an image with an index some per level
 * of the tree and hull near by, else of all hulls. `work` counts what a call did. At worst every hull matters.
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
#define ALULA_PLANE_ROWS 1024U /* decoded planes of an image that are kept, 16 bytes each; 261 hold any hull */
#endif
#ifndef ALULA_KEPT_HULLS
#define ALULA_KEPT_HULLS 16U /* at most, whose planes are kept; not above 31 */
#endif
#define ALULA_MAX_PLANES 16777216U /* counts must be exact in float */
#ifndef ALULA_NEAR_HULLS
#define ALULA_NEAR_HULLS 128U /* near enough to count in a tick that are listed; more of them take longer */
#endif
#if ALULA_KEPT_HULLS > 31U || ALULA_KEPT_HULLS < 1U || ALULA_PLANE_ROWS < 7U
#error "capacities out of range"
#endif
#define ALULA_NO_LIST 0xFFFFFFFFU

/* Read-only arrays of the caller's, in flash on a microcontroller.
 *
 * `plane` holds rows n_x, n_y, n_z, d whose offsets are so far outward that the float value of
 * n . p - d, for any p with |p_i| <= extent_m given rounded to float, is at most the true one.
 * `lower` and `upper` hold, per hull and axis, the offset of a plane of that hull whose normal is
 * -e_i or e_i (as -d and d); where there is none, -FLT_MAX and FLT_MAX. So the larger of
 * lower - p and p - upper bounds psi_k from below; a box that is only known to contain the hull
 * would not. `slack_m` bounds how much two float evaluations of psi at equally rounded positions
 * may differ. */
typedef struct {
  const float* plane;          /* plane_start[hull_count] rows of 4 */
  const uint32_t* plane_start; /* hull_count + 1 */
  const float* lower;          /* hull_count rows of 3 */
  const float* upper;          /* hull_count rows of 3 */
  uint32_t hull_count;
  float extent_m;
  float slack_m;
} alula_polytope_map;

/* What a call looked at. */
typedef struct {
  uint32_t boxes;        /* of nodes and hulls */
  uint32_t hulls;        /* times that planes of one were looked at */
  uint32_t planes;       /* of them, once per time */
  uint32_t made;         /* of these, decoded from the image */
  uint32_t exponentials; /* of planes */
} alula_polytope_work;

/* Made by alula_polytope_cbf_init or _open; the fields are not for the caller, but for `work`. */
typedef struct {
  alula_polytope_map map; /* without arrays when there is an image */
  alula_map image;        /* without data when there are arrays */
  alula_polytope_cbf_config config;
  float outward_m; /* what planes of the image are moved outward by */
  float inverse_kappa;
  float cutoff_m;       /* hulls this much farther than the nearest do not count */
  float max_lowering_m; /* largest log(L_k) / kappa */
  float crowd_m;        /* log(hulls) / kappa */
  int is_damaged;       /* the image is no longer what it was */
  alula_polytope_work work;
  uint32_t near_count; /* or ALULA_NO_LIST */
  float near_base_m;   /* psi may be up to this for the list to hold what matters */
  struct {
    uint32_t hull, record;
    float bound;
  } near[ALULA_NEAR_HULLS];
  uint32_t kept_count, row_count;
  uint32_t used, used_before; /* in this tick and the last: a bit for each of what is kept */
  struct {
    uint32_t hull, first;
  } kept[ALULA_KEPT_HULLS];
  float row[ALULA_PLANE_ROWS][4];
} alula_polytope_cbf;

typedef struct {
  float hard;        /* psi [m]; FLT_MAX without hulls */
  float smooth;      /* s [m] */
  float gradient[3]; /* of s */
  uint32_t nearest;  /* hull where psi is attained, the first of equals; ALULA_NO_HULL without hulls */
} alula_polytope_value;

typedef struct {
  float u[3];
  float margin_m;      /* s - r, or where the row cannot bind a bound below it */
  float hard_margin_m; /* psi - r */
  float fraction;      /* of the command that the step check left, 1 when untouched */
  uint32_t active;     /* as `nearest` */
} alula_polytope_result;

/* Check arrays and parameters and set up a filter; one per thread. Reads the whole map once. */
ALULA_MUST_USE alula_status alula_polytope_cbf_init(alula_polytope_cbf* cbf, const alula_polytope_map* map,
                                                    const alula_polytope_cbf_config* config);

/* The same for an open image, whose bytes stay where they are. Positions may lie up to extent_m from the origin
 * of each axis, and as far as the map does. ALULA_BAD_MAP when a hull has more planes than there are rows.
 *
 * A hull's planes are the six faces of its box and its oblique planes, made unit vectors in single precision and
 * moved outward, so that their value at p is at most the true one. With u = 2^-24, E the extent, n a unit normal
 * and S = |n_1| + |n_2| + |n_3| <= sqrt 3, so that |n . p|, |d| <= sqrt 3 E:
 *
 *   normal    root, quotient and product    3 u S E        offset    integer to float, g, its product, root,
 *   position  three roundings of p          3 u S E                  quotient, product              6 u |d|
 *   value     products, two sums            3 u S E        last difference          u (|n . p| + |d|)
 *
 * together 17 sqrt 3 u E = 29.5 u E, and 2 u E for adding what it is moved by: 64 u E = 2^-18 E. A hull whose box
 * has faces of its own that the cover's hull touches loses nothing by them: they contain it. */
ALULA_MUST_USE alula_status alula_polytope_cbf_open(alula_polytope_cbf* cbf, const alula_map* image, float extent_m,
                                                    const alula_polytope_cbf_config* config);

/* psi, its smooth version and gradient at x; ALULA_BAD_INPUT when x is not finite or beyond extent_m. */
ALULA_MUST_USE alula_status alula_polytope_cbf_evaluate(alula_polytope_cbf* cbf, const float x[3],
                                                        alula_polytope_value* value);

/* The safe velocity nearest to u_nom. Whatever is not finite or beyond the map is refused: u = 0. */
ALULA_MUST_USE alula_filter_status alula_polytope_cbf_filter(alula_polytope_cbf* cbf, const float x[3],
                                                             const float u_nom[3], alula_polytope_result* result);

#ifdef __cplusplus
}
#endif
#endif
