#include "bytes.h"
#include "map_index.h"

#define INDEX_HEAD_BYTES 4U
#define START_BYTES 4U

alula_map_box alula_map_node(const alula_map* map, uint32_t level, uint32_t i) {
  const uint8_t* at = map->data + map->level_at[level] + ALULA_MAP_NODE_BYTES * i;
  alula_map_box box;
  for (int k = 0; k < 3; ++k) {
    box.lower[k] = map->origin[k] + i16_at(at + 2 * k);
    box.upper[k] = map->origin[k] + i16_at(at + 6 + 2 * k);
  }
  return box;
}

uint32_t alula_map_leaf_start(const alula_map* map, uint32_t i) {
  return u32_at(map->data + map->starts_at + START_BYTES * i);
}

static void grow(alula_map_box* box, const int32_t lower[3], const int32_t upper[3], int is_first) {
  for (int k = 0; k < 3; ++k) {
    if (is_first || lower[k] < box->lower[k]) box->lower[k] = lower[k];
    if (is_first || upper[k] > box->upper[k]) box->upper[k] = upper[k];
  }
}

static int same(const alula_map_box* a, const alula_map_box* b) {
  for (int k = 0; k < 3; ++k)
    if (a->lower[k] != b->lower[k] || a->upper[k] != b->upper[k]) return 0;
  return 1;
}

/* Finds the parts of the index; 0 unless they fill the image exactly. */
static int find_levels(alula_map* map) {
  const uint8_t* head = map->data + map->records_end;
  const uint32_t room = map->total_bytes - map->records_end;
  if (map->hull_count == 0U || room < INDEX_HEAD_BYTES) return 0;
  if (head[0] == 0U || head[2] != 0U || head[3] != 0U) return 0;
  const uint32_t leaves = (map->hull_count - 1U) / head[0] + 1U;
  uint32_t size = leaves, used = INDEX_HEAD_BYTES, levels = 0U;
  for (; levels < ALULA_MAP_LEVELS; ++levels) {
    map->level_at[levels] = map->records_end + used;
    map->level_size[levels] = size;
    used += ALULA_MAP_NODE_BYTES * size; /* no overflow: at most 2^24 leaves */
    if (used > room) return 0;
    if (size == 1U) break;
    size = (size - 1U) / ALULA_MAP_FANOUT + 1U;
  }
  map->level_count = levels + 1U;
  map->starts_at = map->records_end + used;
  map->leaf_hulls = head[0];
  return head[1] == map->level_count && used + START_BYTES * leaves == room;
}

static int leaves_hold(const alula_map* map) {
  uint32_t at = ALULA_MAP_HEADER_BYTES;
  for (uint32_t i = 0; i < map->level_size[0]; ++i) {
    if (alula_map_leaf_start(map, i) != at) return 0;
    const uint32_t first = i * map->leaf_hulls, left = map->hull_count - first;
    const uint32_t count = left < map->leaf_hulls ? left : map->leaf_hulls;
    alula_map_box all = {{0, 0, 0}, {0, 0, 0}};
    for (uint32_t h = 0; h < count; ++h) {
      alula_map_hull hull;
      if (alula_map_read(map, at, &hull) != ALULA_MAP_READY) return 0;
      grow(&all, hull.lower, hull.upper, h == 0U);
      at = hull.next;
    }
    const alula_map_box node = alula_map_node(map, 0U, i);
    if (!same(&all, &node)) return 0;
  }
  return 1;
}

static int nodes_hold(const alula_map* map) {
  for (uint32_t level = 1; level < map->level_count; ++level) {
    for (uint32_t i = 0; i < map->level_size[level]; ++i) {
      alula_map_box all = {{0, 0, 0}, {0, 0, 0}};
      const uint32_t first = ALULA_MAP_FANOUT * i;
      for (uint32_t j = first; j < first + ALULA_MAP_FANOUT && j < map->level_size[level - 1U]; ++j) {
        const alula_map_box below = alula_map_node(map, level - 1U, j);
        grow(&all, below.lower, below.upper, j == first);
      }
      const alula_map_box node = alula_map_node(map, level, i);
      if (!same(&all, &node)) return 0;
    }
  }
  return 1;
}

int alula_map_index_open(alula_map* map) { return find_levels(map) && leaves_hold(map) && nodes_hold(map); }
