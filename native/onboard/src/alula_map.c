#include "alula_map.h"

#include "bytes.h"
#include "map_index.h"
#include "vector.h"

#define EXTENT_OF_MARGIN 262144.0F /* 2^18 */
#define MARGIN_OF_EXTENT (1.0F / EXTENT_OF_MARGIN)
#define LARGEST_POSITION 1.0e12F
#define SMALLEST_VOXEL 1.0e-6F
#define LARGEST_VOXEL 1.0e5F
#define LARGEST_ORIGIN (1 << 22) /* floats represent all coordinates exactly */

const int8_t alula_map_direction[ALULA_MAP_DIRECTIONS][3] = {
    {-1, -1, -1}, {-1, -1, 0}, {-1, -1, 1}, {-1, 0, -1}, {-1, 0, 1}, {-1, 1, -1}, {-1, 1, 0},
    {-1, 1, 1},   {0, -1, -1}, {0, -1, 1},  {0, 1, -1},  {0, 1, 1},  {1, -1, -1}, {1, -1, 0},
    {1, -1, 1},   {1, 0, -1},  {1, 0, 1},   {1, 1, -1},  {1, 1, 0},  {1, 1, 1}};

/* Half a byte at a time. */
uint32_t alula_crc32(const uint8_t* data, uint32_t length) {
  static const uint32_t TABLE[16] = {0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U,
                                     0x4DB26158U, 0x5005713CU, 0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU,
                                     0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU};
  uint32_t crc = 0xFFFFFFFFU;
  for (uint32_t i = 0; i < length; ++i) {
    crc ^= data[i];
    crc = crc >> 4 ^ TABLE[crc & 15U];
    crc = crc >> 4 ^ TABLE[crc & 15U];
  }
  return ~crc;
}

/* Nonzero for a valid record: a box with volume within the extent, and planes that cut it without removing all of
 * it. */
static int hull_is_valid(const alula_map* map, const alula_map_hull* hull, int32_t largest) {
  for (int i = 0; i < 3; ++i) {
    if (hull->lower[i] >= hull->upper[i]) return 0;
    if (absolute((float)hull->lower[i] * map->voxel_size_m) > map->extent_m) return 0;
    if (absolute((float)hull->upper[i] * map->voxel_size_m) > map->extent_m) return 0;
  }
  for (uint32_t l = 0; l < hull->plane_count; ++l) {
    const uint8_t* at = hull->planes + l * map->plane_bytes;
    if (map->plane_bytes == ALULA_MAP_KDOP_PLANE_BYTES && (at[0] & 31U) >= ALULA_MAP_DIRECTIONS) return 0;
    const alula_map_plane plane = alula_map_plane_at(map, hull, l);
    int64_t reach = 0;
    int oblique = 0;
    for (int i = 0; i < 3; ++i) {
      const int32_t size = plane.normal[i] < 0 ? -plane.normal[i] : plane.normal[i];
      if (size > largest) return 0;
      if (size > 0) ++oblique;
      reach += (int64_t)size * (hull->upper[i] - hull->lower[i]);
    }
    if (oblique < 2 || plane.depth == 0U || (int64_t)plane.depth >= reach) return 0;
  }
  return 1;
}

static alula_map_status check_records(alula_map* map, int32_t largest, int indexed) {
  uint32_t at = ALULA_MAP_HEADER_BYTES;
  for (uint32_t h = 0; h < map->hull_count; ++h) {
    alula_map_hull hull;
    if (alula_map_read(map, at, &hull) != ALULA_MAP_READY) return ALULA_MAP_MALFORMED;
    if (!hull_is_valid(map, &hull, largest)) return ALULA_MAP_MALFORMED;
    map->plane_count += hull.plane_count;
    if (hull.plane_count > map->most_planes) map->most_planes = hull.plane_count;
    at = hull.next;
  }
  map->records_end = at;
  if (!indexed) return at == map->total_bytes ? ALULA_MAP_READY : ALULA_MAP_MALFORMED;
  return alula_map_index_open(map) ? ALULA_MAP_READY : ALULA_MAP_MALFORMED;
}

