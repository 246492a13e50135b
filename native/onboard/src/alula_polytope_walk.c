/* Walks through the hulls near a position: one by one for arrays, by the tree of boxes for an image. */
#include "polytope_walk.h"

static int leaves_out(const alula_polytope_cbf* cbf, const alula_walk_rule* rule, float bound, uint32_t number) {
  if (cbf->config.brute_force) return 0;
  if (!(bound > rule->nearer || (bound == rule->nearer && number > rule->nearest))) return 0;
  return (bound - rule->lowering) - rule->least > rule->cutoff;
}

/* The largest of lower - x and x - upper, for the offsets of six planes parallel to the axes. The arithmetic is
 * that of alula_plane_value for such a plane, so no hull in the box has a smaller rounded value. */
static float beside(float found, float lower, float upper, float x) {
  const float below = lower - x, above = x - upper;
  if (below > found) found = below;
  return above > found ? above : found;
}

/* The same for a box of the image: int16 lower[3], upper[3] at `at`, of a node or a record. */
static inline float lattice_axis(const alula_polytope_cbf* cbf, const uint8_t* at, int i, float x, float found) {
  const float g = cbf->image.voxel_size_m, outward = cbf->outward_m;
  const float lower = (float)(cbf->image.origin[i] + i16_at(at + 2 * i)) * g - outward;
  const float upper = (float)(cbf->image.origin[i] + i16_at(at + 6 + 2 * i)) * g + outward;
  return beside(found, lower, upper, x);
}

static float lattice_value(const alula_polytope_cbf* cbf, const uint8_t* at, const float x[3]) {
  const float one = lattice_axis(cbf, at, 0, x[0], -FLT_MAX);
  return lattice_axis(cbf, at, 2, x[2], lattice_axis(cbf, at, 1, x[1], one));
}

static const uint8_t* node_at(const alula_map* map, uint32_t level, uint32_t node) {
  return map->data + map->level_at[level] + ALULA_MAP_NODE_BYTES * node;
}

static float array_value(const alula_polytope_map* map, uint32_t hull, const float x[3]) {
  float value = -FLT_MAX;
  for (uint32_t i = 0; i < 3U; ++i) value = beside(value, map->lower[3U * hull + i], map->upper[3U * hull + i], x[i]);
  return value;
}

static void enter(const alula_map* map, uint32_t leaf, alula_walk* walk) {
  const uint32_t first = leaf * map->leaf_hulls, left = map->hull_count - first;
  walk->next = first;
  walk->end = first + (left < map->leaf_hulls ? left : map->leaf_hulls);
  walk->at = alula_map_leaf_start(map, leaf);
}

/* Advances to the next leaf that matters; 0 when there is none. Each node is tested at most once. */
static int next_leaf(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk) {
  const alula_map* map = &cbf->image;
  if (map->leaf_hulls == 0U) return 0;
  while (walk->node < map->level_size[walk->level]) {
    const uint32_t leaf = walk->node << 2U * walk->level; /* the first below; 4^level */
    const float bound = lattice_value(cbf, node_at(map, walk->level, walk->node), x);
    ++cbf->work.boxes;
    if (leaves_out(cbf, rule, bound, leaf * map->leaf_hulls)) {
      alula_map_pass(map, &walk->level, &walk->node);
    } else if (walk->level > 0U) {
      --walk->level;
      walk->node *= ALULA_MAP_FANOUT;
    } else {
      alula_map_pass(map, &walk->level, &walk->node);
      enter(map, leaf, walk);
      return 1;
    }
  }
  return 0;
}

void alula_walk_begin(const alula_polytope_cbf* cbf, alula_walk* walk) {
  const alula_map* map = &cbf->image;
  const int indexed = map->leaf_hulls > 0U;
  walk->listed = 0U;
  walk->level = indexed ? map->level_count - 1U : 0U;
  walk->node = 0U;
  walk->next = 0U;
  walk->end = indexed ? 0U : cbf->map.hull_count;
  walk->at = ALULA_MAP_HEADER_BYTES;
}

/* Advances to the next hull of the leaf, which must have one. */
static void step(alula_polytope_cbf* cbf, const float x[3], alula_walk* walk) {
  const alula_map* map = &cbf->image;
  walk->hull = walk->next++;
  walk->record = walk->at;
  ++cbf->work.boxes;
  if (!map->data) {
    walk->bound = array_value(&cbf->map, walk->hull, x);
    return;
  }
  if (walk->at > map->records_end - ALULA_MAP_HULL_BYTES) {
    cbf->is_damaged = 1; /* the image was valid when it was opened */
    walk->bound = FLT_MAX;
    return;
  }
  const uint8_t* at = map->data + walk->at;
  walk->bound = lattice_value(cbf, at, x);
  walk->at += ALULA_MAP_HULL_BYTES + at[12] * map->plane_bytes;
}

