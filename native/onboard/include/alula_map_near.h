/* psi of a map at positions near one another: the bits of alula_map_evaluate, from what is remembered.
 *
 * Listed are the hulls whose boxes come within `limit` of a centre. As every psi_h is 1-Lipschitz, none that is not
 * listed decides psi at p as long as psi(p) + |p - centre| is below the limit; else the tree of the map's index finds
 * the hulls around p, and they are the new list. For a few hulls the planes are kept that decide psi_h within `reach`
 * of the place where all were looked at: at least psi_h - 2 reach there. All comparisons leave room for four times
 * the margin of alula_map_evaluate, of which the rounding of a value is less than half.
 *
 * A hull that is not the nearest is passed by for the plane that showed it to be farther the last time.
 *
 * So what is found does not depend on what is remembered. Without an index, or far from the last position, a call
 * takes as long as a search does.
 */
#ifndef ALULA_MAP_NEAR_H
#define ALULA_MAP_NEAR_H

#include "alula_map.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ALULA_LISTED_HULLS
#define ALULA_LISTED_HULLS 48U /* 44 bytes each; more of them than there is room for cost time */
#endif
#ifndef ALULA_NEAR_PLANES
#define ALULA_NEAR_PLANES 16U /* kept of a hull, 16 bytes each */
#endif
#define ALULA_NEAR_KEPT 8U /* hulls of which planes are kept */
#define ALULA_NEAR_FAR 64U /* hulls of which a plane is kept that shows them to be farther than others */
#if ALULA_LISTED_HULLS < 1U || ALULA_NEAR_PLANES < 1U
#error "capacities out of range"
#endif

typedef struct {
  uint32_t hull, record;
  float bound;              /* at most psi_h at the centre */
  uint32_t is_refined;      /* the bound is of its planes, not of its box alone */
  float lower[3], upper[3]; /* of its box [m] */
} alula_listed_hull;

/* A plane that showed a hull to be farther than another. */
typedef struct {
  uint32_t hull;
  float plane[4];
} alula_far_plane;

typedef struct {
  uint32_t hull, count, last; /* the last that was the largest */
  float at[3], reach_square;  /* negative: the planes are some of it, psi_h may be larger */
  float plane[ALULA_NEAR_PLANES][4];
} alula_kept_planes;

/* Made by alula_map_near_open; one per thread. */
typedef struct {
  const alula_map* map;
  float centre[3], limit;
  uint32_t count, last; /* listed; the last that decided */
  float thickness;      /* planes down to psi_h less this are tried to be kept */
  alula_listed_hull listed[ALULA_LISTED_HULLS];
  alula_kept_planes kept[ALULA_NEAR_KEPT], tried; /* while a hull is looked at */
  alula_far_plane far[ALULA_NEAR_FAR];
  float wide; /* hulls up to so much farther than the nearest are tried to be listed [m] */
} alula_map_near;

/* `map` lives as long as this; null for none. */
void alula_map_near_open(alula_map_near* near, const alula_map* map);

/* As alula_map_evaluate. */
ALULA_MUST_USE alula_map_status alula_map_near_evaluate(alula_map_near* near, const float x[3],
                                                        alula_map_value* value);

#ifdef __cplusplus
}
#endif
#endif
