// polytope-cbf on images in memory of exactly their size: mutated before and after they are opened.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "alula.h"
#include "check.hpp"

namespace {

using Bytes = std::vector<std::uint8_t>;
constexpr int kHulls = 23, kLeaf = 4;

struct Random {
  std::uint64_t state;
  std::uint32_t operator()(std::uint32_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return static_cast<std::uint32_t>(state >> 33) % below;
  }
};

std::uint32_t crc32_bitwise(const std::uint8_t* data, std::size_t length) {
  std::uint32_t crc = 0xFFFFFFFFu;
  for (std::size_t i = 0; i < length; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ ((crc & 1u) != 0 ? 0xEDB88320u : 0u);
  }
  return ~crc;
}

void put(Bytes& bytes, std::size_t at, std::uint64_t value, std::size_t size) {
  for (std::size_t i = 0; i < size; ++i) bytes[at + i] = static_cast<std::uint8_t>(value >> 8 * i & 0xFF);
}

void append(Bytes& bytes, std::int64_t value, std::size_t size) {
  bytes.resize(bytes.size() + size);
  put(bytes, bytes.size() - size, static_cast<std::uint64_t>(value), size);
}

void put_float(Bytes& bytes, std::size_t at, float value) {
  std::uint32_t bits;
  std::memcpy(&bits, &value, 4);
  put(bytes, at, bits, 4);
}

void seal(Bytes& bytes) {
  put(bytes, 20, crc32_bitwise(bytes.data() + 64, bytes.size() - 64), 4);
  put(bytes, 60, crc32_bitwise(bytes.data(), 60), 4);
}

struct Box {
  int corner[6];
  void grow(const Box& other) {
    for (int i = 0; i < 3; ++i) {
      corner[i] = std::min(corner[i], other.corner[i]);
      corner[3 + i] = std::max(corner[3 + i], other.corner[3 + i]);
    }
  }
};

// Boxes in a row, each with two edges cut off, and the index over them. Voxels of 0.25 m.
Bytes image() {
  Bytes bytes(64, 0);
  std::vector<Box> below;
  std::vector<std::size_t> start;
  for (int h = 0; h < kHulls; ++h) {
    below.push_back({{6 * h - 60, h % 3, 0, 6 * h - 56, h % 3 + 5, 4 + h % 2}});
    start.push_back(bytes.size());
    for (const int c : below.back().corner) append(bytes, c, 2);
    append(bytes, 2, 1), append(bytes, 0, 1);
    for (const int sign : {1, -1})
      append(bytes, sign, 1), append(bytes, 1, 1), append(bytes, 0, 1), append(bytes, 2, 2);
  }
  const std::size_t head = bytes.size();
  append(bytes, kLeaf, 1), append(bytes, 0, 3);
  int levels = 0;
  for (std::size_t width = kLeaf; levels == 0 || below.size() > 1; width = 4, ++levels) {
    std::vector<Box> level;
    for (std::size_t i = 0; i < below.size(); ++i) {
      if (i % width == 0) level.push_back(below[i]);
      level.back().grow(below[i]);
    }
    for (const Box& box : level)
      for (const int c : box.corner) append(bytes, c, 2);
    below = level;
  }
  bytes[head + 1] = static_cast<std::uint8_t>(levels);
  for (std::size_t h = 0; h < start.size(); h += kLeaf) append(bytes, static_cast<std::int64_t>(start[h]), 4);
  std::memcpy(bytes.data(), "ALMP", 4);
  bytes[4] = 1, bytes[6] = 64, bytes[8] = ALULA_MAP_INDEXED, bytes[10] = 1, bytes[12] = kHulls;
  put(bytes, 16, bytes.size(), 4);
  put_float(bytes, 36, 0.25F), put(bytes, 40, 0x3FD0000000000000u, 8);
  put_float(bytes, 48, 32.0F / 262144.0F);
  seal(bytes);
  return bytes;
}

constexpr alula_polytope_cbf_config kConfig{.radius_m = 0.1F,
                                            .beta = 5,
                                            .kappa = 60,
                                            .dt_s = 0.1F,
                                            .v_max = 2,
                                            .smoothing = ALULA_SMOOTHING_SOUND,
                                            .brute_force = 0};

// Flies some ticks; every command is finite and within the limit, and zero when it is refused.
int fly(alula_polytope_cbf& cbf, Random& random) {
  int refused = 0;
  for (int tick = 0; tick < 4; ++tick) {
    float x[3], u[3];
    for (int i = 0; i < 3; ++i) {
      x[i] = static_cast<float>(random(4000)) * 0.01F - 20;
      u[i] = static_cast<float>(random(400)) * 0.01F - 2;
    }
    x[1] *= 0.1F, x[2] *= 0.1F;
    alula_polytope_result result;
    const auto status = alula_polytope_cbf_filter(&cbf, x, u, &result);
    const float square = result.u[0] * result.u[0] + result.u[1] * result.u[1] + result.u[2] * result.u[2];
    CHECK(square <= 4.0001F);
    CHECK(status != ALULA_FILTER_REFUSED || square == 0.0F);
    refused += status == ALULA_FILTER_REFUSED;
  }
  return refused;
}

void test_the_image_is_one() {
  const Bytes bytes = image();
  alula_map map;
  CHECK(alula_map_open(&map, bytes.data(), static_cast<std::uint32_t>(bytes.size())) == ALULA_MAP_READY);
  CHECK(map.hull_count == kHulls && map.leaf_hulls == kLeaf && map.level_count == 3 && map.level_size[1] == 2);
  static alula_polytope_cbf cbf;
  CHECK(alula_polytope_cbf_open(&cbf, &map, 25, &kConfig) == ALULA_READY);
  CHECK(alula_polytope_cbf_open(&cbf, &map, NAN, &kConfig) == ALULA_BAD_PARAMETER);
  CHECK(alula_polytope_cbf_open(&cbf, nullptr, 25, &kConfig) == ALULA_BAD_POINTER);
  CHECK(alula_polytope_cbf_open(&cbf, &map, 25, &kConfig) == ALULA_READY);
  const float x[3] = {-14.5F, 0.5F, -1.0F}, down[3] = {0, 0, 1};
  alula_polytope_result result;
  CHECK(alula_polytope_cbf_filter(&cbf, x, down, &result) == ALULA_FILTER_OK && result.active == 0);
  CHECK(result.hard_margin_m <= 0.9F && result.hard_margin_m > 0.899F);
}

void test_mutated_before_it_is_opened() {
  const Bytes good = image();
  Random random{1};
  int taken = 0;
  for (int turn = 0; turn < 20000; ++turn) {
    Bytes bad = good;
    for (std::uint32_t n = random(3) + 1; n > 0; --n)
      bad[8 + random(static_cast<std::uint32_t>(bad.size()) - 8)] = static_cast<std::uint8_t>(random(256));
    if (random(8) == 0) bad.resize(64 + random(static_cast<std::uint32_t>(bad.size()) - 64));
    if (random(4) != 0) put(bad, 16, bad.size(), 4);
    seal(bad);
    alula_map map;
    if (alula_map_open(&map, bad.data(), static_cast<std::uint32_t>(bad.size())) != ALULA_MAP_READY) continue;
    static alula_polytope_cbf cbf;
    if (alula_polytope_cbf_open(&cbf, &map, 25, &kConfig) != ALULA_READY) continue;
    ++taken;
    (void)fly(cbf, random);
  }
  CHECK(taken > 100);
}

// The flash changes while the filter runs: wrong results cannot be detected, but nothing is read or written outside.
void test_mutated_after_it_is_opened() {
  const Bytes good = image();
  Random random{2};
  int refused = 0;
  for (int turn = 0; turn < 5000; ++turn) {
    Bytes own = good;
    alula_map map;
    CHECK(alula_map_open(&map, own.data(), static_cast<std::uint32_t>(own.size())) == ALULA_MAP_READY);
    static alula_polytope_cbf cbf;
    CHECK(alula_polytope_cbf_open(&cbf, &map, 25, &kConfig) == ALULA_READY);
    for (std::uint32_t n = random(60) + 1; n > 0; --n)
      own[64 + random(static_cast<std::uint32_t>(own.size()) - 64)] = static_cast<std::uint8_t>(random(256));
    refused += fly(cbf, random) > 0;
  }
  CHECK(refused > 100);
}

}  // namespace

int main() {
  test_the_image_is_one();
  test_mutated_before_it_is_opened();
  test_mutated_after_it_is_opened();
  return alula_failures == 0 ? 0 : 1;
}
