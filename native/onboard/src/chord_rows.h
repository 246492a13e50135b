/* The rows of a tick of alula_chord.h, for the filters that add rows of their own. Private. */
#ifndef ALULA_ONBOARD_CHORD_ROWS_H
#define ALULA_ONBOARD_CHORD_ROWS_H

#include "alula_chord.h"
#include "alula_fence.h"

/* No command yet: zero velocity, unknown margins. */
void alula_chord_clear(alula_polytope_result* result);

/* Finds the rows of the hulls, and of box and faces of `fence` if it is not null. `speed` gets the limit of this
 * tick. Returns 0 where the chord filter refuses: no row is then valid. */
ALULA_MUST_USE int alula_chord_find_rows(alula_chord* chord, const alula_fence* fence, const float p[3],
                                         const float v[3], int is_taking_off, float* speed,
                                         alula_polytope_result* result);

/* Shortens u to the speed. */
void alula_chord_limit(float u[3], float speed);

/* The velocity nearest to `wanted` with the rows, into result->u. */
void alula_chord_project(const alula_chord* chord, const float wanted[3], float speed, alula_polytope_result* result);

/* Puts a velocity that a projection found into the result, shortened to the speed; zero, which satisfies all rows but
 * the soft ones, where rounding has broken one of them. */
void alula_chord_put(const alula_chord* chord, const float found[3], float speed, alula_polytope_result* result);

/* The status of result->u as an answer to u_nom. */
ALULA_MUST_USE alula_filter_status alula_chord_status(const alula_chord* chord, const float u_nom[3],
                                                      alula_polytope_result* result);

#endif
