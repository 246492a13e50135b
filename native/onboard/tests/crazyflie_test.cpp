// The Crazyflie's filter: closed loop at 1 kHz with a worker task, and every outcome.
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <thread>
#include <vector>

#include "box_map.hpp"
#include "check.hpp"
#include "crazyflie_filter.h"

namespace {

using Vector = std::array<double, 3>;
constexpr double kStep = 0.001;
const float kNaN = std::numeric_limits<float>::quiet_NaN();

alula_crazyflie_state state_at(const Vector& p, double yaw = 0, const Vector& v = {}) {
  alula_crazyflie_state s{};
  for (std::size_t i = 0; i < 3; ++i)
    s.position[i] = static_cast<float>(p[i]), s.velocity[i] = static_cast<float>(v[i]);
  s.attitude[0] = static_cast<float>(std::cos(yaw / 2)), s.attitude[3] = static_cast<float>(std::sin(yaw / 2));
  s.variance = 1e-4F;
  return s;
}

alula_crazyflie_request velocity_request(float x, float y, float z) {
  alula_crazyflie_request w{};
  for (auto& mode : w.mode) mode = ALULA_AXIS_VELOCITY;
  w.velocity[0] = x, w.velocity[1] = y, w.velocity[2] = z;
  return w;
}

struct Rig {
  std::vector<std::uint8_t> image = box_map(obstacles());
  alula_crazyflie_config config = alula_crazyflie_defaults();
  alula_crazyflie_filter filter{};
  alula_crazyflie_output out{};
  Vector p{-5.3, -5.3, 1}, v{};
  int step = 0;
  int period = 10;

