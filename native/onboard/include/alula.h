/* Alula on board: safety filters in freestanding C99. This header includes all others.
 *
 *   map          alula_map_open             a cover in flash, written by `alula export COVER --target ...`
 *   tiles        alula_tiles_open           a cover in tiles, of which two are in memory: `alula export --tiles ...`
 *                alula_tiles_select
 *   polytope-cbf alula_polytope_cbf_open    velocity commands among the map's hulls
 *                alula_polytope_cbf_filter
 *   chord        alula_chord_open           the same for a vehicle that follows velocities with a lag
 *                alula_chord_filter
 *   dr-acbf      alula_dr_acbf_init         acceleration commands among moving obstacles and walls
 *                alula_dr_acbf_filter
 *   geofence     alula_geofence_init        throttle and rates of a pilot, inside a box or polytope, outside the map
 *                alula_geofence_filter
 *   stack        alula_stack_init           velocities of a vehicle that lags, among hulls and moving obstacles, in a
 *                alula_stack_filter         fence: one projection on all rows
 *
 * Every filter is a struct that the caller owns. Set-up checks every parameter and returns an alula_status; a tick
 * takes the state and the nominal input and returns a status and the command to fly. No heap, no recursion,
 * no library, no state outside the struct: one struct per thread. Inputs that are not finite or out of range are
 * refused.
 *
 * Capacity macros, with the same definition for all files: ALULA_PLANE_ROWS and ALULA_KEPT_HULLS (polytope-cbf),
 * ALULA_OBSTACLES and ALULA_WALLS (dr-acbf), ALULA_FENCE_FACES (geofence).
 */
#ifndef ALULA_H
#define ALULA_H

#include "alula_cascade.h"
#include "alula_chord.h"
#include "alula_dr_acbf.h"
#include "alula_geofence.h"
#include "alula_map.h"
#include "alula_polytope_cbf.h"
#include "alula_stack.h"
#include "alula_tiles.h"

#endif
