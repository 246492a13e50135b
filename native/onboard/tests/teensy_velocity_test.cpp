// The Teensy's loop with sticks as velocities, byte by byte: among hulls, in a fence, among thrown balls.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <random>

#include "radio.hpp"
#include "stack_world.hpp"

namespace {

constexpr std::uint32_t kStepUs = 1000, kOn = 1800;
constexpr double kBody = 0.15, kBall = 0.12;

struct Rig {
  alula_teensy_config config = alula_teensy_defaults();
  alula_fence fence = box();
  std::unique_ptr<alula_teensy_loop> loop = std::make_unique<alula_teensy_loop>();
  std::unique_ptr<alula_teensy_velocity> velocity = std::make_unique<alula_teensy_velocity>();
  alula_racer_state x{};
  alula_racer_command command{};
  float stick[3] = {0, 0, 0};  // ahead, right, up
  double yaw_rate = 0;
  bool is_on = true, has_navigation = true;
  std::uint32_t now = 0xFFFF0000U, k = 0;
  std::uint16_t sequence = 0;
  alula_teensy_status status = ALULA_TEENSY_NO_RECEIVER;
  int guided = 0;  // ticks with a command of the stack, blended or not

  Rig() {
    fence.keep_out = &field();
    config.velocity_channel = 5;
    config.geofence.radius_m = 0.15F, config.geofence.reserve_m = 0.05F;
    alula_teensy_velocity_config velocities = alula_teensy_velocity_defaults();
    velocities.stack.extent_m = 20.0F;
    velocities.stack.polytope_cbf.radius_m = 0.3F;
    CHECK(alula_teensy_init(loop.get(), &fence, &config) == ALULA_READY);
    CHECK(alula_teensy_velocity_init(velocity.get(), &field(), &fence, config.geofence.tick_s, &velocities) ==
          ALULA_READY);
    loop->velocity = velocity.get();
    x.attitude[0] = 1.0F;
    x.position[0] = 1.7F, x.position[1] = 1.6F, x.position[2] = 1.5F;
    command.throttle = alula_racer_hover_throttle(&config.geofence.model);
  }
  // A millisecond: a frame of the radio every 7, a packet of navigation every 10, a tick every 5.
  void run() {
    if (k % 7 == 0) {
      alula_sbus_frame frame = radio_frame(config, {});
      const auto us = [&](float deflection) { return channel_of(config.rates.middle_us + 500 * deflection); };
      frame.channel[config.pitch] = us(stick[0]), frame.channel[config.roll] = us(stick[1]);
      const float low = config.rates.throttle_low_us, high = config.rates.throttle_high_us;
      frame.channel[config.throttle] = channel_of(low + 0.5F * (1 + stick[2]) * (high - low));
      const float turn = alula_rates_deflection(&config.rates.axis[2], static_cast<float>(yaw_rate));
      frame.channel[config.yaw] = us(-turn);
      frame.channel[config.velocity_channel] = is_on ? kOn : 200;
      std::uint8_t bytes[ALULA_SBUS_BYTES];
      alula_sbus_encode(&frame, bytes);
      alula_teensy_receive(loop.get(), now, bytes, sizeof bytes);
    }
    if (k % 10 == 0 && has_navigation) {
      const alula_navigation n{x, now, sequence++, ALULA_NAVIGATION_VALID};
      std::uint8_t packet[ALULA_NAVIGATION_BYTES];
      CHECK(alula_navigation_encode(&n, packet));
      alula_teensy_navigate(loop.get(), now, packet, sizeof packet);
    }
    if (k % 5 == 0) {
      std::uint8_t out[ALULA_SBUS_BYTES];
      status = alula_teensy_tick(loop.get(), now, out);
      guided += is_guided();
      const auto heard = heard_by_controller(config, loop->sent);
      command.throttle = static_cast<float>(heard.throttle);
      for (int i = 0; i < 3; ++i) command.rates[i] = static_cast<float>(heard.rates[i]);
    }
    const alula_racer_step_size step = alula_racer_step_of(&config.geofence.model, 0.001F);
    (void)alula_racer_step(&config.geofence.model, &step, &command, &x);
    ++k, now += kStepUs;
  }
  bool is_guided() const {
    return loop->is_guided && (status == ALULA_TEENSY_GUIDED || status == ALULA_TEENSY_BLENDED);
  }
  Triple at() const {
    return {static_cast<double>(x.position[0]), static_cast<double>(x.position[1]),
            static_cast<double>(x.position[2])};
  }
};

void test_sticks_are_velocities_in_the_frame_of_the_nose() {
  Rig rig;
  const double half = 0.6;
  rig.x.attitude[0] = static_cast<float>(std::cos(half)), rig.x.attitude[3] = static_cast<float>(std::sin(half));
  for (const float sign : {1.0F, -1.0F}) {
    rig.x.position[0] = 1.7F, rig.x.position[1] = 1.6F, rig.x.position[2] = 1.5F;
    rig.stick[0] = 0.5F * sign, rig.stick[1] = 0.3F * sign, rig.stick[2] = 0;
    for (int k = 0; k < 600; ++k) rig.run();
    const double ahead = 0.5 * static_cast<double>(sign), right = 0.3 * static_cast<double>(sign), yaw = 2 * half;
    CHECK(std::abs(static_cast<double>(rig.x.velocity[0]) - (std::cos(yaw) * ahead + std::sin(yaw) * right)) < 0.15);
    CHECK(std::abs(static_cast<double>(rig.x.velocity[1]) - (std::sin(yaw) * ahead - std::cos(yaw) * right)) < 0.15);
  }
  CHECK(rig.guided > 200);
}

void test_without_navigation_the_geofence_takes_over_and_the_switch_gives_the_sticks_back() {
  Rig rig;
  for (int k = 0; k < 300; ++k) rig.run();
  CHECK(rig.is_guided());
  rig.has_navigation = false;
  for (int k = 0; k < 60; ++k) rig.run();
  CHECK(rig.status == ALULA_TEENSY_NO_PILOT);
  rig.has_navigation = true;
  for (int k = 0; k < 60; ++k) rig.run();
  CHECK(rig.is_guided());
  rig.is_on = false;
  for (int k = 0; k < 20; ++k) rig.run();
  CHECK(!rig.is_guided() && rig.status != ALULA_TEENSY_NO_PILOT);
}

// Sticks at random for two minutes, a ball every two seconds; hits.
int fly(bool has_tracks, int* thrown) {
  Rig rig;
  Random random{std::mt19937(8)};
  Triple ball{}, way{};
  alula_track track{};
  bool is_hit = true;
  int hits = 0;
  double hull = 1e9, fence = 1e9;
  for (int k = 0; k < 90000; ++k) {
    if (k % 2500 == 0) {
      for (float& stick : rig.stick) stick = static_cast<float>(random(-1, 1));
      rig.yaw_rate = random(-1, 1);
    }
    if (k % 2000 == 1000) {
      const double heading = random(0, 6.28), time = 4 / random(3, 5);
      const Triple from{4 * std::cos(heading), 4 * std::sin(heading), random(-0.5, 1)};
      for (std::size_t i = 0; i < 3; ++i) {
        ball[i] = rig.at()[i] + from[i];
        way[i] = (0.5 * time * static_cast<double>(rig.x.velocity[i]) - from[i]) / time;
      }
      is_hit = false, ++*thrown;
    }
    for (std::size_t i = 0; i < 3; ++i) ball[i] += 0.001 * way[i];
    if (has_tracks && *thrown > 0 && k % 10 == 0) {
      track = ball_at(ball, way, static_cast<std::uint32_t>(*thrown));
      rig.velocity->track = &track, rig.velocity->track_count = 1;
    }
    rig.run();
    const Triple p = rig.at();
    double square = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      square += (ball[i] - p[i]) * (ball[i] - p[i]);
      fence =
          std::min({fence, p[i] - static_cast<double>(box().lower[i]), static_cast<double>(box().upper[i]) - p[i]});
    }
    if (!is_hit && square < (kBody + kBall) * (kBody + kBall)) is_hit = true, ++hits;
    hull = std::min(hull, distance(p));
  }
  CHECK(hull > kBody && fence > kBody);
  CHECK(rig.guided > 17500);
  std::printf("teensy, tracks %d: hulls %.3f m, fence %.3f m, guided %d of 18000, %d of %d balls hit\n", has_tracks,
              hull, fence, rig.guided, hits, *thrown);
  return hits;
}

