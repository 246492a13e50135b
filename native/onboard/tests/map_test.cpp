// The onboard map as firmware reads it: hand-made images, each in memory of exactly its size.
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "alula_map_near.h"
#include "check.hpp"

namespace {

using Bytes = std::vector<std::uint8_t>;

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

void put_float(Bytes& bytes, std::size_t at, float value) {
  std::uint32_t bits;
  std::memcpy(&bits, &value, 4);
  put(bytes, at, bits, 4);
}

void seal(Bytes& bytes) {
  put(bytes, 20, crc32_bitwise(bytes.data() + 64, bytes.size() - 64), 4);
  put(bytes, 60, crc32_bitwise(bytes.data(), 60), 4);
}

// Voxels of 0.5 m, origin (10, 0, -10): the box [11, 13] x [0, 2] x [-10, -8], whose edge along z is cut
// by x + y <= 14 (depth 1), and the box [-10, -9] x [-1, 0] x [-10, -9].
Bytes image(bool is_kdop) {
  Bytes bytes(64, 0);
  const char magic[] = "ALMP";
  std::memcpy(bytes.data(), magic, 4);
  bytes[4] = 1, bytes[6] = 64, bytes[8] = is_kdop ? 1 : 0, bytes[10] = 1, bytes[12] = 2;
  const auto box = [&](std::initializer_list<int> corners, std::uint8_t planes) {
    for (const int c : corners) {
      bytes.push_back(static_cast<std::uint8_t>(c & 0xFF));
      bytes.push_back(static_cast<std::uint8_t>(c >> 8 & 0xFF));
    }
    bytes.push_back(planes);
    bytes.push_back(0);
  };
  box({1, 0, 0, 3, 2, 2}, 1);
  const Bytes plane = is_kdop ? Bytes{18 | 1 << 5, 0} : Bytes{1, 1, 0, 1, 0};
  bytes.insert(bytes.end(), plane.begin(), plane.end());
  box({-20, -1, 0, -19, 0, 1}, 0);
  put(bytes, 16, bytes.size(), 4);
  put(bytes, 24, 10, 4), put(bytes, 32, static_cast<std::uint32_t>(-10), 4);
  put_float(bytes, 36, 0.5F), put(bytes, 40, 0x3FE0000000000000u, 8);
  put_float(bytes, 48, 8.0F / 262144.0F);
  seal(bytes);
  return bytes;
}

alula_map_status open_copy(const Bytes& bytes, std::size_t length) {
  const Bytes own(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
  alula_map map;
  const alula_map_status status = alula_map_open(&map, own.data(), static_cast<std::uint32_t>(length));
  if (status != ALULA_MAP_READY) {
    CHECK(map.data == nullptr && map.hull_count == 0);
    return status;
  }
  const float x[3] = {0, 0, 0};
  alula_map_value value;
  CHECK(alula_map_evaluate(&map, x, &value) == ALULA_MAP_READY);
  CHECK(std::isfinite(value.psi_m));
  return status;
}

void test_hulls_and_planes_are_read(bool is_kdop) {
  const Bytes bytes = image(is_kdop);
  alula_map map;
  CHECK(alula_map_open(&map, bytes.data(), static_cast<std::uint32_t>(bytes.size())) == ALULA_MAP_READY);
  CHECK(map.hull_count == 2 && map.plane_count == 1 && map.total_bytes == 64u + 28u + (is_kdop ? 2u : 5u));
  CHECK(map.extent_m == 8.0F && map.voxel_size_m == 0.5F);
  alula_map_hull hull;
  CHECK(alula_map_read(&map, ALULA_MAP_HEADER_BYTES, &hull) == ALULA_MAP_READY);
  CHECK(hull.lower[0] == 11 && hull.lower[1] == 0 && hull.lower[2] == -10);
  CHECK(hull.upper[0] == 13 && hull.upper[1] == 2 && hull.upper[2] == -8 && hull.plane_count == 1);
  const alula_map_plane plane = alula_map_plane_at(&map, &hull, 0);
  CHECK(plane.normal[0] == 1 && plane.normal[1] == 1 && plane.normal[2] == 0 && plane.depth == 1);
  CHECK(alula_map_read(&map, hull.next, &hull) == ALULA_MAP_READY);
  CHECK(hull.lower[0] == -10 && hull.upper[2] == -9 && hull.plane_count == 0 && hull.next == map.total_bytes);
  CHECK(alula_map_read(&map, hull.next, &hull) == ALULA_MAP_MALFORMED);
  CHECK(alula_map_read(&map, 63, &hull) == ALULA_MAP_MALFORMED);
  CHECK(alula_map_read(&map, UINT32_MAX, &hull) == ALULA_MAP_MALFORMED);

  alula_map_value value;
  const float beside[3] = {8, 0.5F, -4.5F}, corner[3] = {7.5F, 2, -4.5F}, inside[3] = {-4.75F, -0.25F, -4.75F};
  CHECK(alula_map_evaluate(&map, beside, &value) == ALULA_MAP_READY);
  CHECK(value.hull == 0 && value.psi_m <= 1.5F && value.psi_m >= 1.4999F && value.normal[0] == 1.0F);
  CHECK(alula_map_evaluate(&map, corner, &value) == ALULA_MAP_READY);
  const float exact = 2.5F / std::sqrt(2.0F);  // x + y <= 7 m
  CHECK(value.hull == 0 && value.psi_m < exact && value.psi_m > exact - 1e-4F);
  CHECK(std::abs(value.normal[0] - 0.70710678F) < 1e-6F && value.normal[2] == 0.0F);
  CHECK(alula_map_evaluate(&map, inside, &value) == ALULA_MAP_READY);
  CHECK(value.hull == 1 && value.psi_m <= -0.25F && value.psi_m >= -0.2501F);
}

void test_what_is_not_whole_is_refused(bool is_kdop) {
  const Bytes good = image(is_kdop);
  CHECK(open_copy(good, good.size()) == ALULA_MAP_READY);
  for (std::size_t length = 1; length < good.size(); ++length) CHECK(open_copy(good, length) == ALULA_MAP_TRUNCATED);
  for (std::size_t at = 0; at < good.size(); ++at) {
    for (int change = 1; change < 256; ++change) {
      Bytes bad = good;
      bad[at] = static_cast<std::uint8_t>(bad[at] ^ change);
      CHECK(open_copy(bad, bad.size()) != ALULA_MAP_READY);
    }
  }
}

void test_no_byte_leads_outside_even_with_matching_sums(bool is_kdop) {
  const Bytes good = image(is_kdop);
  int taken = 0;
  for (std::size_t at = 4; at < good.size(); ++at) {
    for (int change = 1; change < 256; ++change) {
      Bytes bad = good;
      bad[at] = static_cast<std::uint8_t>(bad[at] ^ change);
      seal(bad);
      taken += open_copy(bad, bad.size()) == ALULA_MAP_READY;
    }
  }
  CHECK(taken > 0);  // a map with another coordinate or hash is valid too
}

// The bytes of a map change after it was opened: invalid records are refused, and nothing is read outside.
void test_flash_that_fails_is_refused_or_read_as_another_map(bool is_kdop) {
  const Bytes good = image(is_kdop);
  for (std::size_t at = 64; at < good.size(); ++at) {
    for (int change = 1; change < 256; ++change) {
      Bytes bad = good;
      alula_map map;
      CHECK(alula_map_open(&map, bad.data(), static_cast<std::uint32_t>(bad.size())) == ALULA_MAP_READY);
      alula_map_near near;
      alula_map_near_open(&near, &map);
      const float x[3] = {8, 0.5F, -4.5F}, y[3] = {-4.5F, 0, -5};
      alula_map_value value, other;
      CHECK(alula_map_near_evaluate(&near, x, &value) == ALULA_MAP_READY);
      bad[at] = static_cast<std::uint8_t>(bad[at] ^ change);
      for (const float* p : {x, y}) {
        const alula_map_status alone = alula_map_evaluate(&map, p, &value);
        const alula_map_status along = alula_map_near_evaluate(&near, p, &other);
        CHECK(alone == ALULA_MAP_READY ? std::isfinite(value.psi_m) : value.psi_m == -FLT_MAX);
        CHECK(along == ALULA_MAP_READY ? std::isfinite(other.psi_m) : other.psi_m == -FLT_MAX);
      }
      if (at == 77 && bad[at] > 16) {  // a shift that removes all bits
        CHECK(alula_map_evaluate(&map, x, &value) == ALULA_MAP_MALFORMED);
        alula_map_near_open(&near, &map);
        CHECK(alula_map_near_evaluate(&near, x, &value) == ALULA_MAP_MALFORMED);
      }
    }
  }
}

void test_what_is_no_call_is_refused() {
  const Bytes bytes = image(false);
  alula_map map;
  alula_map_hull hull;
  alula_map_value value;
  const float good[3] = {0, 0, 0};
  CHECK(alula_map_open(nullptr, bytes.data(), 64) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_map_open(&map, nullptr, 64) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_map_read(&map, 64, &hull) == ALULA_MAP_BAD_POINTER);  // not open
  CHECK(alula_map_evaluate(&map, good, &value) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_map_open(&map, bytes.data(), static_cast<std::uint32_t>(bytes.size())) == ALULA_MAP_READY);
  CHECK(alula_map_evaluate(&map, nullptr, &value) == ALULA_MAP_BAD_POINTER);
  alula_map_near near;
  alula_map_near_open(&near, nullptr);
  CHECK(alula_map_near_evaluate(&near, good, &value) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_map_near_evaluate(nullptr, good, &value) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_map_evaluate(&map, good, nullptr) == ALULA_MAP_BAD_POINTER);
  CHECK(alula_map_read(&map, 64, nullptr) == ALULA_MAP_BAD_POINTER);
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), -2e12F}) {
    const float x[3] = {0, bad, 0};
    CHECK(alula_map_evaluate(&map, x, &value) == ALULA_MAP_BAD_POSITION);
    CHECK(value.psi_m == -FLT_MAX && value.hull == ALULA_MAP_NO_HULL);
  }
}

}  // namespace

int main() {
  for (const bool is_kdop : {false, true}) {
    test_hulls_and_planes_are_read(is_kdop);
    test_what_is_not_whole_is_refused(is_kdop);
    test_no_byte_leads_outside_even_with_matching_sums(is_kdop);
    test_flash_that_fails_is_refused_or_read_as_another_map(is_kdop);
  }
  test_what_is_no_call_is_refused();
  return alula_failures == 0 ? 0 : 1;
}
