#include "alula_tiles.h"

#include "bytes.h"
#include "vector.h"

#define LARGEST_LATTICE (1 << 22) /* floats represent all coordinates exactly */
#define LARGEST_POSITION 1.0e12F
#define SMALLEST_VOXEL 1.0e-6F
#define LARGEST_VOXEL 1.0e5F
#define FAR FLT_MAX

static int grid_is_valid(alula_tiles* tiles, const uint8_t* index, uint32_t total) {
  const uint32_t count[2] = {u32_at(index + 16), u32_at(index + 20)};
  const uint32_t edge = u32_at(index + 24), reach = u32_at(index + 28), hysteresis = u32_at(index + 32);
  if (count[0] == 0U || count[1] == 0U || count[0] > ALULA_TILES_MOST || count[1] > ALULA_TILES_MOST / count[0])
    return 0;
  if (total != ALULA_TILES_HEADER_BYTES + ALULA_TILES_ROW_BYTES * count[0] * count[1]) return 0;
  if (edge > LARGEST_LATTICE || reach == 0U || reach > LARGEST_LATTICE) return 0;
  if (hysteresis == 0U || hysteresis > edge / 2U) return 0;
  for (int k = 0; k < 2; ++k) {
    const int64_t first = i32_at(index + 8 + 4 * k), last = first + count[k] - 1;
    if (first * (int64_t)edge < -2 * LARGEST_LATTICE || (last + 1) * (int64_t)edge > 2 * LARGEST_LATTICE) return 0;
    tiles->first[k] = (int32_t)first;
    tiles->last[k] = (int32_t)last;
  }
  const float g = f32_at(index + 76);
  if (!(g >= SMALLEST_VOXEL && g <= LARGEST_VOXEL)) return 0;
  tiles->along_x = count[0];
  tiles->edge = (int32_t)edge;
  tiles->voxel_size_m = g;
  tiles->edge_m = (float)edge * g;
  tiles->reach_m = (float)reach * g;
  tiles->hysteresis_m = (float)hysteresis * g;
  tiles->largest_bytes = u32_at(index + 36);
  for (uint32_t t = 0; t < count[0] * count[1]; ++t) {
    const uint32_t bytes = u32_at(index + ALULA_TILES_HEADER_BYTES + ALULA_TILES_ROW_BYTES * t);
    if (bytes < ALULA_MAP_HEADER_BYTES || bytes > tiles->largest_bytes) return 0;
  }
  return 1;
}

static alula_tiles_status open_index(alula_tiles* tiles, const uint8_t* index, uint32_t length) {
  static const uint8_t MAGIC[4] = {'A', 'L', 'T', 'I'};
  for (uint32_t i = 0; i < 4U && i < length; ++i) {
    if (index[i] != MAGIC[i]) return ALULA_TILES_FOREIGN;
  }
  if (length < ALULA_TILES_HEADER_BYTES) return ALULA_TILES_TRUNCATED;
  if (index[4] != 1U) return ALULA_TILES_NEWER;
  if (u32_at(index + 124) != alula_crc32(index, 124U)) return ALULA_TILES_DAMAGED;
  const uint32_t total = u32_at(index + 72);
  if (u16_at(index + 6) != ALULA_TILES_HEADER_BYTES || total < ALULA_TILES_HEADER_BYTES) return ALULA_TILES_MALFORMED;
  if (total > length) return ALULA_TILES_TRUNCATED;
  if (u32_at(index + 88) != alula_crc32(index + ALULA_TILES_HEADER_BYTES, total - ALULA_TILES_HEADER_BYTES))
    return ALULA_TILES_DAMAGED;
  return grid_is_valid(tiles, index, total) ? ALULA_TILES_READY : ALULA_TILES_MALFORMED;
}

