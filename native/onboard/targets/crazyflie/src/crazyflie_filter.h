/* The chord of alula_chord.h between the set-points and the controller of a Crazyflie, without its firmware's
 * headers.
 *
 * The stabilizer's loop, 1000 times a second, calls alula_crazyflie_step; another task of lower priority calls
 * alula_crazyflie_work. A tick of the filter may take longer than the loop's millisecond (docs/results/onboard.md),
 * and the loop that controls the attitude must not wait for it. In every period T of some steps the loop
 *
 *   1. takes the velocity u that was computed during the last period, and flies it for T,
 *   2. posts a new nominal command w with the state at the end of this period, of a vehicle that follows with the lag
 * tau: with E = exp(-T / tau), p + T u + tau (1 - E) (v - u) and u + E (v - u). The velocity computed now begins to
 * act there.
 *
 * So every velocity is flown for exactly the T, and from the state, for which it was checked; a nominal command acts
 * T to 2 T after it was read. The radius must cover what a vehicle of this lag does not do: its velocity loop is of a
 * higher order, and its estimator errs.
 *
 * A take-off begins when the motors start. It ends when the chord is first clear of all margins; until then the
 * vehicle leaves a floor that it rests on upwards (`is_taking_off` of alula_chord.h).
 *
 * The loop always flies one of: the set-point itself if it has no thrust or the pilot switched the filter
 * off, a velocity of the filter, or zero velocity. If the work is not done in time, or the state or the nominal
 * command cannot be used, it flies zero velocity.
 *
 *   set-point, axes x y z               becomes
 *   x, y and z off, no thrust           itself: motors off, also in flight
 *   velocity (world, or turned by yaw)  the nominal command
 *   position                            the nominal command gain (p_set - p), at most v_max
 *   any other axis off (attitude)       zero velocity; with `attitude` set, itself, unguarded
 *
 * With ALULA_CRAZYFLIE_OBSTACLES the filter is that of alula_stack.h, in a box and among moving obstacles. An
 * obstacle is reported again and again; between reports it flies straight on, and after ALULA_CRAZYFLIE_FORGOTTEN_S
 * without one it is forgotten. The variances of a report are those of a tracker that updates 20 times a second.
 *
 * One frame, metres, seconds; freestanding C99. Tick: alula_chord.h, alula_stack.h.
 */
#ifndef ALULA_CRAZYFLIE_FILTER_H
#define ALULA_CRAZYFLIE_FILTER_H

#include "alula_chord.h"

#ifndef ALULA_CRAZYFLIE_OBSTACLES
#define ALULA_CRAZYFLIE_OBSTACLES 0U /* at most so many moving ones; 0: neither obstacles nor a fence */
#endif
#if ALULA_CRAZYFLIE_OBSTACLES > 0U
#include "alula_stack.h"
#if ALULA_CRAZYFLIE_OBSTACLES > ALULA_OBSTACLES
#error "define ALULA_OBSTACLES too"
#endif
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_CRAZYFLIE_EXTENT 30.0F    /* [m] largest coordinate of a position */
#define ALULA_CRAZYFLIE_STALE_STEPS 50  /* steps with bit-identical states while a motion is commanded */
#define ALULA_CRAZYFLIE_STALE_WAY 0.01F /* [m] and the minimum commanded motion */

typedef enum { ALULA_AXIS_OFF = 0, ALULA_AXIS_POSITION = 1, ALULA_AXIS_VELOCITY = 2 } alula_axis_mode;

typedef struct {
  float radius_m;   /* of the vehicle, plus all errors of position */
  float beta;       /* [1/s] */
  float lag;        /* tau, with which velocities are followed [s] */
  float v_max;      /* [m/s] */
  float period_s;   /* T */
  float gain;       /* of positions [1/s] */
  float variance;   /* maximum accepted variance of the position [m^2] */
  uint8_t enabled;  /* 0: set-points pass unchanged */
  uint8_t attitude; /* 1: set-points of attitude and thrust pass unchanged */
#if ALULA_CRAZYFLIE_OBSTACLES > 0U
  uint8_t fenced; /* 1: keeps in the box */
  float lower[3], upper[3];
#endif
} alula_crazyflie_config;

#define ALULA_CRAZYFLIE_FORGOTTEN_S 1.0F

/* A report of a moving obstacle. */
typedef struct {
  uint8_t id; /* 1 to 255 */
  float position[3], velocity[3], radius_m;
} alula_crazyflie_obstacle;

alula_crazyflie_config alula_crazyflie_defaults(void);

typedef struct {
  uint8_t mode[3]; /* alula_axis_mode of x, y, z */
  uint8_t is_body; /* velocity x, y in the frame turned by yaw */
  float position[3], velocity[3];
  float thrust;
} alula_crazyflie_request;

