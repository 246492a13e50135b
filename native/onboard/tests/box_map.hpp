// An onboard map of boxes, for tests: no index, voxels of 0.25 m; and a field of obstacles.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "alula_map.h"

inline constexpr double kBoxMapVoxel = 0.25;
using LatticeBox = std::array<int, 6>;  // lower, upper, in voxels

inline std::vector<std::uint8_t> box_map(const std::vector<LatticeBox>& boxes) {
  std::vector<std::uint8_t> bytes(ALULA_MAP_HEADER_BYTES, 0);
  const auto put = [&](std::size_t at, std::uint64_t value, std::size_t size) {
    for (std::size_t i = 0; i < size; ++i) bytes[at + i] = static_cast<std::uint8_t>(value >> 8 * i & 0xFF);
  };
  const auto crc = [&](std::size_t from, std::size_t to) {
    std::uint32_t rest = 0xFFFFFFFFU;
    for (std::size_t i = from; i < to; ++i) {
      rest ^= bytes[i];
      for (int bit = 0; bit < 8; ++bit) rest = rest >> 1 ^ ((rest & 1U) != 0 ? 0xEDB88320U : 0U);
    }
    return ~rest;
  };
  const auto put_float = [&](std::size_t at, float value) {
    std::uint32_t bits;
    std::memcpy(&bits, &value, 4);
    put(at, bits, 4);
  };
  for (const LatticeBox& box : boxes) {
    const std::size_t at = bytes.size();
    bytes.resize(at + ALULA_MAP_HULL_BYTES, 0);
    for (std::size_t i = 0; i < 6; ++i) put(at + 2 * i, static_cast<std::uint64_t>(box[i]), 2);
  }
  std::memcpy(bytes.data(), "ALMP", 4);
  bytes[4] = 1, bytes[6] = 64, bytes[10] = 1;
  put(12, boxes.size(), 4), put(16, bytes.size(), 4);
  put_float(36, static_cast<float>(kBoxMapVoxel));
  std::uint64_t edge;
  std::memcpy(&edge, &kBoxMapVoxel, 8);
  put(40, edge, 8);
  put_float(48, 64.0F / 262144.0F);
  put(20, crc(64, bytes.size()), 4);
  put(60, crc(0, 60), 4);
  return bytes;
}

// Pillars, a wall and a table in a field of 12 m.
inline std::vector<LatticeBox> obstacles() {
  std::vector<LatticeBox> boxes{{24, -24, -4, 26, 24, 16}, {-2, -2, -4, 2, 2, 3}};
  for (int i = -3; i <= 3; ++i)
    for (int j = -3; j <= 3; ++j)
      if ((i + j) % 2 != 0) boxes.push_back({6 * i, 6 * j, -4, 6 * i + 2, 6 * j + 1 + (i & 1), 16});
  return boxes;
}

inline double distance(const std::array<double, 3>& p) {
  double smallest = 1e9;
  for (const LatticeBox& box : obstacles()) {
    double square = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      const double away = std::max({kBoxMapVoxel * box[i] - p[i], p[i] - kBoxMapVoxel * box[i + 3], 0.0});
      square += away * away;
    }
    smallest = std::min(smallest, std::sqrt(square));
  }
  return smallest;
}
