// The geofence as firmware calls it: for every input, the command is within the limits or refused.
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>

#include "alula_geofence.h"
#include "check.hpp"

namespace {

alula_fence box() {
  alula_fence fence{};
  fence.has_box = 1;
  for (int i = 0; i < 3; ++i) fence.lower[i] = -20.0F, fence.upper[i] = 20.0F;
  return fence;
}

alula_racer_state hovering() {
  alula_racer_state x{};
  x.attitude[0] = 1.0F;
  return x;
}

bool is_in_limits(const alula_racer_command& u, const alula_racer_model& model) {
  bool good = u.throttle >= 0.0F && u.throttle <= 1.0F;
  for (int i = 0; i < 3; ++i) good = good && std::fabs(u.rates[i]) <= model.max_rate[i];
  return good;
}

bool is_nothing(const alula_geofence_result& r) {
  return r.command.throttle == 0.0F && r.command.rates[0] == 0.0F && r.lambda == 0.0F;
}

void test_without_a_filter_or_a_fence_nothing_is_flown() {
  const alula_racer_state x = hovering();
  const alula_racer_command pilot{0.5F, {1.0F, 0.0F, 0.0F}};
  alula_geofence_result result;
  CHECK(alula_geofence_filter(nullptr, &x, &pilot, &result) == ALULA_GEOFENCE_REFUSED && is_nothing(result));
  alula_geofence filter{};
  CHECK(alula_geofence_filter(&filter, &x, &pilot, &result) == ALULA_GEOFENCE_REFUSED && is_nothing(result));
  CHECK(alula_geofence_filter(&filter, &x, &pilot, nullptr) == ALULA_GEOFENCE_REFUSED);
  const alula_geofence_config config = alula_geofence_defaults();
  alula_fence fence = box();
  CHECK(alula_geofence_init(nullptr, &fence, &config) == ALULA_BAD_POINTER);
  CHECK(alula_geofence_init(&filter, nullptr, &config) == ALULA_BAD_POINTER);
  CHECK(alula_geofence_init(&filter, &fence, nullptr) == ALULA_BAD_POINTER);
  fence.upper[1] = -20.0F;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_BAD_PARAMETER);
  const alula_map closed{};
  fence = box();
  fence.keep_out = &closed;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_BAD_MAP);
  CHECK(alula_geofence_filter(&filter, &x, &pilot, &result) == ALULA_GEOFENCE_REFUSED && is_nothing(result));
  fence = box();
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_READY);
  CHECK(alula_geofence_filter(&filter, nullptr, &pilot, &result) == ALULA_GEOFENCE_REFUSED && is_nothing(result));
}

void test_every_number_of_the_parameters_is_checked() {
  const alula_fence fence = box();
  alula_geofence filter;
  const alula_geofence_config good = alula_geofence_defaults();
  CHECK(alula_geofence_init(&filter, &fence, &good) == ALULA_READY);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (std::size_t at = 0; at + sizeof nan <= sizeof good; at += sizeof nan) {
    alula_geofence_config bad = good;
    std::memcpy(reinterpret_cast<char*>(&bad) + at, &nan, sizeof nan);
    CHECK(alula_geofence_init(&filter, &fence, &bad) == ALULA_BAD_PARAMETER);
  }
}

void test_parameters_that_violate_a_condition_are_refused() {
  const alula_fence fence = box();
  alula_geofence filter;
  alula_geofence_conditions found;
  alula_geofence_config config = alula_geofence_defaults();
  CHECK(alula_geofence_examine(&config, &found) == ALULA_READY);
  CHECK(found.rest_m_s < found.most_rest_m_s && found.upright > found.least_upright);
  CHECK(config.beta < found.most_beta);
  config.beta = 1.001F * found.most_beta;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_TOO_LATE);
  const alula_racer_state x = hovering();
  alula_geofence_result result;
  CHECK(alula_geofence_filter(&filter, &x, nullptr, &result) == ALULA_GEOFENCE_REFUSED && is_nothing(result));
  config = alula_geofence_defaults();
  config.steps = 10U;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_NO_REST);
  config = alula_geofence_defaults();
  config.backup.height_gain = config.backup.climb_gain = 0.0F;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_NO_REST);
  CHECK(alula_geofence_examine(nullptr, &found) == ALULA_BAD_POINTER);
  CHECK(alula_geofence_examine(&config, nullptr) == ALULA_BAD_POINTER);
}

