/* Navigation data on a serial line: packets of 44 bytes with a checksum, in freestanding C99.
 *
 *    0  2  0xA1 0x5A                          22  6  int16 velocity[3]      [0.01 m/s], world
 *    2  1  version: 1                         28  8  int16 attitude[4]      [1 / 32767] w, x, y, z; body to world
 *    3  1  flags: 1 the estimate is valid     36  6  int16 rates[3]         [0.002 rad/s], body
 *    4  2  uint16 sequence, one more each     42  2  uint16 CRC of bytes 0..41: polynomial 0x1021, first 0xFFFF,
 *    6  4  uint32 time of the state [us]             no reflection (CRC-16/CCITT-FALSE; of "123456789" 0x29B1)
 *   10 12  int32 position[3] [0.001 m], world
 *
 * Little-endian; world z up, body x forward, y left, z up. Rounded to nearest: the error of a position is at most
 * 0.5 mm per axis, of a velocity 5 mm/s, of an attitude 6e-5 rad, of rates 0.001 rad/s. A packet damaged in a burst
 * of at most 16 bits, or in at most three bits, is always refused; of other damaged packets, one in 65,536 passes the
 * checksum.
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

/* Returns zero and writes nothing when a number is not finite or does not fit: positions up to 2147 km, velocities up
 * to 327.67 m/s, components of the attitude up to 1, rates up to 65.5 rad/s. */
ALULA_MUST_USE int alula_navigation_encode(const alula_navigation* navigation, uint8_t bytes[ALULA_NAVIGATION_BYTES]);

/* Returns nonzero and writes *navigation when these are the bytes of a packet. */
ALULA_MUST_USE int alula_navigation_decode(const uint8_t bytes[ALULA_NAVIGATION_BYTES], alula_navigation* navigation);

/* Finds packets in a stream of bytes. The fields are private, except the counts. */
typedef struct {
  uint8_t bytes[ALULA_NAVIGATION_BYTES];
  uint32_t count;
  uint32_t packets; /* found so far */
  uint32_t skipped; /* bytes outside packets */
} alula_navigation_parser;

void alula_navigation_begin(alula_navigation_parser* parser);

/* Takes the next byte. Returns nonzero and writes *navigation when it ends a packet. After bytes that are not a
 * packet it continues at the next of them that may begin one. Computes at most one checksum, otherwise at most 44
 * steps. */
ALULA_MUST_USE int alula_navigation_push(alula_navigation_parser* parser, uint8_t byte, alula_navigation* navigation);

#ifdef __cplusplus
}
#endif
#endif