static int next_listed(alula_polytope_cbf* cbf, const alula_walk_rule* rule, alula_walk* walk) {
  while (walk->listed < cbf->near_count) {
    const uint32_t i = walk->listed++;
    walk->hull = cbf->near[i].hull;
    walk->bound = cbf->near[i].bound;
    walk->record = cbf->near[i].record;
    if (!leaves_out(cbf, rule, walk->bound, walk->hull)) return 1;
  }
  return 0;
}

void alula_walk_forget(alula_polytope_cbf* cbf) { cbf->near_count = ALULA_NO_LIST; }

int alula_walk_next(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk) {
  if (cbf->near_count != ALULA_NO_LIST) return next_listed(cbf, rule, walk);
  do {
    while (walk->next < walk->end) {
      step(cbf, x, walk);
      if (!leaves_out(cbf, rule, walk->bound, walk->hull)) return 1;
    }
  } while (next_leaf(cbf, rule, x, walk));
  return 0;
}

void alula_walk_gather(alula_polytope_cbf* cbf, float farthest, const float x[3]) {
  const alula_walk_rule rule = {farthest, ALULA_NO_HULL, 0.0F, 0.0F, -FLT_MAX};
  uint32_t count = 0U;
  alula_walk walk;
  alula_walk_forget(cbf);
  alula_walk_begin(cbf, &walk);
  while (alula_walk_next(cbf, &rule, x, &walk)) {
    if (count == ALULA_NEAR_HULLS) return;
    cbf->near[count].hull = walk.hull;
    cbf->near[count].bound = walk.bound;
    cbf->near[count].record = walk.record;
    ++count;
  }
  cbf->near_count = count;
}

void alula_walk_to(alula_polytope_cbf* cbf, uint32_t hull, const float x[3], alula_walk* walk) {
  const alula_map* map = &cbf->image;
  alula_walk_begin(cbf, walk);
  if (map->leaf_hulls > 0U) enter(map, hull / map->leaf_hulls, walk);
  if (!map->data) walk->next = hull;
  do step(cbf, x, walk);
  while (walk->hull < hull);
}

uint32_t alula_walk_guess(alula_polytope_cbf* cbf, const float x[3]) {
  const alula_map* map = &cbf->image;
  if (cbf->config.brute_force) return 0U;
  alula_walk walk;
  alula_walk_begin(cbf, &walk);
  if (map->leaf_hulls > 0U) {
    uint32_t best = 0U;
    for (uint32_t level = map->level_count - 1U; level-- > 0U;) {
      const uint32_t first = ALULA_MAP_FANOUT * best;
      float least = FLT_MAX;
      best = first;
      for (uint32_t i = first; i < first + ALULA_MAP_FANOUT && i < map->level_size[level]; ++i) {
        const float bound = lattice_value(cbf, node_at(map, level, i), x);
        ++cbf->work.boxes;
        if (bound < least) {
          least = bound;
          best = i;
        }
      }
    }
    enter(map, best, &walk);
  }
  uint32_t guess = walk.next;
  float least = FLT_MAX;
  while (walk.next < walk.end) {
    step(cbf, x, &walk);
    if (walk.bound < least) {
      least = walk.bound;
      guess = walk.hull;
    }
  }
  return guess;
}

enum { THERE, TO_KEEP, PASSING };

/* The first row of a hull's cached planes, or of space for them. When the space is exhausted, hulls that were not
 * used in this tick and the last are evicted; if there are none, the hull uses rows at the end, which hold any hull.
 */
static uint32_t room_for(alula_polytope_cbf* cbf, uint32_t hull, uint32_t count, int* how) {
  const uint32_t passing = cbf->image.most_planes + 6U;
  for (uint32_t i = 0; i < cbf->kept_count; ++i) {
    if (cbf->kept[i].hull != hull) continue;
    cbf->used |= 1U << i;
    *how = THERE;
    return cbf->kept[i].first;
  }
  for (int attempt = 0; attempt < 2; ++attempt) {
    if (cbf->kept_count < ALULA_KEPT_HULLS && cbf->row_count + count + passing <= ALULA_PLANE_ROWS) {
      *how = TO_KEEP;
      return cbf->row_count;
    }
    if ((cbf->used | cbf->used_before) == (1U << cbf->kept_count) - 1U) break;
    cbf->kept_count = cbf->row_count = cbf->used = cbf->used_before = 0U;
  }
  *how = PASSING;
  return ALULA_PLANE_ROWS - passing;
}

