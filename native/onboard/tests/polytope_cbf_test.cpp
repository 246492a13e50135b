// The onboard filter as firmware calls it: refused inputs, and a flight past a block that stays clear.
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "alula_polytope_cbf.h"
#include "check.hpp"

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// The unit cube with planes slightly outward, like a map in flash.
constexpr std::array<float, 24> kPlane{1, 0,  0, 1.0001F, -1, 0, 0, 0.0001F, 0, 1, 0,  1.0001F,
                                       0, -1, 0, 0.0001F, 0,  0, 1, 1.0001F, 0, 0, -1, 0.0001F};
constexpr std::array<std::uint32_t, 2> kStart{0, 6};
constexpr std::array<float, 3> kLower{-0.0001F, -0.0001F, -0.0001F}, kUpper{1.0001F, 1.0001F, 1.0001F};

alula_polytope_map cube() {
  return {.plane = kPlane.data(),
          .plane_start = kStart.data(),
          .lower = kLower.data(),
          .upper = kUpper.data(),
          .hull_count = 1,
          .extent_m = 10,
          .slack_m = 1e-4F};
}

alula_polytope_cbf_config config() {
  return {.radius_m = 0.1F,
          .beta = 2,
          .kappa = 100,
          .dt_s = 0.01F,
          .v_max = 1,
          .smoothing = ALULA_SMOOTHING_SOUND,
          .brute_force = 0};
}

template <class Change>
alula_status init_with(Change change) {
  alula_polytope_map map = cube();
  alula_polytope_cbf_config parameters = config();
  change(map, parameters);
  alula_polytope_cbf cbf;
  return alula_polytope_cbf_init(&cbf, &map, &parameters);
}

