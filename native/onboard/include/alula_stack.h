/* The filters of a vehicle, one after the other, behind one entry point, in freestanding C99.
 *
 *   velocity      polytope-cbf   hulls of the map, for a single integrator
 *                 velocity loop  a = gain (v - v_now), shortened to |a|_inf <= a_max
 *   acceleration  dr-acbf        moving obstacles; walls: planes of the near hulls, faces of the fence
 *                 cascade        thrust along the body axis, attitude error to body rates, as u_B of alula_racer.h
 *   sticks        geofence       box, polytope and map, for throttle and body rates
 *
 * `takes` is the kind of the nominal command, `gives` that of the result, at or below it. Parts that are off are left
 * out: a part that is alone, without a loop before or behind it, gives the bits of its own call.
 *
 * Walls. Each hull is behind its plane with the largest n . p - d, at the distance psi_k <= the true one. Hulls and
 * fence faces farther away than a row of dr-acbf can bind at this speed (alula_wall_row) are left out. Of the others
 * the stack passes on the `most_walls` before which the vehicle could stop from the least additional speed
 *
 *   sqrt(2 a_w (distance - radius - room)) + n . v        (n towards the vehicle)
 *
 * and of planes with one normal the nearest. The walls of the caller come first and are always passed on.
 *
 * Guarantees, each under the conditions at the head of the part's own header:
 *
 *   polytope-cbf   a vehicle that flies exactly the velocity never comes closer than the radius
 *   dr-acbf        no wall is hit while the walls' rows have a common point; each row of an obstacle holds with
 *                  probability 1 - alpha over one horizon
 *   geofence       h_I >= 0: the vehicle can always stop inside
 *
 * In the stack only the last part keeps its guarantee, whatever the parts before it command, because nothing changes
 * its command any more. A geofence that is on is the last part. For the parts before it nothing is proven:
 *
 * polytope-cbf is made for a vehicle that changes its velocity at once. Behind a velocity loop it hits hulls, also
 * when flown slowly: it limits the velocity towards the nearest hull, so another one that becomes the nearest may be
 * met too fast. The stack accepts it there only with dr-acbf, whose walls count every near hull, or with a geofence
 * that keeps out of a map. It also demands gain >= 4 beta: a vehicle with v' = gain (v_cmd - v) then does not
 * overshoot towards a single plane. That no hull is hit then is tested, not proven.
 *
 * dr-acbf may leave the row of polytope-cbf to avoid an obstacle; the rows of the walls then limit the speed towards
 * the hulls. It does not know walls beyond `most_walls` (see `walls_are_full`). With sticks the acceleration lags by
 * the attitude, which its rows do not model: latency_s, j_max and wall_room_m must cover that, and only tests can
 * show that they do.
 *
 * The geofence knows no moving obstacle, and may fly back into the way of one.
 *
 * Refusals. The status of the stack is the worst of its parts; REFUSED also for a nominal command that is not finite
 * or not of the kind `takes`. Then nothing of it is flown, and no earlier command again:
 *
 *   polytope-cbf   zero velocity
 *   dr-acbf        an acceleration that brakes as the velocity loop would towards zero velocity, projected on
 *                  the rows of the walls that the stack found; zero if the velocity is not finite
 *   cascade        without a valid state: hover throttle and zero rates; before a geofence, no pilot
 *   geofence       without a pilot u_B; without navigation its prediction, then its hand-over; before the
 *                  first navigation no throttle, as alone
 *
 * The parts behind one that refuses filter what it gives. Outcomes of the geofence: PASSED is OK, BLENDED is
 * FILTERED, BACKUP and NO_PILOT are RECOVERING, HAND_OVER and REFUSED are REFUSED.
 *
 * One inertial frame, z up, the map's; SI units; quaternions w, x, y, z, body to world. Cost: the sum of the parts,
 * and the planes of the hulls that may be walls. All memory is in the struct, also that of parts that are off.
 */
#ifndef ALULA_STACK_H
#define ALULA_STACK_H

#include "alula_dr_acbf.h"
#include "alula_geofence.h"
#include "alula_polytope_cbf.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Parts, in their order; in `parts` of the configuration as bits. */
typedef enum { ALULA_STACK_POLYTOPE_CBF = 0, ALULA_STACK_DR_ACBF, ALULA_STACK_GEOFENCE } alula_stack_part;
#define ALULA_STACK_PARTS 3U

