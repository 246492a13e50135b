/* Avoidance of moving obstacles, common to DR-ACBF and the filters compared with it: early warning and manoeuvres.
 *
 * Per tick and obstacle i, with P = p_i - p, V = v_i - v, d = |P|, n = P / d and v_cl = max(0, -n . V):
 *
 *   envelope     ahat_i: the recent maximum of a sliding-mode differentiator of v_i
 *   warning      CVaR of Z = R + v tau + v^2 / (2 (a_e + a_i)) - |P(t)| under the tracker's Gaussian, rounded up,
 *                plus eps L_Z, at five times up to H_max; or a chance constraint at one time (the ablation)
 *   manoeuvre    NOMINAL -> AVOID -> HOVER -> NOMINAL: to a bypass point in the best of twelve directions, a stop,
 *                and onward
 *
 * Source: Mandaokar, Rinner 2025 (DR-ACBF, arXiv 2512.00462), sections III-B to III-D, IV-A.
 * One inertial frame, SI units, single precision; all memory in the structs; every loop bounded.
 */
#ifndef ALULA_AVOIDANCE_H
#define ALULA_AVOIDANCE_H

#include "alula_onboard.h"
#include "alula_options.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef ALULA_OBSTACLES
#define ALULA_OBSTACLES 128U /* maximum per tick; define it smaller for a microcontroller */
#endif
#ifndef ALULA_WALLS
#define ALULA_WALLS 32U
#endif
#define ALULA_LARGEST 1.0e6F /* largest number of an input; for a covariance, its square */
#define ALULA_NO_OBSTACLE 0xFFFFFFFFU

typedef struct {
  float position[3], velocity[3];
  float covariance[6]; /* of the position: xx, xy, xz, yy, yz, zz */
} alula_vehicle_state;

/* A confirmed track. */
typedef struct {
  uint32_t id; /* identifies the obstacle in every tick */
  float position[3], velocity[3];
  float covariance[21]; /* of (position, velocity): the lower triangle, row by row */
  float radius_m;
  float acceleration[3]; /* estimated; 0 when unknown */
} alula_track;

/* A plane with static obstacles behind it: points x with n . (x - p) <= -distance_m may be inside an obstacle. */
typedef struct {
  float normal[3];  /* of length 1, from the obstacle to the vehicle */
  float distance_m; /* from the vehicle's centre */
} alula_wall;

/* The defaults of the source; where it states none, those of the specification. */
alula_avoidance_config alula_avoidance_defaults(void);

typedef enum { ALULA_NOMINAL = 0, ALULA_AVOID, ALULA_HOVER } alula_avoidance_mode;

/* An obstacle in this tick. */
typedef struct {
  float los[3];      /* n, to the obstacle */
  float distance_m;  /* d */
  float closing_m_s; /* v_cl */
  float radius_m;    /* the sum of both */
  float envelope;    /* ahat [m/s^2] */
  float sigma2_p;    /* n . (Sigma_e + Sigma_i) n [m^2] */
  float sigma2_v;    /* n . Sigma_vv n [m^2/s^2] */
  uint32_t active;   /* closing and in range */
  uint32_t has_row;  /* in dr-acbf: active, or in range if receding_rows */
  float miss[3];     /* relative position at the closest approach, if the vehicle hovered here, */
  float miss_s;      /* and the time until then; only for active obstacles in a manoeuvre */
} alula_encounter;

typedef struct {
  uint32_t id, age; /* age: ticks since the first */
  uint32_t seen;    /* in this tick */
  float z0[3], z1[3], bound;
} alula_envelope;

typedef struct {
  alula_avoidance_config config;
  alula_avoidance_mode mode;
  uint32_t ticks_in_mode;
  float bypass[3], direction[3];
  uint32_t has_bypass;
  uint32_t threat;  /* id of the obstacle being avoided */
  float command[3]; /* flown in the last tick, for the prediction */
  uint32_t envelope_count;
  alula_envelope envelope[ALULA_OBSTACLES];
  uint32_t count;
  alula_encounter encounter[ALULA_OBSTACLES]; /* in the order of the tracks */
  float tail_of_normal, tail_of_square;       /* CVaR of a standard normal and of its square */
} alula_avoidance;

typedef struct {
  float desired[3]; /* the command before the barriers: the nominal one, or that of the manoeuvre */
  int warned;       /* in this tick */
  float risk_m;     /* the largest CVaR, -FLT_MAX without obstacles */
  uint32_t urgent;  /* index of the track with the largest v_cl / d; ALULA_NO_OBSTACLE */
  alula_avoidance_mode mode;
} alula_guidance;

/* Returns ALULA_BAD_PARAMETER unless all numbers are in range. */
ALULA_MUST_USE alula_status alula_avoidance_init(alula_avoidance* avoidance, const alula_avoidance_config* config);

void alula_avoidance_reset(alula_avoidance* avoidance); /* to before the first tick */

/* One tick. Returns ALULA_BAD_INPUT for numbers that are not finite or larger than ALULA_LARGEST, negative variances
 * or radii, equal ids, or more obstacles or walls than the capacity; then nothing changes. */
ALULA_MUST_USE alula_status alula_avoidance_step(alula_avoidance* avoidance, const alula_vehicle_state* vehicle,
                                                 const alula_track* track, uint32_t count, const alula_wall* wall,
                                                 uint32_t wall_count, const float nominal[3],
                                                 alula_guidance* guidance);

/* Sets the command flown after this tick, for the next prediction. */
void alula_avoidance_flown(alula_avoidance* avoidance, const float command[3]);

/* The first returns the envelope of a track, or null. The second advances all envelopes by a tick and drops those of
 * tracks that are gone. */
alula_envelope* alula_find_envelope(alula_avoidance* avoidance, uint32_t id);
void alula_update_envelopes(alula_avoidance* avoidance, const alula_track* track, uint32_t count);

/* Chooses the bypass point of this tick: among twelve directions and the current one, the direction that needs the
 * minimum acceleration to pass all active obstacles and is not behind a wall. Call it after the encounters of the
 * tick are computed; `urgent` is one of them. */
void alula_choose_bypass(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track,
                         const alula_wall* wall, uint32_t wall_count, uint32_t urgent);

/* The largest CVaR of Z plus eps L_Z of one track, from above; a value of at least 0 warns. `relative_acceleration`
 * is a_i - a_e [m/s^2]. */
float alula_early_warning(const alula_avoidance* avoidance, const alula_vehicle_state* vehicle,
                          const alula_track* track, const float relative_acceleration[3]);

/* CVaR at tail probability `tail` of a standard normal variable and of its square, rounded up. */
void alula_early_warning_tails(float tail, float* of_normal, float* of_square);

#ifdef __cplusplus
}
#endif
#endif
