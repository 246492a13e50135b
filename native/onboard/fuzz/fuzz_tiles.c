/* An index of tiles, positions, and images that are loaded when they are requested. */
#include "fuzz.h"

/* Makes the checksums of an index match its bytes. */
static void seal(uint8_t* index, uint32_t size) {
  put(index + 72, size);
  put(index + 88, crc_of(index + ALULA_TILES_HEADER_BYTES, size - ALULA_TILES_HEADER_BYTES));
  put(index + 124, crc_of(index, 124));
}

/* Makes a row of the index match an image. */
static void list(uint8_t* index, uint32_t tile, const uint8_t* image, uint32_t size) {
  uint8_t* row = index + ALULA_TILES_HEADER_BYTES + ALULA_TILES_ROW_BYTES * tile;
  alula_sha256 hash;
  put(row, size);
  alula_sha256_begin(&hash);
  alula_sha256_add(&hash, image, size);
  alula_sha256_end(&hash, row + 8);
}

static void check_place(const alula_tiles* tiles, alula_tiles_place place, const alula_map* map) {
  CHECK((place == ALULA_TILES_NOT_LOADED) == (map == NULL));
  CHECK(!map || map == &tiles->slot[tiles->active].map);
  CHECK(!map || map->data != NULL);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  const uint32_t wanted = take(&in, 2), length = wanted < in.left ? wanted : (uint32_t)in.left;
  uint8_t* index = malloc(length > 0U ? length : 1U);
  if (!index) abort();
  memcpy(index, in.at, length);
  in.at += length;
  in.left -= length;
  if (length >= ALULA_TILES_HEADER_BYTES && take(&in, 1) != 1U) seal(index, length);
  uint32_t image_bytes;
  uint8_t* image = take_image(&in, &image_bytes);
  alula_tiles tiles;
  alula_tiles_request_data request;
  const alula_map* map;
  const uint8_t key[3] = {1, 2, 3};
  uint8_t signature[ALULA_SHA256_BYTES] = {0};
  if (alula_tiles_open(&tiles, index, length, NULL, 0, NULL) == ALULA_TILES_READY) {
    for (int k = 0; k < 24; ++k) {
      float x[3], towards[3];
      const float scale = 2.0F * tiles.edge_m * (float)(tiles.last[0] - tiles.first[0] + 1);
      take_floats(&in, scale, x, 3);
      take_floats(&in, scale, towards, 3);
      check_place(&tiles, alula_tiles_select(&tiles, x, towards, &map), map);
      if (!alula_tiles_request(&tiles, &request)) continue;
      CHECK(request.slot < ALULA_TILES_SLOTS && request.slot != tiles.active);
      CHECK(request.at[0] >= tiles.first[0] && request.at[0] <= tiles.last[0]);
      CHECK(request.at[1] >= tiles.first[1] && request.at[1] <= tiles.last[1]);
      if (image_bytes < ALULA_MAP_HEADER_BYTES || image_bytes > tiles.largest_bytes) continue;
      list(index, request.tile, image, image_bytes); /* of all images this one passes the hash */
      const alula_tiles_status status = alula_tiles_loaded(&tiles, image);
      CHECK(status == ALULA_TILES_READY || status == ALULA_TILES_MALFORMED);
      CHECK((status == ALULA_TILES_READY) != alula_tiles_request(&tiles, &request));
      check_place(&tiles, alula_tiles_select(&tiles, x, towards, &map), map);
    }
    CHECK(alula_tiles_open(&tiles, index, length, key, sizeof key, signature) != ALULA_TILES_READY);
    CHECK(alula_tiles_select(&tiles, NULL, NULL, &map) == ALULA_TILES_NOT_LOADED && !map);
  }
  free(index);
  free(image);
  return 0;
}
