/* The geofence between a receiver and a flight controller: bytes in, bytes out, without the board's headers.
 *
 * SBUS frames of the receiver and packets of navigation come in as bytes at any time; every period T a frame goes
 * out. What it carries, the first row that holds:
 *
 *   never a frame of the receiver           sticks centred, no throttle, failsafe flag
 *   override switch on, receiver heard      the receiver's last frame, bit by bit
 *   override switch on, receiver silent     that frame with the failsafe flag: the flight controller's own procedure
 *   geofence REFUSED, nothing flown yet,    sticks centred, no throttle: one cannot take off without navigation
 *     nor any throttle by the override
 *   geofence PASSED                         the receiver's last frame, bit by bit
 *   BLENDED, BACKUP, NO_PILOT               the geofence's command in the four sticks; failsafe and lost flags clear,
 *                                           as the flight controller would drop the command otherwise
 *   HAND_OVER                               its command, a level attitude from the last state, sinking; with a
 *                                           `level_channel` centred sticks instead, and that channel high
 *   REFUSED later on                        as HAND_OVER, with the failsafe flag
 *   the receiver silent for give_up_us      any of them but the override, with the failsafe flag
 *
 * All other channels are those of the last good frame: whoever has armed stays armed.
 *
 * The receiver is silent when no frame without the lost or failsafe flag came for radio_limit_us, and at once on the
 * failsafe flag. A frame has no checksum, so the override switch must stand the same way in SWITCH_FRAMES of them in
 * a row. Navigation is what came since the last frame out, with a good checksum, its flag `valid`, a new sequence
 * number and a later time than the last one; else the geofence has none in this period, and goes on by its model.
 *
 * Rounding. Sticks have steps of 5/8 us; no direction of them is the safe one, so what a stick was off by is added to
 * the next command: after any number of frames the sum of what was flown is within half a step of what was asked for,
 * in each stick, as long as none is at its end. Half a step is at most 0.025 rad/s (at full deflection, with the
 * rates of alula_rates_defaults), so attitudes are off by at most 0.025 T rad: with T = 5 ms and 80 m/s^2 that is
 * 0.01 m/s^2. Over the 1.7 s of a stop from 100 km/h it leads 15 mm astray; what packets of navigation round, 0.9 mm,
 * 9 mm/s and 6e-5 rad together along a direction, 23 mm. 0.05 m of `reserve_m` cover both; docs/guide/firmware.md has
 * what flights lost.
 *
 * Freestanding C99.
 */
#ifndef ALULA_TEENSY_LOOP_H
#define ALULA_TEENSY_LOOP_H

#include "alula_geofence.h"
#include "alula_navigation_link.h"
#include "alula_rates.h"
#include "alula_sbus.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_TEENSY_NO_CHANNEL 255U
#define ALULA_TEENSY_SWITCH_FRAMES 3U

typedef struct {
  alula_geofence_config geofence;     /* tick_s is T; model.max_rate at least what full sticks ask for */
  alula_rates rates;                  /* of the flight controller */
  uint8_t roll, pitch, throttle, yaw; /* channels, from 0 */
  uint8_t override_channel;           /* of a switch that only the pilot moves */
  uint8_t level_channel;              /* that makes the flight controller level itself, or ALULA_TEENSY_NO_CHANNEL */
  uint16_t switch_above;              /* of a channel that is on */
  uint32_t radio_limit_us, give_up_us;
} alula_teensy_config;

/* Sticks on channels 1 to 4, override on 8; 200 frames a second, as many as 100,000 baud carry with a pause. */
alula_teensy_config alula_teensy_defaults(void);

typedef enum {
  ALULA_TEENSY_NO_RECEIVER = 0, /* as in the table above */
  ALULA_TEENSY_OVERRIDE,
  ALULA_TEENSY_OVERRIDE_LOST,
  ALULA_TEENSY_LOCKED,
  ALULA_TEENSY_PASSED,
  ALULA_TEENSY_BLENDED,
  ALULA_TEENSY_BACKUP,
  ALULA_TEENSY_NO_PILOT,
  ALULA_TEENSY_HAND_OVER,
  ALULA_TEENSY_LOST
} alula_teensy_status;

/* One per vehicle; the fields are not for the caller, but for `result`, `sent` and the counts. */
typedef struct {
  alula_teensy_config config;
  alula_geofence geofence;
  alula_sbus_parser receiver;
  alula_navigation_parser link;
  alula_sbus_frame heard; /* the last good one */
  alula_navigation navigation;
  uint32_t silence_us, counted_us, byte_us, navigation_us;
  int has_heard, is_silent, has_navigation, is_new, has_flown;
  int override_on;
  uint32_t switch_frames; /* in a row that say otherwise */
  float carry[4];         /* what sticks were off by: throttle, rates */
  alula_geofence_result result;
  alula_sbus_frame sent;
  uint32_t replayed; /* packets that were no news, or said that they are not valid */
} alula_teensy_loop;

/* ALULA_BAD_PARAMETER when a channel is none or is used twice, a limit is 0, or full sticks ask for more than the
 * geofence's model allows; else as alula_geofence_init. `fence` lives as long as the loop. */
ALULA_MUST_USE alula_status alula_teensy_init(alula_teensy_loop* loop, const alula_fence* fence,
                                              const alula_teensy_config* config);

/* Bytes of the receiver, and of the navigation, as they come. */
void alula_teensy_receive(alula_teensy_loop* loop, uint32_t now_us, const uint8_t* bytes, uint32_t count);
void alula_teensy_navigate(alula_teensy_loop* loop, uint32_t now_us, const uint8_t* bytes, uint32_t count);

/* Every T: the frame to send. */
alula_teensy_status alula_teensy_tick(alula_teensy_loop* loop, uint32_t now_us, uint8_t out[ALULA_SBUS_BYTES]);

#ifdef __cplusplus
}
#endif
#endif
