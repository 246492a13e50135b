#include "alula_rates.h"

#include "vector.h"

#define CENTER 3.49065850F /* [rad/s] 200 deg/s */
#define BOOST_FROM 2.0F    /* rc_rate above which the boost applies */
#define BOOST 14.54F
#define LEAST_DIVISOR 0.01F
#define SPAN_US 500.0F
#define HALVINGS 26 /* bisections of [0, 1]: below the spacing of floats around 1/2 */

static const int channel_of[3] = {ALULA_CHANNEL_ROLL, ALULA_CHANNEL_PITCH, ALULA_CHANNEL_YAW};
static const float sign_of[3] = {1.0F, 1.0F, -1.0F};

static float within(float x, float low, float high) { return x < low ? low : (x > high ? high : x); }

static int lies_in(float x, float low, float high) { return x >= low && x <= high; } /* false for NaN */

alula_rates alula_rates_defaults(void) {
  alula_rates rates;
  for (int i = 0; i < 3; ++i) {
    rates.axis[i].rc_rate = 1.0F;
    rates.axis[i].super_rate = 0.7F;
    rates.axis[i].expo = 0.0F;
  }
  rates.middle_us = 1500.0F;
  rates.throttle_low_us = 1050.0F;
  rates.throttle_high_us = 2000.0F;
  return rates;
}

alula_status alula_rates_check(const alula_rates* rates) {
  if (!rates) return ALULA_BAD_POINTER;
  for (int i = 0; i < 3; ++i) {
    const alula_rates_axis* a = &rates->axis[i];
    if (!lies_in(a->rc_rate, 0.01F, 2.55F) || !lies_in(a->super_rate, 0.0F, 1.0F) || !lies_in(a->expo, 0.0F, 1.0F))
      return ALULA_BAD_PARAMETER;
  }
  if (!lies_in(rates->middle_us, 1400.0F, 1600.0F)) return ALULA_BAD_PARAMETER;
  if (!lies_in(rates->throttle_low_us, 900.0F, 2000.0F)) return ALULA_BAD_PARAMETER;
  if (!lies_in(rates->throttle_high_us, rates->throttle_low_us + 100.0F, 2100.0F)) return ALULA_BAD_PARAMETER;
  return ALULA_READY;
}

static float slope(const alula_rates_axis* axis) {
  const float r = axis->rc_rate;
  return CENTER * (r > BOOST_FROM ? r + BOOST * (r - BOOST_FROM) : r);
}

/* omega(x) of x in [0, 1]. */
static float rate_of(const alula_rates_axis* axis, float x) {
  const float shaped = x * (axis->expo * x * x * x + (1.0F - axis->expo));
  return slope(axis) * shaped / within(1.0F - axis->super_rate * x, LEAST_DIVISOR, 1.0F);
}

float alula_rates_at(const alula_rates_axis* axis, float deflection) {
  const float x = within(deflection, -1.0F, 1.0F); /* keeps NaN */
  return x < 0.0F ? -rate_of(axis, -x) : rate_of(axis, x);
}

/* The inverse without expo: at the curve's steep end, where the divisor is clipped, it is linear again. */
static float closed_inverse(const alula_rates_axis* axis, float rate) {
  const float full = slope(axis), x = rate / (full + axis->super_rate * rate);
  return 1.0F - axis->super_rate * x < LEAST_DIVISOR ? LEAST_DIVISOR * rate / full : x;
}

static float bisected_inverse(const alula_rates_axis* axis, float rate) {
  float low = 0.0F, high = 1.0F;
  for (int i = 0; i < HALVINGS; ++i) {
    const float middle = 0.5F * (low + high);
    if (rate_of(axis, middle) < rate) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return 0.5F * (low + high);
}

float alula_rates_deflection(const alula_rates_axis* axis, float rate) {
  const float size = absolute(rate);
  if (!(size <= FLT_MAX)) return size > FLT_MAX ? (rate < 0.0F ? -1.0F : 1.0F) : rate;
  if (size >= rate_of(axis, 1.0F)) return rate < 0.0F ? -1.0F : 1.0F;
  const float x = within(axis->expo > 0.0F ? bisected_inverse(axis, size) : closed_inverse(axis, size), 0.0F, 1.0F);
  return rate < 0.0F ? -x : x;
}

static uint16_t pulse(float microseconds) { return (uint16_t)(microseconds + 0.5F); }

alula_status alula_rates_channels(const alula_rates* rates, const alula_racer_command* command,
                                  uint16_t channels[ALULA_CHANNELS]) {
  if (!channels) return ALULA_BAD_POINTER;
  for (int i = 0; i < ALULA_CHANNELS; ++i) channels[i] = 0;
  if (!rates || !command) return ALULA_BAD_POINTER;
  if (!alula_racer_command_is_finite(command)) return ALULA_BAD_INPUT;
  for (int i = 0; i < 3; ++i) {
    const float x = alula_rates_deflection(&rates->axis[i], command->rates[i]);
    channels[channel_of[i]] = pulse(rates->middle_us + sign_of[i] * SPAN_US * x);
  }
  const float throttle = within(command->throttle, 0.0F, 1.0F);
  channels[ALULA_CHANNEL_THROTTLE] =
      pulse(rates->throttle_low_us + throttle * (rates->throttle_high_us - rates->throttle_low_us));
  return ALULA_READY;
}

alula_status alula_rates_command(const alula_rates* rates, const uint16_t channels[ALULA_CHANNELS],
                                 alula_racer_command* command) {
  if (!command) return ALULA_BAD_POINTER;
  command->throttle = 0.0F;
  for (int i = 0; i < 3; ++i) command->rates[i] = 0.0F;
  if (!rates || !channels) return ALULA_BAD_POINTER;
  for (int i = 0; i < ALULA_CHANNELS; ++i)
    if (channels[i] < ALULA_RATES_SHORTEST || channels[i] > ALULA_RATES_LONGEST) return ALULA_BAD_INPUT;
  for (int i = 0; i < 3; ++i) {
    const float x = ((float)channels[channel_of[i]] - rates->middle_us) / SPAN_US;
    command->rates[i] = sign_of[i] * alula_rates_at(&rates->axis[i], x);
  }
  const float throttle = ((float)channels[ALULA_CHANNEL_THROTTLE] - rates->throttle_low_us) /
                         (rates->throttle_high_us - rates->throttle_low_us);
  command->throttle = within(throttle, 0.0F, 1.0F);
  return ALULA_READY;
}
