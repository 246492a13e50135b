#include "alula_navigation_link.h"

#include "byte_window.h"
#include "bytes.h"

#define FIRST 0xA1U
#define SECOND 0x5AU
#define VERSION 1U
#define CRC_AT 42U
#define PER_METRE 1000.0F
#define PER_METRE_PER_SECOND 100.0F
#define PER_ONE 32767.0F
#define PER_RADIAN_PER_SECOND 500.0F
#define MOST_32 2.147e9F
#define MOST_16 32767.0F

static uint32_t crc16(const uint8_t* bytes, uint32_t length) {
  uint32_t crc = 0xFFFFU;
  for (uint32_t i = 0; i < length; ++i) {
    crc ^= (uint32_t)bytes[i] << 8;
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 0x8000U) != 0U ? crc << 1 ^ 0x1021U : crc << 1;
    crc &= 0xFFFFU;
  }
  return crc;
}

static void put(uint8_t* at, uint32_t value, uint32_t size) {
  for (uint32_t i = 0; i < size; ++i) at[i] = (uint8_t)(value >> 8U * i & 0xFFU);
}

/* Writes numbers in units of 1 / scale, rounded to nearest; zero when one does not fit. */
static int put_numbers(uint8_t* at, const float* x, uint32_t count, float scale, float most, uint32_t size) {
  for (uint32_t i = 0; i < count; ++i) {
    const float scaled = x[i] * scale;
    if (!(scaled >= -most && scaled <= most)) return 0; /* also NaN */
    put(at + size * i, (uint32_t)(int32_t)(scaled < 0.0F ? scaled - 0.5F : scaled + 0.5F), size);
  }
  return 1;
}

int alula_navigation_encode(const alula_navigation* navigation, uint8_t bytes[ALULA_NAVIGATION_BYTES]) {
  const alula_racer_state* x = &navigation->state;
  uint8_t made[ALULA_NAVIGATION_BYTES];
  made[0] = FIRST;
  made[1] = SECOND;
  made[2] = VERSION;
  made[3] = navigation->flags;
  put(made + 4, navigation->sequence, 2U);
  put(made + 6, navigation->time_us, 4U);
  if (!put_numbers(made + 10, x->position, 3U, PER_METRE, MOST_32, 4U) ||
      !put_numbers(made + 22, x->velocity, 3U, PER_METRE_PER_SECOND, MOST_16, 2U) ||
      !put_numbers(made + 28, x->attitude, 4U, PER_ONE, MOST_16, 2U) ||
      !put_numbers(made + 36, x->rates, 3U, PER_RADIAN_PER_SECOND, MOST_16, 2U)) {
    return 0;
  }
  put(made + CRC_AT, crc16(made, CRC_AT), 2U);
  for (uint32_t i = 0; i < ALULA_NAVIGATION_BYTES; ++i) bytes[i] = made[i];
  return 1;
}

int alula_navigation_decode(const uint8_t bytes[ALULA_NAVIGATION_BYTES], alula_navigation* navigation) {
  if (bytes[0] != FIRST || bytes[1] != SECOND || bytes[2] != VERSION) return 0;
  if (crc16(bytes, CRC_AT) != u16_at(bytes + CRC_AT)) return 0;
  alula_racer_state* x = &navigation->state;
  navigation->flags = bytes[3];
  navigation->sequence = (uint16_t)u16_at(bytes + 4);
  navigation->time_us = u32_at(bytes + 6);
  for (int i = 0; i < 3; ++i) {
    x->position[i] = (float)i32_at(bytes + 10 + 4 * i) / PER_METRE;
    x->velocity[i] = (float)i16_at(bytes + 22 + 2 * i) / PER_METRE_PER_SECOND;
    x->rates[i] = (float)i16_at(bytes + 36 + 2 * i) / PER_RADIAN_PER_SECOND;
  }
  for (int i = 0; i < 4; ++i) x->attitude[i] = (float)i16_at(bytes + 28 + 2 * i) / PER_ONE;
  return 1;
}

void alula_navigation_begin(alula_navigation_parser* parser) {
  parser->count = parser->packets = parser->skipped = 0U;
}

int alula_navigation_push(alula_navigation_parser* parser, uint8_t byte, alula_navigation* navigation) {
  if (!add_byte(parser->bytes, &parser->count, ALULA_NAVIGATION_BYTES, FIRST, byte, &parser->skipped)) return 0;
  if (alula_navigation_decode(parser->bytes, navigation)) {
    parser->count = 0U;
    ++parser->packets;
    return 1;
  }
  parser->skipped += drop_until(parser->bytes, &parser->count, FIRST, 1U);
  return 0;
}