static alula_map_status open_map(alula_map* map, const uint8_t* data, uint32_t length) {
  static const uint8_t MAGIC[4] = {'A', 'L', 'M', 'P'};
  for (uint32_t i = 0; i < 4U && i < length; ++i) {
    if (data[i] != MAGIC[i]) return ALULA_MAP_FOREIGN;
  }
  if (length < ALULA_MAP_HEADER_BYTES) return ALULA_MAP_TRUNCATED;
  if (data[4] != 1U) return ALULA_MAP_NEWER;
  if (u32_at(data + 60) != alula_crc32(data, 60U)) return ALULA_MAP_DAMAGED;
  const uint32_t flags = u16_at(data + 8);
  if ((flags & ~(ALULA_MAP_KDOP | ALULA_MAP_INDEXED)) != 0U) return ALULA_MAP_NEWER;
  const uint32_t total = u32_at(data + 16);
  if (u16_at(data + 6) != ALULA_MAP_HEADER_BYTES || total < ALULA_MAP_HEADER_BYTES) return ALULA_MAP_MALFORMED;
  if (total > length) return ALULA_MAP_TRUNCATED;
  if (u32_at(data + 20) != alula_crc32(data + ALULA_MAP_HEADER_BYTES, total - ALULA_MAP_HEADER_BYTES)) {
    return ALULA_MAP_DAMAGED;
  }
  map->data = data;
  map->total_bytes = map->records_end = total;
  map->hull_count = u32_at(data + 12);
  map->plane_bytes = (flags & ALULA_MAP_KDOP) != 0U ? ALULA_MAP_KDOP_PLANE_BYTES : ALULA_MAP_PLANE_BYTES;
  map->voxel_size_m = f32_at(data + 36);
  map->margin_m = f32_at(data + 48);
  map->extent_m = map->margin_m * EXTENT_OF_MARGIN;
  if (map->hull_count > ALULA_MAP_MOST_HULLS || data[11] != 0U) return ALULA_MAP_MALFORMED;
  const int32_t largest = i8_at(data + 10);
  if (largest < 1 || ((flags & ALULA_MAP_KDOP) != 0U && largest != 1)) return ALULA_MAP_MALFORMED;
  if (!(map->voxel_size_m >= SMALLEST_VOXEL && map->voxel_size_m <= LARGEST_VOXEL)) return ALULA_MAP_MALFORMED;
  if (!(map->extent_m >= map->voxel_size_m && map->extent_m <= LARGEST_POSITION)) return ALULA_MAP_MALFORMED;
  for (int i = 0; i < 3; ++i) {
    map->origin[i] = i32_at(data + 24 + 4 * i);
    if (map->origin[i] < -LARGEST_ORIGIN || map->origin[i] > LARGEST_ORIGIN) return ALULA_MAP_MALFORMED;
  }
  return check_records(map, largest, (flags & ALULA_MAP_INDEXED) != 0U);
}

alula_map_status alula_map_open(alula_map* map, const uint8_t* data, uint32_t length) {
  static const alula_map EMPTY = {0};
  if (!map) return ALULA_MAP_BAD_POINTER;
  *map = EMPTY;
  if (!data) return ALULA_MAP_BAD_POINTER;
  const alula_map_status status = open_map(map, data, length);
  if (status != ALULA_MAP_READY) *map = EMPTY;
  return status;
}