alula_tiles_status alula_tiles_open(alula_tiles* tiles, const uint8_t* index, uint32_t length, const uint8_t* key,
                                    uint32_t key_length, const uint8_t* signature) {
  static const alula_tiles EMPTY = {0};
  if (!tiles) return ALULA_TILES_BAD_POINTER;
  *tiles = EMPTY;
  tiles->active = tiles->loading = ALULA_TILES_NO_SLOT;
  if (!index || (key && !signature)) return ALULA_TILES_BAD_POINTER;
  alula_tiles_status status = open_index(tiles, index, length);
  if (status == ALULA_TILES_READY && key) {
    uint8_t code[ALULA_SHA256_BYTES];
    alula_hmac_sha256(key, key_length, index, u32_at(index + 72), code);
    if (!alula_sha256_equal(code, signature)) status = ALULA_TILES_FORGED;
  }
  if (status == ALULA_TILES_READY) tiles->index = index;
  return status;
}

/* Number of the tile with a coordinate along one axis; the one at the rim beyond it. */
static int32_t tile_of(const alula_tiles* tiles, int k, float x) {
  const float at = x / tiles->edge_m;
  if (!(at > (float)tiles->first[k])) return tiles->first[k];
  if (at >= (float)tiles->last[k]) return tiles->last[k];
  const int32_t whole = (int32_t)at;
  return (float)whole > at ? whole - 1 : whole;
}

/* The ends of a tile along one axis, grown; without end at the rim. */
static void ends_of(const alula_tiles* tiles, int k, int32_t tile, float grown, float ends[2]) {
  ends[0] = tile <= tiles->first[k] ? -FAR : (float)(tile * tiles->edge) * tiles->voxel_size_m - grown;
  ends[1] = tile >= tiles->last[k] ? FAR : (float)((tile + 1) * tiles->edge) * tiles->voxel_size_m + grown;
}

/* The distance of a position from a tile along x and y, the larger of both; at most 0 within. */
static float outside(const alula_tiles* tiles, const alula_tile_slot* slot, const float position[3]) {
  float largest = -FAR;
  for (int k = 0; k < 2; ++k) {
    float ends[2];
    ends_of(tiles, k, slot->at[k], 0.0F, ends);
    if (ends[0] - position[k] > largest) largest = ends[0] - position[k];
    if (position[k] - ends[1] > largest) largest = position[k] - ends[1];
  }
  return largest;
}

static int is_resident(const alula_tiles* tiles, uint32_t slot) { return tiles->slot[slot].map.data != 0; }

/* Keeps the active tile within half the hysteresis of it; otherwise takes the nearest resident one that has the
 * position in its region, so that a switch never leads behind a wall. */
static void choose(alula_tiles* tiles, const float position[3]) {
  float best = tiles->hysteresis_m;
  if (tiles->active != ALULA_TILES_NO_SLOT) {
    const float now = outside(tiles, tiles->slot + tiles->active, position);
    if (now <= 0.5F * tiles->hysteresis_m) return;
    if (now < best) best = now;
  }
  for (uint32_t s = 0; s < ALULA_TILES_SLOTS; ++s) {
    if (s == tiles->active || !is_resident(tiles, s)) continue;
    const float distance = outside(tiles, tiles->slot + s, position);
    if (!(distance < best)) continue;
    best = distance;
    tiles->active = s;
  }
}

/* The tile in which the way from the position to `towards` leaves the region of the active tile; the tile of
 * `towards` if it does not leave it, and of the position if that is outside already. */
static void next_tile(const alula_tiles* tiles, const float position[3], const float towards[3], int32_t at[2]) {
  const alula_tile_slot* slot = tiles->active != ALULA_TILES_NO_SLOT ? tiles->slot + tiles->active : 0;
  float along = 1.0F;
  if (!slot || outside(tiles, slot, position) > tiles->hysteresis_m) along = 0.0F;
  for (int k = 0; k < 2 && along > 0.0F; ++k) {
    float ends[2];
    ends_of(tiles, k, slot->at[k], tiles->hysteresis_m, ends);
    const float way = towards[k] - position[k];
    const float room = way < 0.0F ? ends[0] - position[k] : ends[1] - position[k];
    if (absolute(along * way) > absolute(room)) along = room / way;
  }
  for (int k = 0; k < 2; ++k) at[k] = tile_of(tiles, k, position[k] + along * (towards[k] - position[k]));
}

