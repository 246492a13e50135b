/* psi of a map at positions near one another: the same bits as alula_map_evaluate, from a cache.
 *
 * The cache lists the hulls with boxes within `limit` of a centre. Every psi_h is 1-Lipschitz, so no other hull
 * decides psi at p as long as psi(p) + |p - centre| is below the limit; otherwise the tree of the map's index finds
 * the hulls around p for a new list. For a few hulls the cache keeps the planes that can decide psi_h within `reach`
 * of the position where all were evaluated: those with at least psi_h - 2 reach there. All comparisons have a slack
 * of four times the margin of alula_map_evaluate; the rounding of a value is less than half of that margin.
 *
 * A hull that is not the nearest is skipped by the plane that showed it to be farther the last time.
 *
 * So the result does not depend on the cache. Without an index, or far from the last position, a call takes as long
 * as a search.
 */
#ifndef ALULA_MAP_NEAR_H
#define ALULA_MAP_NEAR_H

#include "alula_map.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ALULA_LISTED_HULLS
#define ALULA_LISTED_HULLS 48U /* 44 bytes each; if more hulls are near, calls take longer */
#endif
#ifndef ALULA_NEAR_PLANES
#define ALULA_NEAR_PLANES 16U /* kept of a hull, 16 bytes each */
#endif
#define ALULA_NEAR_KEPT 8U /* hulls with cached planes */
#define ALULA_NEAR_FAR 64U /* hulls with one cached plane that shows them to be farther than others */
#if ALULA_LISTED_HULLS < 1U || ALULA_NEAR_PLANES < 1U
#error "capacities out of range"
#endif

typedef struct {
  uint32_t hull, record;
  float bound;              /* at most psi_h at the centre */
  uint32_t is_refined;      /* the bound is computed from its planes, not from its box alone */
  float lower[3], upper[3]; /* of its box [m] */
} alula_listed_hull;

/* A plane that showed a hull to be farther than another. */
typedef struct {
  uint32_t hull;
  float plane[4];
} alula_far_plane;

typedef struct {
  uint32_t hull, count, last; /* last: the plane that was the largest last time */
  float at[3], reach_square;  /* negative: only some of the planes, psi_h may be larger */
  float plane[ALULA_NEAR_PLANES][4];
} alula_kept_planes;

/* Initialised by alula_map_near_open; one per thread. */
typedef struct {
  const alula_map* map;
  float centre[3], limit;
  uint32_t count, last; /* number of listed hulls; the one that decided last */
  float thickness;      /* planes down to psi_h minus this are candidates for the cache */
  alula_listed_hull listed[ALULA_LISTED_HULLS];
  alula_kept_planes kept[ALULA_NEAR_KEPT], tried; /* tried: scratch for the hull being evaluated */
  alula_far_plane far[ALULA_NEAR_FAR];
  float wide; /* hulls up to this much farther than the nearest are candidates for the list [m] */
} alula_map_near;

/* `map` must live as long as the cache; null for none. */
void alula_map_near_open(alula_map_near* near, const alula_map* map);

/* Same result as alula_map_evaluate. */
ALULA_MUST_USE alula_map_status alula_map_near_evaluate(alula_map_near* near, const float x[3],
                                                        alula_map_value* value);

#ifdef __cplusplus
}
#endif
#endif
