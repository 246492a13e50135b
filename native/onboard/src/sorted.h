/* A sorted list beside another list of the same order. Private. */
#ifndef ALULA_ONBOARD_SORTED_H
#define ALULA_ONBOARD_SORTED_H

#include <stdint.h>

/* Puts a value into a sorted list of `count`, behind its equals, and returns its place. */
static inline uint32_t insert_sorted(float* list, uint32_t count, float value) {
  uint32_t at = count;
  for (; at > 0U && value < list[at - 1U]; --at) list[at] = list[at - 1U];
  list[at] = value;
  return at;
}

#endif
