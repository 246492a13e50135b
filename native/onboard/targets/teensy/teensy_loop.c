#include "teensy_loop.h"

#define FIRST_US 880.0F /* a channel c is 880 + 5/8 c us */
#define STEP_US 0.625F
#define SPAN_US 500.0F
#define ON 1811U
#define BAD_FLAGS (ALULA_SBUS_LOST | ALULA_SBUS_FAILSAFE)
#define IDLE_US 1000U       /* longer than any pause within a frame, shorter than a pause between two */
#define BYTE_US 120U        /* duration of a byte on the line */
#define RESTART_US 1000000U /* time without navigation after which its sender may have restarted */
#define OVER_FULL 1.0001F   /* tolerance of full sticks, relative to a limit */

static const float SIGN[3] = {1.0F, 1.0F, -1.0F}; /* sticks to the right are right; yaw is positive to the left */

alula_teensy_config alula_teensy_defaults(void) {
  alula_teensy_config config;
  config.geofence = alula_geofence_defaults();
  config.rates = alula_rates_defaults();
  config.geofence.tick_s = 0.005F;
  config.geofence.latency_s = 0.01F;
  config.geofence.reserve_m = 0.5F;
  config.geofence.model.max_rate[2] = 12.0F; /* full sticks give 11.6 with the default rates */
  config.roll = 0U;
  config.pitch = 1U;
  config.throttle = 2U;
  config.yaw = 3U;
  config.override_channel = 7U;
  config.level_channel = ALULA_TEENSY_NO_CHANNEL;
  config.velocity_channel = ALULA_TEENSY_NO_CHANNEL;
  config.switch_above = 1400U;
  config.radio_limit_us = 100000U;
  config.give_up_us = 20000000U;
  return config;
}

static int channels_are_good(const alula_teensy_config* c) {
  const uint32_t used[7] = {c->roll,          c->pitch,           c->throttle, c->yaw, c->override_channel,
                            c->level_channel, c->velocity_channel};
  uint32_t seen = 0U;
  for (int i = 0; i < 7; ++i) {
    if (i >= 5 && used[i] == ALULA_TEENSY_NO_CHANNEL) continue;
    if (used[i] >= ALULA_SBUS_CHANNELS || (seen >> used[i] & 1U) != 0U) return 0;
    seen |= 1U << used[i];
  }
  return 1;
}

alula_status alula_teensy_init(alula_teensy_loop* loop, const alula_fence* fence, const alula_teensy_config* config) {
  if (!loop || !fence || !config) return ALULA_BAD_POINTER;
  const alula_status rates = alula_rates_check(&config->rates);
  if (rates != ALULA_READY) return rates;
  if (!channels_are_good(config) || config->switch_above >= ALULA_SBUS_MOST || config->radio_limit_us == 0U ||
      config->give_up_us < config->radio_limit_us || config->give_up_us > INT32_MAX) {
    return ALULA_BAD_PARAMETER;
  }
  for (int i = 0; i < 3; ++i) {
    const float most = alula_rates_at(&config->rates.axis[i], 1.0F);
    if (!(most <= config->geofence.model.max_rate[i] * OVER_FULL)) return ALULA_BAD_PARAMETER;
  }
  loop->config = *config;
  loop->velocity = 0;
  loop->is_guided = 0;
  alula_sbus_begin(&loop->receiver);
  alula_navigation_begin(&loop->link);
  loop->has_heard = loop->is_silent = loop->has_navigation = loop->is_new = loop->has_flown = 0;
  loop->override_on = 0;
  loop->switch_frames = loop->replayed = 0U;
  loop->silence_us = loop->counted_us = loop->byte_us = loop->navigation_us = 0U;
  for (int i = 0; i < 4; ++i) loop->carry[i] = 0.0F;
  return alula_geofence_init(&loop->geofence, fence, &config->geofence);
}

static float microseconds(uint32_t channel) { return FIRST_US + STEP_US * (float)channel; }

