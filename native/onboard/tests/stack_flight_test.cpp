// Flights behind the stack: the cascade against accelerations, and a racer, which lags by its attitude, through hulls
// in a fence among thrown balls. Inputs are pseudo-random and the same in every run.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>

#include "alula_cascade.h"
#include "alula_geofence.h"
#include "stack_world.hpp"

namespace {

constexpr float kLag = 0.22F;  // of the cascade alone; the stack counts the attitude's too

alula_cascade_config cascade() {
  const alula_geofence_config fence = ALULA_GEOFENCE_DEFAULTS;
  return {fence.model, fence.backup.attitude_gain, kLag, 6.0F};
}

// The cascade gives the thrust of the acceleration along the body axis, and its attitude has no error when it is
// right.
void test_the_cascade_flies_the_acceleration() {
  const alula_cascade_config c = cascade();
  CHECK(alula_cascade_check(&c) == ALULA_READY);
  const alula_racer_step_size step = alula_racer_step_of(&c.model, 0.001F);
  Random random{std::mt19937(4)};
  for (int n = 0; n < 40; ++n) {
    alula_racer_state state{};
    const double half_yaw = random(-1.5, 1.5);
    state.attitude[0] = static_cast<float>(std::cos(half_yaw));
    state.attitude[3] = static_cast<float>(std::sin(half_yaw));
    float a[3], u[3];
    for (int i = 0; i < 3; ++i) a[i] = static_cast<float>(random(-5, 5)), u[i] = c.lag_s * a[i];
    for (int tick = 0; tick < 150; ++tick) {
      alula_racer_command command;
      for (int i = 0; i < 3; ++i) state.position[i] = state.velocity[i] = 0.0F;
      CHECK(alula_cascade_follow(&c, &state, u, 0.0F, &command) == ALULA_READY);
      for (int k = 0; k < 10; ++k) (void)alula_racer_step(&c.model, &step, &command, &state);
    }
    for (int i = 0; i < 3; ++i) CHECK(std::abs(state.velocity[i] / 0.01F - a[i]) < 0.02F);
    const double yaw = std::atan2(static_cast<double>(state.attitude[3]), static_cast<double>(state.attitude[0]));
    CHECK(std::abs(yaw - half_yaw) < 0.2); /* held up to the coupling of the turn */
  }
}

void test_the_cascade_refuses_what_it_cannot_fly() {
  alula_cascade_config c = cascade();
  const float u[3] = {0.5F, 0.0F, 0.0F}, bad[3] = {std::nanf(""), 0.0F, 0.0F};
  alula_racer_state state{};
  state.attitude[0] = 1.0F;
  alula_racer_command command;
  const float hover = alula_racer_hover_throttle(&c.model);
  const auto is_hovering = [&] { return command.throttle == hover && command.rates[1] == 0.0F; };
  CHECK(alula_cascade_follow(&c, &state, u, 0.0F, &command) == ALULA_READY && command.rates[1] > 0.0F);
  CHECK(alula_cascade_follow(&c, &state, bad, 0.0F, &command) == ALULA_BAD_INPUT && is_hovering());
  CHECK(alula_cascade_follow(&c, &state, u, bad[0], &command) == ALULA_BAD_INPUT && is_hovering());
  state.attitude[0] = 0.0F;
  CHECK(alula_cascade_follow(&c, &state, u, 0.0F, &command) == ALULA_BAD_INPUT && is_hovering());
  CHECK(alula_cascade_follow(&c, nullptr, u, 0.0F, &command) == ALULA_BAD_POINTER && is_hovering());
  c.a_max = 9.5F; /* almost free fall */
  CHECK(alula_cascade_check(&c) == ALULA_BAD_PARAMETER);
  c = cascade(), c.lag_s = 0.0F;
  CHECK(alula_cascade_check(&c) == ALULA_BAD_PARAMETER);
  c = cascade(), c.model.thrust[2] = 9.0F;
  CHECK(alula_cascade_check(&c) == ALULA_BAD_PARAMETER);
}

struct Flown {
  double hull_m = 1e9, fence_m = 1e9;  // minimum distance of the vehicle's sphere
  int hits = 0, balls = 0, refused = 0, changed = 0;
};

constexpr double kRadius = 0.15, kBall = 0.12;

// `geofence` is null, or has the last word on throttle and rates.
Flown fly(alula_stack* stack, alula_geofence* geofence, std::uint32_t seed, bool has_radar) {
  Random random{std::mt19937(seed)};
  const auto place = [&] {
    Triple p;
    do p = {random(-5, 5), random(-5, 5), random(0.6, 2.8)};
    while (distance(p) < 0.5);
    return p;
  };
  alula_stack_reset(stack);
  if (geofence != nullptr) alula_geofence_reset(geofence);
  const alula_cascade_config follow = cascade();
  const alula_racer_model& model = follow.model;
  alula_racer_state x{};
  x.attitude[0] = 1.0F;
  const alula_racer_step_size step = alula_racer_step_of(&model, 0.002F);
  alula_stack_input in{};
  Triple goal = place(), ball{}, thrown{};
  const Triple start = place();
  for (std::size_t i = 0; i < 3; ++i) x.position[i] = static_cast<float>(start[i]);
  Flown flown;
  bool is_hit = true;
  for (int tick = 0; tick < 800; ++tick) {
    double to_goal[3], left = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      to_goal[i] = goal[i] - static_cast<double>(x.position[i]);
      left += to_goal[i] * to_goal[i];
    }
    left = std::sqrt(left);
    if (left < 0.4 || tick % 300 == 299) goal = place();
    for (std::size_t i = 0; i < 3; ++i)
      in.nominal[i] = static_cast<float>(std::min(1.0, left) * to_goal[i] / (left + 1e-9));
    if (tick % 160 == 80) { /* thrown at where the vehicle will be */
      const double heading = random(0, 6.28), up = random(-0.2, 0.4), time = 4 / random(3, 6);
      const Triple way{std::cos(heading) * std::cos(up), std::sin(heading) * std::cos(up), std::sin(up)};
      for (std::size_t i = 0; i < 3; ++i) {
        ball[i] = static_cast<double>(x.position[i]) + 4 * way[i];
        thrown[i] = (0.5 * time * static_cast<double>(x.velocity[i]) - 4 * way[i]) / time;
      }
      ++flown.balls;
      is_hit = false;
    }
    const alula_track track = ball_at(ball, thrown, static_cast<std::uint32_t>(flown.balls));
    in.track = &track, in.track_count = has_radar && flown.balls > 0 ? 1U : 0U;
    alula_stack_result result;
    alula_racer_command sticks;
    for (int i = 0; i < 3; ++i) in.position[i] = x.position[i], in.velocity[i] = x.velocity[i];
    if (alula_stack_filter(stack, &in, &result) == ALULA_FILTER_REFUSED) ++flown.refused;
    CHECK(alula_cascade_follow(&follow, &x, result.velocity, 0.0F, &sticks) == ALULA_READY);
    if (geofence != nullptr) {
      alula_geofence_result held;
      flown.changed += alula_geofence_filter(geofence, &x, &sticks, &held) != ALULA_GEOFENCE_PASSED;
      sticks = held.command;
    }
    for (int k = 0; k < 5; ++k) {
      (void)alula_racer_step(&model, &step, &sticks, &x);
      Triple p;
      double square = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        p[i] = static_cast<double>(x.position[i]);
        ball[i] += 0.002 * thrown[i];
        square += (ball[i] - p[i]) * (ball[i] - p[i]);
        const double below = p[i] - static_cast<double>(box().lower[i]),
                     above = static_cast<double>(box().upper[i]) - p[i];
        flown.fence_m = std::min(flown.fence_m, std::min(below, above) - kRadius);
      }
      flown.hull_m = std::min(flown.hull_m, distance(p) - kRadius);
      if (!is_hit && square < (kRadius + kBall) * (kRadius + kBall)) is_hit = true, ++flown.hits;
    }
  }
  return flown;
}

