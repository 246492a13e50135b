#include "alula_sbus.h"

#include "byte_window.h"

#define FIRST 0x0FU
#define FLAGS_AT 23U
#define LAST_AT 24U
#define KNOWN_FLAGS 0x0FU
#define CHANNEL_BITS 11U

void alula_sbus_encode(const alula_sbus_frame* frame, uint8_t bytes[ALULA_SBUS_BYTES]) {
  uint32_t bits = 0U, held = 0U, at = 1U;
  bytes[0] = FIRST;
  for (uint32_t i = 0; i < ALULA_SBUS_CHANNELS; ++i) {
    const uint32_t value = frame->channel[i] > ALULA_SBUS_MOST ? ALULA_SBUS_MOST : frame->channel[i];
    bits |= value << held;
    for (held += CHANNEL_BITS; held >= 8U; held -= 8U) {
      bytes[at++] = (uint8_t)(bits & 0xFFU);
      bits >>= 8;
    }
  }
  bytes[FLAGS_AT] = (uint8_t)(frame->flags & KNOWN_FLAGS);
  bytes[LAST_AT] = 0U;
}

int alula_sbus_decode(const uint8_t bytes[ALULA_SBUS_BYTES], alula_sbus_frame* frame) {
  const uint32_t last = bytes[LAST_AT];
  if (bytes[0] != FIRST || bytes[FLAGS_AT] > KNOWN_FLAGS) return 0;
  if (last != 0U && (last & 0xCFU) != 4U) return 0;
  uint32_t bits = 0U, held = 0U, at = 1U;
  for (uint32_t i = 0; i < ALULA_SBUS_CHANNELS; ++i) {
    for (; held < CHANNEL_BITS; held += 8U) bits |= (uint32_t)bytes[at++] << held;
    frame->channel[i] = (uint16_t)(bits & ALULA_SBUS_MOST);
    bits >>= CHANNEL_BITS;
    held -= CHANNEL_BITS;
  }
  frame->flags = bytes[FLAGS_AT];
  return 1;
}

void alula_sbus_begin(alula_sbus_parser* parser) { parser->count = parser->frames = parser->skipped = 0U; }

void alula_sbus_idle(alula_sbus_parser* parser) {
  parser->skipped += parser->count;
  parser->count = 0U;
}

int alula_sbus_push(alula_sbus_parser* parser, uint8_t byte, alula_sbus_frame* frame) {
  if (!add_byte(parser->bytes, &parser->count, ALULA_SBUS_BYTES, FIRST, byte, &parser->skipped)) return 0;
  if (alula_sbus_decode(parser->bytes, frame)) {
    parser->count = 0U;
    ++parser->frames;
    return 1;
  }
  parser->skipped += drop_until(parser->bytes, &parser->count, FIRST, 1U);
  return 0;
}
