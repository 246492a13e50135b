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

#include "alula/vec3.hpp"

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

struct RandomStream {
  std::uint64_t seed = 0;
  std::uint32_t trial = 0;

  // Three independent standard normal numbers (Box and Muller, from uniform numbers in (0, 1)).
  geometry::Vec3 normals(std::uint64_t step, std::uint32_t channel) const {
    const Counter bits =
        philox({static_cast<std::uint32_t>(step), static_cast<std::uint32_t>(step >> 32), trial, channel},
               {static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)});
    const auto uniform = [&](std::size_t i) { return (bits[i] + 0.5) * 0x1p-32; };
    const double first = std::sqrt(-2 * std::log(uniform(0))), second = std::sqrt(-2 * std::log(uniform(2)));
    const double turn = 2 * std::numbers::pi * uniform(1);
    return {first * std::cos(turn), first * std::sin(turn), second * std::cos(2 * std::numbers::pi * uniform(3))};
  }
};

}  // namespace alula::flight