typedef enum { ALULA_STACK_VELOCITY = 0, ALULA_STACK_ACCELERATION, ALULA_STACK_STICKS } alula_stack_command;

typedef struct {
  uint32_t parts; /* bits 1 << alula_stack_part */
  alula_stack_command takes, gives;
  alula_polytope_cbf_config polytope_cbf;
  float extent_m;                 /* of alula_polytope_cbf_open */
  alula_dr_acbf_config dr_acbf;   /* its a_max limits the velocity loop too */
  alula_geofence_config geofence; /* model and attitude gain also for the cascade, and if the geofence is off */
  float velocity_gain;            /* [1/s] */
  uint32_t most_walls;            /* that the stack finds; at most ALULA_WALLS */
} alula_stack_config;

/* All parts, from velocities to sticks, at 100 Hz. */
alula_stack_config alula_stack_defaults(void);

/* Initialised by alula_stack_init; the fields are private. */
typedef struct {
  alula_stack_config config;
  int is_ready;
  float hover; /* throttle */
  alula_polytope_cbf polytope_cbf;
  alula_dr_acbf dr_acbf;
  alula_geofence geofence;
  alula_wall wall[ALULA_WALLS]; /* of the tick */
} alula_stack;

typedef struct {
  alula_racer_state state; /* without sticks only position and velocity are read */
  float covariance[6];     /* of the position: xx, xy, xz, yy, yz, zz */
  const alula_track* track;
  uint32_t track_count;
  const alula_wall* wall; /* of the caller, beside those that the stack finds; for dr-acbf */
  uint32_t wall_count;
  alula_stack_command kind;   /* of the nominal command; `takes` */
  float nominal[3];           /* velocity or acceleration */
  float yaw_rate_rad_s;       /* of the cascade; turns the body to the left */
  alula_racer_command sticks; /* the nominal command of this kind */
} alula_stack_input;

typedef struct {
  alula_filter_status status;                  /* the worst */
  alula_filter_status part[ALULA_STACK_PARTS]; /* OK for a part that is off */
  /* The command of each kind from `takes` to `gives`, behind the part that filters it; 0 for other kinds. */
  float velocity[3], acceleration[3];
  alula_racer_command sticks;
  alula_polytope_result polytope_cbf; /* 0 for parts that are off, or were not asked */
  alula_dr_acbf_result dr_acbf;
  alula_geofence_result geofence;
  alula_geofence_status outcome; /* of the geofence */
  uint32_t walls;                /* that dr-acbf was given */
  int walls_are_full;            /* most_walls were found: others that could bind may have been left out */
} alula_stack_result;

/* `hulls` and `fence` are of the parts that are on, else null; both must live as long as the stack.
 *
 * Returns ALULA_BAD_POINTER for a missing map or fence of a part that is on; the status of the part's own set-up;
 * ALULA_BAD_PARAMETER when no part is on; when a part is not between `takes` and `gives` (polytope-cbf needs
 * velocities in, dr-acbf velocities or accelerations in and more than velocities out, the geofence sticks out); when
 * polytope-cbf is on, the stack gives more than velocities, and neither dr-acbf nor a geofence with a map is on; when
 * time steps of the parts differ; when a velocity loop's gain is below 4 beta or above 1 / dt; and with a cascade
 * when the model's thrust is less than |(a_max, a_max, g + a_max)| or a_max is above 0.95 g: then it could not fly
 * all accelerations of the box. */
ALULA_MUST_USE alula_status alula_stack_init(alula_stack* stack, const alula_map* hulls, const alula_fence* fence,
                                             const alula_stack_config* config);

/* Continues on another image of the same cover, such as the next tile (alula_tiles.h); O(1). `hulls` is for
 * polytope-cbf. A geofence uses the map of its fence, which the caller owns: see alula_geofence_move. Status as
 * alula_polytope_cbf_move; no change unless it is ALULA_READY. */
ALULA_MUST_USE alula_status alula_stack_move(alula_stack* stack, const alula_map* hulls);

/* To before the first tick. */
void alula_stack_reset(alula_stack* stack);

/* One tick: call it once per time step, also without an input that is valid. Returns result->status. */
ALULA_MUST_USE alula_filter_status alula_stack_filter(alula_stack* stack, const alula_stack_input* input,
                                                      alula_stack_result* result);

#ifdef __cplusplus
}
#endif
#endif