static uint16_t channel_at(float us) {
  const float low = (float)ALULA_RATES_SHORTEST, high = (float)ALULA_RATES_LONGEST;
  const float cut = us > low ? (us < high ? us : high) : low; /* low for NaN */
  return (uint16_t)((cut - FIRST_US) / STEP_US + 0.5F);
}

/* The numbers of a command: throttle, then rates. */
static float number_of(const alula_racer_command* command, int i) {
  return i == 0 ? command->throttle : command->rates[i - 1];
}

static float from_channel(const alula_teensy_config* c, int i, uint32_t channel) {
  const float us = microseconds(channel);
  if (i > 0) return SIGN[i - 1] * alula_rates_at(&c->rates.axis[i - 1], (us - c->rates.middle_us) / SPAN_US);
  const float throttle = (us - c->rates.throttle_low_us) / (c->rates.throttle_high_us - c->rates.throttle_low_us);
  return throttle < 0.0F ? 0.0F : (throttle > 1.0F ? 1.0F : throttle);
}

static uint16_t to_channel(const alula_teensy_config* c, int i, float number) {
  if (i > 0) {
    const float x = alula_rates_deflection(&c->rates.axis[i - 1], number);
    return channel_at(c->rates.middle_us + SIGN[i - 1] * SPAN_US * x);
  }
  const float throttle = number > 0.0F ? (number < 1.0F ? number : 1.0F) : 0.0F;
  return channel_at(c->rates.throttle_low_us + throttle * (c->rates.throttle_high_us - c->rates.throttle_low_us));
}

static uint32_t stick(const alula_teensy_config* c, int i) {
  const uint32_t channels[4] = {c->throttle, c->roll, c->pitch, c->yaw};
  return channels[i];
}

static void forget_carry(alula_teensy_loop* loop) {
  for (int i = 0; i < 4; ++i) loop->carry[i] = 0.0F;
}

/* Writes the command to the sticks; the rounding error is carried into the next command. */
static void put_command(alula_teensy_loop* loop, const alula_racer_command* command) {
  const alula_teensy_config* c = &loop->config;
  for (int i = 0; i < 4; ++i) {
    const float wanted = number_of(command, i) + loop->carry[i];
    const uint16_t channel = to_channel(c, i, wanted);
    /* the sticks cannot give more; less than zero throttle is never commanded */
    const int is_at_end = channel == to_channel(c, i, FLT_MAX) || (i > 0 && channel == to_channel(c, i, -FLT_MAX));
    loop->carry[i] = is_at_end ? 0.0F : wanted - from_channel(c, i, channel);
    loop->sent.channel[stick(c, i)] = channel;
  }
}

static void put_centred(alula_teensy_loop* loop, float throttle) {
  const alula_teensy_config* c = &loop->config;
  loop->sent.channel[c->throttle] = to_channel(c, 0, throttle);
  for (int i = 1; i < 4; ++i) loop->sent.channel[stick(c, i)] = to_channel(c, i, 0.0F);
  forget_carry(loop);
}

/* Debounces a switch: it counts when it was the same in several consecutive frames. */
static void read_switch(alula_teensy_loop* loop) {
  const int is_on = loop->heard.channel[loop->config.override_channel] > loop->config.switch_above;
  loop->switch_frames = is_on == loop->override_on ? 0U : loop->switch_frames + 1U;
  if (loop->switch_frames < ALULA_TEENSY_SWITCH_FRAMES) return;
  loop->override_on = is_on;
  loop->switch_frames = 0U;
}

