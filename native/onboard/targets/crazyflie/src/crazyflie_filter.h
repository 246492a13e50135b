/* polytope-cbf between the set-points and the controller of a Crazyflie, without its firmware's headers.
 *
 * The stabilizer's loop, 1000 times a second, calls alula_crazyflie_step; another task of lower priority calls
 * alula_crazyflie_work. A tick of the filter may take longer than the loop's millisecond (docs/results/onboard.md),
 * and the loop that holds the attitude must not wait for it. In every period T of some steps the loop
 *
 *   1. takes the velocity that was worked out since the last one, and flies it for T,
 *   2. hands over a new wish w with the position at the end of this period, p + T u: where the velocity u that is
 *      flown now leads, and where the one that is worked out now begins to act.
 *
 * So every velocity is flown for exactly the T, and from the position, that polytope-cbf checked; a wish acts T to
 * 2 T after it was read. What the vehicle leaves of p + T u by not following a velocity exactly is for the radius, as
 * is the error of the estimator.
 *
 * What is flown is always one of: the set-point itself where no thrust is asked for or the pilot turned the filter
 * off, a velocity of polytope-cbf, or zero velocity. When the work is not done in time, or the state or the wish
 * cannot be used, it is zero velocity.
 *
 *   set-point, axes x y z               becomes
 *   x, y and z off, no thrust           itself: motors off, also in flight
 *   velocity (world, or turned by yaw)  the wish
 *   position                            the wish gain (p_set - p), at most v_max
 *   any other axis off (attitude)       zero velocity; with `attitude` set itself, unguarded
 *
 * One frame, metres, seconds; freestanding C99. Tick: alula_polytope_cbf.h.
 */
#ifndef ALULA_CRAZYFLIE_FILTER_H
#define ALULA_CRAZYFLIE_FILTER_H

#include "alula_polytope_cbf.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_CRAZYFLIE_EXTENT 30.0F    /* [m] farthest coordinate of a position */
#define ALULA_CRAZYFLIE_STALE_STEPS 50  /* that a state may be the same bits while the vehicle is told to move */
#define ALULA_CRAZYFLIE_STALE_WAY 0.01F /* [m] and by at least so much */

typedef enum { ALULA_AXIS_OFF = 0, ALULA_AXIS_POSITION = 1, ALULA_AXIS_VELOCITY = 2 } alula_axis_mode;

typedef struct {
  float radius_m;   /* of the vehicle, and of all errors of position */
  float beta;       /* [1/s] */
  float kappa;      /* [1/m] */
  float v_max;      /* [m/s] */
  float period_s;   /* T */
  float gain;       /* of positions [1/s] */
  float variance;   /* of the position, the most that is flown with [m^2] */
  uint8_t enabled;  /* 0: set-points go through as they are */
  uint8_t attitude; /* 1: so do set-points of attitude and thrust */
} alula_crazyflie_config;

alula_crazyflie_config alula_crazyflie_defaults(void);

typedef struct {
  uint8_t mode[3]; /* alula_axis_mode of x, y, z */
  uint8_t is_body; /* velocity x, y in the frame turned by yaw */
  float position[3], velocity[3];
  float thrust;
} alula_crazyflie_wish;

typedef struct {
  float position[3], velocity[3];
  float attitude[4]; /* w, x, y, z */
  float variance;    /* the largest of the position's three [m^2]; 0 of an estimator that does not run */
} alula_crazyflie_state;

typedef enum {
  ALULA_CRAZYFLIE_NOT_READY = 0, /* no map, or no parameters that mean something: motors off */
  ALULA_CRAZYFLIE_OFF,           /* no thrust asked for: the set-point itself */
  ALULA_CRAZYFLIE_DISABLED,      /* by the pilot: the set-point itself */
  ALULA_CRAZYFLIE_UNGUARDED,     /* attitude, where it is allowed: the set-point itself */
  ALULA_CRAZYFLIE_OK,            /* the wish */
  ALULA_CRAZYFLIE_FILTERED,      /* changed by the barrier or the speed limit */
  ALULA_CRAZYFLIE_SHORTENED,     /* ... and by the check of the step */
  ALULA_CRAZYFLIE_RECOVERING,    /* too close already: out */
  ALULA_CRAZYFLIE_REFUSED,       /* by the filter: zero velocity, as in all that follow */
  ALULA_CRAZYFLIE_BAD_STATE,     /* not finite, beyond the extent, or no yaw */
  ALULA_CRAZYFLIE_UNCERTAIN,     /* variance */
  ALULA_CRAZYFLIE_STALE,         /* the estimator stands still */
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

/* Who may touch what a request holds; written by one side only in each value. */
typedef enum { ALULA_CRAZYFLIE_FREE = 0, ALULA_CRAZYFLIE_POSTED, ALULA_CRAZYFLIE_DONE } alula_crazyflie_turn;

/* Made by alula_crazyflie_open; one per vehicle. The fields are not for the caller, but for the counts. */
typedef struct {
  alula_map map;
  alula_polytope_cbf cbf; /* of the task that works */
  alula_crazyflie_config config;
  int is_open;
  volatile uint32_t turn;
  float at[3], wish[3];         /* of the request */
  alula_polytope_result result; /* of the answer */
  alula_filter_status answer;
  float period_s;  /* of what is flown */
  int has_request; /* of the period that runs, in good order */
  alula_crazyflie_output output;
  float seen[6]; /* the last state */
  int still;     /* steps that it has been the same */
  float still_way;
  uint32_t late, corrections; /* counts, for logs */
  float margin_m;             /* s - r of the last answer */
} alula_crazyflie_filter;

/* Open a map and set parameters; nonzero when it may fly. Reads every byte of the map once. */
ALULA_MUST_USE int alula_crazyflie_open(alula_crazyflie_filter* filter, const uint8_t* image, uint32_t length,
                                        const alula_crazyflie_config* config);

/* Other parameters, from the task that works, between two calls of alula_crazyflie_work. Those that mean nothing
 * are refused, and the last ones stay: zero. */
ALULA_MUST_USE int alula_crazyflie_configure(alula_crazyflie_filter* filter, const alula_crazyflie_config* config);

/* A step of the loop. `is_due` begins a period: every T. `step_s` is that from one step to the next. */
void alula_crazyflie_step(alula_crazyflie_filter* filter, const alula_crazyflie_wish* wish,
                          const alula_crazyflie_state* state, int is_due, float step_s,
                          alula_crazyflie_output* output);

/* The loop was elsewhere: what was flown, or worked out, is for another place. From the loop. */
void alula_crazyflie_restart(alula_crazyflie_filter* filter);

/* Work out what was handed over, if anything: nonzero when there was something. */
int alula_crazyflie_work(alula_crazyflie_filter* filter);

#ifdef __cplusplus
}
#endif
#endif