void test_flights_among_hulls_and_balls_in_a_fence() {
  const Stack stack = make(indoors());
  Flown with, without;
  for (std::uint32_t seed = 0; seed < 24; ++seed) {
    for (Flown* sum : {&with, &without}) {
      const Flown one = fly(stack.get(), nullptr, seed, sum == &with);
      CHECK(one.hull_m > 0 && one.fence_m > 0 && one.refused == 0);
      sum->hull_m = std::min(sum->hull_m, one.hull_m), sum->fence_m = std::min(sum->fence_m, one.fence_m);
      sum->hits += one.hits, sum->balls += one.balls;
    }
  }
  std::printf("stack: hulls %.3f m, fence %.3f m, %d of %d balls hit; without tracks %.3f m, %.3f m, %d of %d\n",
              with.hull_m, with.fence_m, with.hits, with.balls, without.hull_m, without.fence_m, without.hits,
              without.balls);
  CHECK(with.balls == 120 && without.hits > 30 && 10 * with.hits < without.hits);
}

// A geofence behind it, which keeps out of the same hulls, changes little and keeps its own guarantee.
void test_flights_with_a_geofence_that_keeps_out_of_the_hulls() {
  alula_fence fence = box();
  fence.keep_out = &field();
  alula_geofence_config c = ALULA_GEOFENCE_DEFAULTS;
  c.radius_m = 0.15F, c.reserve_m = 0.05F, c.tick_s = 0.01F;
  const Stack stack = make(indoors());
  const auto geofence = std::make_unique<alula_geofence>();
  CHECK(alula_geofence_init(geofence.get(), &fence, &c) == ALULA_READY);
  for (std::uint32_t seed = 0; seed < 8; ++seed) {
    const Flown one = fly(stack.get(), geofence.get(), seed, true);
    CHECK(one.hull_m > 0 && one.fence_m > 0 && one.refused == 0);
  }
}

void test_a_flight_after_a_reset_is_the_same() {
  const Stack stack = make(indoors());
  const Flown one = fly(stack.get(), nullptr, 3, true), again = fly(stack.get(), nullptr, 3, true);
  CHECK(one.hull_m == again.hull_m && one.fence_m == again.fence_m && one.hits == again.hits);
}

}  // namespace

int main() {
  test_the_cascade_flies_the_acceleration();
  test_the_cascade_refuses_what_it_cannot_fly();
  test_flights_among_hulls_and_balls_in_a_fence();
  test_flights_with_a_geofence_that_keeps_out_of_the_hulls();
  test_a_flight_after_a_reset_is_the_same();
  return alula_failures == 0 ? 0 : 1;
}