void alula_teensy_receive(alula_teensy_loop* loop, uint32_t now_us, const uint8_t* bytes, uint32_t count) {
  alula_sbus_frame frame;
  /* bytes that arrived during a slow tick are read together: the line was busy for their duration */
  const uint32_t busy_us = IDLE_US + BYTE_US * (count < ALULA_SBUS_BYTES ? count : ALULA_SBUS_BYTES);
  if (count > 0U && now_us - loop->byte_us > busy_us) alula_sbus_idle(&loop->receiver);
  for (uint32_t i = 0; i < count; ++i) {
    loop->byte_us = now_us;
    if (!alula_sbus_push(&loop->receiver, bytes[i], &frame)) continue;
    if ((frame.flags & ALULA_SBUS_FAILSAFE) != 0U) loop->is_silent = 1;
    if ((frame.flags & BAD_FLAGS) != 0U) continue;
    loop->heard = frame;
    loop->silence_us = 0U;
    loop->counted_us = now_us;
    loop->has_heard = 1;
    loop->is_silent = 0;
    read_switch(loop);
  }
}

static int is_news(const alula_teensy_loop* loop, uint32_t now_us, const alula_navigation* packet) {
  if ((packet->flags & ALULA_NAVIGATION_VALID) == 0U) return 0;
  if (!loop->has_navigation || now_us - loop->navigation_us > RESTART_US) return 1;
  return packet->sequence != loop->navigation.sequence && (int32_t)(packet->time_us - loop->navigation.time_us) > 0;
}

void alula_teensy_navigate(alula_teensy_loop* loop, uint32_t now_us, const uint8_t* bytes, uint32_t count) {
  alula_navigation packet;
  for (uint32_t i = 0; i < count; ++i) {
    if (!alula_navigation_push(&loop->link, bytes[i], &packet)) continue;
    if (!is_news(loop, now_us, &packet)) {
      ++loop->replayed;
      continue;
    }
    loop->navigation = packet;
    loop->navigation_us = now_us;
    loop->has_navigation = loop->is_new = 1;
  }
}

static void put_hand_over(alula_teensy_loop* loop) {
  const alula_teensy_config* c = &loop->config;
  if (c->level_channel == ALULA_TEENSY_NO_CHANNEL) {
    put_command(loop, &loop->result.command);
    return;
  }
  put_centred(loop, loop->result.command.throttle);
  loop->sent.channel[c->level_channel] = ON;
}

/* Writes the geofence's outcome into a frame that starts as a copy of the last good one. */
static alula_teensy_status put_outcome(alula_teensy_loop* loop, alula_geofence_status outcome) {
  if (!alula_racer_command_is_finite(&loop->result.command)) outcome = ALULA_GEOFENCE_REFUSED;
  if (outcome != ALULA_GEOFENCE_REFUSED) loop->has_flown = 1;
  switch (outcome) {
    case ALULA_GEOFENCE_PASSED:
      if (loop->is_guided) {
        put_command(loop, &loop->result.command);
        return ALULA_TEENSY_GUIDED;
      }
      forget_carry(loop);
      return ALULA_TEENSY_PASSED;
    case ALULA_GEOFENCE_BLENDED:
      put_command(loop, &loop->result.command);
      return ALULA_TEENSY_BLENDED;
    case ALULA_GEOFENCE_BACKUP:
      put_command(loop, &loop->result.command);
      return ALULA_TEENSY_BACKUP;
    case ALULA_GEOFENCE_NO_PILOT:
      put_command(loop, &loop->result.command);
      return ALULA_TEENSY_NO_PILOT;
    case ALULA_GEOFENCE_HAND_OVER:
      put_hand_over(loop);
      return ALULA_TEENSY_HAND_OVER;
    case ALULA_GEOFENCE_REFUSED:
    default:
      break;
  }
  if (!loop->has_flown) {
    put_centred(loop, 0.0F);
    return ALULA_TEENSY_LOCKED;
  }
  put_centred(loop, loop->config.geofence.descent * loop->geofence.hover);
  if (loop->config.level_channel != ALULA_TEENSY_NO_CHANNEL) loop->sent.channel[loop->config.level_channel] = ON;
  loop->sent.flags |= ALULA_SBUS_FAILSAFE;
  return ALULA_TEENSY_LOST;
}

