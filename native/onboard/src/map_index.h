/* The index of a map, and coordinates on its lattice; not for callers. */
#ifndef ALULA_ONBOARD_MAP_INDEX_H
#define ALULA_ONBOARD_MAP_INDEX_H

#include "alula_map.h"

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
