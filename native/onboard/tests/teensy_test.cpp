// The Teensy's loop on the bench: every outcome, and arbitrary bytes on both lines.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

#include "check.hpp"
#include "radio.hpp"
#include "teensy_loop.h"

namespace {

using alula::flight::RacerCommand;

constexpr float kHalfStepUs = 0.3125F;

// A loop on the bench: frames and packets at will, one tick at a time.
struct Bench {
  alula_teensy_config config;
  alula_fence fence = onboard_yard();
  alula_teensy_loop loop{};
  std::uint32_t now = 5000;
  std::uint16_t sequence = 0;
  alula_sbus_frame out{};
  alula_racer_state state{};

  explicit Bench(const alula_teensy_config& c = alula_teensy_defaults()) : config(c) {
    CHECK(alula_teensy_init(&loop, &fence, &config) == ALULA_READY);
    state.attitude[0] = 1, state.position[2] = 20;
  }
  void radio(const alula_sbus_frame& frame) {
    std::uint8_t bytes[ALULA_SBUS_BYTES];
    alula_sbus_encode(&frame, bytes);
    alula_teensy_receive(&loop, now, bytes, sizeof bytes);
  }
  void navigation(std::uint8_t flags = ALULA_NAVIGATION_VALID, bool is_new = true) {
    if (is_new) ++sequence;
    const alula_navigation n{state, is_new ? now : loop.navigation.time_us, sequence, flags};
    std::uint8_t bytes[ALULA_NAVIGATION_BYTES];
    CHECK(alula_navigation_encode(&n, bytes));
    alula_teensy_navigate(&loop, now, bytes, sizeof bytes);
  }
  alula_teensy_status tick(std::uint32_t us = 5000) {
    now += us;
    std::uint8_t bytes[ALULA_SBUS_BYTES];
    const alula_teensy_status status = alula_teensy_tick(&loop, now, bytes);
    CHECK(alula_sbus_decode(bytes, &out));
    return status;
  }
  bool is_verbatim(const alula_sbus_frame& frame) const {
    return std::equal(out.channel, out.channel + 16, frame.channel) && out.flags == frame.flags;
  }
  bool is_idle() const {
    const float low = 880 + 0.625F * static_cast<float>(out.channel[config.throttle]);
    return low <= config.rates.throttle_low_us + kHalfStepUs && out.channel[config.roll] == 992 &&
           out.channel[config.pitch] == 992 && out.channel[config.yaw] == 992;
  }
};

void test_nothing_flies_before_receiver_and_navigation_are_there() {
  Bench b;
  CHECK(b.tick() == ALULA_TEENSY_NO_RECEIVER && b.is_idle() && b.out.flags == ALULA_SBUS_FAILSAFE);
  b.navigation();
  CHECK(b.tick() == ALULA_TEENSY_NO_RECEIVER && b.is_idle());
  Bench c;
  alula_sbus_frame frame = radio_frame(c.config, {0.8, {1, 1, 1}});
  c.radio(frame);
  CHECK(c.tick() == ALULA_TEENSY_LOCKED && c.is_idle() && c.out.flags == 0);
  CHECK(c.out.channel[9] == frame.channel[9]);  // arming and all other channels are the pilot's
  c.navigation(0);                              // not valid
  c.radio(frame);
  CHECK(c.tick() == ALULA_TEENSY_LOCKED && c.loop.replayed == 1);
  c.navigation();
  c.radio(frame);
  CHECK(c.tick() == ALULA_TEENSY_PASSED && c.is_verbatim(frame));
}

void test_the_override_switch_wins_and_only_when_it_is_meant() {
  Bench b;
  alula_sbus_frame at_wall = radio_frame(b.config, {1.0, {0, 8, 0}}), on = at_wall;
  on.channel[b.config.override_channel] = 1811;
  b.state.position[0] = 39.9F, b.state.velocity[0] = 25;  // too late to stop inside
  const auto next = [&](const alula_sbus_frame& frame) {
    b.radio(frame), b.navigation();
    return b.tick();
  };
  CHECK(next(at_wall) == ALULA_TEENSY_BACKUP && !b.is_verbatim(at_wall));
  CHECK(next(on) == ALULA_TEENSY_BACKUP);  // one frame may be noise
  CHECK(next(at_wall) == ALULA_TEENSY_BACKUP);
  CHECK(next(on) == ALULA_TEENSY_BACKUP && next(on) == ALULA_TEENSY_BACKUP);
  CHECK(next(on) == ALULA_TEENSY_OVERRIDE && b.is_verbatim(on));
  CHECK(next(at_wall) == ALULA_TEENSY_OVERRIDE);
  CHECK(next(on) == ALULA_TEENSY_OVERRIDE);
  for (int i = 0; i < 25; ++i) b.tick();  // silence
  CHECK(b.tick() == ALULA_TEENSY_OVERRIDE_LOST && (b.out.flags & ALULA_SBUS_FAILSAFE) != 0);
  CHECK(b.out.channel[b.config.throttle] == on.channel[b.config.throttle]);
  CHECK(next(at_wall) == ALULA_TEENSY_OVERRIDE && next(at_wall) == ALULA_TEENSY_OVERRIDE);
  CHECK(next(at_wall) == ALULA_TEENSY_BACKUP);
}

void test_the_receiver_is_silent_by_its_flag_or_by_time_and_for_good_by_more() {
  alula_teensy_config config = alula_teensy_defaults();
  config.give_up_us = 1000000;
  Bench b(config);
  const alula_sbus_frame frame = radio_frame(b.config, {0.36, {0, 0, 0}});
  alula_sbus_frame lost = frame, failed = frame;
  lost.flags = ALULA_SBUS_LOST, failed.flags = ALULA_SBUS_FAILSAFE | ALULA_SBUS_LOST;
  const auto next = [&](const alula_sbus_frame* f) {
    if (f) b.radio(*f);
    b.navigation();
    return b.tick();
  };
  CHECK(next(&frame) == ALULA_TEENSY_PASSED);
  for (int i = 0; i < 19; ++i) CHECK(next(&lost) == ALULA_TEENSY_PASSED);  // 100 ms since a good one
  CHECK(next(&lost) == ALULA_TEENSY_NO_PILOT && b.out.flags == 0);
  CHECK(b.out.channel[9] == frame.channel[9]);
  CHECK(next(&frame) == ALULA_TEENSY_PASSED);
  CHECK(next(&failed) == ALULA_TEENSY_NO_PILOT && b.out.flags == 0);
  for (int i = 0; i < 195; ++i) CHECK(next(nullptr) == ALULA_TEENSY_NO_PILOT && b.out.flags == 0);
  for (int i = 0; i < 8; ++i) next(nullptr);
  CHECK(next(nullptr) == ALULA_TEENSY_NO_PILOT && b.out.flags == ALULA_SBUS_FAILSAFE);
  b.now += 0xFFFFFF00U;  // the clock wraps: still silent
  CHECK(next(nullptr) == ALULA_TEENSY_NO_PILOT && b.out.flags == ALULA_SBUS_FAILSAFE);
  CHECK(next(&frame) == ALULA_TEENSY_PASSED && b.is_verbatim(frame));
}

void test_old_navigation_is_none_and_what_follows_is_documented() {
  for (const std::uint8_t level : {ALULA_TEENSY_NO_CHANNEL, 11U}) {
    alula_teensy_config config = alula_teensy_defaults();
    config.level_channel = level;
    Bench b(config);
    const alula_sbus_frame frame = radio_frame(b.config, {0.36, {0, 0, 0}});
    b.radio(frame), b.navigation();
    CHECK(b.tick() == ALULA_TEENSY_PASSED);
    alula_teensy_status status = ALULA_TEENSY_PASSED;
    for (int i = 0; i < 70; ++i) {
      b.radio(frame), b.navigation(ALULA_NAVIGATION_VALID, false);  // the same packet again and again
      status = b.tick();
      CHECK((status == ALULA_TEENSY_HAND_OVER) == (b.loop.result.stale_s > 0.3F));
    }
    CHECK(status == ALULA_TEENSY_HAND_OVER && b.out.flags == 0);
    const RacerCommand sent = heard_by_controller(b.config, b.out);
    CHECK(std::fabs(sent.throttle - 0.9 * static_cast<double>(b.loop.geofence.hover)) < 0.001);
    for (int i = 0; i < 3; ++i) CHECK(std::fabs(sent.rates[i]) < 0.01);
    CHECK(b.out.channel[11] == (level == 11U ? 1811 : frame.channel[11]));
    b.radio(frame), b.navigation();
    CHECK(b.tick() == ALULA_TEENSY_PASSED && b.is_verbatim(frame));
  }
}

void test_a_sender_that_begins_anew_is_heard_after_a_second() {
  Bench b;
  const alula_sbus_frame frame = radio_frame(b.config, {0.36, {0, 0, 0}});
  b.now = 50000000;
  b.radio(frame), b.navigation();
  CHECK(b.tick() == ALULA_TEENSY_PASSED);
  const std::uint32_t packets = b.loop.replayed;
  const auto old = [&] {
    const alula_navigation n{b.state, 17, 1, ALULA_NAVIGATION_VALID};
    std::uint8_t bytes[ALULA_NAVIGATION_BYTES];
    CHECK(alula_navigation_encode(&n, bytes));
    alula_teensy_navigate(&b.loop, b.now, bytes, sizeof bytes);
  };
  old();
  CHECK(b.loop.replayed == packets + 1);
  b.now += 1100000;
  old();
  b.radio(frame);
  CHECK(b.loop.replayed == packets + 1 && b.tick() == ALULA_TEENSY_PASSED);
}

void test_parameters_that_mean_nothing_are_refused() {
  const alula_fence fence = onboard_yard();
  alula_teensy_loop loop{};
  const alula_teensy_config good = alula_teensy_defaults();
  const auto is_refused = [&](auto change) {
    alula_teensy_config bad = good;
    change(bad);
    return alula_teensy_init(&loop, &fence, &bad) == ALULA_BAD_PARAMETER;
  };
  CHECK(alula_teensy_init(&loop, &fence, &good) == ALULA_READY);
  CHECK(is_refused([](auto& c) { c.roll = 16; }));
  CHECK(is_refused([](auto& c) { c.roll = c.yaw; }));
  CHECK(is_refused([](auto& c) { c.override_channel = c.throttle; }));
  CHECK(is_refused([](auto& c) { c.level_channel = c.override_channel; }));
  CHECK(is_refused([](auto& c) { c.level_channel = 16; }));
  CHECK(is_refused([](auto& c) { c.switch_above = 2047; }));
  CHECK(is_refused([](auto& c) { c.radio_limit_us = 0; }));
  CHECK(is_refused([](auto& c) { c.give_up_us = 1; }));
  CHECK(is_refused([](auto& c) { c.rates.axis[0].rc_rate = NAN; }));
  CHECK(is_refused([](auto& c) { c.geofence.model.max_rate[2] = 6; }));  // full yaw would never pass
  CHECK(is_refused([](auto& c) { c.geofence.tick_s = 0; }));
  CHECK(alula_teensy_init(nullptr, &fence, &good) == ALULA_BAD_POINTER);
  CHECK(alula_teensy_init(&loop, nullptr, &good) == ALULA_BAD_POINTER);
}

// A tick of the geofence may take longer than a pause between frames; a frame received meanwhile is complete.
void test_a_frame_that_came_during_a_slow_tick_counts() {
  Bench b;
  const alula_sbus_frame frame = radio_frame(b.config, {0.36, {0, 0, 0}});
  std::uint8_t bytes[ALULA_SBUS_BYTES];
  alula_sbus_encode(&frame, bytes);
  alula_teensy_receive(&b.loop, b.now, bytes, 10);
  alula_teensy_receive(&b.loop, b.now + 15 * 120, bytes + 10, 15);
  CHECK(b.loop.receiver.frames == 1 && b.loop.receiver.skipped == 0);
  alula_teensy_receive(&b.loop, b.now + 10000, bytes, 10);  // an incomplete frame does not count
  alula_teensy_receive(&b.loop, b.now + 17000, bytes, 2);
  alula_teensy_receive(&b.loop, b.now + 19760, bytes + 2, 23);
  CHECK(b.loop.receiver.frames == 2 && b.loop.receiver.skipped == 10);
}

void test_who_took_off_by_the_override_does_not_fall_without_navigation() {
  Bench b;
  alula_sbus_frame off = radio_frame(b.config, {0, {0, 0, 0}}), on = off;
  on.channel[b.config.override_channel] = 1811;
  const auto next = [&](const alula_sbus_frame& frame) {
    b.radio(frame);
    return b.tick();
  };
  for (int i = 0; i < 4; ++i) next(on);
  for (int i = 0; i < 3; ++i) next(off);
  CHECK(next(off) == ALULA_TEENSY_LOCKED && b.is_idle());  // no throttle so far
  on.channel[b.config.throttle] = 900;
  for (int i = 0; i < 4; ++i) next(on);
  CHECK(next(on) == ALULA_TEENSY_OVERRIDE);
  for (int i = 0; i < 3; ++i) next(off);
  CHECK(next(off) == ALULA_TEENSY_LOST && (b.out.flags & ALULA_SBUS_FAILSAFE) != 0);
  CHECK(heard_by_controller(b.config, b.out).throttle > 0.8 * static_cast<double>(b.loop.geofence.hover));
}

// Sticks with an end beyond 1000 or 2000 us are sent up to that end.
void test_sticks_reach_the_ends_of_the_rates() {
  for (const float middle : {1400.0F, 1500.0F, 1600.0F}) {
    alula_teensy_config config = alula_teensy_defaults();
    config.rates.middle_us = middle;
    config.rates.throttle_low_us = 900, config.rates.throttle_high_us = 2100;
    Bench b(config);
    b.state.attitude[0] = 0.8F, b.state.attitude[1] = 0.6F;
    b.state.velocity[0] = 20, b.state.velocity[1] = -20, b.state.velocity[2] = -30, b.state.position[2] = 1;
    int at_end = 0;
    for (int k = 0; k < 40; ++k) {
      b.radio(radio_frame(b.config, {1, {0, 0, 0}})), b.navigation();
      CHECK(b.tick() == ALULA_TEENSY_BACKUP);
      const RacerCommand sent = heard_by_controller(b.config, b.out);
      const alula_racer_command& asked = b.loop.result.command;
      CHECK(std::fabs(sent.throttle - static_cast<double>(asked.throttle)) < 0.001);
      for (int i = 0; i < 3; ++i) {
        const double wanted = std::clamp(static_cast<double>(asked.rates[i]), -11.63, 11.63);
        CHECK(std::fabs(sent.rates[i] - wanted) < 0.06);
        at_end += std::fabs(wanted) > 11.6;
      }
      b.state.attitude[1] = k % 2 == 0 ? -0.6F : 0.6F;
    }
    CHECK(at_end > 10);
  }
}

// For arbitrary bytes on both lines, the loop sends a frame with sticks that a radio could have sent.
void test_noise_gives_frames() {
  Bench b;
  std::mt19937 random(1);
  const alula_sbus_frame frame = radio_frame(b.config, {0.36, {0, 0, 0}});
  for (int k = 0; k < 4000; ++k) {
    std::uint8_t bytes[64];
    for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random());
    if (random() % 2 == 0) b.radio(frame);
    alula_teensy_receive(&b.loop, b.now, bytes, static_cast<std::uint32_t>(random() % 64));
    if (random() % 2 == 0) b.navigation();
    alula_teensy_navigate(&b.loop, b.now, bytes, static_cast<std::uint32_t>(random() % 64));
    const alula_teensy_status status = b.tick(static_cast<std::uint32_t>(random() % 20000));
    if (status == ALULA_TEENSY_PASSED || status == ALULA_TEENSY_OVERRIDE || status == ALULA_TEENSY_OVERRIDE_LOST)
      continue;
    for (int i = 0; i < 4; ++i) CHECK(b.out.channel[i] >= 192 && b.out.channel[i] <= 1792);
  }
}

}  // namespace

int main() {
  test_parameters_that_mean_nothing_are_refused();
  test_nothing_flies_before_receiver_and_navigation_are_there();
  test_the_override_switch_wins_and_only_when_it_is_meant();
  test_the_receiver_is_silent_by_its_flag_or_by_time_and_for_good_by_more();
  test_old_navigation_is_none_and_what_follows_is_documented();
  test_a_sender_that_begins_anew_is_heard_after_a_second();
  test_a_frame_that_came_during_a_slow_tick_counts();
  test_who_took_off_by_the_override_does_not_fall_without_navigation();
  test_sticks_reach_the_ends_of_the_rates();
  test_noise_gives_frames();
  return alula_failures == 0 ? 0 : 1;
}
