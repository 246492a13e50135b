// Counter-based random numbers: a function of where they are used, not of how many were drawn before.
//
// Philox 4x32-10: ten rounds on the counter (step low, step high, trial, channel) with the seed as key.
// The same (seed, trial, step, channel) gives the same numbers on any thread and in any order.
// Source: Salmon, Moraes, Dror and Shaw 2011.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "alula/geometry/vec3.hpp"

namespace alula::flight {

using Counter = std::array<std::uint32_t, 4>;

inline Counter philox(Counter counter, std::array<std::uint32_t, 2> key) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t a = std::uint64_t{0xD2511F53} * counter[0], b = std::uint64_t{0xCD9E8D57} * counter[2];
    counter = {static_cast<std::uint32_t>(b >> 32) ^ counter[1] ^ key[0], static_cast<std::uint32_t>(b),
               static_cast<std::uint32_t>(a >> 32) ^ counter[3] ^ key[1], static_cast<std::uint32_t>(a)};
    key[0] += 0x9E3779B9, key[1] += 0xBB67AE85;
  }
  return counter;
}

// First channel of each user of random numbers; each user has all channels up to the next. The channels before the
// first belong to the plant and its sensor.
namespace channel {
inline constexpr std::uint32_t kObstacle = 0x1000'0000, kDetection = 0x2000'0000, kClutter = 0x3000'0000,
                               kOwnState = 0x4000'0000;
}

struct RandomStream {
  std::uint64_t seed = 0;
  std::uint32_t trial = 0;

  // Four independent uniform numbers in (0, 1), multiples of 2^-33.
  std::array<double, 4> uniforms(std::uint64_t step, std::uint32_t channel) const {
    const Counter bits =
        philox({static_cast<std::uint32_t>(step), static_cast<std::uint32_t>(step >> 32), trial, channel},
               {static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)});
    std::array<double, 4> result;
    for (std::size_t i = 0; i < 4; ++i) result[i] = (bits[i] + 0.5) * 0x1p-32;
    return result;
  }

  // Three independent standard normal numbers (Box and Muller, from uniform numbers).
  geometry::Vec3 normals(std::uint64_t step, std::uint32_t channel) const {
    const std::array<double, 4> u = uniforms(step, channel);
    const double first = std::sqrt(-2 * std::log(u[0])), second = std::sqrt(-2 * std::log(u[2]));
    const double turn = 2 * std::numbers::pi * u[1];
    return {first * std::cos(turn), first * std::sin(turn), second * std::cos(2 * std::numbers::pi * u[3])};
  }
};

// Poisson quantile for a mean of at most 500 and a uniform number u in (0, 1): the smallest k with P(X <= k) >= u.
// The search ends twenty standard deviations above the mean, where the sum has reached 1 up to rounding.
inline int poisson(double mean, double u) {
  double term = std::exp(-mean), sum = term;
  const int last = static_cast<int>(mean + 20 * std::sqrt(mean) + 20);
  int k = 0;
  while (sum < u && k < last) term *= mean / ++k, sum += term;
  return k;
}

}  // namespace alula::flight
