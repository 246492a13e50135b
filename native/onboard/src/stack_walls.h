/* The walls that a stack passes to dr-acbf. Private. */
#ifndef ALULA_ONBOARD_STACK_WALLS_H
#define ALULA_ONBOARD_STACK_WALLS_H

#include "alula_stack.h"

static inline int alula_stack_has(const alula_stack* stack, alula_stack_part part) {
  return (stack->config.parts >> (uint32_t)part & 1U) != 0U;
}

/* Finds walls among the hulls and the fence for a position and velocity that are finite, and writes at most `room` of
 * them to `wall`, the most urgent first. Sets *is_full when no room is left. A position beyond the map's
 * extent, or a map that has changed, has no hulls: polytope-cbf refuses it. */
uint32_t alula_stack_walls(alula_stack* stack, const float position[3], const float velocity[3], uint32_t room,
                           alula_wall* wall, int* is_full);

#endif
