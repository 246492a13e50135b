// A field of hulls in a fence, thrown balls and the stack's configuration, for its tests.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <random>
#include <vector>

#include "alula_stack.h"
#include "box_map.hpp"
#include "check.hpp"

using Triple = std::array<double, 3>;

struct Random {
  std::mt19937 bits;
  double operator()(double low, double high) { return low + (high - low) * static_cast<double>(bits()) * 0x1p-32; }
};

inline const alula_map& field() {
  static const std::vector<std::uint8_t> bytes = box_map(obstacles());
  static const alula_map map = [] {
    alula_map opened;
    CHECK(alula_map_open(&opened, bytes.data(), static_cast<std::uint32_t>(bytes.size())) == ALULA_MAP_READY);
    return opened;
  }();
  return map;
}

inline const alula_fence& box() {
  static const alula_fence fence = [] {
    alula_fence made{};
    made.has_box = 1;
    for (int i = 0; i < 3; ++i) made.lower[i] = i < 2 ? -5.5F : 0.0F, made.upper[i] = i < 2 ? 5.5F : 3.5F;
    return made;
  }();
  return fence;
}

inline alula_stack_config indoors() {
  alula_stack_config c = alula_stack_defaults();
  c.extent_m = 20.0F;
  c.polytope_cbf.radius_m = 0.25F;
  return c;
}

using Stack = std::unique_ptr<alula_stack>;

inline Stack make(const alula_stack_config& config) {
  auto stack = std::make_unique<alula_stack>();
  CHECK(alula_stack_init(stack.get(), &field(), &box(), &config) == ALULA_READY);
  return stack;
}

inline alula_stack_input hovering() {
  alula_stack_input in{};
  in.position[0] = 1.7F, in.position[1] = 1.6F, in.position[2] = 1.5F;
  in.nominal[0] = 0.8F;
  return in;
}

inline alula_track ball_at(const Triple& position, const Triple& velocity, std::uint32_t id) {
  alula_track track{};
  track.id = id;
  track.radius_m = 0.12F;
  constexpr int kDiagonal[] = {0, 2, 5, 9, 14, 20};
  for (int i = 0; i < 6; ++i) track.covariance[kDiagonal[i]] = i < 3 ? 1.0e-4F : 1.0e-2F;
  for (std::size_t i = 0; i < 3; ++i) {
    track.position[i] = static_cast<float>(position[i]);
    track.velocity[i] = static_cast<float>(velocity[i]);
  }
  return track;
}