  explicit Rig(int period_steps = 10) : period(period_steps) {
    config.period_s = static_cast<float>(period_steps) * 0.001F;
    CHECK(alula_crazyflie_open(&filter, image.data(), static_cast<std::uint32_t>(image.size()), &config));
  }
  bool is_due() const { return step % period == 0; }
  // A millisecond of a vehicle that follows its command with the assumed lag.
  void follow(double& x, double& speed, double u) const {
    const double lag = static_cast<double>(config.lag), left = std::exp(-kStep / lag);
    x += kStep * u + lag * (1 - left) * (speed - u);
    speed = u + left * (speed - u);
  }
  // A millisecond of the loop and of the vehicle; the worker runs after it.
  void run(const alula_crazyflie_request& request, const alula_crazyflie_state& state, bool works = true) {
    alula_crazyflie_step(&filter, &request, &state, is_due(), 0.001F, &out);
    for (std::size_t i = 0; i < 3 && out.is_replaced; ++i) follow(p[i], v[i], static_cast<double>(out.velocity[i]));
    if (works) alula_crazyflie_work(&filter);
    ++step;
  }
  void run(const alula_crazyflie_request& request) { run(request, state_at(p, 0, v)); }
  bool is_still() const {
    return out.is_replaced && !out.is_off && out.velocity[0] == 0 && out.velocity[1] == 0 && out.velocity[2] == 0;
  }
};

// Nominal commands of all kinds for a minute: never closer than the radius, and in each period exactly the command of
// the chord filter.
void test_it_flies_the_commands_of_the_chord_filter_and_touches_nothing() {
  for (const int period : {2, 10, 20}) {
    Rig rig(period);
    alula_map map;
    CHECK(alula_map_open(&map, rig.image.data(), static_cast<std::uint32_t>(rig.image.size())) == ALULA_MAP_READY);
    static alula_chord reference;
    alula_polytope_cbf_config same = ALULA_POLYTOPE_CBF_DEFAULTS;
    same.radius_m = rig.config.radius_m, same.beta = rig.config.beta;
    same.dt_s = rig.config.period_s, same.v_max = rig.config.v_max;
    CHECK(alula_chord_open(&reference, &map, ALULA_CRAZYFLIE_EXTENT, &same, rig.config.lag) == ALULA_READY);
    std::mt19937 random(static_cast<unsigned>(period));
    std::uniform_real_distribution<float> unit(-1, 1);
    alula_crazyflie_request request{};
    double yaw = 0, least = 1e9;
    int changed = 0, compared = 0;
    alula_polytope_result expected{};
    bool has_expected = false;
    for (int k = 0; k < 30000; ++k) {
      if (k % 700 == 0) {
        request = velocity_request(1.5F * unit(random), 1.5F * unit(random), 0.3F * unit(random));
        yaw = 3 * static_cast<double>(unit(random));
        request.is_body = k % 1400 == 0;
        if (random() % 3 == 0) {
          for (std::size_t i = 0; i < 3; ++i) {
            request.mode[i] = ALULA_AXIS_POSITION;
            request.position[i] = (i == 2 ? 1.0F : 6.0F) * unit(random);
          }
        } else if (random() % 2 == 0) {
          request.mode[2] = ALULA_AXIS_POSITION, request.position[2] = 1 + unit(random);
        }
      }
      const alula_crazyflie_state state = state_at(rig.p, yaw, rig.v);
      if (rig.is_due() && k > 0) {
        Vector then = rig.p, moving = rig.v;
        rig.run(request, state);
        if (has_expected) {
          ++compared;
          for (int i = 0; i < 3; ++i) CHECK(rig.out.velocity[i] == expected.u[i]);
        }
        // the nominal command, computed independently
        float v[3];
        const double c = std::cos(yaw), s = std::sin(yaw);
        for (std::size_t i = 0; i < 3; ++i) {
          v[i] = request.mode[i] == ALULA_AXIS_POSITION ? 2 * (request.position[i] - state.position[i])
                                                        : request.velocity[i];
        }
        if (request.is_body && request.mode[0] == ALULA_AXIS_VELOCITY) {
          v[0] = static_cast<float>(c * request.velocity[0] - s * request.velocity[1]);
          v[1] = static_cast<float>(s * request.velocity[0] + c * request.velocity[1]);
        }
        // A position setpoint is flown by the controller of PolyMerge, eq. 16: -(c/2)(p - p_goal) with c twice the
        // gain, scaled to the speed limit.
        const bool has_position =
            std::any_of(request.mode, request.mode + 3, [](auto m) { return m == ALULA_AXIS_POSITION; });
        const float size = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        const float scale = has_position && size > rig.config.v_max ? rig.config.v_max / size : 1.0F;
        for (int i = 0; i < 3; ++i) {
          CHECK(std::fabs(rig.filter.nominal[i] - scale * v[i]) < 1e-5F);
          const auto axis = static_cast<std::size_t>(i);
          for (int n = 0; n < period; ++n)
            rig.follow(then[axis], moving[axis], static_cast<double>(rig.out.velocity[i]));
          CHECK(std::fabs(rig.filter.at[i] - static_cast<float>(then[axis])) < 3e-6F);
          CHECK(std::fabs(rig.filter.moving[i] - static_cast<float>(moving[axis])) < 3e-6F);
        }
        const auto status = alula_chord_filter(&reference, rig.filter.at, rig.filter.moving, rig.filter.nominal,
                                               rig.filter.from_the_ground, &expected);
        CHECK(status != ALULA_FILTER_REFUSED);
        changed += status != ALULA_FILTER_OK;
        has_expected = true;
      } else {
        rig.run(request, state);
      }
      least = std::min(least, distance(rig.p));
    }
    CHECK(compared > 30000 / period - 5 && changed > compared / 20);
    CHECK(least >= static_cast<double>(rig.config.radius_m) - 1e-5);
    CHECK(least < static_cast<double>(rig.config.radius_m) + 0.1);
    CHECK(rig.filter.late == 0 && rig.filter.corrections > 0);
    if (std::getenv("ALULA_PRINT")) std::printf("period %2d ms: minimum distance %.4f m of 0.15\n", period, least);
  }
}

// Straight at the wall with a velocity loop that lags by 0.1 s: the radius must cover the effect of the lag.
void test_the_radius_covers_the_lag_of_a_vehicle() {
  Rig rig;
  Vector v{0, 0, 0};
  rig.p = {3.2, 2.6, 1};
  double least = 1e9;
  for (int k = 0; k < 6000; ++k) {
    const Vector before = rig.p;
    alula_crazyflie_state state = state_at(rig.p);
    for (std::size_t i = 0; i < 3; ++i) state.velocity[i] = static_cast<float>(v[i]);
    rig.run(velocity_request(1, 0, 0), state);
    for (std::size_t i = 0; i < 3; ++i) {
      v[i] += kStep / 0.1 * (static_cast<double>(rig.out.velocity[i]) - v[i]);
      rig.p[i] = before[i] + kStep * v[i];
    }
    least = std::min(least, distance(rig.p));
  }
  if (std::getenv("ALULA_PRINT")) std::printf("lag 0.1 s: minimum distance %.4f m of 0.15\n", least);
  CHECK(least >= 0.149 && least < 0.25);
}

void test_without_a_map_or_with_a_damaged_one_nothing_turns() {
  std::vector<std::uint8_t> image = box_map(obstacles());
  const alula_crazyflie_config config = alula_crazyflie_defaults();
  static alula_crazyflie_filter filter;
  alula_crazyflie_output out;
  const alula_crazyflie_request request = velocity_request(1, 0, 0);
  const alula_crazyflie_state state = state_at({-5, -5, 1});
  const auto is_off = [&](std::uint32_t length) {
    const int ready = alula_crazyflie_open(&filter, image.data(), length, &config);
    alula_crazyflie_step(&filter, &request, &state, 1, 0.001F, &out);
    return !ready && out.is_off && !out.is_replaced && out.status == ALULA_CRAZYFLIE_NOT_READY;
  };
  CHECK(is_off(0) && is_off(100));
  image[70] ^= 1;
  CHECK(is_off(static_cast<std::uint32_t>(image.size())));
}

void test_set_points_that_ask_for_nothing_or_for_attitude() {
  Rig rig;
  const alula_crazyflie_request fast = velocity_request(0, 0, 0.5F);
  const auto fly = [&](int count = 30) {
    for (int k = 0; k < count; ++k) rig.run(fast);
    return rig.out.status == ALULA_CRAZYFLIE_OK && rig.out.velocity[2] == 0.5F;
  };
  CHECK(fly());
  alula_crazyflie_request off{};
  rig.run(off);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OFF && !rig.out.is_replaced && !rig.out.is_off);
  CHECK(fly(25));
  off.thrust = 30000;  // by hand
  rig.run(off);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_BAD_WISH && rig.is_still());
  alula_crazyflie_request watchdog = fast;  // the firmware levels when the radio is silent
  watchdog.mode[0] = watchdog.mode[1] = ALULA_AXIS_OFF;
  rig.run(watchdog);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_BAD_WISH && rig.is_still());
  alula_crazyflie_config by_hand = rig.config;
  by_hand.attitude = 1;
  CHECK(alula_crazyflie_configure(&rig.filter, &by_hand));
  rig.run(off);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_UNGUARDED && !rig.out.is_replaced && !rig.out.is_off);
  rig.step = 1;
  rig.run(fast);  // guarded again, with no result yet
  CHECK(rig.out.status == ALULA_CRAZYFLIE_STARTING && rig.is_still());
  by_hand.enabled = 0;
  CHECK(alula_crazyflie_configure(&rig.filter, &by_hand));
  rig.run(fast);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_DISABLED && !rig.out.is_replaced);
}

