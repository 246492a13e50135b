#include "alula_map_near.h"

#include "map_index.h"

#define SLACK 4.0F     /* slack of comparisons for rounding, in margins */
#define SHRUNK 0.9999F /* covers the rounding of distances and the growth of the margin */
#define WIDE 1.0F      /* [m] hulls up to psi + WIDE + WIDER psi are listed */
#define WIDER 0.5F
#define NARROW 0.01F /* [m] */
#define THICK 8.0F   /* [m] planes down to psi_h minus at most this are cached */
#define THIN 1.0e-2F /* [m] */
#define THINNER 0.7F

typedef struct {
  const float* x;
  float slack;
  alula_map_value found; /* without margin */
  alula_map_status status;
} query;

/* A walk through the hulls in their order, by the index or record by record. */
typedef struct {
  uint32_t level, node;   /* next node of the index */
  uint32_t next, end, at; /* hulls of the leaf, and the byte of the next one's record */
} walk;

void alula_map_near_open(alula_map_near* near, const alula_map* map) {
  if (!near) return;
  near->map = map;
  near->count = near->last = 0U;
  near->thickness = THICK;
  near->wide = FLT_MAX;
  for (uint32_t k = 0; k < ALULA_NEAR_FAR; ++k) near->far[k].hull = ALULA_MAP_NO_HULL;
  for (uint32_t k = 0; k < ALULA_NEAR_KEPT; ++k) near->kept[k].hull = ALULA_MAP_NO_HULL;
}

