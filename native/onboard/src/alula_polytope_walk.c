/* The hulls near a position, from arrays one by one, from an image by its tree of boxes. */
#include "bytes.h"
#include "map_index.h"
#include "polytope_walk.h"

static int leaves_out(const alula_polytope_cbf* cbf, const alula_walk_rule* rule, float bound, uint32_t number) {
  if (cbf->config.brute_force) return 0;
  if (!(bound > rule->nearer || (bound == rule->nearer && number > rule->nearest))) return 0;
  return (bound - rule->lowering) - rule->least > rule->cutoff;
}

/* The largest of lower - x and x - upper, for the offsets of six planes parallel to the axes. The arithmetic is
 * that of alula_plane_value for such a plane, so that no plane of a hull in the box has a smaller rounded value. */
static float beside(float found, float lower, float upper, float x) {
  const float below = lower - x, above = x - upper;
  if (below > found) found = below;
  return above > found ? above : found;
}

static float lattice_value(const alula_polytope_cbf* cbf, const int32_t lower[3], const int32_t upper[3],
                           const float x[3]) {
  const float g = cbf->image.voxel_size_m, outward = cbf->outward_m;
  float value = -FLT_MAX;
  for (int i = 0; i < 3; ++i)
    value = beside(value, (float)lower[i] * g - outward, (float)upper[i] * g + outward, x[i]);
  return value;
}

static float array_value(const alula_polytope_map* map, uint32_t hull, const float x[3]) {
  float value = -FLT_MAX;
  for (uint32_t i = 0; i < 3U; ++i) value = beside(value, map->lower[3U * hull + i], map->upper[3U * hull + i], x[i]);
  return value;
}

static void advance(const alula_map* map, alula_walk* walk) {
  ++walk->node;
  while (walk->level + 1U < map->level_count && walk->node % ALULA_MAP_FANOUT == 0U) {
    ++walk->level;
    walk->node /= ALULA_MAP_FANOUT;
  }
}

static void enter(const alula_map* map, uint32_t leaf, alula_walk* walk) {
  const uint32_t first = leaf * map->leaf_hulls, left = map->hull_count - first;
  walk->next = first;
  walk->end = first + (left < map->leaf_hulls ? left : map->leaf_hulls);
  walk->at = alula_map_leaf_start(map, leaf);
}

/* Into the next leaf that matters; 0 when there is none. Each node is looked at once at most. */
static int next_leaf(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk) {
  const alula_map* map = &cbf->image;
  if (map->leaf_hulls == 0U) return 0;
  while (walk->node < map->level_size[walk->level]) {
    const uint32_t leaf = walk->node << 2U * walk->level; /* the first below; 4^level */
    const alula_map_box box = alula_map_node(map, walk->level, walk->node);
    const float bound = lattice_value(cbf, box.lower, box.upper, x);
    ++cbf->work.boxes;
    if (leaves_out(cbf, rule, bound, leaf * map->leaf_hulls)) {
      advance(map, walk);
    } else if (walk->level > 0U) {
      --walk->level;
      walk->node *= ALULA_MAP_FANOUT;
    } else {
      advance(map, walk);
      enter(map, leaf, walk);
      return 1;
    }
  }
  return 0;
}

void alula_walk_begin(const alula_polytope_cbf* cbf, alula_walk* walk) {
  const alula_map* map = &cbf->image;
  const int indexed = map->leaf_hulls > 0U;
  walk->level = indexed ? map->level_count - 1U : 0U;
  walk->node = 0U;
  walk->next = 0U;
  walk->end = indexed ? 0U : cbf->map.hull_count;
  walk->at = ALULA_MAP_HEADER_BYTES;
}

/* The next hull of the leaf, which has one. */
static void step(alula_polytope_cbf* cbf, const float x[3], alula_walk* walk) {
  walk->hull = walk->next++;
  ++cbf->work.boxes;
  if (!cbf->image.data) {
    walk->bound = array_value(&cbf->map, walk->hull, x);
  } else if (alula_map_read(&cbf->image, walk->at, &walk->record) == ALULA_MAP_READY) {
    walk->bound = lattice_value(cbf, walk->record.lower, walk->record.upper, x);
    walk->at = walk->record.next;
  } else {
    cbf->is_damaged = 1; /* the image was whole when it was opened */
    walk->bound = FLT_MAX;
    walk->record.plane_count = 0U;
  }
}

