// Sticks and commands as firmware maps them: every input gives a valid pulse or is refused.
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>

#include "alula_rates.h"
#include "check.hpp"

namespace {

bool are(const std::uint16_t* channels, unsigned low, unsigned high) {
  for (int i = 0; i < ALULA_CHANNELS; ++i)
    if (channels[i] < low || channels[i] > high) return false;
  return true;
}

bool is_nothing(const alula_racer_command& u) {
  return u.throttle == 0.0F && u.rates[0] == 0.0F && u.rates[1] == 0.0F && u.rates[2] == 0.0F;
}

void test_without_pointers_there_are_no_pulses() {
  const alula_rates rates = alula_rates_defaults();
  const alula_racer_command command{0.5F, {1.0F, 2.0F, 3.0F}};
  alula_racer_command back{1.0F, {1.0F, 1.0F, 1.0F}};
  std::uint16_t channels[ALULA_CHANNELS] = {1500, 1500, 1500, 1500};
  CHECK(alula_rates_check(nullptr) == ALULA_BAD_POINTER && alula_rates_check(&rates) == ALULA_READY);
  CHECK(alula_rates_command(nullptr, channels, &back) == ALULA_BAD_POINTER && is_nothing(back));
  CHECK(alula_rates_command(&rates, nullptr, &back) == ALULA_BAD_POINTER && is_nothing(back));
  CHECK(alula_rates_command(&rates, channels, nullptr) == ALULA_BAD_POINTER);
  CHECK(alula_rates_channels(&rates, &command, nullptr) == ALULA_BAD_POINTER);
  CHECK(alula_rates_channels(nullptr, &command, channels) == ALULA_BAD_POINTER && are(channels, 0, 0));
  channels[0] = 1500;
  CHECK(alula_rates_channels(&rates, nullptr, channels) == ALULA_BAD_POINTER && are(channels, 0, 0));
}

float any_float(std::mt19937& random) { return std::bit_cast<float>(static_cast<std::uint32_t>(random())); }

void test_any_bits_are_pulses_or_refused() {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  for (int n = 0; n < 20000; ++n) {
    alula_rates rates = alula_rates_defaults();
    for (alula_rates_axis& a : rates.axis) a = {0.01F + 2.54F * unit(random), unit(random), unit(random)};
    CHECK(alula_rates_check(&rates) == ALULA_READY);
    const alula_racer_command command{any_float(random), {any_float(random), any_float(random), any_float(random)}};
    std::uint16_t channels[ALULA_CHANNELS];
    alula_racer_command back;
    if (alula_rates_channels(&rates, &command, channels) == ALULA_READY) {
      CHECK(alula_racer_command_is_finite(&command) && are(channels, 1000, 2000));
      CHECK(alula_rates_command(&rates, channels, &back) == ALULA_READY && alula_racer_command_is_finite(&back));
      for (int i = 0; i < 3; ++i) CHECK(command.rates[i] * back.rates[i] >= 0.0F);
    } else {
      CHECK(!alula_racer_command_is_finite(&command) && are(channels, 0, 0));
      CHECK(alula_rates_command(&rates, channels, &back) == ALULA_BAD_INPUT && is_nothing(back));
    }
  }
}

void test_any_pulses_are_commands_in_the_limits_or_refused() {
  std::mt19937 random(2);
  const alula_rates rates = alula_rates_defaults();
  const float full = alula_rates_at(&rates.axis[0], 1.0F);
  for (int n = 0; n < 20000; ++n) {
    std::uint16_t channels[ALULA_CHANNELS];
    for (std::uint16_t& c : channels) c = static_cast<std::uint16_t>(n % 2 ? random() : 885 + random() % 1231);
    alula_racer_command u;
    if (alula_rates_command(&rates, channels, &u) == ALULA_READY) {
      CHECK(are(channels, ALULA_RATES_SHORTEST, ALULA_RATES_LONGEST));
      CHECK(u.throttle >= 0.0F && u.throttle <= 1.0F);
      for (const float r : u.rates) CHECK(std::fabs(r) <= full);
    } else {
      CHECK(!are(channels, ALULA_RATES_SHORTEST, ALULA_RATES_LONGEST) && is_nothing(u));
    }
  }
}

void test_profiles_of_any_bits_never_pass_unchecked() {
  std::mt19937 random(3);
  for (int n = 0; n < 20000; ++n) {
    alula_rates rates = alula_rates_defaults();
    float* numbers[] = {&rates.axis[n % 3].rc_rate, &rates.axis[n % 3].super_rate, &rates.axis[n % 3].expo,
                        &rates.middle_us,           &rates.throttle_low_us,        &rates.throttle_high_us};
    float& changed = *numbers[random() % 6];
    changed = any_float(random);
    if (alula_rates_check(&rates) != ALULA_READY) continue;
    CHECK(std::isfinite(changed));
    const alula_racer_command most{1.0F, {1000.0F, -1000.0F, 1000.0F}};
    std::uint16_t channels[ALULA_CHANNELS];
    CHECK(alula_rates_channels(&rates, &most, channels) == ALULA_READY);
    CHECK(are(channels, ALULA_RATES_SHORTEST, ALULA_RATES_LONGEST));
  }
}

}  // namespace

int main() {
  test_without_pointers_there_are_no_pulses();
  test_any_bits_are_pulses_or_refused();
  test_any_pulses_are_commands_in_the_limits_or_refused();
  test_profiles_of_any_bits_never_pass_unchecked();
  return alula_failures == 0 ? 0 : 1;
}