void test_a_state_or_a_request_that_cannot_be_used_stops_at_once() {
  const alula_crazyflie_request good = velocity_request(0, 0, 0.5F);
  const auto stops_at = [&](int phase, alula_crazyflie_status status, auto spoil) {
    Rig rig;
    for (int k = 0; k < 40 + phase; ++k) rig.run(good);
    CHECK(rig.out.status == ALULA_CRAZYFLIE_OK);
    alula_crazyflie_request request = good;
    alula_crazyflie_state state = state_at(rig.p);
    spoil(request, state);
    rig.run(request, state);
    if (rig.out.status != status || !rig.is_still()) return false;
    for (int k = 0; k < 40; ++k) rig.run(good);  // and continues when it is good again
    return rig.out.status == ALULA_CRAZYFLIE_OK;
  };
  for (const int phase : {0, 3}) {  // where a period begins, and between
    for (const float bad : {kNaN, std::numeric_limits<float>::infinity(), -31.0F}) {
      CHECK(stops_at(phase, ALULA_CRAZYFLIE_BAD_STATE, [&](auto&, auto& s) { s.position[1] = bad; }));
    }
    CHECK(stops_at(phase, ALULA_CRAZYFLIE_BAD_STATE, [&](auto&, auto& s) { s.velocity[2] = kNaN; }));
    for (const float bad : {kNaN, 0.0026F, -1.0F, 0.0F}) {
      CHECK(stops_at(phase, ALULA_CRAZYFLIE_UNCERTAIN, [&](auto&, auto& s) { s.variance = bad; }));
    }
  }
  for (const float bad : {kNaN, std::numeric_limits<float>::infinity(), 2e6F}) {
    CHECK(stops_at(0, ALULA_CRAZYFLIE_BAD_WISH, [&](auto& w, auto&) { w.velocity[1] = bad; }));
    CHECK(stops_at(0, ALULA_CRAZYFLIE_BAD_WISH,
                   [&](auto& w, auto&) { w.mode[0] = ALULA_AXIS_POSITION, w.position[0] = bad; }));
  }
  CHECK(stops_at(0, ALULA_CRAZYFLIE_BAD_WISH, [&](auto& w, auto&) { w.mode[2] = 7; }));
  CHECK(stops_at(0, ALULA_CRAZYFLIE_BAD_STATE, [&](auto& w, auto& s) {
    w.is_body = 1, s.attitude[0] = s.attitude[2] = 0.70710678F;  // the nose straight down: no yaw
  }));
  CHECK(stops_at(0, ALULA_CRAZYFLIE_BAD_STATE, [&](auto& w, auto& s) { w.is_body = 1, s.attitude[1] = kNaN; }));
}