static float square_between(const float a[3], const float b[3]) {
  const float way[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  return dot(way, way);
}

/* Nonzero if a hull of at least this value does not change the result. */
static inline int is_beyond(const alula_map_value* found, float psi, uint32_t hull) {
  return psi > found->psi_m || (psi == found->psi_m && hull > found->hull);
}

static void accept(query* q, uint32_t hull, float psi, int face, const float* row) {
  q->found.psi_m = psi;
  q->found.hull = hull;
  for (int i = 0; i < 3; ++i) q->found.normal[i] = row ? row[i] : 0.0F;
  if (!row) q->found.normal[face % 3] = face < 3 ? -1.0F : 1.0F;
}

/* Keeps only the planes of at least this value; returns their number. */
static uint32_t drop(alula_kept_planes* kept, float* value, uint32_t count, float least) {
  uint32_t left = 0U;
  for (uint32_t l = 0; l < count; ++l) {
    if (value[l] < least) continue;
    value[left] = value[l];
    for (int i = 0; i < 4; ++i) kept->plane[left][i] = kept->plane[l][i];
    ++left;
  }
  return left;
}

/* Decodes a hull's planes up to the one that shows it to be beyond, and caches those that decide around x. `psi` is
 * the box's value, of `face`. */
static void look_at_all(alula_map_near* near, const alula_listed_hull* hull, float psi, int face, query* q) {
  const alula_map* map = near->map;
  alula_kept_planes* const kept = &near->tried;
  alula_map_hull record;
  if (alula_map_read(map, hull->record, &record) != ALULA_MAP_READY) {
    q->status = ALULA_MAP_MALFORMED; /* it was valid when it was opened */
    return;
  }
  float value[ALULA_NEAR_PLANES], row[4], deciding[3] = {0.0F, 0.0F, 0.0F}, thickness = near->thickness;
  uint32_t count = 0U;
  int is_face = 1;
  kept->last = 0U;
  kept->reach_square = -1.0F;
  const uint8_t* stored = record.planes;
  for (uint32_t l = 0; l < record.plane_count; ++l, stored += map->plane_bytes) {
    const alula_map_plane plane = alula_map_plane_in(stored, map->plane_bytes, record.shift);
    alula_map_plane_row(&plane, &record, map->voxel_size_m, 0.0F, row);
    const float a = alula_plane_value(row, q->x);
    if (a > psi) {
      psi = a;
      is_face = 0;
      for (int i = 0; i < 3; ++i) deciding[i] = row[i];
      if (is_beyond(&q->found, psi, hull->hull)) {
        alula_far_plane* far = &near->far[hull->hull % ALULA_NEAR_FAR];
        far->hull = hull->hull;
        for (int i = 0; i < 4; ++i) far->plane[i] = row[i];
        return;
      }
    }
    if (a < psi - thickness) continue;
    while (count == ALULA_NEAR_PLANES && thickness > THIN) {
      thickness *= THINNER;
      count = drop(kept, value, count, psi - thickness);
    }
    if (a < psi - thickness) continue;
    if (count == ALULA_NEAR_PLANES) {
      thickness = 0.0F; /* too many planes of equal value: the cache is incomplete */
      continue;
    }
    value[count] = a;
    for (int i = 0; i < 4; ++i) kept->plane[count][i] = row[i];
    ++count;
  }
  kept->hull = hull->hull;
  kept->count = drop(kept, value, count, psi - thickness);
  for (int i = 0; i < 3; ++i) kept->at[i] = q->x[i];
  const float next = thickness * (2.0F * THINNER); /* almost half more than fitted */
  near->thickness = next < THIN ? THIN : (next < THICK ? next : THICK);
  const float reach = 0.5F * SHRUNK * (thickness - q->slack);
  if (reach > 0.0F) kept->reach_square = reach * reach;
  near->kept[hull->hull % ALULA_NEAR_KEPT] = *kept;
  accept(q, hull->hull, psi, face, is_face ? 0 : deciding);
}

/* alula_plane_value for a position in registers. */
static inline float row_value(const float* row, float x, float y, float z) {
  const float at[3] = {x, y, z};
  return alula_plane_value(row, at);
}

/* Replaces the result by psi_h when that is smaller, or equal with an earlier h. */
static void consider(alula_map_near* near, const alula_listed_hull* hull, query* q) {
  int face;
  const float box = alula_map_box_value(hull->lower, hull->upper, q->x, &face);
  if (is_beyond(&q->found, box, hull->hull)) return;
  const alula_far_plane* far = &near->far[hull->hull % ALULA_NEAR_FAR];
  if (far->hull == hull->hull && is_beyond(&q->found, alula_plane_value(far->plane, q->x), hull->hull)) return;
  alula_kept_planes* kept = &near->kept[hull->hull % ALULA_NEAR_KEPT];
  if (kept->hull == hull->hull) {
    const float x = q->x[0], y = q->x[1], z = q->x[2];
    if (kept->count > 0U && is_beyond(&q->found, row_value(kept->plane[kept->last], x, y, z), hull->hull)) return;
    uint32_t decides = ALULA_NEAR_PLANES;
    float psi = box;
    for (uint32_t l = 0; l < kept->count; ++l) {
      const float a = row_value(kept->plane[l], x, y, z);
      if (!(a > psi)) continue;
      psi = a;
      decides = l;
    }
    if (decides < ALULA_NEAR_PLANES) kept->last = decides;
    if (is_beyond(&q->found, psi, hull->hull)) return;
    if (square_between(q->x, kept->at) <= kept->reach_square) {
      accept(q, hull->hull, psi, face, decides < ALULA_NEAR_PLANES ? kept->plane[decides] : 0);
      return;
    }
  }
  look_at_all(near, hull, box, face, q);
}

static walk begin(const alula_map* map) {
  const int indexed = map->leaf_hulls > 0U;
  const walk w = {indexed ? map->level_count - 1U : 0U, 0U, 0U, indexed ? 0U : map->hull_count,
                  ALULA_MAP_HEADER_BYTES};
  return w;
}

static void enter(const alula_map* map, uint32_t leaf, walk* w) {
  const uint32_t first = leaf * map->leaf_hulls, left = map->hull_count - first;
  w->next = first;
  w->end = first + (left < map->leaf_hulls ? left : map->leaf_hulls);
  w->at = alula_map_leaf_start(map, leaf);
}

static float node_bound(const alula_map* map, uint32_t level, uint32_t node, const float x[3]) {
  const alula_map_box box = alula_map_node(map, level, node);
  float lower[3], upper[3];
  int face;
  for (int i = 0; i < 3; ++i) {
    lower[i] = (float)box.lower[i] * map->voxel_size_m;
    upper[i] = (float)box.upper[i] * map->voxel_size_m;
  }
  return alula_map_box_value(lower, upper, x, &face);
}

/* Reads the current hull of the walk and advances. */
static int step(const alula_map* map, walk* w, query* q, alula_listed_hull* hull) {
  alula_map_hull record;
  int face;
  if (alula_map_read(map, w->at, &record) != ALULA_MAP_READY) {
    q->status = ALULA_MAP_MALFORMED;
    return 0;
  }
  hull->hull = w->next++;
  hull->is_refined = 0U;
  hull->record = w->at;
  w->at = record.next;
  for (int i = 0; i < 3; ++i) {
    hull->lower[i] = (float)record.lower[i] * map->voxel_size_m;
    hull->upper[i] = (float)record.upper[i] * map->voxel_size_m;
  }
  hull->bound = alula_map_box_value(hull->lower, hull->upper, q->x, &face);
  return 1;
}

/* Advances to the next hull with a box within `cut`; 0 at the end, or when the map has become invalid. */
static int next_hull(const alula_map* map, walk* w, query* q, float cut, alula_listed_hull* hull) {
  for (;;) {
    while (w->next < w->end) {
      if (!step(map, w, q, hull)) return 0;
      if (!(hull->bound > cut)) return 1;
    }
    if (map->leaf_hulls == 0U) return 0;
    for (;;) {
      if (w->node >= map->level_size[w->level]) return 0;
      if (node_bound(map, w->level, w->node, q->x) > cut) {
        alula_map_pass(map, &w->level, &w->node);
      } else if (w->level > 0U) {
        --w->level;
        w->node *= ALULA_MAP_FANOUT;
      } else {
        enter(map, w->node, w);
        alula_map_pass(map, &w->level, &w->node);
        break;
      }
    }
  }
}

/* Evaluates hulls that are probably near: those of the leaf reached by the nearest child of each node. */
static void guess(alula_map_near* near, query* q) {
  const alula_map* map = near->map;
  walk w = begin(map);
  if (map->leaf_hulls > 0U) {
    uint32_t best = 0U;
    for (uint32_t level = map->level_count - 1U; level-- > 0U;) {
      const uint32_t first = ALULA_MAP_FANOUT * best;
      float least = FLT_MAX;
      best = first;
      for (uint32_t i = first; i < first + ALULA_MAP_FANOUT && i < map->level_size[level]; ++i) {
        const float bound = node_bound(map, level, i, q->x);
        if (!(bound < least)) continue;
        least = bound;
        best = i;
      }
    }
    enter(map, best, &w);
  } else {
    w.end = 1U;
  }
  alula_listed_hull hull;
  while (w.next < w.end && step(map, &w, q, &hull)) consider(near, &hull, q);
}

/* Raises a bound to psi_h, or to a plane's value beyond the limit: from far away over a corner, boxes alone would
 * list most hulls. */
static void refine(const alula_map* map, alula_listed_hull* hull, float limit, query* q) {
  alula_map_hull record;
  if (hull->is_refined) return;
  hull->is_refined = 1U;
  if (alula_map_read(map, hull->record, &record) != ALULA_MAP_READY) {
    q->status = ALULA_MAP_MALFORMED;
    return;
  }
  const uint8_t* stored = record.planes;
  for (uint32_t l = 0; l < record.plane_count && !(hull->bound > limit); ++l, stored += map->plane_bytes) {
    const alula_map_plane plane = alula_map_plane_in(stored, map->plane_bytes, record.shift);
    float row[4];
    alula_map_plane_row(&plane, &record, map->voxel_size_m, 0.0F, row);
    const float a = alula_plane_value(row, q->x);
    if (a > hull->bound) hull->bound = a;
  }
}

/* Keeps only the listed hulls that may be within the limit. */
static void drop_listed(alula_map_near* near, float limit) {
  uint32_t left = 0U;
  for (uint32_t k = 0; k < near->count; ++k) {
    if (!(near->listed[k].bound > limit)) near->listed[left++] = near->listed[k];
  }
  near->count = left;
}

/* Makes a new list around x and finds the nearest hull, given some hull's psi_h or none. */
static void gather(alula_map_near* near, query* q) {
  const alula_map* map = near->map;
  near->count = near->last = 0U;
  if (q->found.hull == ALULA_MAP_NO_HULL) guess(near, q);
  const float base = q->found.psi_m;
  float wide = WIDE + (base > 0.0F ? WIDER * base : 0.0F), left_out = FLT_MAX;
  if (wide > near->wide) wide = near->wide;
  float limit = base + wide;
  alula_listed_hull hull;
  walk w = begin(map);
  while (next_hull(map, &w, q, limit, &hull)) {
    while (near->count == ALULA_LISTED_HULLS && wide > NARROW) {
      if (wide < WIDE) {
        for (uint32_t k = 0; k < near->count; ++k) refine(map, &near->listed[k], limit, q);
        refine(map, &hull, limit, q);
        drop_listed(near, limit);
        if (near->count < ALULA_LISTED_HULLS) break;
      }
      wide *= 0.5F;
      limit = base + wide;
      drop_listed(near, limit);
    }
    if (hull.bound > limit) continue;
    if (near->count < ALULA_LISTED_HULLS) {
      near->listed[near->count++] = hull;
    } else if (hull.bound < left_out) {
      left_out = hull.bound;
    }
  }
  near->wide = 1.5F * wide; /* more may fit the next time */
  for (int i = 0; i < 3; ++i) near->centre[i] = q->x[i];
  near->limit = limit < left_out ? limit : left_out;
  for (uint32_t k = 0; k < near->count; ++k) consider(near, &near->listed[k], q);
  if (!(left_out > q->found.psi_m)) {
    w = begin(map);
    while (next_hull(map, &w, q, q->found.psi_m, &hull)) consider(near, &hull, q);
  }
  for (uint32_t k = 0; k < near->count; ++k) {
    if (near->listed[k].hull == q->found.hull) near->last = k;
  }
}

/* Finds the nearest hull of the list; nonzero if no other hull can be nearer. */
static int search_list(alula_map_near* near, query* q) {
  if (near->count == 0U) return 0;
  const float travelled = __builtin_sqrtf(square_between(q->x, near->centre)) * (2.0F - SHRUNK) + q->slack;
  const uint32_t first = near->last;
  consider(near, &near->listed[first], q);
  for (uint32_t k = 0; k < near->count; ++k) {
    const alula_listed_hull* hull = &near->listed[k];
    if (hull->bound - travelled > q->found.psi_m || k == first) continue;
    consider(near, hull, q);
    if (q->found.hull == hull->hull) near->last = k;
  }
  return q->found.psi_m < near->limit - travelled;
}

alula_map_status alula_map_near_evaluate(alula_map_near* near, const float x[3], alula_map_value* value) {
  if (!near) return ALULA_MAP_BAD_POINTER;
  float margin;
  query q = {x, 0.0F, {FLT_MAX, ALULA_MAP_NO_HULL, {0.0F, 0.0F, 0.0F}}, ALULA_MAP_READY};
  const alula_map_status begun = alula_map_begin(near->map, x, value, &margin);
  if (begun != ALULA_MAP_READY) return begun;
  q.slack = SLACK * margin;
  if (near->map->hull_count > 0U) {
    if (!search_list(near, &q) && q.status == ALULA_MAP_READY) gather(near, &q);
    if (q.status != ALULA_MAP_READY) {
      alula_map_near_open(near, near->map);
      return q.status;
    }
    q.found.psi_m -= margin;
  }
  *value = q.found;
  return ALULA_MAP_READY;
}
