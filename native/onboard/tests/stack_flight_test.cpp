// Flights of the stack: its cascade against accelerations, and a vehicle on the racer's model through hulls in a
// fence among thrown balls. Inputs are pseudo-random and the same in every run.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>

#include "stack_world.hpp"

namespace {

// The cascade gives the thrust of the acceleration along the body axis, and its attitude has no error when it is
// right.
void test_the_cascade_flies_the_acceleration() {
  alula_stack_config c = indoors();
  c.parts = kMoving, c.takes = ALULA_STACK_ACCELERATION;
  const Stack stack = make(c);
  const alula_racer_step_size step = alula_racer_step_of(&c.geofence.model, 0.001F);
  Random random{std::mt19937(4)};
  for (int n = 0; n < 40; ++n) {
    alula_stack_input in{};
    in.kind = ALULA_STACK_ACCELERATION;
    const double half_yaw = random(-1.5, 1.5);
    in.state.attitude[0] = static_cast<float>(std::cos(half_yaw));
    in.state.attitude[3] = static_cast<float>(std::sin(half_yaw));
    for (float& component : in.nominal) component = static_cast<float>(random(-5, 5));
    alula_stack_result result;
    for (int tick = 0; tick < 150; ++tick) {
      for (int i = 0; i < 3; ++i) in.state.position[i] = in.state.velocity[i] = 0.0F;
      alula_stack_reset(stack.get());
      CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_OK);
      for (int k = 0; k < 10; ++k) (void)alula_racer_step(&c.geofence.model, &step, &result.sticks, &in.state);
    }
    for (int i = 0; i < 3; ++i) CHECK(std::abs(in.state.velocity[i] / 0.01F - in.nominal[i]) < 0.02F);
    const double yaw =
        std::atan2(static_cast<double>(in.state.attitude[3]), static_cast<double>(in.state.attitude[0]));
    CHECK(std::abs(yaw - half_yaw) < 0.2); /* held up to the coupling of the turn */
  }
}

struct Flown {
  double hull_m = 1e9, fence_m = 1e9;  // minimum distance of the vehicle's sphere
  int hits = 0, balls = 0, refused = 0, full = 0;
};

constexpr double kRadius = 0.15, kBall = 0.12;

Flown fly(alula_stack* stack, std::uint32_t seed, bool has_radar) {
  Random random{std::mt19937(seed)};
  const auto place = [&] {
    Triple p;
    do p = {random(-5, 5), random(-5, 5), random(0.6, 2.8)};
    while (distance(p) < 0.5);
    return p;
  };
  alula_stack_reset(stack);
  const alula_racer_model& model = stack->config.geofence.model;
  const alula_racer_step_size step = alula_racer_step_of(&model, 0.002F);
  alula_stack_input in{};
  in.state.attitude[0] = 1.0F;
  Triple goal = place(), ball{}, thrown{};
  const Triple start = place();
  for (std::size_t i = 0; i < 3; ++i) in.state.position[i] = static_cast<float>(start[i]);
  Flown flown;
  bool is_hit = true;
  for (int tick = 0; tick < 800; ++tick) {
    double to_goal[3], left = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      to_goal[i] = goal[i] - static_cast<double>(in.state.position[i]);
      left += to_goal[i] * to_goal[i];
    }
    left = std::sqrt(left);
    if (left < 0.4 || tick % 300 == 299) goal = place();
    for (std::size_t i = 0; i < 3; ++i)
      in.nominal[i] = static_cast<float>(std::min(1.5, left) * to_goal[i] / (left + 1e-9));
    if (tick % 160 == 80) { /* thrown at where the vehicle will be */
      const double heading = random(0, 6.28), up = random(-0.2, 0.4), time = 4 / random(3, 6);
      const Triple way{std::cos(heading) * std::cos(up), std::sin(heading) * std::cos(up), std::sin(up)};
      for (std::size_t i = 0; i < 3; ++i) {
        ball[i] = static_cast<double>(in.state.position[i]) + 4 * way[i];
        thrown[i] = (0.5 * time * static_cast<double>(in.state.velocity[i]) - 4 * way[i]) / time;
      }
      ++flown.balls;
      is_hit = false;
    }
    const alula_track track = ball_at(ball, thrown, static_cast<std::uint32_t>(flown.balls));
    in.track = &track, in.track_count = has_radar && flown.balls > 0 ? 1U : 0U;
    alula_stack_result result;
    if (alula_stack_filter(stack, &in, &result) == ALULA_FILTER_REFUSED) ++flown.refused;
    flown.full += result.walls_are_full;
    for (int k = 0; k < 5; ++k) {
      (void)alula_racer_step(&model, &step, &result.sticks, &in.state);
      Triple p;
      double square = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        p[i] = static_cast<double>(in.state.position[i]);
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
      const Flown one = fly(stack.get(), seed, sum == &with);
      CHECK(one.hull_m > 0 && one.fence_m > 0 && one.refused == 0);
      sum->hull_m = std::min(sum->hull_m, one.hull_m), sum->fence_m = std::min(sum->fence_m, one.fence_m);
      sum->hits += one.hits, sum->balls += one.balls, sum->full += one.full;
    }
  }
  std::printf("stack: hulls %.3f m, fence %.3f m, %d of %d balls hit; without tracks %.3f m, %.3f m, %d of %d\n",
              with.hull_m, with.fence_m, with.hits, with.balls, without.hull_m, without.fence_m, without.hits,
              without.balls);
  CHECK(with.balls == 120 && without.hits > 30 && 10 * with.hits < without.hits);
}

// Without dr-acbf the map of the geofence keeps the vehicle from the hulls.
void test_flights_with_a_geofence_that_keeps_out_of_the_hulls() {
  alula_fence fence = box();
  fence.keep_out = &field();
  alula_stack_config c = indoors();
  c.parts = kPolytope | kGeofence;
  const auto stack = std::make_unique<alula_stack>();
  CHECK(alula_stack_init(stack.get(), &field(), &fence, &c) == ALULA_READY);
  for (std::uint32_t seed = 0; seed < 8; ++seed) {
    const Flown one = fly(stack.get(), seed, true);
    CHECK(one.hull_m > 0 && one.fence_m > 0 && one.refused == 0);
  }
}

void test_a_flight_after_a_reset_is_the_same() {
  const Stack stack = make(indoors());
  const Flown one = fly(stack.get(), 3, true), again = fly(stack.get(), 3, true);
  CHECK(one.hull_m == again.hull_m && one.fence_m == again.fence_m && one.hits == again.hits);
}

}  // namespace

int main() {
  test_the_cascade_flies_the_acceleration();
  test_flights_among_hulls_and_balls_in_a_fence();
  test_flights_with_a_geofence_that_keeps_out_of_the_hulls();
  test_a_flight_after_a_reset_is_the_same();
  return alula_failures == 0 ? 0 : 1;
}