typedef struct {
  float position[3], velocity[3];
  float attitude[4]; /* w, x, y, z */
  float variance;    /* the largest of the position's three [m^2]; 0 if the estimator does not run */
} alula_crazyflie_state;

typedef enum {
  ALULA_CRAZYFLIE_NOT_READY = 0, /* no map, or no valid parameters: motors off */
  ALULA_CRAZYFLIE_OFF,           /* no thrust commanded: the set-point itself */
  ALULA_CRAZYFLIE_DISABLED,      /* by the pilot: the set-point itself */
  ALULA_CRAZYFLIE_UNGUARDED,     /* attitude, where it is allowed: the set-point itself */
  ALULA_CRAZYFLIE_OK,            /* the nominal command */
  ALULA_CRAZYFLIE_FILTERED,      /* changed by the barrier or the speed limit */
  ALULA_CRAZYFLIE_SHORTENED,     /* ... and by the check of the step */
  ALULA_CRAZYFLIE_RECOVERING,    /* already too close: moving out */
  ALULA_CRAZYFLIE_REFUSED,       /* by the filter: zero velocity, as in all values below */
  ALULA_CRAZYFLIE_BAD_STATE,     /* not finite, beyond the extent, or no yaw */
  ALULA_CRAZYFLIE_UNCERTAIN,     /* variance */
  ALULA_CRAZYFLIE_STALE,         /* the estimator does not change */
  ALULA_CRAZYFLIE_BAD_WISH,      /* not finite, or attitude */
  ALULA_CRAZYFLIE_LATE,          /* the work was not done */
  ALULA_CRAZYFLIE_STARTING       /* the first period */
} alula_crazyflie_status;

typedef struct {
  alula_crazyflie_status status;
  int is_off;      /* fly with all motors off */
  int is_replaced; /* fly `velocity`, in the world, on all three axes; else the set-point itself */
  float velocity[3];
} alula_crazyflie_output;

/* Ownership of the request's data; each value is written by one side only. */
typedef enum { ALULA_CRAZYFLIE_FREE = 0, ALULA_CRAZYFLIE_POSTED, ALULA_CRAZYFLIE_DONE } alula_crazyflie_turn;

/* Initialised by alula_crazyflie_open; one per vehicle. The fields are private, except the counts. */
typedef struct {
  alula_map map;
#if ALULA_CRAZYFLIE_OBSTACLES > 0U
  alula_stack stack; /* used by the working task only, as all of these */
  alula_fence fence;
  alula_track track[ALULA_CRAZYFLIE_OBSTACLES];
  float age_s[ALULA_CRAZYFLIE_OBSTACLES];
  uint32_t track_count;
#else
  alula_chord chord; /* used by the working task only */
#endif
  alula_crazyflie_config config;
  int is_open;
  volatile uint32_t turn;
  float at[3], moving[3], nominal[3]; /* of the request */
  int from_the_ground;                /* of the request */
  alula_polytope_result result;       /* of the answer */
  alula_filter_status answer;
  int is_taking_off; /* until the chord is first clear */
  float period_s;    /* of the command being flown */
  int has_request;   /* the current period has a valid request */
  alula_crazyflie_output output;
  float seen[6]; /* the last state */
  int still;     /* number of steps without a change */
  float still_way;
  uint32_t late, corrections; /* counts, for logs */
  float margin_m;             /* least D_k - r of the last answer */
} alula_crazyflie_filter;

/* Opens a map and sets parameters; nonzero when it may fly. Reads every byte of the map once. */
ALULA_MUST_USE int alula_crazyflie_open(alula_crazyflie_filter* filter, const uint8_t* image, uint32_t length,
                                        const alula_crazyflie_config* config);

/* Changes the parameters; call it from the working task, between two calls of alula_crazyflie_work. Returns zero for
 * parameters out of range, and keeps the last ones. */
ALULA_MUST_USE int alula_crazyflie_configure(alula_crazyflie_filter* filter, const alula_crazyflie_config* config);

/* A step of the loop. `is_due` begins a period, every T. `step_s` is the time between two steps. */
void alula_crazyflie_step(alula_crazyflie_filter* filter, const alula_crazyflie_request* request,
                          const alula_crazyflie_state* state, int is_due, float step_s,
                          alula_crazyflie_output* output);

/* Call it from the loop after an interruption: the command and the request are for another position. */
void alula_crazyflie_restart(alula_crazyflie_filter* filter);

#if ALULA_CRAZYFLIE_OBSTACLES > 0U
/* Takes a report of an obstacle; call it from the working task. Zero when it cannot be used, or too many are known.
 */
ALULA_MUST_USE int alula_crazyflie_report(alula_crazyflie_filter* filter, const alula_crazyflie_obstacle* obstacle);
#endif

/* Processes the posted request, if any; nonzero when there was one. */
int alula_crazyflie_work(alula_crazyflie_filter* filter);

#ifdef __cplusplus
}
#endif
#endif
