/* Sticks as velocities, through the stack of alula_stack.h: among hulls, in the geofence's box and faces, and among
 * moving obstacles. For the loop of teensy_loop.h, in front of its geofence.
 *
 *   pitch, roll     velocity ahead and to the right, up to speed_m_s; the nose is the vehicle's yaw
 *   throttle        climb, 0 in the middle, up to climb_m_s
 *   yaw             the yaw rate, as ever
 *
 * Every dt of the stack, a multiple of the loop's period T, the stack filters the velocity from the last navigation.
 * Every navigation turns the filtered velocity into throttle and rates (alula_cascade.h), which the geofence then
 * guards as a pilot's. Without navigation for dt there is no command: the geofence acts as without a pilot.
 */
#ifndef ALULA_TEENSY_VELOCITY_H
#define ALULA_TEENSY_VELOCITY_H

#include "alula_cascade.h"
#include "alula_geofence.h"
#include "alula_stack.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
  alula_stack_config stack;
  alula_cascade_config cascade; /* its lag is shorter than the stack's, which counts the attitude's too */
  float speed_m_s, climb_m_s;   /* of full sticks */
} alula_teensy_velocity_config;

/* 1 m/s; the stack every 20 ms. */
alula_teensy_velocity_config alula_teensy_velocity_defaults(void);

/* Initialised by alula_teensy_velocity_init; `track` and `track_count` are set by the caller at any time, the rest is
 * private. */
typedef struct {
  alula_teensy_velocity_config config;
  alula_stack stack;
  alula_fence fence;
  const alula_track* track;
  uint32_t track_count;
  uint32_t period, ticks, age; /* of the stack, since its last tick, and of the navigation, in periods T */
  int has_state, has_command;
  alula_racer_state state;
  float u[3];
  alula_racer_command command;
  alula_stack_result result;
} alula_teensy_velocity;

/* `fence` is the geofence's, whose map the hulls replace. Status as alula_stack_init and alula_cascade_check;
 * ALULA_BAD_PARAMETER also when the stack's time step is not a multiple of tick_s. */
ALULA_MUST_USE alula_status alula_teensy_velocity_init(alula_teensy_velocity* velocity, const alula_map* hulls,
                                                       const alula_fence* fence, float tick_s,
                                                       const alula_teensy_velocity_config* config);

/* One period. `navigation` is null without a new one; `stick` has pitch, roll and throttle from -1 to 1. Returns the
 * command, or null without one. */
const alula_racer_command* alula_teensy_velocity_tick(alula_teensy_velocity* velocity,
                                                      const alula_racer_state* navigation, const float stick[3],
                                                      float yaw_rate_rad_s);

/* To before the first tick, as when the pilot switches it off. */
void alula_teensy_velocity_reset(alula_teensy_velocity* velocity);

#ifdef __cplusplus
}
#endif
#endif
