// The Crazyflie's filter built for a fence and moving obstacles: reports in, and a vehicle that lags among thrown
// balls.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <memory>
#include <random>
#include <vector>

#include "box_map.hpp"
#include "check.hpp"
#include "crazyflie_filter.h"

namespace {

using Vector = std::array<double, 3>;
constexpr double kStep = 0.001, kBall = 0.12, kBody = 0.1;
const float kNan = std::numeric_limits<float>::quiet_NaN();

alula_crazyflie_obstacle report_of(std::uint8_t id, const Vector& p, const Vector& v) {
  alula_crazyflie_obstacle o{};
  o.id = id, o.radius_m = static_cast<float>(kBall);
  for (std::size_t i = 0; i < 3; ++i)
    o.position[i] = static_cast<float>(p[i]), o.velocity[i] = static_cast<float>(v[i]);
  return o;
}

struct Rig {
  std::vector<std::uint8_t> image = box_map(obstacles());
  alula_crazyflie_config config = alula_crazyflie_defaults();
  std::unique_ptr<alula_crazyflie_filter> filter = std::make_unique<alula_crazyflie_filter>();
  alula_crazyflie_output out{};
  alula_crazyflie_request request{};
  Vector p{-5.3, -5.3, 1}, v{};
  int step = 0;