static void keep(alula_polytope_cbf* cbf, uint32_t hull, uint32_t count) {
  cbf->used |= 1U << cbf->kept_count;
  cbf->kept[cbf->kept_count].hull = hull;
  cbf->kept[cbf->kept_count].first = cbf->row_count;
  ++cbf->kept_count;
  cbf->row_count += count;
}

/* Rows of the six faces of a record; walk->bound is the largest of their values. */
static void face_rows(float g, float outward, const alula_map_hull* record, float row[6][4]) {
  for (int i = 0; i < 6; ++i) {
    const int axis = i % 3;
    row[i][0] = row[i][1] = row[i][2] = 0.0F;
    row[i][axis] = i < 3 ? -1.0F : 1.0F;
    row[i][3] = (i < 3 ? -(float)record->lower[axis] : (float)record->upper[axis]) * g + outward;
  }
}

/* Raises *hard to the largest value of the rows; 0 as soon as the rule excludes the hull. */
static int largest(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], const alula_walk* walk,
                   float* hard) {
  const float at[3] = {x[0], x[1], x[2]};
  const float* plane = walk->plane;
  float found = *hard;
  for (uint32_t l = 0; l < walk->plane_count; ++l, plane += 4) {
    const float a = alula_plane_value(plane, at);
    if (!(a > found)) continue;
    found = a;
    if (leaves_out(cbf, rule, a, walk->hull)) {
      cbf->work.planes += l + 1U;
      return 0;
    }
  }
  cbf->work.planes += walk->plane_count;
  *hard = found;
  return 1;
}

/* The same for a record with rows that are decoded during the loop. */
static int largest_made(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3],
                        const alula_walk* walk, float (*row)[4], float* hard) {
  const float at[3] = {x[0], x[1], x[2]}, g = cbf->image.voxel_size_m, outward = cbf->outward_m;
  const uint32_t plane_bytes = cbf->image.plane_bytes;
  alula_map_hull record;
  if (alula_map_read(&cbf->image, walk->record, &record) != ALULA_MAP_READY) {
    cbf->is_damaged = 1;
    return 0;
  }
  face_rows(g, outward, &record, row);
  float found = *hard;
  const uint8_t* stored = record.planes;
  for (uint32_t l = 6U; l < walk->plane_count; ++l, stored += plane_bytes) {
    const alula_map_plane plane = alula_map_plane_in(stored, plane_bytes, record.shift);
    alula_map_plane_row(&plane, &record, g, outward, row[l]);
    const float a = alula_plane_value(row[l], at);
    if (!(a > found)) continue;
    found = a;
    if (leaves_out(cbf, rule, a, walk->hull)) {
      cbf->work.planes += l + 1U;
      cbf->work.made += l + 1U;
      return 0;
    }
  }
  cbf->work.planes += walk->plane_count;
  cbf->work.made += walk->plane_count;
  *hard = found;
  return 1;
}

static int decode(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk,
                  float* hard) {
  int how;
  walk->plane_count = 6U + cbf->image.data[walk->record + 12U];
  if (walk->plane_count > cbf->image.most_planes + 6U) {
    cbf->is_damaged = 1; /* the image has changed since it was opened: the hull does not fit the rows */
    return 0;
  }
  float (*row)[4] = cbf->row + room_for(cbf, walk->hull, walk->plane_count, &how);
  walk->plane = row[0];
  *hard = walk->bound;
  if (how == THERE) return largest(cbf, rule, x, walk, hard);
  if (!largest_made(cbf, rule, x, walk, row, hard)) return 0;
  if (how == TO_KEEP) keep(cbf, walk->hull, walk->plane_count);
  return 1;
}

int alula_walk_planes(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk,
                      float* hard) {
  ++cbf->work.hulls;
  if (cbf->is_damaged) return 0; /* the start of the record is unknown */
  if (cbf->image.data) return decode(cbf, rule, x, walk, hard);
  const uint32_t begin = cbf->map.plane_start[walk->hull];
  walk->plane = cbf->map.plane + 4U * begin;
  walk->plane_count = cbf->map.plane_start[walk->hull + 1U] - begin;
  *hard = -FLT_MAX;
  return largest(cbf, rule, x, walk, hard);
}