void test_an_estimator_that_stands_still_is_found_and_one_at_rest_is_not() {
  Rig rig;
  const alula_crazyflie_request up = velocity_request(0, 0, 0.5F);
  const alula_crazyflie_state frozen = state_at(rig.p);
  int k = 0;
  for (; k < 200 && rig.out.status != ALULA_CRAZYFLIE_STALE; ++k) rig.run(up, frozen);
  CHECK(k > 50 && k < 80 && rig.is_still());
  for (int i = 0; i < 100; ++i) rig.run(up, frozen);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_STALE);
  for (int i = 0; i < 40; ++i) rig.run(up);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OK);
  for (int i = 0; i < 1000; ++i) rig.run(velocity_request(0, 0, 0));
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OK);
}

void test_work_that_is_not_done_in_time_is_not_flown() {
  Rig rig;
  const alula_crazyflie_request up = velocity_request(0, 0, 0.5F);
  for (int k = 0; k < 50; ++k) rig.run(up);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OK);
  for (int k = 0; k < 11; ++k) rig.run(up, state_at(rig.p, 0, rig.v), false);  // no worker in this period
  CHECK(rig.out.status == ALULA_CRAZYFLIE_LATE && rig.is_still() && rig.filter.late == 1);
  for (int k = 0; k < 9; ++k) rig.run(up);
  rig.run(up);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_STARTING && rig.is_still());  // computed, but for an old position
  for (int k = 0; k < 10; ++k) rig.run(up);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OK && rig.out.velocity[2] == 0.5F);
}