  Rig() {
    config.fenced = 1;
    for (int i = 0; i < 3; ++i) config.lower[i] = i < 2 ? -6.0F : 0.4F, config.upper[i] = i < 2 ? 6.0F : 2.5F;
    CHECK(alula_crazyflie_open(filter.get(), image.data(), static_cast<std::uint32_t>(image.size()), &config));
    for (auto& mode : request.mode) mode = ALULA_AXIS_VELOCITY;
  }
  void run() {
    alula_crazyflie_state state{};
    for (std::size_t i = 0; i < 3; ++i)
      state.position[i] = static_cast<float>(p[i]), state.velocity[i] = static_cast<float>(v[i]);
    state.attitude[0] = 1.0F, state.variance = 1e-4F;
    alula_crazyflie_step(filter.get(), &request, &state, step % 10 == 0, 0.001F, &out);
    CHECK(out.is_replaced);
    const double lag = static_cast<double>(config.lag), left = std::exp(-kStep / lag);
    for (std::size_t i = 0; i < 3; ++i) {
      const double u = static_cast<double>(out.velocity[i]);
      p[i] += kStep * u + lag * (1 - left) * (v[i] - u);
      v[i] = u + left * (v[i] - u);
    }
    alula_crazyflie_work(filter.get());
    ++step;
  }
};

void test_reports_are_taken_moved_and_forgotten() {
  Rig rig;
  alula_crazyflie_filter* filter = rig.filter.get();
  const alula_crazyflie_obstacle nobody = report_of(0, {1, 1, 1}, {});
  CHECK(alula_crazyflie_report(filter, &nobody) == 0);
  for (const float bad : {kNan, 1e9F, -std::numeric_limits<float>::infinity()}) {
    for (int word = 0; word < 7; ++word) {
      alula_crazyflie_obstacle o = report_of(3, {1, 1, 1}, {});
      (word < 3 ? o.position[word] : word < 6 ? o.velocity[word - 3] : o.radius_m) = bad;
      CHECK(alula_crazyflie_report(filter, &o) == 0);
    }
  }
  CHECK(filter->track_count == 0);
  for (std::uint8_t id = 1; id <= ALULA_CRAZYFLIE_OBSTACLES; ++id) {
    const alula_crazyflie_obstacle o = report_of(id, {20, 0, 1}, {0.5, 0, 0});
    CHECK(alula_crazyflie_report(filter, &o) && filter->track_count == id);
  }
  alula_crazyflie_obstacle o = report_of(200, {20, 0, 1}, {});
  CHECK(alula_crazyflie_report(filter, &o) == 0); /* too many */
  for (int k = 0; k < 500; ++k) rig.run();
  CHECK(std::abs(filter->track[0].position[0] - 20.25F) < 0.01F);
  o = report_of(2, {21, 0, 1}, {});
  CHECK(alula_crazyflie_report(filter, &o) && filter->track_count == ALULA_CRAZYFLIE_OBSTACLES);
  for (int k = 0; k < 600; ++k) rig.run();
  CHECK(filter->track_count == 1 && filter->track[0].id == 2 && filter->track[0].position[0] == 21.0F);
}

void test_refused_parameters_keep_the_last_ones() {
  Rig rig;
  alula_crazyflie_config bad = rig.config;
  bad.v_max = 1.2F; /* 2 v_max / lag > 6 m/s^2 */
  CHECK(!alula_crazyflie_configure(rig.filter.get(), &bad));
  bad = rig.config, bad.lower[0] = 7.0F;
  CHECK(!alula_crazyflie_configure(rig.filter.get(), &bad));
  rig.request.velocity[0] = 0.5F;
  for (int k = 0; k < 50; ++k) rig.run();
  CHECK(rig.out.status == ALULA_CRAZYFLIE_OK);
}

// Balls thrown at the vehicle every two seconds, reported 20 times a second or not at all; hits.
int fly(bool has_reports, int* thrown) {
  Rig rig;
  std::mt19937 bits(5);
  const auto random = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(bits()) * 0x1p-32;
  };
  Vector ball{}, way{};
  int hits = 0;
  bool is_hit = true;
  for (int k = 0; k < 60000; ++k) {
    if (k % 3000 == 0)
      for (int i = 0; i < 3; ++i) rig.request.velocity[i] = static_cast<float>(random(-0.6, 0.6));
    if (k % 2000 == 1000) {
      const double heading = random(0, 6.28), time = 4 / random(3, 5);
      const Vector from{4 * std::cos(heading), 4 * std::sin(heading), 0.5};
      for (std::size_t i = 0; i < 3; ++i) {
        ball[i] = rig.p[i] + from[i];
        way[i] = (0.5 * time * rig.v[i] - from[i]) / time;
      }
      is_hit = false, ++*thrown;
    }
    for (std::size_t i = 0; i < 3; ++i) ball[i] += kStep * way[i];
    if (has_reports && *thrown > 0 && k % 50 == 0) {
      const alula_crazyflie_obstacle o = report_of(static_cast<std::uint8_t>(1 + *thrown % 200), ball, way);
      (void)!alula_crazyflie_report(rig.filter.get(), &o);
    }
    rig.run();
    double square = 0;
    for (std::size_t i = 0; i < 3; ++i) square += (ball[i] - rig.p[i]) * (ball[i] - rig.p[i]);
    if (!is_hit && square < (kBall + kBody) * (kBall + kBody)) is_hit = true, ++hits;
    CHECK(distance(rig.p) >= 0.15 - 1e-4);
    for (std::size_t i = 0; i < 3; ++i) {
      CHECK(rig.p[i] >= static_cast<double>(rig.config.lower[i]) + 0.15 - 1e-4);
      CHECK(rig.p[i] <= static_cast<double>(rig.config.upper[i]) - 0.15 + 1e-4);
    }
  }
  return hits;
}

void test_reported_balls_are_dodged_and_hulls_and_box_are_kept_at_the_radius() {
  int thrown = 0, unseen = 0;
  const int hits = fly(true, &thrown), without = fly(false, &unseen);
  std::printf("crazyflie: %d of %d balls hit, without reports %d of %d\n", hits, thrown, without, unseen);
  CHECK(thrown == 30 && unseen == 30 && without > 8 && 4 * hits < without);
}

}  // namespace

int main() {
  test_reports_are_taken_moved_and_forgotten();
  test_refused_parameters_keep_the_last_ones();
  test_reported_balls_are_dodged_and_hulls_and_box_are_kept_at_the_radius();
  return alula_failures == 0 ? 0 : 1;
}