static float deflection(const alula_teensy_config* c, int i, const alula_sbus_frame* frame) {
  const float us = microseconds(frame->channel[stick(c, i)]);
  const float x =
      i > 0 ? (us - c->rates.middle_us) / SPAN_US : 2.0F * from_channel(c, 0, frame->channel[stick(c, 0)]) - 1.0F;
  return x < -1.0F ? -1.0F : (x > 1.0F ? 1.0F : x);
}

/* The stack's command for sticks that are velocities, null without one; the pilot's own when they are not. */
static const alula_racer_command* guide(alula_teensy_loop* loop, const alula_racer_command* pilot) {
  const alula_teensy_config* c = &loop->config;
  loop->is_guided = 0;
  if (!loop->velocity || c->velocity_channel == ALULA_TEENSY_NO_CHANNEL) return pilot;
  if (!pilot || loop->override_on || loop->heard.channel[c->velocity_channel] <= c->switch_above) {
    alula_teensy_velocity_reset(loop->velocity);
    return pilot;
  }
  const float sticks[3] = {deflection(c, 2, &loop->heard), deflection(c, 1, &loop->heard),
                           deflection(c, 0, &loop->heard)};
  loop->is_guided = 1;
  return alula_teensy_velocity_tick(loop->velocity, loop->is_new ? &loop->navigation.state : 0, sticks,
                                    pilot->rates[2]);
}

/* Counts the time without frames. The clock wraps after 71 minutes; this count must not. */
static void count_silence(alula_teensy_loop* loop, uint32_t now_us) {
  const uint32_t more = now_us - loop->counted_us;
  loop->silence_us = loop->silence_us > UINT32_MAX - more ? UINT32_MAX : loop->silence_us + more;
  loop->counted_us = now_us;
}

alula_teensy_status alula_teensy_tick(alula_teensy_loop* loop, uint32_t now_us, uint8_t out[ALULA_SBUS_BYTES]) {
  const alula_teensy_config* c = &loop->config;
  count_silence(loop, now_us);
  if (loop->silence_us > c->radio_limit_us) loop->is_silent = 1;
  const int has_pilot = loop->has_heard && !loop->is_silent;
  alula_racer_command pilot;
  for (int i = 0; i < 4; ++i) {
    const float number = loop->has_heard ? from_channel(c, i, loop->heard.channel[stick(c, i)]) : 0.0F;
    if (i == 0) {
      pilot.throttle = number;
    } else {
      pilot.rates[i - 1] = number;
    }
  }
  /* in every tick, because it counts the age of its navigation */
  const alula_geofence_status outcome =
      alula_geofence_filter(&loop->geofence, loop->is_new ? &loop->navigation.state : 0,
                            guide(loop, has_pilot ? &pilot : 0), &loop->result);
  loop->is_new = 0;

  alula_teensy_status status = ALULA_TEENSY_NO_RECEIVER;
  if (loop->has_heard) {
    loop->sent = loop->heard;
    if (!loop->override_on) {
      status = put_outcome(loop, outcome);
      if (!has_pilot && loop->silence_us > c->give_up_us) loop->sent.flags |= ALULA_SBUS_FAILSAFE;
    } else {
      forget_carry(loop);
      if (pilot.throttle > 0.0F) loop->has_flown = 1;
      status = has_pilot ? ALULA_TEENSY_OVERRIDE : ALULA_TEENSY_OVERRIDE_LOST;
      if (!has_pilot) loop->sent.flags |= ALULA_SBUS_FAILSAFE;
    }
  } else {
    for (uint32_t i = 0; i < ALULA_SBUS_CHANNELS; ++i) loop->sent.channel[i] = 0U;
    put_centred(loop, 0.0F);
    loop->sent.flags = ALULA_SBUS_FAILSAFE;
  }
  alula_sbus_encode(&loop->sent, out);
  return status;
}