void test_init_refuses_what_it_cannot_use() {
  using Map = alula_polytope_map;
  using Config = alula_polytope_cbf_config;
  CHECK(init_with([](Map&, Config&) {}) == ALULA_READY);
  CHECK(init_with([](Map& m, Config&) { m.plane = nullptr; }) == ALULA_BAD_POINTER);
  CHECK(init_with([](Map& m, Config&) { m.plane_start = nullptr; }) == ALULA_BAD_POINTER);
  CHECK(init_with([](Map& m, Config&) { m.upper = nullptr; }) == ALULA_BAD_POINTER);
  CHECK(init_with([](Map& m, Config&) { m.extent_m = kInfinity; }) == ALULA_BAD_MAP);
  CHECK(init_with([](Map& m, Config&) { m.slack_m = kNan; }) == ALULA_BAD_MAP);
  CHECK(init_with([](Map& m, Config&) { m.hull_count = ALULA_MAX_PLANES + 1; }) == ALULA_BAD_MAP);
  static std::array<float, 24> damaged = kPlane;
  damaged[7] = kNan;
  CHECK(init_with([](Map& m, Config&) { m.plane = damaged.data(); }) == ALULA_BAD_MAP);
  static const std::array<std::uint32_t, 2> empty{0, 0}, shifted{1, 6};
  CHECK(init_with([](Map& m, Config&) { m.plane_start = empty.data(); }) == ALULA_BAD_MAP);
  CHECK(init_with([](Map& m, Config&) { m.plane_start = shifted.data(); }) == ALULA_BAD_MAP);
  for (const float bad : {kNan, kInfinity, -1.0F}) {
    CHECK(init_with([=](Map&, Config& c) { c.radius_m = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init_with([=](Map&, Config& c) { c.beta = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init_with([=](Map&, Config& c) { c.kappa = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init_with([=](Map&, Config& c) { c.dt_s = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init_with([=](Map&, Config& c) { c.v_max = bad; }) == ALULA_BAD_PARAMETER);
  }
  CHECK(init_with([](Map&, Config& c) { c.beta = 100.1F; }) == ALULA_BAD_PARAMETER);  // beta dt > 1
  CHECK(init_with([](Map&, Config& c) { c.kappa = std::numeric_limits<float>::denorm_min(); }) ==
        ALULA_BAD_PARAMETER);
  CHECK(alula_polytope_cbf_init(nullptr, nullptr, nullptr) == ALULA_BAD_POINTER);
}

void test_filter_refuses_without_a_command() {
  const alula_polytope_map map = cube();
  const alula_polytope_cbf_config parameters = config();
  alula_polytope_cbf cbf;
  CHECK(alula_polytope_cbf_init(&cbf, &map, &parameters) == ALULA_READY);
  const float good[3] = {3, 3, 3};
  alula_polytope_result result;
  for (const float bad : {kNan, kInfinity, -kInfinity, 3e38F}) {
    for (int axis = 0; axis < 3; ++axis) {
      float x[3] = {3, 3, 3};
      x[axis] = bad;
      CHECK(alula_polytope_cbf_filter(&cbf, x, good, &result) == ALULA_FILTER_REFUSED);
      CHECK(result.u[0] == 0 && result.u[1] == 0 && result.u[2] == 0);
      if (std::isfinite(bad)) continue;
      CHECK(alula_polytope_cbf_filter(&cbf, good, x, &result) == ALULA_FILTER_REFUSED);
      CHECK(result.u[0] == 0 && result.u[1] == 0 && result.u[2] == 0);
    }
  }
  CHECK(alula_polytope_cbf_filter(nullptr, good, good, &result) == ALULA_FILTER_REFUSED);
  CHECK(alula_polytope_cbf_filter(&cbf, nullptr, good, &result) == ALULA_FILTER_REFUSED);
  CHECK(alula_polytope_cbf_filter(&cbf, good, good, nullptr) == ALULA_FILTER_REFUSED);
  alula_polytope_value value;
  CHECK(alula_polytope_cbf_evaluate(&cbf, good, nullptr) == ALULA_BAD_POINTER);
  CHECK(alula_polytope_cbf_evaluate(&cbf, good, &value) == ALULA_READY && value.nearest == 0);
}

void test_flight_at_a_wall_stops_before_it() {
  const alula_polytope_map map = cube();
  const alula_polytope_cbf_config parameters = config();
  alula_polytope_cbf cbf;
  CHECK(alula_polytope_cbf_init(&cbf, &map, &parameters) == ALULA_READY);
  float x[3] = {-2, 0.5F, 0.5F};
  const float u_nom[3] = {1, 0, 0};
  alula_polytope_result result;
  for (int step = 0; step < 1000; ++step) {
    const auto status = alula_polytope_cbf_filter(&cbf, x, u_nom, &result);
    CHECK(status != ALULA_FILTER_REFUSED && status != ALULA_FILTER_RECOVERING);
    CHECK(step > 0 || (status == ALULA_FILTER_OK && result.u[0] == 1.0F));
    for (int i = 0; i < 3; ++i) x[i] += result.u[i] * parameters.dt_s;
    CHECK(x[0] <= -0.1F);
  }
  CHECK(x[0] > -0.15F);  // log(6) / kappa = 1.8 cm of smoothing
}

void test_exponential_and_logarithm_at_their_edges() {
  CHECK(alula_expf(0) == 1.0F && alula_expf(-0.0F) == 1.0F && alula_logf(1) == 0.0F);
  CHECK(alula_expf(-kInfinity) == 0.0F && alula_expf(kInfinity) == kInfinity && std::isnan(alula_expf(kNan)));
  CHECK(alula_logf(0) == -kInfinity && std::isnan(alula_logf(-1)) && std::isnan(alula_logf(kNan)));
  CHECK(std::isfinite(alula_expf(88.722F)) && alula_expf(88.73F) == kInfinity);
  CHECK(std::abs(alula_logf(std::numeric_limits<float>::denorm_min()) + 103.27893F) < 1e-4F);
}

}  // namespace

int main() {
  test_init_refuses_what_it_cannot_use();
  test_filter_refuses_without_a_command();
  test_flight_at_a_wall_stops_before_it();
  test_exponential_and_logarithm_at_their_edges();
  return alula_failures == 0 ? 0 : 1;
}
