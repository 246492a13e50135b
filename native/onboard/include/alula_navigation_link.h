/* Navigation data on a serial line: packets of 44 bytes with a checksum, in freestanding C99.
 *
 *    0  2  0xA1 0x5A                          22  6  int16 velocity[3]      [0.01 m/s], world
 *    2  1  version: 1                         28  8  int16 attitude[4]      [1 / 32767] w, x, y, z; body to world
 *    3  1  flags: 1 the estimate is valid     36  6  int16 rates[3]         [0.002 rad/s], body
 *    4  2  uint16 sequence, one more each     42  2  uint16 CRC of bytes 0..41: polynomial 0x1021, first 0xFFFF,
 *    6  4  uint32 time of the state [us]             no reflection (CRC-16/CCITT-FALSE; of "123456789" 0x29B1)
 *   10 12  int32 position[3] [0.001 m], world
 *
 * Little-endian; world z up, body x forward, y left, z up. Rounded to nearest: a position is off by at most 0.5 mm an
 * axis, a velocity by 5 mm/s, an attitude by 6e-5 rad, rates by 0.001 rad/s. A packet that was damaged in a burst of
 * at most 16 bits, or in at most three bits, is always refused; of others one in 65,536 gets past the checksum.
 */
#ifndef ALULA_NAVIGATION_LINK_H
#define ALULA_NAVIGATION_LINK_H

#include "alula_racer.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_NAVIGATION_BYTES 44U
#define ALULA_NAVIGATION_VALID 1U

typedef struct {
  alula_racer_state state;
  uint32_t time_us; /* of the sender's clock */
  uint16_t sequence;
  uint8_t flags;
} alula_navigation;

/* Zero, and nothing written, when a number is not finite or does not fit: positions of 2147 km, velocities of
 * 327.67 m/s, components of the attitude of 1, rates of 65.5 rad/s. */
ALULA_MUST_USE int alula_navigation_encode(const alula_navigation* navigation, uint8_t bytes[ALULA_NAVIGATION_BYTES]);

/* Nonzero, and *navigation written, when these are the bytes of a packet. */
ALULA_MUST_USE int alula_navigation_decode(const uint8_t bytes[ALULA_NAVIGATION_BYTES], alula_navigation* navigation);

/* Finds packets in a stream of bytes. The fields are not for the caller, but for the counts. */
typedef struct {
  uint8_t bytes[ALULA_NAVIGATION_BYTES];
  uint32_t count;
  uint32_t packets; /* found so far */
  uint32_t skipped; /* bytes that belong to none */
} alula_navigation_parser;

void alula_navigation_begin(alula_navigation_parser* parser);

/* The next byte; nonzero, and *navigation written, when it ends a packet. After bytes that are no packet it goes on
 * at the next one of them that may begin one. A checksum is computed at most once, else at most 44 steps. */
ALULA_MUST_USE int alula_navigation_push(alula_navigation_parser* parser, uint8_t byte, alula_navigation* navigation);

#ifdef __cplusplus
}
#endif
#endif