void test_guided_flights_touch_nothing_and_dodge_balls() {
  int thrown = 0, unseen = 0;
  const int hits = fly(true, &thrown), without = fly(false, &unseen);
  CHECK(thrown == 45 && unseen == 45 && without > 10 && 4 * hits < without);
}

void test_bad_configurations_are_refused() {
  const Rig rig;
  alula_teensy_velocity velocity;
  const alula_teensy_velocity_config good = alula_teensy_velocity_defaults();
  const auto status_of = [&](const auto& change, float tick_s) {
    alula_teensy_velocity_config c = good;
    c.stack.extent_m = 20.0F;
    change(c);
    return alula_teensy_velocity_init(&velocity, &field(), &rig.fence, tick_s, &c);
  };
  using Config = alula_teensy_velocity_config;
  const auto keep = [](Config&) {};
  CHECK(status_of(keep, 0.005F) == ALULA_READY && status_of(keep, 0.02F) == ALULA_READY);
  CHECK(status_of(keep, 0.003F) == ALULA_BAD_PARAMETER && status_of(keep, 0.04F) == ALULA_BAD_PARAMETER);
  CHECK(status_of([](Config& c) { c.speed_m_s = std::nanf(""); }, 0.005F) == ALULA_BAD_PARAMETER);
  CHECK(status_of([](Config& c) { c.cascade.lag_s = 0.0F; }, 0.005F) == ALULA_BAD_PARAMETER);
  CHECK(status_of([](Config& c) { c.stack.lag_s = 0.01F; }, 0.005F) == ALULA_BAD_PARAMETER);
  CHECK(alula_teensy_velocity_init(&velocity, nullptr, &rig.fence, 0.005F, &good) == ALULA_BAD_POINTER);
}

}  // namespace

int main() {
  test_sticks_are_velocities_in_the_frame_of_the_nose();
  test_without_navigation_the_geofence_takes_over_and_the_switch_gives_the_sticks_back();
  test_guided_flights_touch_nothing_and_dodge_balls();
  test_bad_configurations_are_refused();
  return alula_failures == 0 ? 0 : 1;
}