alula_map_status alula_map_read(const alula_map* map, uint32_t at, alula_map_hull* hull) {
  if (!map || !map->data || !hull) return ALULA_MAP_BAD_POINTER;
  if (at < ALULA_MAP_HEADER_BYTES || at > map->records_end || map->records_end - at < ALULA_MAP_HULL_BYTES) {
    return ALULA_MAP_MALFORMED;
  }
  const uint8_t* record = map->data + at;
  const uint32_t bytes = ALULA_MAP_HULL_BYTES + record[12] * map->plane_bytes;
  if (map->records_end - at < bytes || record[13] > ALULA_MAP_MOST_SHIFT) return ALULA_MAP_MALFORMED;
  for (int i = 0; i < 3; ++i) {
    hull->lower[i] = map->origin[i] + i16_at(record + 2 * i);
    hull->upper[i] = map->origin[i] + i16_at(record + 6 + 2 * i);
  }
  hull->plane_count = record[12];
  hull->shift = record[13];
  hull->planes = record + ALULA_MAP_HULL_BYTES;
  hull->next = at + bytes;
  return ALULA_MAP_READY;
}

alula_map_plane alula_map_plane_at(const alula_map* map, const alula_map_hull* hull, uint32_t l) {
  return alula_map_plane_in(hull->planes + l * map->plane_bytes, map->plane_bytes, hull->shift);
}

/* Replaces *value by psi_h when that is smaller. */
static void evaluate_hull(const alula_map* map, const alula_map_hull* hull, uint32_t number, const float x[3],
                          alula_map_value* value) {
  const float g = map->voxel_size_m;
  float lower[3], upper[3], normal[3] = {0.0F, 0.0F, 0.0F};
  for (int i = 0; i < 3; ++i) {
    lower[i] = (float)hull->lower[i] * g;
    upper[i] = (float)hull->upper[i] * g;
  }
  int face;
  float psi = alula_map_box_value(lower, upper, x, &face);
  normal[face % 3] = face < 3 ? -1.0F : 1.0F;
  for (uint32_t l = 0; l < hull->plane_count && psi < value->psi_m; ++l) {
    const alula_map_plane plane = alula_map_plane_at(map, hull, l);
    float row[4];
    alula_map_plane_row(&plane, hull, g, 0.0F, row);
    const float a = alula_plane_value(row, x);
    if (a > psi) {
      psi = a;
      for (int i = 0; i < 3; ++i) normal[i] = row[i];
    }
  }
  if (!(psi < value->psi_m)) return;
  value->psi_m = psi;
  value->hull = number;
  for (int i = 0; i < 3; ++i) value->normal[i] = normal[i];
}

alula_map_status alula_map_begin(const alula_map* map, const float x[3], alula_map_value* value, float* margin) {
  if (!map || !map->data || !x || !value) return ALULA_MAP_BAD_POINTER;
  value->psi_m = -FLT_MAX; /* for a caller that ignores the status */
  value->hull = ALULA_MAP_NO_HULL;
  value->normal[0] = value->normal[1] = value->normal[2] = 0.0F;
  float largest = map->extent_m;
  for (int i = 0; i < 3; ++i) {
    if (!(absolute(x[i]) <= LARGEST_POSITION)) return ALULA_MAP_BAD_POSITION; /* also NaN */
    if (absolute(x[i]) > largest) largest = absolute(x[i]);
  }
  *margin = largest * MARGIN_OF_EXTENT;
  return ALULA_MAP_READY;
}

alula_map_status alula_map_evaluate(const alula_map* map, const float x[3], alula_map_value* value) {
  float margin;
  const alula_map_status begun = alula_map_begin(map, x, value, &margin);
  if (begun != ALULA_MAP_READY) return begun;
  alula_map_value found = *value;
  found.psi_m = FLT_MAX;
  uint32_t at = ALULA_MAP_HEADER_BYTES;
  for (uint32_t h = 0; h < map->hull_count; ++h) {
    alula_map_hull hull;
    const alula_map_status status = alula_map_read(map, at, &hull);
    if (status != ALULA_MAP_READY) return status;
    evaluate_hull(map, &hull, h, x, &found);
    at = hull.next;
  }
  if (found.hull != ALULA_MAP_NO_HULL) found.psi_m -= margin;
  *value = found;
  return ALULA_MAP_READY;
}