int alula_walk_next(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk) {
  do {
    while (walk->next < walk->end) {
      step(cbf, x, walk);
      if (!leaves_out(cbf, rule, walk->bound, walk->hull)) return 1;
    }
  } while (next_leaf(cbf, rule, x, walk));
  return 0;
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
        const alula_map_box box = alula_map_node(map, level, i);
        const float bound = lattice_value(cbf, box.lower, box.upper, x);
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

/* The first row of the hull, when they are still there, else of room for them: then *is_there is 0. */
static uint32_t room_for(alula_polytope_cbf* cbf, uint32_t hull, uint32_t count, int* is_there) {
  for (uint32_t i = 0; i < cbf->kept_count; ++i) {
    if (cbf->kept[i].hull == hull) {
      *is_there = 1;
      return cbf->kept[i].first;
    }
  }
  *is_there = 0;
  if (cbf->kept_count == ALULA_KEPT_HULLS || cbf->row_count + count > ALULA_PLANE_ROWS) {
    cbf->kept_count = 0U;
    cbf->row_count = 0U;
  }
  return cbf->row_count;
}

static void keep(alula_polytope_cbf* cbf, uint32_t hull, uint32_t count) {
  cbf->kept[cbf->kept_count].hull = hull;
  cbf->kept[cbf->kept_count].first = cbf->row_count;
  ++cbf->kept_count;
  cbf->row_count += count;
}

/* Rows of the six faces of a record; their values are those that walk->bound is the largest of. */
static void face_rows(const alula_polytope_cbf* cbf, const alula_map_hull* record, float row[6][4]) {
  const float g = cbf->image.voxel_size_m, outward = cbf->outward_m;
  for (int i = 0; i < 6; ++i) {
    const int axis = i % 3;
    row[i][0] = row[i][1] = row[i][2] = 0.0F;
    row[i][axis] = i < 3 ? -1.0F : 1.0F;
    row[i][3] = (i < 3 ? -(float)record->lower[axis] : (float)record->upper[axis]) * g + outward;
  }
}

/* See alula_polytope_cbf_open for what rounding costs. All sums of integers are below 2^31: normals are at most
 * 127, coordinates 2^22 + 2^15, and a plane cuts its box, so that its depth is below 2^25. */
static void plane_row(const alula_polytope_cbf* cbf, const alula_map_hull* record, uint32_t l, float row[4]) {
  const alula_map_plane plane = alula_map_plane_at(&cbf->image, record, l);
  int32_t square = 0, offset = -(int32_t)plane.depth;
  for (int i = 0; i < 3; ++i) {
    const int32_t n = plane.normal[i];
    square += n * n;
    offset += n * (n > 0 ? record->upper[i] : record->lower[i]);
  }
  const float inverse = 1.0F / __builtin_sqrtf((float)square);
  for (int i = 0; i < 3; ++i) row[i] = (float)plane.normal[i] * inverse;
  row[3] = ((float)offset * cbf->image.voxel_size_m) * inverse + cbf->outward_m;
}

static int decode(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk,
                  float* hard) {
  const uint32_t count = 6U + walk->record.plane_count;
  int is_there;
  float(*row)[4] = cbf->row + room_for(cbf, walk->hull, count, &is_there);
  walk->plane = row[0];
  walk->plane_count = count;
  *hard = walk->bound;
  if (!is_there) face_rows(cbf, &walk->record, row);
  for (uint32_t l = 6U; l < count; ++l) {
    if (!is_there) plane_row(cbf, &walk->record, l - 6U, row[l]);
    const float a = alula_plane_value(row[l], x);
    if (!(a > *hard)) continue;
    *hard = a;
    if (leaves_out(cbf, rule, a, walk->hull)) {
      cbf->work.planes += l + 1U;
      return 0;
    }
  }
  if (!is_there) keep(cbf, walk->hull, count);
  cbf->work.planes += count;
  return 1;
}

int alula_walk_planes(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk,
                      float* hard) {
  ++cbf->work.hulls;
  if (cbf->image.data) return decode(cbf, rule, x, walk, hard);
  const uint32_t begin = cbf->map.plane_start[walk->hull];
  walk->plane = cbf->map.plane + 4U * begin;
  walk->plane_count = cbf->map.plane_start[walk->hull + 1U] - begin;
  *hard = -FLT_MAX;
  for (uint32_t l = 0; l < walk->plane_count; ++l) {
    const float a = alula_plane_value(walk->plane + 4U * l, x);
    if (!(a > *hard)) continue;
    *hard = a;
    if (leaves_out(cbf, rule, a, walk->hull)) {
      cbf->work.planes += l + 1U;
      return 0;
    }
  }
  cbf->work.planes += walk->plane_count;
  return 1;
}
