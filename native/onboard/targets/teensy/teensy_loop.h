/* The geofence between a receiver and a flight controller: bytes in, bytes out, without the board's headers.
 *
 * SBUS frames of the receiver and packets of navigation arrive as bytes at any time; the loop sends a frame in every
 * period T. Its content, by the first row that applies:
 *
 *   no frame of the receiver so far         sticks centred, no throttle, failsafe flag
 *   override switch on, receiver active     the receiver's last frame, bit by bit
 *   override switch on, receiver silent     that frame with the failsafe flag: the flight controller's own procedure
 *   geofence REFUSED, nothing flown yet,    sticks centred, no throttle: no take-off without navigation
 *     nor any throttle by the override
 *   geofence PASSED                         the receiver's last frame, bit by bit; with sticks as velocities
 *                                           (teensy_velocity.h), the command of the stack
 *   BLENDED, BACKUP, NO_PILOT               the geofence's command in the four sticks; failsafe and lost flags clear,
 *                                           because the flight controller would otherwise drop the command
 *   HAND_OVER                               its command, a level attitude from the last state, sinking; with a
 *                                           `level_channel` centred sticks instead, and that channel high
 *   REFUSED later on                        as HAND_OVER, with the failsafe flag
 *   the receiver silent for give_up_us      any of these but the override, with the failsafe flag
 *
 * All other channels are those of the last good frame: an armed vehicle stays armed.
 *
 * The receiver is silent when no frame without the lost or failsafe flag came for radio_limit_us, and at once on the
 * failsafe flag. A frame has no checksum, so the override switch must be the same in SWITCH_FRAMES consecutive
 * frames. A packet of navigation counts if it arrived since the last sent frame, with a good checksum, its flag
 * `valid`, a new sequence number and a later time than the last one. Without such a packet the geofence has no
 * navigation in this period, and predicts by its model.
 *
 * Rounding. Sticks have steps of 5/8 us, and neither direction of rounding is safe, so the error of a stick is added
 * to the next command: after any number of frames the sum of the flown commands is within half a step of the sum of
 * the requested ones, in each stick, as long as none is at its end. Half a step is at most 0.025 rad/s (at full
 * deflection, with the rates of alula_rates_defaults), so the error of attitudes is at most 0.025 T rad: with
 * T = 5 ms and 80 m/s^2 that is 0.01 m/s^2. Over the 1.7 s of a stop from 100 km/h the path error is 15 mm. The
 * rounding of navigation packets, 0.9 mm, 9 mm/s and 6e-5 rad together along a direction, adds 23 mm. 0.05 m of
 * `reserve_m` cover both; docs/guide/firmware.md lists the distances lost in flights.
 *
 * Freestanding C99.
 */
#ifndef ALULA_TEENSY_LOOP_H
#define ALULA_TEENSY_LOOP_H

#include "alula_geofence.h"
#include "alula_navigation_link.h"
#include "alula_rates.h"
#include "alula_sbus.h"
#include "teensy_velocity.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_TEENSY_NO_CHANNEL 255U
#define ALULA_TEENSY_SWITCH_FRAMES 3U

typedef struct {
  alula_geofence_config geofence;     /* tick_s is T; model.max_rate at least the rates of full sticks */
  alula_rates rates;                  /* of the flight controller */
  uint8_t roll, pitch, throttle, yaw; /* channels, from 0 */
  uint8_t override_channel;           /* of a switch that only the pilot moves */
  uint8_t level_channel;              /* selects the flight controller's level mode, or ALULA_TEENSY_NO_CHANNEL */
  uint8_t velocity_channel;           /* on: sticks are velocities, or ALULA_TEENSY_NO_CHANNEL */
  uint16_t switch_above;              /* a channel above this value is on */
  uint32_t radio_limit_us, give_up_us;
} alula_teensy_config;

/* Sticks on channels 1 to 4, override on 8; 200 frames a second, the maximum of 100,000 baud with a pause. */
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
  ALULA_TEENSY_LOST,
  ALULA_TEENSY_GUIDED /* PASSED, of a command of the stack */
} alula_teensy_status;

/* One per vehicle; the fields are private, except `velocity`, `result`, `sent` and the counts. */
typedef struct {
  alula_teensy_config config;
  alula_geofence geofence;
  alula_teensy_velocity* velocity; /* null, or set by the caller after init */
  int is_guided;                   /* in this period */
  alula_sbus_parser receiver;
  alula_navigation_parser link;
  alula_sbus_frame heard; /* the last good one */
  alula_navigation navigation;
  uint32_t silence_us, counted_us, byte_us, navigation_us;
  int has_heard, is_silent, has_navigation, is_new, has_flown;
  int override_on;
  uint32_t switch_frames; /* consecutive frames with the other position */
  float carry[4];         /* rounding errors of the sticks: throttle, rates */
  alula_geofence_result result;
  alula_sbus_frame sent;
  uint32_t replayed; /* packets that were repeated or marked as not valid */
} alula_teensy_loop;

/* Returns ALULA_BAD_PARAMETER when a channel is missing or used twice, a limit is 0, or full sticks exceed the
 * geofence's model; otherwise as alula_geofence_init. `fence` must live as long as the loop. */
ALULA_MUST_USE alula_status alula_teensy_init(alula_teensy_loop* loop, const alula_fence* fence,
                                              const alula_teensy_config* config);

/* Take bytes of the receiver, and of the navigation, as they arrive. */
void alula_teensy_receive(alula_teensy_loop* loop, uint32_t now_us, const uint8_t* bytes, uint32_t count);
void alula_teensy_navigate(alula_teensy_loop* loop, uint32_t now_us, const uint8_t* bytes, uint32_t count);

/* Call it in every period T: returns the frame to send. */
alula_teensy_status alula_teensy_tick(alula_teensy_loop* loop, uint32_t now_us, uint8_t out[ALULA_SBUS_BYTES]);

#ifdef __cplusplus
}
#endif
#endif
