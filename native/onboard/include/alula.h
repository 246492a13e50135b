/* Alula on board: safety filters in freestanding C99, one header for all.
 *
 *   map          alula_map_open             a cover in flash, written by `alula export COVER --target ...`
 *   polytope-cbf alula_polytope_cbf_open    velocity commands among the map's hulls
 *                alula_polytope_cbf_filter
 *   dr-acbf      alula_dr_acbf_init         acceleration commands among moving obstacles and walls
 *                alula_dr_acbf_filter
 *   geofence     alula_geofence_init        throttle and rates of a pilot, inside a box or polytope, outside the map
 *                alula_geofence_filter
 *
 * Every filter is a struct that the caller owns; set-up checks every parameter and gives an alula_status, a tick
 * takes the state and the nominal input and gives a status and what to fly. No heap, no recursion,
 * no library, no state but the struct: one struct per thread. What is not finite or out of range is refused.
 *
 * Capacities, to be defined alike for all files: ALULA_PLANE_ROWS and ALULA_KEPT_HULLS (polytope-cbf),
 * ALULA_OBSTACLES and ALULA_WALLS (dr-acbf), ALULA_FENCE_FACES (geofence).
 */
#ifndef ALULA_H
#define ALULA_H

#include "alula_dr_acbf.h"
#include "alula_geofence.h"
#include "alula_map.h"
#include "alula_polytope_cbf.h"

#endif
