/* Little-endian numbers at any address, and their check. Private. */
#ifndef ALULA_ONBOARD_BYTES_H
#define ALULA_ONBOARD_BYTES_H

#include <stdint.h>

/* CRC-32 as in zlib and Ethernet. */
uint32_t alula_crc32(const uint8_t* data, uint32_t length);

static inline uint32_t u16_at(const uint8_t* p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }
static inline uint32_t u32_at(const uint8_t* p) { return u16_at(p) | u16_at(p + 2) << 16; }
static inline int32_t i8_at(const uint8_t* p) { return *(const int8_t*)p; }
static inline int32_t i16_at(const uint8_t* p) { return (int32_t)(u16_at(p) ^ 0x8000U) - 0x8000; }

static inline int32_t i32_at(const uint8_t* p) {
  const uint32_t bits = u32_at(p);
  return bits < 0x80000000U ? (int32_t)bits : -(int32_t)(~bits) - 1;
}

static inline float f32_at(const uint8_t* p) {
  union {
    uint32_t bits;
    float value;
  } word;
  word.bits = u32_at(p);
  return word.value;
}

#endif
