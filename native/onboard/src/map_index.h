/* The index of a map, and coordinates on its lattice. Private. */
#ifndef ALULA_ONBOARD_MAP_INDEX_H
#define ALULA_ONBOARD_MAP_INDEX_H

#include "alula_map.h"
#include "bytes.h"
#include "vector.h"

#define ALULA_MAP_DIRECTIONS 20U
#define ALULA_MAP_DIRECTION_BITS 5U
#define ALULA_MAP_MOST_SHIFT 16U

extern const int8_t alula_map_direction[ALULA_MAP_DIRECTIONS][3];

/* Decodes a stored plane. */
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

/* A plane as a row n, d: unit normal, and offset moved outward; see alula_polytope_cbf_open for the rounding error.
 * All sums of integers are below 2^31: normals are at most 127, coordinates 2^22 + 2^15, and a plane cuts its box, so
 * its depth is below 2^25. */
static inline void alula_map_plane_row(const alula_map_plane* plane, const alula_map_hull* record, float g,
                                       float outward, float row[4]) {
  const int32_t i = plane->normal[0], j = plane->normal[1], k = plane->normal[2];
  const int32_t support = i * (i > 0 ? record->upper[0] : record->lower[0]) +
                          j * (j > 0 ? record->upper[1] : record->lower[1]) +
                          k * (k > 0 ? record->upper[2] : record->lower[2]);
  const float offset = (float)(int32_t)((uint32_t)support - plane->depth);
  const float inverse = 1.0F / __builtin_sqrtf((float)(i * i + j * j + k * k));
  row[0] = (float)i * inverse;
  row[1] = (float)j * inverse;
  row[2] = (float)k * inverse;
  row[3] = (offset * g) * inverse + outward;
}

/* Signed distance of a position from a row. */
static inline float alula_plane_value(const float* plane, const float x[3]) {
  return ((plane[0] * x[0] + plane[1] * x[1]) + plane[2] * x[2]) - plane[3];
}

typedef struct {
  int32_t lower[3], upper[3];
} alula_map_box;

/* Finds and checks the index after the records; nonzero when it is valid: every node is exactly the union of the
 * boxes below it, and every leaf stores the start of its records. O(hulls). */
int alula_map_index_open(alula_map* map);

/* Node `i` of a level, with i < level_size[level]. */
alula_map_box alula_map_node(const alula_map* map, uint32_t level, uint32_t i);

/* Byte at which the first record of leaf i begins. */
uint32_t alula_map_leaf_start(const alula_map* map, uint32_t i);

/* The largest distance from the faces of a box, and the face: i for lower, 3 + i for upper. For a box inside another
 * the value is at least as large, also after rounding. */
static inline float alula_map_box_value(const float lower[3], const float upper[3], const float x[3], int* face) {
  float largest = -FLT_MAX;
  *face = 0;
  ALULA_UNROLL
  for (int i = 0; i < 3; ++i) {
    const float below = lower[i] - x[i], above = x[i] - upper[i];
    if (below > largest) {
      largest = below;
      *face = i;
    }
    if (above > largest) {
      largest = above;
      *face = 3 + i;
    }
  }
  return largest;
}

/* Starts an evaluation: the value for no hulls, and the margin to subtract from psi. */
ALULA_MUST_USE alula_map_status alula_map_begin(const alula_map* map, const float x[3], alula_map_value* value,
                                                float* margin);

/* Advances to the next node that is not below this one, in the order of the records. */
static inline void alula_map_pass(const alula_map* map, uint32_t* level, uint32_t* node) {
  ++*node;
  while (*level + 1U < map->level_count && *node % ALULA_MAP_FANOUT == 0U) {
    ++*level;
    *node /= ALULA_MAP_FANOUT;
  }
}

#endif