static uint32_t row_of(const alula_tiles* tiles, const int32_t at[2]) {
  return (uint32_t)(at[1] - tiles->first[1]) * tiles->along_x + (uint32_t)(at[0] - tiles->first[0]);
}

static void request_next(alula_tiles* tiles, const float position[3], const float towards[3]) {
  int32_t at[2];
  next_tile(tiles, position, towards, at);
  const uint32_t tile = row_of(tiles, at);
  for (uint32_t s = 0; s < ALULA_TILES_SLOTS; ++s) {
    if (is_resident(tiles, s) && tiles->slot[s].tile == tile) return;
  }
  const uint32_t free = tiles->active == 0U ? 1U : 0U;
  alula_tile_slot* slot = tiles->slot + free;
  slot->tile = tile;
  slot->at[0] = at[0];
  slot->at[1] = at[1];
  slot->map.data = 0;
  tiles->loading = free;
}

static int is_position(const float x[3]) {
  return absolute(x[0]) <= LARGEST_POSITION && absolute(x[1]) <= LARGEST_POSITION &&
         absolute(x[2]) <= LARGEST_POSITION; /* not for NaN */
}

alula_tiles_place alula_tiles_select(alula_tiles* tiles, const float position[3], const float towards[3],
                                     const alula_map** map) {
  if (!map) return ALULA_TILES_NOT_LOADED;
  *map = 0;
  if (!tiles || !tiles->index || !position || !is_position(position)) return ALULA_TILES_NOT_LOADED;
  choose(tiles, position);
  if (tiles->loading == ALULA_TILES_NO_SLOT)
    request_next(tiles, position, towards && is_position(towards) ? towards : position);
  if (tiles->active == ALULA_TILES_NO_SLOT) return ALULA_TILES_NOT_LOADED;
  const alula_tile_slot* slot = tiles->slot + tiles->active;
  const float beyond = outside(tiles, slot, position) - tiles->hysteresis_m;
  if (!(beyond < tiles->reach_m)) return ALULA_TILES_NOT_LOADED; /* in a wall: the position has jumped */
  *map = &slot->map;
  return beyond <= 0.0F ? ALULA_TILES_INSIDE : ALULA_TILES_OUTSIDE;
}

int alula_tiles_request(const alula_tiles* tiles, alula_tiles_request_data* request) {
  if (!tiles || !request || !tiles->index || tiles->loading == ALULA_TILES_NO_SLOT) return 0;
  const alula_tile_slot* slot = tiles->slot + tiles->loading;
  request->slot = tiles->loading;
  request->tile = slot->tile;
  request->at[0] = slot->at[0];
  request->at[1] = slot->at[1];
  request->bytes = u32_at(tiles->index + ALULA_TILES_HEADER_BYTES + ALULA_TILES_ROW_BYTES * slot->tile);
  return 1;
}

alula_tiles_status alula_tiles_loaded(alula_tiles* tiles, const uint8_t* image) {
  alula_tiles_request_data request;
  if (!tiles || !image) return ALULA_TILES_BAD_POINTER;
  if (!alula_tiles_request(tiles, &request)) return ALULA_TILES_NO_REQUEST;
  const uint8_t* row = tiles->index + ALULA_TILES_HEADER_BYTES + ALULA_TILES_ROW_BYTES * request.tile;
  alula_sha256 hash;
  uint8_t digest[ALULA_SHA256_BYTES];
  alula_sha256_begin(&hash);
  alula_sha256_add(&hash, image, request.bytes);
  alula_sha256_end(&hash, digest);
  if (!alula_sha256_equal(digest, row + 8)) return ALULA_TILES_DAMAGED;
  alula_map* map = &tiles->slot[request.slot].map;
  if (alula_map_open(map, image, request.bytes) != ALULA_MAP_READY) return ALULA_TILES_MALFORMED;
  if (map->total_bytes != request.bytes || map->voxel_size_m != tiles->voxel_size_m) {
    map->data = 0;
    return ALULA_TILES_MALFORMED;
  }
  tiles->loading = ALULA_TILES_NO_SLOT;
  return ALULA_TILES_READY;
}