// Random bits, and valid inputs with random bits in one position.
void test_for_every_input_the_command_stays_in_its_limits() {
  const alula_fence fence = box();
  const alula_geofence_config config = alula_geofence_defaults();
  alula_geofence filter;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_READY);
  std::mt19937 random(1);
  int flown = 0;
  for (int k = 0; k < 20000; ++k) {
    alula_racer_state x = hovering();
    alula_racer_command u{0.3F, {0.0F, 0.0F, 0.0F}};
    std::uint32_t bits[17];
    for (std::uint32_t& b : bits) b = static_cast<std::uint32_t>(random());
    if (k % 3 == 0) {
      std::memcpy(&x, bits, sizeof x);
      std::memcpy(&u, bits + 13, sizeof u);
    } else {
      std::memcpy(reinterpret_cast<char*>(&x) + 4 * (bits[0] % 13), bits + 1, 4);
      std::memcpy(reinterpret_cast<char*>(&u) + 4 * (bits[2] % 4), bits + 3, 4);
    }
    alula_geofence_result result;
    const alula_geofence_status status =
        alula_geofence_filter(&filter, k % 7 == 0 ? nullptr : &x, k % 11 == 0 ? nullptr : &u, &result);
    CHECK(is_in_limits(result.command, config.model));
    CHECK(result.lambda >= 0.0F && result.lambda <= 1.0F);
    if (status == ALULA_GEOFENCE_PASSED) CHECK(std::memcmp(&result.command, &u, sizeof u) == 0);
    if (status == ALULA_GEOFENCE_REFUSED) {
      CHECK(is_nothing(result));
    } else {
      ++flown;
    }
  }
  CHECK(flown > 10000);
}

// Long steps of a fast turn overflow: a flow without a known end is not safe.
void test_a_flow_that_is_no_number_is_not_safe() {
  std::mt19937 random(1);
  const auto between = [&](float low, float high) {
    return std::uniform_real_distribution<float>(low, high)(random);
  };
  int broken = 0;
  for (int k = 0; k < 2000; ++k) {
    alula_geofence_config config = alula_geofence_defaults();
    config.step_s = between(0.03F, 0.1F);
    config.steps = 20U;
    config.model.rate_gain = std::pow(10.0F, between(0.0F, 3.0F));
    config.backup.attitude_gain = std::pow(10.0F, between(0.0F, 3.0F));
    for (float& rate : config.model.max_rate) rate = between(1.0F, 40.0F);
    alula_fence fence = box();
    for (int i = 0; i < 3; ++i) fence.lower[i] = -9000.0F, fence.upper[i] = 9000.0F;
    // refused, or accepted and still not safe: the parameters are put into a filter that was made with good ones
    alula_geofence filter;
    const alula_geofence_config good = alula_geofence_defaults();
    const alula_status made = alula_geofence_init(&filter, &fence, &config);
    CHECK(made == ALULA_READY || made == ALULA_NO_REST || made == ALULA_TOO_LATE);
    CHECK(alula_geofence_init(&filter, &fence, &good) == ALULA_READY);
    filter.config = config;
    filter.fine = alula_racer_step_of(&config.model, config.step_s);
    filter.coarse = alula_racer_step_of(&config.model, 2.0F * config.step_s);
    alula_racer_state x = hovering();
    for (float& rate : x.rates) rate = between(-100.0F, 100.0F);
    const alula_backup_hold hold = alula_geofence_hold(&filter, &x);
    alula_geofence_value value;
    alula_geofence_evaluate(&filter, &x, &hold, 0.0F, &value);
    if (std::isfinite(value.end) && std::isfinite(value.margin_m)) continue;
    ++broken;
    CHECK(value.h_i == -FLT_MAX);
  }
  CHECK(broken > 100);
}

void test_reset_forgets() {
  const alula_fence fence = box();
  const alula_geofence_config config = alula_geofence_defaults();
  alula_geofence filter;
  CHECK(alula_geofence_init(&filter, &fence, &config) == ALULA_READY);
  const alula_racer_state x = hovering();
  const alula_racer_command u{0.4F, {0.0F, 1.0F, 0.0F}};
  alula_geofence_result first, again;
  CHECK(alula_geofence_filter(&filter, &x, &u, &first) != ALULA_GEOFENCE_REFUSED);
  CHECK(alula_geofence_filter(&filter, nullptr, nullptr, &again) == ALULA_GEOFENCE_NO_PILOT);
  alula_geofence_reset(&filter);
  CHECK(alula_geofence_filter(&filter, nullptr, &u, &again) == ALULA_GEOFENCE_REFUSED);
  CHECK(alula_geofence_filter(&filter, &x, &u, &again) != ALULA_GEOFENCE_REFUSED);
  CHECK(std::memcmp(&first, &again, sizeof first) == 0);
}

}  // namespace

int main() {
  test_without_a_filter_or_a_fence_nothing_is_flown();
  test_every_number_of_the_parameters_is_checked();
  test_parameters_that_violate_a_condition_are_refused();
  test_for_every_input_the_command_stays_in_its_limits();
  test_a_flow_that_is_no_number_is_not_safe();
  test_reset_forgets();
  return alula_failures == 0 ? 0 : 1;
}
