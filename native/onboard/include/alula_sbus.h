/* SBUS: sixteen channels of a receiver in frames of 25 bytes, decoded and encoded in freestanding C99.
 *
 *    0  1  0x0F
 *    1 22  16 channels of 11 bits, the low bits of the first channel first
 *   23  1  flags: 1 and 2 switches, 4 the receiver lost a frame, 8 it is in failsafe; the others are zero
 *   24  1  0x00, or 0x04, 0x14, 0x24, 0x34 (SBUS2)
 *
 * The line is a UART of 100,000 baud with even parity and two stop bits, inverted: a byte takes 120 us, a frame
 * 3 ms. A frame has no checksum. Only its position, the flags and the last byte can be checked, so a reader must
 * expect any channel values.
 */
#ifndef ALULA_SBUS_H
#define ALULA_SBUS_H

#include "alula_onboard.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_SBUS_BYTES 25U
#define ALULA_SBUS_CHANNELS 16U
#define ALULA_SBUS_MOST 2047U /* maximum of a channel */
#define ALULA_SBUS_SWITCH_17 1U
#define ALULA_SBUS_SWITCH_18 2U
#define ALULA_SBUS_LOST 4U
#define ALULA_SBUS_FAILSAFE 8U

typedef struct {
  uint16_t channel[ALULA_SBUS_CHANNELS];
  uint8_t flags;
} alula_sbus_frame;

/* Channels above ALULA_SBUS_MOST are clipped to it; unknown flags are dropped. */
void alula_sbus_encode(const alula_sbus_frame* frame, uint8_t bytes[ALULA_SBUS_BYTES]);

/* Returns nonzero and writes *frame when these are the bytes of a frame. */
ALULA_MUST_USE int alula_sbus_decode(const uint8_t bytes[ALULA_SBUS_BYTES], alula_sbus_frame* frame);

/* Finds frames in a stream of bytes. The fields are private, except the counts. */
typedef struct {
  uint8_t bytes[ALULA_SBUS_BYTES];
  uint32_t count;   /* of buffered bytes */
  uint32_t frames;  /* found so far */
  uint32_t skipped; /* bytes outside frames */
} alula_sbus_parser;

void alula_sbus_begin(alula_sbus_parser* parser);

/* Reports that the line was idle for longer than a byte: an unfinished frame is dropped. Between the frames of a
 * receiver the line is idle for 4 ms or more; with this call a reader cannot stay synchronised to bytes that only
 * look like a frame. */
void alula_sbus_idle(alula_sbus_parser* parser);

/* Takes the next byte. Returns nonzero and writes *frame when it ends a frame. After bytes that are not a frame it
 * continues at the next of them that may begin one. At most 25 steps. */
ALULA_MUST_USE int alula_sbus_push(alula_sbus_parser* parser, uint8_t byte, alula_sbus_frame* frame);

#ifdef __cplusplus
}
#endif
#endif
