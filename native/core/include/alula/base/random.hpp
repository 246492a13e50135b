// Random numbers that are a function of where they are used, not of how many were drawn before.
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

// Where the channels of those who draw begin; each has all up to the next. Those before are a plant's and its
// sensor's.
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

// The Poisson number of this mean, at most 500, that a uniform number in (0, 1) stands for: the least k with
// P(X <= k) >= u. Twenty deviations above the mean the sum has reached 1 up to rounding, and the search ends.
inline int poisson(double mean, double u) {
  double term = std::exp(-mean), sum = term;
  const int last = static_cast<int>(mean + 20 * std::sqrt(mean) + 20);
  int k = 0;
  while (sum < u && k < last) term *= mean / ++k, sum += term;
  return k;
}

}  // namespace alula::flight
