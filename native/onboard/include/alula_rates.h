/* Converts commands to radio sticks by the inverse of a flight controller's rate profile, in freestanding C99.
 *
 * Betaflight's rates (rates_type BETAFLIGHT) of an axis give a deflection x in [-1, 1] the rate
 *
 *   omega(x) = 200 deg/s  r  x (e |x|^3 + 1 - e) / cut(1 - s |x|, 0.01, 1)
 *
 * with r = rc_rate, r + 14.54 (r - 2) above 2, s = super_rate, e = expo. Without expo its inverse has a closed form,
 * x = omega / (200 deg/s r + s |omega|); with expo it is found by bisection, as omega(x) increases with x. Both are
 * odd, and clipped at full deflection: a rate beyond the sticks becomes the largest rate of the sticks.
 *
 * Pulses are whole microseconds, middle + 500 x and low + (high - low) throttle, rounded to the nearest, for a
 * controller without a deadband. So the error of a rate is half a microsecond of stick: omega'(x) / 1000, 0.2 deg/s
 * in the middle and 2.2 deg/s at the end for rc_rate 1, super_rate 0.7. A pulse converted to a command and back is
 * the same pulse: a filter that passes the pilot's command bit by bit passes the pilot's sticks.
 *
 * Body x forward, y left, z up: rolling right, pitching down and turning left are positive. Sticks: right, forward
 * and right; so yaw changes its sign. Single precision, SI units; every loop is bounded by a constant.
 */
#ifndef ALULA_RATES_H
#define ALULA_RATES_H

#include "alula_racer.h"

#ifdef __cplusplus
extern "C" {
#endif

/* [us] Limits of a valid pulse: Betaflight's rx_min_usec and rx_max_usec. */
#define ALULA_RATES_SHORTEST 885U
#define ALULA_RATES_LONGEST 2115U

/* In the order of Betaflight's default map AETR1234. */
enum { ALULA_CHANNEL_ROLL = 0, ALULA_CHANNEL_PITCH, ALULA_CHANNEL_THROTTLE, ALULA_CHANNEL_YAW, ALULA_CHANNELS };

typedef struct {
  float rc_rate;    /* 0.01 to 2.55; the configurator's numbers, or a hundredth of the command line's */
  float super_rate; /* 0 to 1 */
  float expo;       /* 0 to 1 */
} alula_rates_axis;

typedef struct {
  alula_rates_axis axis[3];                /* roll, pitch, yaw */
  float middle_us;                         /* mid_rc, 1400 to 1600 */
  float throttle_low_us, throttle_high_us; /* of throttle 0 and 1: min_check and 2000; between 900 and 2100 */
} alula_rates;

/* rc_rate 1, super_rate 0.7, no expo, 1500 us, 1050 to 2000 us. */
alula_rates alula_rates_defaults(void);

ALULA_MUST_USE alula_status alula_rates_check(const alula_rates* rates);

/* omega(x) [rad/s]; x is clipped to [-1, 1]. NaN for NaN. */
ALULA_MUST_USE float alula_rates_at(const alula_rates_axis* axis, float deflection);

/* The deflection in [-1, 1] of a rate [rad/s]. NaN for NaN. */
ALULA_MUST_USE float alula_rates_deflection(const alula_rates_axis* axis, float rate);

/* Pulses [us] of a command, clipped to the range of the sticks. ALULA_BAD_INPUT when a number is not finite: then all
 * pulses are 0, which a receiver counts as no pulse. */
ALULA_MUST_USE alula_status alula_rates_channels(const alula_rates* rates, const alula_racer_command* command,
                                                 uint16_t channels[ALULA_CHANNELS]);

/* The command of a pilot's pulses. ALULA_BAD_INPUT when one is not a valid pulse: then the command is 0. */
ALULA_MUST_USE alula_status alula_rates_command(const alula_rates* rates, const uint16_t channels[ALULA_CHANNELS],
                                                alula_racer_command* command);

#ifdef __cplusplus
}
#endif
#endif
