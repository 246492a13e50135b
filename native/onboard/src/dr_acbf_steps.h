/* The steps of a tick of alula_dr_acbf.h before its projection, for filters that project among rows of their own.
 * Private. */
#ifndef ALULA_ONBOARD_DR_ACBF_STEPS_H
#define ALULA_ONBOARD_DR_ACBF_STEPS_H

#include "alula_dr_acbf.h"

/* Warning and manoeuvre, and the rows of the obstacles without their bounds. `longest_only` gets whether the rows are
 * those of the longest horizon, as in the tick that enters a manoeuvre. Status as alula_avoidance_step. */
ALULA_MUST_USE alula_status alula_dr_acbf_meet(alula_dr_acbf* filter, const alula_vehicle_state* vehicle,
                                               const alula_track* track, uint32_t count, const alula_wall* wall,
                                               uint32_t wall_count, const float nominal[3], alula_guidance* guidance,
                                               int* longest_only);

/* Sets the bounds of the obstacles' rows at a horizon; returns the minimum. */
float alula_dr_acbf_set_bounds(alula_dr_acbf* filter, float horizon_s);

/* The horizons of a tick, in the order in which they are tried: largest minimum bound first. */
typedef struct {
  uint32_t count, tried;
  float at[ALULA_HORIZONS], least[ALULA_HORIZONS];
} alula_horizons;

void alula_dr_acbf_horizons(alula_dr_acbf* filter, int longest_only, alula_horizons* horizons);

/* Sets the bounds of the next horizon, and returns 1; 0 at the end. */
ALULA_MUST_USE int alula_dr_acbf_next(alula_dr_acbf* filter, alula_horizons* horizons, float* horizon_s);

/* Counts a tick whose rows hold, or one more in which they do not. */
void alula_dr_acbf_count(alula_dr_acbf* filter, int holds);

#endif