void test_what_was_worked_out_elsewhere_is_not_flown() {
  Rig rig;
  const alula_crazyflie_request up = velocity_request(0, 0, 0.5F);
  for (int k = 0; k < 55; ++k) rig.run(up);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OK);
  rig.p = {5.7, 0, 1};  // flown there by another controller
  alula_crazyflie_restart(&rig.filter);
  for (int k = 0; k < 15; ++k) {
    rig.run(velocity_request(1, 0, 0));
    CHECK(rig.out.status == ALULA_CRAZYFLIE_STARTING && rig.is_still());
  }
  for (int k = 0; k < 40; ++k) rig.run(velocity_request(1, 0, 0));
  CHECK(rig.out.status == ALULA_CRAZYFLIE_FILTERED && rig.out.velocity[0] < 0.5F);
}

void test_parameters_that_mean_nothing_leave_the_last_ones() {
  Rig rig;
  const auto is_refused = [&](auto change) {
    alula_crazyflie_config bad = rig.config;
    change(bad);
    return !alula_crazyflie_configure(&rig.filter, &bad) && rig.filter.config.beta == rig.config.beta &&
           rig.filter.chord.hulls.config.v_max == rig.config.v_max;
  };
  for (const float value : {kNaN, -1.0F, std::numeric_limits<float>::infinity()}) {
    CHECK(is_refused([&](auto& c) { c.radius_m = value; }));
    CHECK(is_refused([&](auto& c) { c.beta = value; }));
    CHECK(is_refused([&](auto& c) { c.lag = value; }));
    CHECK(is_refused([&](auto& c) { c.v_max = value; }));
    CHECK(is_refused([&](auto& c) { c.gain = value; }));
    CHECK(is_refused([&](auto& c) { c.variance = value; }));
    CHECK(is_refused([&](auto& c) { c.period_s = value; }));
  }
  CHECK(is_refused([](auto& c) { c.beta = 101; }));  // above 1 / T
  const alula_crazyflie_request up = velocity_request(0, 0, 0.5F);
  for (int k = 0; k < 45; ++k) rig.run(up);
  alula_crazyflie_config longer = rig.config;
  longer.period_s = 0.02F;
  CHECK(alula_crazyflie_configure(&rig.filter, &longer));
  rig.run(up);
  CHECK(rig.out.status == ALULA_CRAZYFLIE_STARTING && rig.is_still());
}

// The loop and the worker run on two cores at the same time: shared data are handed over without a race.
void test_the_hand_over_has_no_race() {
  Rig rig;
  std::atomic<bool> ends{false};
  std::thread worker([&] {
    while (!ends.load()) {
      if (!alula_crazyflie_work(&rig.filter)) std::this_thread::yield();
    }
  });
  int flown = 0;
  double least = 1e9;
  // On a busy machine the worker may wait for a processor: go on until it has handed over something.
  for (int k = 0; k < 20000 || (flown == 0 && k < 20000000); ++k) {
    rig.run(velocity_request(0.8F, 0.6F, 0), state_at(rig.p, 0, rig.v), false);
    flown += rig.out.velocity[0] != 0;
    least = std::min(least, distance(rig.p));
    if (k % 10 == 0) std::this_thread::yield();
  }
  ends.store(true);
  worker.join();
  CHECK(flown > 0);
  CHECK(least >= static_cast<double>(rig.config.radius_m) - 1e-5);
}

}  // namespace

int main() {
  test_it_flies_the_commands_of_the_chord_filter_and_touches_nothing();
  test_the_radius_covers_the_lag_of_a_vehicle();
  test_without_a_map_or_with_a_damaged_one_nothing_turns();
  test_set_points_that_ask_for_nothing_or_for_attitude();
  test_a_state_or_a_request_that_cannot_be_used_stops_at_once();
  test_an_estimator_that_stands_still_is_found_and_one_at_rest_is_not();
  test_work_that_is_not_done_in_time_is_not_flown();
  test_what_was_worked_out_elsewhere_is_not_flown();
  test_parameters_that_mean_nothing_leave_the_last_ones();
  test_the_hand_over_has_no_race();
  return alula_failures == 0 ? 0 : 1;
}
