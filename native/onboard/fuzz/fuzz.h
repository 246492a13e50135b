/* Common code of the fuzz targets: values from bytes, and checks. */
#ifndef ALULA_FUZZ_H
#define ALULA_FUZZ_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "alula.h"

#define CHECK(what)                                                             \
  do {                                                                          \
    if (!(what)) {                                                              \
      fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #what); \
      abort();                                                                  \
    }                                                                           \
  } while (0)

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

typedef struct {
  const uint8_t* at;
  size_t left;
} bytes;

/* The next bytes as a number; zeros after the end. */
static inline uint32_t take(bytes* in, size_t count) {
  uint32_t value = 0;
  for (size_t i = 0; i < count; ++i) {
    const uint32_t byte = in->left > 0 ? *in->at : 0U;
    if (in->left > 0) ++in->at, --in->left;
    value |= byte << 8 * i;
  }
  return value;
}

static inline float float_of(uint32_t bits) {
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/* Mostly a number up to `scale`; sometimes a value that no sensor should give, or any bits. */
static inline float take_float(bytes* in, float scale) {
  static const uint32_t ODD[] = {0x7FC00000U, 0x7F800000U, 0xFF800000U, 0x7F7FFFFFU, 0xFF7FFFFFU, 0x00000001U,
                                 0x80000001U, 0x80000000U, 0x00800000U, 0x7149F2CAU, 0x4B800000U, 0xCB800000U};
  const uint32_t kind = take(in, 1);
  if (kind < 12U) return float_of(ODD[kind]);
  if (kind < 20U) return float_of(take(in, 4));
  if (kind < 30U) return 0.0F;
  return scale * ((float)(int32_t)(take(in, 2) - 0x8000U) / 32768.0F);
}

static inline float take_between(bytes* in, float low, float high) {
  const float part = take_float(in, 1.0F);
  return low + (high - low) * 0.5F * (part + 1.0F);
}

static inline void take_floats(bytes* in, float scale, float* to, int count) {
  for (int i = 0; i < count; ++i) to[i] = take_float(in, scale);
}

/* A track of any kind, with this identity or, seldom, that of another. */
static inline void take_track(bytes* in, uint32_t id, alula_track* track) {
  track->id = take(in, 1) < 8U ? take(in, 1) : id;
  take_floats(in, 10.0F, track->position, 3);
  take_floats(in, 5.0F, track->velocity, 3);
  for (int i = 0; i < 21; ++i) track->covariance[i] = 0.0F;
  for (int i = 0, k = 0; i < 6; k += ++i + 1) track->covariance[k] = take_between(in, 0.0F, 0.5F);
  if (take(in, 1) < 64U) take_floats(in, 0.1F, track->covariance, 21);
  track->radius_m = take_between(in, 0.0F, 1.0F);
  take_floats(in, 3.0F, track->acceleration, 3);
}

static inline int same_bits(const void* a, const void* b, size_t size) { return memcmp(a, b, size) == 0; }

static inline int all_finite(const float* x, int count) {
  for (int i = 0; i < count; ++i)
    if (!isfinite(x[i])) return 0;
  return 1;
}

static inline uint32_t crc_of(const uint8_t* data, size_t size) {
  uint32_t crc = 0xFFFFFFFFU;
  for (size_t i = 0; i < size; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ ((crc & 1U) != 0U ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

static inline void put(uint8_t* at, uint32_t value) {
  for (int i = 0; i < 4; ++i) at[i] = (uint8_t)(value >> 8 * i);
}

/* An image: a uint16 size, then its bytes. Returns a copy in memory of exactly that size, with matching checksums
 * unless the byte before requests otherwise; null when there is no image. */
static inline uint8_t* take_image(bytes* in, uint32_t* size) {
  const uint32_t keeps_sums = take(in, 1) == 1U;
  const uint32_t wanted = take(in, 2);
  *size = wanted < in->left ? wanted : (uint32_t)in->left;
  uint8_t* image = malloc(*size > 0U ? *size : 1U);
  if (!image) abort();
  memcpy(image, in->at, *size);
  in->at += *size;
  in->left -= *size;
  if (!keeps_sums && *size >= ALULA_MAP_HEADER_BYTES) {
    put(image + 16, *size);
    put(image + 20, crc_of(image + ALULA_MAP_HEADER_BYTES, *size - ALULA_MAP_HEADER_BYTES));
    put(image + 60, crc_of(image, 60));
  }
  return image;
}

/* Opens an image; if it is invalid, returns 0 and an empty map, which every function must refuse. */
static inline int open_image(const uint8_t* image, uint32_t size, alula_map* map) {
  const alula_map_status status = alula_map_open(map, image, size);
  if (status == ALULA_MAP_READY) return 1;
  static alula_polytope_cbf cbf;
  static alula_chord chord;
  const alula_polytope_cbf_config config = {0.1F, 2.0F, 100.0F, 0.01F, 1.0F, ALULA_SMOOTHING_SOUND, 0};
  const alula_fence fence = {.keep_out = map};
  const float x[3] = {0.0F, 0.0F, 0.0F};
  alula_map_value value;
  CHECK(map->data == NULL && map->hull_count == 0U);
  CHECK(alula_map_evaluate(map, x, &value) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_polytope_cbf_open(&cbf, map, 10.0F, &config) == ALULA_BAD_POINTER);
  CHECK(alula_chord_open(&chord, map, 10.0F, &config, 0.3F) == ALULA_BAD_POINTER);
  CHECK(alula_fence_check(&fence) == ALULA_BAD_MAP);
  return 0;
}

#endif
