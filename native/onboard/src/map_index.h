/* The index of a map, and coordinates on its lattice; not for callers. */
#ifndef ALULA_ONBOARD_MAP_INDEX_H
#define ALULA_ONBOARD_MAP_INDEX_H

#include "alula_map.h"
#include "bytes.h"

#define ALULA_MAP_DIRECTIONS 20U
#define ALULA_MAP_DIRECTION_BITS 5U
#define ALULA_MAP_MOST_SHIFT 16U

extern const int8_t alula_map_direction[ALULA_MAP_DIRECTIONS][3];

/* A plane as it is stored. */
static inline alula_map_plane alula_map_plane_in(const uint8_t* at, uint32_t plane_bytes, uint32_t shift) {
  alula_map_plane plane;
  if (plane_bytes == ALULA_MAP_KDOP_PLANE_BYTES) {
    const uint32_t word = u16_at(at);
    const int8_t* direction = alula_map_direction[(word & 31U) % ALULA_MAP_DIRECTIONS];
    plane.normal[0] = direction[0];
    plane.normal[1] = direction[1];
    plane.normal[2] = direction[2];
    plane.depth = word >> ALULA_MAP_DIRECTION_BITS << shift;
  } else {
    plane.normal[0] = i8_at(at);
    plane.normal[1] = i8_at(at + 1);
    plane.normal[2] = i8_at(at + 2);
    plane.depth = u16_at(at + 3) << shift;
  }
  return plane;
}

typedef struct {
  int32_t lower[3], upper[3];
} alula_map_box;

/* Finds and checks the index behind the records: every node is exactly the union of what is below it, and
 * every leaf knows where its records begin. Nonzero when it is so. O(hulls). */
int alula_map_index_open(alula_map* map);

/* Node `i` of a level, with i < level_size[level]. */
alula_map_box alula_map_node(const alula_map* map, uint32_t level, uint32_t i);

/* Byte at which the first record of leaf i begins. */
uint32_t alula_map_leaf_start(const alula_map* map, uint32_t i);

#endif
