/* The permitted region of a drone: inside a box, inside a convex polytope, outside the hulls of a map, or all of
 * these.
 *
 *   h(p) = min( min_i (upper_i - p_i, p_i - lower_i), min_l (d_l - n_l . p), psi(p) )
 *
 * Along a flow a tracker keeps the minimum value of each face, and of the map. The minima are lower bounds: they
 * include the error of the flow at a node, `error`, and its distance from the chord between two nodes, `sag`. Over a
 * chord a face's value is linear; the map's value, which is 1-Lipschitz, is evaluated in short pieces. A distant map
 * costs nothing, because psi decreases no faster than the vehicle moves.
 *
 * Source: Singletary et al. 2022 (arXiv 2201.04331), eq. 16, 17; psi: alula_map.h.
 * One frame, metres, single precision; every loop is bounded by a constant or the number of faces or hulls.
 */
#ifndef ALULA_FENCE_H
#define ALULA_FENCE_H

#include "alula_map_near.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ALULA_FENCE_FACES
#define ALULA_FENCE_FACES 32U /* maximum of the polytope; define it smaller for a microcontroller */
#endif
#define ALULA_FENCE_BOX_FACES 6U
#define ALULA_FENCE_MAP (ALULA_FENCE_BOX_FACES + ALULA_FENCE_FACES) /* number of the map among the constraints */
#define ALULA_FENCE_CONSTRAINTS (ALULA_FENCE_MAP + 1U)
#define ALULA_FENCE_LOOKS 4U   /* stored evaluations: nodes are evaluated up to three times */
#define ALULA_FENCE_FAR 1.0e4F /* [m] largest coordinate of a fence and of a vehicle in it */

typedef struct {
  int has_box;
  float lower[3], upper[3];
  uint32_t face_count;              /* of the polytope; 0: no polytope */
  float face[ALULA_FENCE_FACES][4]; /* n, d: n . p <= d inside, |n| = 1 */
  const alula_map* keep_out;        /* null: no map; must live as long as the fence */
} alula_fence;

/* Checks that there is a fence, its numbers are in range and its box is not empty. */
ALULA_MUST_USE alula_status alula_fence_check(const alula_fence* fence);

/* psi at a position relative to the tracker's origin. */
typedef struct {
  float psi, at[3], normal[3];
} alula_fence_look;

/* Faces are numbered: 0 to 2 lower, 3 to 5 upper, then the polytope's, ALULA_FENCE_MAP for the map. */
typedef struct {
  const alula_fence* fence;
  alula_map_near* near;        /* cached part of the map, null without a map */
  float origin[3];             /* positions below are relative to it, which keeps small steps exact in float */
  float room[ALULA_FENCE_MAP]; /* distance of each face at the origin, minus the clearance */
  float clearance;             /* required from all constraints: radius and reserve */
  float push_distance, push_gain, push_speed;
  float least[ALULA_FENCE_CONSTRAINTS];
  float map_normal[3];                      /* away from the hull that decides least[ALULA_FENCE_MAP] */
  alula_fence_look look[ALULA_FENCE_LOOKS]; /* ring buffer of the last evaluations of the map */
  uint32_t newest, next;
  int damaged; /* the map could not be evaluated: nothing is safe */
} alula_fence_tracker;

/* Begins at `origin`, with the values there as minima. `near` is open for the fence's map, or null without a map. */
void alula_fence_begin(alula_fence_tracker* tracker, const alula_fence* fence, alula_map_near* near,
                       const float origin[3], float clearance, float push_distance, float push_gain,
                       float push_speed);

/* v_d at a position relative to the origin, (17): each face within push_distance pushes away from it with
 * cut(gain (push_distance - its distance), 0, speed). Along each axis the strongest push to either side counts. */
void alula_fence_push(alula_fence_tracker* tracker, const float at[3], float v_d[3]);

/* Follows the chord from one node to the next; `allowance` is the sag plus the larger error of the two ends. */
void alula_fence_follow(alula_fence_tracker* tracker, const float from[3], const float to[3], float allowance);

#ifdef __cplusplus
}
#endif
#endif
