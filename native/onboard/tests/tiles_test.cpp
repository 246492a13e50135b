// Tiles: commands across hundreds of borders are those of the whole map, and a tile that is late is a wall.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "alula.h"
#include "alula_tiles.h"
#include "box_map.hpp"
#include "check.hpp"

namespace {

using Bytes = std::vector<std::uint8_t>;
using Point = std::array<float, 3>;

constexpr int kEdge = 16, kReach = 10, kHysteresis = 2;  // [voxels of 0.25 m]
constexpr int kAlong = 9, kAcross = 7;
constexpr int kFirst[2] = {-4, -3};
const LatticeBox kWhole{
    kFirst[0] * kEdge, kFirst[1] * kEdge, -8, (kFirst[0] + kAlong) * kEdge, (kFirst[1] + kAcross) * kEdge, 12};
constexpr float kDt = 0.02F;

Bytes digest(const std::uint8_t* data, std::size_t length) {
  alula_sha256 hash;
  Bytes found(32);
  alula_sha256_begin(&hash);
  alula_sha256_add(&hash, data, static_cast<std::uint32_t>(length));
  alula_sha256_end(&hash, found.data());
  return found;
}

std::string hex(const Bytes& bytes) {
  std::string text;
  for (const std::uint8_t byte : bytes) text += "0123456789abcdef"[byte >> 4], text += "0123456789abcdef"[byte & 15];
  return text;
}

// Boxes of two sizes on a lattice, with rods through the borders, and corner posts that make the box of all hulls.
std::vector<LatticeBox> field() {
  std::vector<LatticeBox> boxes;
  for (int i = kWhole[0] + 3; i < kWhole[3] - 4; i += 9)
    for (int j = kWhole[1] + 2; j < kWhole[4] - 4; j += 9) {
      const int size = 1 + ((i + 3 * j) & 1);
      boxes.push_back({i, j, -8, i + size, j + size, 12});
      if ((i + j) % 4 == 0) boxes.push_back({i - 3, j, 6, i + 5, j + 1, 8});
    }
  boxes.push_back({kWhole[0], kWhole[1], -8, kWhole[0] + 1, kWhole[1] + 1, 12});
  boxes.push_back({kWhole[3] - 1, kWhole[4] - 1, -8, kWhole[3], kWhole[4], 12});
  return boxes;
}

struct Tiles {
  Bytes whole, index;
  std::vector<Bytes> image;
};

void put(Bytes& bytes, std::size_t at, std::uint64_t value, std::size_t size) {
  for (std::size_t i = 0; i < size; ++i) bytes[at + i] = static_cast<std::uint8_t>(value >> 8 * i & 0xFF);
}

std::uint32_t crc32_bitwise(const std::uint8_t* data, std::size_t length) {
  std::uint32_t crc = 0xFFFFFFFFU;
  for (std::size_t i = 0; i < length; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

void seal(Bytes& index) {
  put(index, 88, crc32_bitwise(index.data() + 128, index.size() - 128), 4);
  put(index, 124, crc32_bitwise(index.data(), 124), 4);
}

Tiles cut(const std::vector<LatticeBox>& boxes, int reach) {
  Tiles made{box_map(boxes), Bytes(128, 0), {}};
  std::size_t largest = 0;
  for (int j = kFirst[1]; j < kFirst[1] + kAcross; ++j)
    for (int i = kFirst[0]; i < kFirst[0] + kAlong; ++i) {
      const int grown = reach + kHysteresis;
      const int low[2] = {i * kEdge - grown, j * kEdge - grown};
      const int high[2] = {(i + 1) * kEdge + grown, (j + 1) * kEdge + grown};
      std::vector<LatticeBox> kept;
      for (const LatticeBox& b : boxes)
        if (b[0] <= high[0] && b[3] >= low[0] && b[1] <= high[1] && b[4] >= low[1]) kept.push_back(b);
      for (int k = 0; k < 2; ++k) {
        LatticeBox below = kWhole, above = kWhole;
        const std::size_t axis = static_cast<std::size_t>(k);
        below[axis + 3] = low[k], above[axis] = high[k];
        if (low[k] > kWhole[axis]) kept.push_back(below);
        if (high[k] < kWhole[axis + 3]) kept.push_back(above);
      }
      made.image.push_back(box_map(kept));
      largest = std::max(largest, made.image.back().size());
    }
  Bytes& index = made.index;
  std::memcpy(index.data(), "ALTI", 4);
  index[4] = 1, index[6] = 128;
  for (std::size_t k = 0; k < 2; ++k) put(index, 8 + 4 * k, static_cast<std::uint64_t>(kFirst[k]), 4);
  put(index, 16, kAlong, 4), put(index, 20, kAcross, 4);
  put(index, 24, kEdge, 4), put(index, 28, static_cast<std::uint64_t>(reach), 4), put(index, 32, kHysteresis, 4);
  put(index, 36, largest, 4);
  std::uint64_t edge;
  std::memcpy(&edge, &kBoxMapVoxel, 8);
  put(index, 40, edge, 8);
  for (std::size_t k = 0; k < 6; ++k) put(index, 48 + 4 * k, static_cast<std::uint64_t>(kWhole[k]), 4);
  const float single = static_cast<float>(kBoxMapVoxel);
  std::uint32_t bits;
  std::memcpy(&bits, &single, 4);
  put(index, 76, bits, 4);
  for (const Bytes& image : made.image) {
    const std::size_t at = index.size();
    index.resize(at + 40);
    put(index, at, image.size(), 4);
    put(index, at + 4, crc32_bitwise(image.data(), image.size()), 4);
    const Bytes hash = digest(image.data(), image.size());
    std::copy(hash.begin(), hash.end(), index.begin() + static_cast<std::ptrdiff_t>(at) + 8);
  }
  put(index, 72, index.size(), 4);
  seal(index);
  return made;
}

const Tiles& world() {
  static const Tiles made = cut(field(), kReach);
  return made;
}

alula_tiles_status opened(alula_tiles& tiles, const Bytes& index) {
  return alula_tiles_open(&tiles, index.data(), static_cast<std::uint32_t>(index.size()), nullptr, 0, nullptr);
}

alula_polytope_cbf_config config() {
  alula_polytope_cbf_config c = ALULA_POLYTOPE_CBF_DEFAULTS;
  c.radius_m = 0.2F, c.beta = 2.0F, c.kappa = 100.0F, c.dt_s = kDt, c.v_max = 2.0F;
  return c;
}

struct Flight {
  int ticks = 0, crossings = 0, switches = 0, different = 0, changed = 0, outside = 0, refused = 0;
  Point at{};
  float least = FLT_MAX;  // distance from the hulls
};

// Flies from way point to way point; a tile takes `latency` ticks to load. With `compares`, every command is compared
// with that of the whole map.
Flight fly(const std::vector<Point>& way, Point x, int latency, int most_ticks) {
  Flight flight;
  alula_map whole;
  alula_tiles tiles;
  alula_polytope_cbf among_whole, among_tiles;
  const alula_polytope_cbf_config c = config();
  const Tiles& made = world();
  CHECK(alula_map_open(&whole, made.whole.data(), static_cast<std::uint32_t>(made.whole.size())) == ALULA_MAP_READY);
  CHECK(alula_polytope_cbf_open(&among_whole, &whole, 64.0F, &c) == ALULA_READY);
  CHECK(alula_polytope_cbf_open(&among_tiles, &whole, 64.0F, &c) == ALULA_READY);
  CHECK(opened(tiles, made.index) == ALULA_TILES_READY);
  CHECK(alula_polytope_cbf_reach(&among_tiles) <= tiles.reach_m);
  Bytes buffer[2] = {Bytes(tiles.largest_bytes), Bytes(tiles.largest_bytes)};
  const std::uint8_t* flown = nullptr;
  int waited = 0, tile[2] = {INT32_MIN, INT32_MIN};
  std::size_t next = 0;
  while (next < way.size() && flight.ticks < most_ticks) {
    ++flight.ticks;
    float u_nom[3], towards[3], gap = 0;
    for (std::size_t k = 0; k < 3; ++k) gap += (way[next][k] - x[k]) * (way[next][k] - x[k]);
    gap = std::sqrt(gap);
    if (gap < 0.1F) {
      ++next;
      continue;
    }
    for (std::size_t k = 0; k < 3; ++k) {
      u_nom[k] = 1.8F * (way[next][k] - x[k]) / gap;
      towards[k] = x[k] + 1.5F * u_nom[k];
    }
    const alula_map* map;
    alula_tiles_place place = alula_tiles_select(&tiles, x.data(), towards, &map);
    alula_tiles_request_data request;
    if (alula_tiles_request(&tiles, &request) && ++waited > latency) {
      waited = 0;
      CHECK(map == nullptr || map->data != buffer[request.slot].data());
      const Bytes& image = made.image[request.tile];
      CHECK(image.size() == request.bytes);
      std::copy(image.begin(), image.end(), buffer[request.slot].begin());
      CHECK(alula_tiles_loaded(&tiles, buffer[request.slot].data()) == ALULA_TILES_READY);
      place = alula_tiles_select(&tiles, x.data(), towards, &map);
    }
    if (place == ALULA_TILES_NOT_LOADED) {
      CHECK(map == nullptr);
      ++flight.refused;
      continue;
    }
    flight.switches += flown != nullptr && map->data != flown;
    if (map->data != flown) CHECK(alula_polytope_cbf_move(&among_tiles, map) == ALULA_READY);
    flown = map->data;
    alula_polytope_result by_whole, by_tile;
    const alula_filter_status one = alula_polytope_cbf_filter(&among_whole, x.data(), u_nom, &by_whole);
    const alula_filter_status other = alula_polytope_cbf_filter(&among_tiles, x.data(), u_nom, &by_tile);
    if (place == ALULA_TILES_OUTSIDE) {
      ++flight.outside;
    } else {
      flight.different += one != other || std::memcmp(by_whole.u, by_tile.u, sizeof by_tile.u) != 0 ||
                          by_whole.fraction != by_tile.fraction;
    }
    flight.changed += one != ALULA_FILTER_OK;
    CHECK(other != ALULA_FILTER_REFUSED);
    for (std::size_t k = 0; k < 3; ++k) x[k] += kDt * by_tile.u[k];
    int now[2];
    for (std::size_t k = 0; k < 2; ++k) now[k] = static_cast<int>(std::floor(x[k] / (kEdge * 0.25F)));
    flight.crossings += tile[0] != INT32_MIN && (now[0] != tile[0] || now[1] != tile[1]);
    tile[0] = now[0], tile[1] = now[1];
    alula_polytope_value value;
    CHECK(alula_polytope_cbf_evaluate(&among_whole, x.data(), &value) == ALULA_READY);
    flight.least = std::min(flight.least, value.hard);
  }
  flight.at = x;
  return flight;
}

// Straight across all tiles along both axes, closely past the posts, and diagonally, where posts are in the way.
std::vector<std::array<Point, 2>> tour() {
  std::vector<std::array<Point, 2>> legs;
  for (int lane = 0; lane < 12; ++lane) {
    const float side = 0.7F + 0.2F * static_cast<float>(lane % 6), n = static_cast<float>(lane);
    const float y = -11.5F + 2.25F * n + side, x = -15.25F + 2.25F * n + side;
    if (lane < 10) legs.push_back({{{-15.8F, y, 0.5F}, {19.7F, y, 0.5F}}});
    legs.push_back({{{x, 15.7F, 0.4F}, {x, -11.9F, 0.4F}}});
    if (lane % 3 == 0) legs.push_back({{{x, -11.9F, 1.0F}, {x + 9.0F, 15.7F, 0.2F}}});
  }
  return legs;
}

void test_commands_across_borders_are_those_of_the_whole_map() {
  for (const int latency : {0, 10}) {
    Flight all;
    for (const auto& [start, goal] : tour()) {
      const Flight one = fly({goal}, start, latency, 1200);
      all.ticks += one.ticks, all.crossings += one.crossings, all.switches += one.switches;
      all.different += one.different, all.changed += one.changed, all.outside += one.outside;
      all.least = std::min(all.least, one.least);
    }
    CHECK(all.different == 0);
    CHECK(all.crossings >= 150 && all.switches >= 150 && all.outside == 0);
    CHECK(all.ticks > 20000 && all.changed > 1000 && all.least >= config().radius_m);
  }
}

// A vehicle that lags. Hulls beyond the reach cannot bind.
void test_the_stack_gives_the_velocities_of_the_whole_map() {
  const Tiles made = cut(field(), 32);
  alula_map whole;
  CHECK(alula_map_open(&whole, made.whole.data(), static_cast<std::uint32_t>(made.whole.size())) == ALULA_MAP_READY);
  alula_stack_config c = alula_stack_defaults();
  c.extent_m = 64.0F;
  static alula_stack among_whole, among_tiles;
  alula_tiles tiles;
  CHECK(opened(tiles, made.index) == ALULA_TILES_READY);
  CHECK(alula_stack_init(&among_whole, &whole, nullptr, &c) == ALULA_READY);
  CHECK(alula_stack_init(&among_tiles, &whole, nullptr, &c) == ALULA_READY);
  CHECK(alula_polytope_cbf_reach(&among_tiles.chord.hulls) <= tiles.reach_m);
  const float dt = c.dr_acbf.avoidance.dt_s;
  int different = 0, switches = 0, rows = 0;
  const std::uint8_t* flown = nullptr;
  for (int lane = 0; lane < 4; ++lane) {
    float x[3] = {-15.8F, -10.4F + 4.5F * static_cast<float>(lane), 0.5F}, v[3] = {0, 0, 0};
    for (int tick = 0; tick < 1500 && x[0] < 19.0F; ++tick) {
      alula_stack_input in = {};
      in.nominal[0] = 1.0F, in.nominal[1] = 0.1F * std::sin(0.01F * static_cast<float>(tick));
      float towards[3];
      for (int k = 0; k < 3; ++k) {
        in.position[k] = x[k], in.velocity[k] = v[k];
        towards[k] = x[k] + 4.0F * in.nominal[k];
      }
      const alula_map* map;
      alula_tiles_request_data request;
      (void)!alula_tiles_select(&tiles, x, towards, &map);
      if (alula_tiles_request(&tiles, &request))
        CHECK(alula_tiles_loaded(&tiles, made.image[request.tile].data()) == ALULA_TILES_READY);
      CHECK(alula_tiles_select(&tiles, x, towards, &map) == ALULA_TILES_INSIDE);
      if (map->data != flown) CHECK(alula_stack_move(&among_tiles, map) == ALULA_READY);
      switches += map->data != flown;
      flown = map->data;
      alula_stack_result one, other;
      const alula_filter_status status = alula_stack_filter(&among_whole, &in, &one);
      different += alula_stack_filter(&among_tiles, &in, &other) != status || one.rows != other.rows ||
                   std::memcmp(one.velocity, other.velocity, sizeof one.velocity) != 0;
      rows += static_cast<int>(one.rows);
      for (int k = 0; k < 3; ++k) v[k] += dt / c.lag_s * (one.velocity[k] - v[k]), x[k] += dt * v[k];
    }
  }
  CHECK(different == 0);
  CHECK(switches > 10 && rows > 500);
}

// The cache of a geofence does not outlive the tile that it is of.
void test_a_geofence_that_moves_is_as_one_that_starts_on_the_tile() {
  const Tiles made = cut(field(), 40);
  alula_map map[2];
  alula_fence fence{}, fresh_fence{};
  static alula_geofence moved, fresh;
  const alula_geofence_config config = alula_geofence_defaults();
  for (std::uint32_t k = 0; k < 2; ++k) {
    const Bytes& image = made.image[static_cast<std::size_t>(-kFirst[1] * kAlong - kFirst[0]) + k];
    CHECK(alula_map_open(&map[k], image.data(), static_cast<std::uint32_t>(image.size())) == ALULA_MAP_READY);
  }
  fence.keep_out = &map[0];
  CHECK(alula_geofence_init(&moved, &fence, &config) == ALULA_READY);
  int blended = 0;
  for (int tick = 0; tick < 40; ++tick) {
    alula_racer_state x{};
    x.attitude[0] = 1.0F;
    x.position[0] = 3.6F + 0.02F * static_cast<float>(tick), x.position[1] = 0.9F, x.position[2] = 0.5F;
    x.velocity[0] = 2.0F;
    const alula_racer_command pilot{0.4F, {0.0F, 1.0F, 0.0F}};
    if (tick % 4 == 0) {
      fence.keep_out = fresh_fence.keep_out = &map[tick / 4 % 2];
      alula_geofence_move(&moved);
      alula_geofence_reset(&moved);
      CHECK(alula_geofence_init(&fresh, &fresh_fence, &config) == ALULA_READY);
    }
    alula_geofence_result one, other;
    CHECK(alula_geofence_filter(&moved, &x, &pilot, &one) == alula_geofence_filter(&fresh, &x, &pilot, &other));
    CHECK(std::memcmp(&one.command, &other.command, sizeof one.command) == 0 && one.h_i == other.h_i);
    blended += one.lambda < 1.0F;
  }
  CHECK(blended > 10);
  alula_geofence_move(nullptr);
}

void test_a_tile_that_never_comes_is_a_wall() {
  // every tile comes late: the vehicle waits in front of walls, and goes on
  const Flight flight = fly({{15.0F, 0.9F, 0.5F}}, {-1.0F, 0.9F, 0.5F}, 200, 2000);
  CHECK(flight.outside > 100 && flight.crossings >= 4 && flight.least >= config().radius_m);
  CHECK(flight.at[0] > 14.8F);
  // after the first tile none comes
  alula_tiles tiles;
  CHECK(opened(tiles, world().index) == ALULA_TILES_READY);
  const float start[3] = {0.9F, 0.9F, 0.2F};
  const alula_map* map;
  CHECK(alula_tiles_select(&tiles, start, start, &map) == ALULA_TILES_NOT_LOADED && map == nullptr);
  alula_tiles_request_data request;
  CHECK(alula_tiles_request(&tiles, &request));
  CHECK(request.at[0] == 0 && request.at[1] == 0 && request.slot == 0);
  CHECK(request.tile == static_cast<std::uint32_t>(-kFirst[1] * kAlong - kFirst[0]));
  CHECK(alula_tiles_loaded(&tiles, world().image[request.tile].data()) == ALULA_TILES_READY);
  alula_polytope_cbf cbf;
  const alula_polytope_cbf_config c = config();
  CHECK(alula_tiles_select(&tiles, start, start, &map) == ALULA_TILES_INSIDE);
  CHECK(alula_polytope_cbf_open(&cbf, map, 64.0F, &c) == ALULA_READY);
  float x[3] = {start[0], start[1], start[2]};
  for (int tick = 0; tick < 1000; ++tick) {
    const float u[3] = {-2.0F, 0, 0};
    alula_polytope_result result;
    CHECK(alula_tiles_select(&tiles, x, start, &map) != ALULA_TILES_NOT_LOADED);
    CHECK(alula_polytope_cbf_filter(&cbf, x, u, &result) != ALULA_FILTER_REFUSED);
    for (int k = 0; k < 3; ++k) x[k] += kDt * result.u[k];
  }
  const float wall = -0.25F * (kReach + kHysteresis);
  CHECK(x[0] >= wall + c.radius_m && x[0] < 0);  // beyond the border, and in front of the wall of the next tile
  CHECK(alula_tiles_select(&tiles, x, start, &map) == ALULA_TILES_OUTSIDE);
}

void test_a_vehicle_at_a_border_does_not_switch_to_and_fro() {
  alula_tiles tiles;
  CHECK(opened(tiles, world().index) == ALULA_TILES_READY);
  const alula_map* map;
  int loads = 0;
  const std::uint8_t* flown = nullptr;
  int switches = 0;
  for (int tick = 0; tick < 400; ++tick) {
    const float swing = 0.24F * std::sin(0.3F * static_cast<float>(tick));
    const float x[3] = {4.0F + swing, 4.0F - swing, 0};
    const float towards[3] = {x[0] + 20 * swing, x[1] + 20 * swing, 0};
    (void)!alula_tiles_select(&tiles, x, towards, &map);
    alula_tiles_request_data request;
    if (alula_tiles_request(&tiles, &request)) {
      ++loads;
      CHECK(alula_tiles_loaded(&tiles, world().image[request.tile].data()) == ALULA_TILES_READY);
    }
    CHECK(tick == 0 || alula_tiles_select(&tiles, x, towards, &map) == ALULA_TILES_INSIDE);
    switches += flown != nullptr && map->data != flown;
    if (map) flown = map->data;
  }
  CHECK(switches == 0 && loads >= 2);
}

void test_the_rim_has_what_lies_beyond() {
  alula_tiles tiles;
  for (const auto& [x, y, i, j] : {std::array<float, 4>{-1e6F, 0.5F, kFirst[0], 0},
                                   std::array<float, 4>{0.5F, 1e11F, 0, kFirst[1] + kAcross - 1},
                                   std::array<float, 4>{1e3F, -1e3F, kFirst[0] + kAlong - 1, kFirst[1]},
                                   std::array<float, 4>{-0.001F, -4.001F, -1, -2}}) {
    CHECK(opened(tiles, world().index) == ALULA_TILES_READY);
    const float at[3] = {x, y, -1e5F};
    const alula_map* map;
    alula_tiles_request_data request;
    CHECK(alula_tiles_select(&tiles, at, nullptr, &map) == ALULA_TILES_NOT_LOADED);
    CHECK(alula_tiles_request(&tiles, &request));
    CHECK(request.at[0] == static_cast<int>(i) && request.at[1] == static_cast<int>(j));
    CHECK(alula_tiles_loaded(&tiles, world().image[request.tile].data()) == ALULA_TILES_READY);
    CHECK(alula_tiles_select(&tiles, at, nullptr, &map) == ALULA_TILES_INSIDE);
    CHECK(!alula_tiles_request(&tiles, &request));
    const float bad[3] = {std::numeric_limits<float>::quiet_NaN(), 0, 0};
    CHECK(alula_tiles_select(&tiles, bad, at, &map) == ALULA_TILES_NOT_LOADED && map == nullptr);
  }
}

void test_a_position_that_jumps_has_no_map_until_its_tile_is_there() {
  alula_tiles tiles;
  CHECK(opened(tiles, world().index) == ALULA_TILES_READY);
  const float here[3] = {0.9F, 0.9F, 0}, there[3] = {12.9F, -9.9F, 0}, between[3] = {6.0F, 0.9F, 0};
  const alula_map* map;
  alula_tiles_request_data request;
  const auto load = [&] {
    CHECK(alula_tiles_request(&tiles, &request));
    CHECK(alula_tiles_loaded(&tiles, world().image[request.tile].data()) == ALULA_TILES_READY);
  };
  CHECK(alula_tiles_select(&tiles, here, there, &map) == ALULA_TILES_NOT_LOADED);
  load();
  CHECK(alula_tiles_select(&tiles, here, here, &map) == ALULA_TILES_INSIDE);
  CHECK(alula_tiles_select(&tiles, between, between, &map) == ALULA_TILES_OUTSIDE && map != nullptr);
  CHECK(alula_tiles_select(&tiles, there, there, &map) == ALULA_TILES_NOT_LOADED && map == nullptr);
  load();  // the tile of `between`, whose load had begun
  CHECK(alula_tiles_select(&tiles, there, there, &map) == ALULA_TILES_NOT_LOADED && map == nullptr);
  load();
  CHECK(request.at[0] == 3 && request.at[1] == -3);
  CHECK(alula_tiles_select(&tiles, there, there, &map) == ALULA_TILES_INSIDE);
  CHECK(!alula_tiles_request(&tiles, &request));
}

void test_hashes_are_those_of_the_standards() {
  const auto bytes = [](const std::string& text) { return Bytes(text.begin(), text.end()); };
  const Bytes abc = bytes("abc");
  CHECK(hex(digest(abc.data(), 3)) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  CHECK(hex(digest(abc.data(), 0)) == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  const Bytes many(1000000, 'a');
  CHECK(hex(digest(many.data(), many.size())) == "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
  const Bytes jefe = bytes("Jefe"), what = bytes("what do ya want for nothing?");  // RFC 4231, cases 2 and 6
  Bytes code(32);
  alula_hmac_sha256(jefe.data(), 4, what.data(), static_cast<std::uint32_t>(what.size()), code.data());
  CHECK(hex(code) == "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843");
  const Bytes key(131, 0xAA), text = bytes("Test Using Larger Than Block-Size Key - Hash Key First");
  alula_hmac_sha256(key.data(), 131, text.data(), static_cast<std::uint32_t>(text.size()), code.data());
  CHECK(hex(code) == "60e431591ee0b67f0d8a26aacbf5b77f8e0bc6213728c5140546040f0ee37f54");
}

void test_what_is_signed_is_flown_and_nothing_else() {
  const Tiles& made = world();
  const std::uint32_t length = static_cast<std::uint32_t>(made.index.size());
  const Bytes key(32, 7), other(32, 8);
  Bytes signature(32);
  alula_hmac_sha256(key.data(), 32, made.index.data(), length, signature.data());
  alula_tiles tiles;
  CHECK(alula_tiles_open(&tiles, made.index.data(), length, key.data(), 32, signature.data()) == ALULA_TILES_READY);
  CHECK(alula_tiles_open(&tiles, made.index.data(), length, other.data(), 32, signature.data()) ==
        ALULA_TILES_FORGED);
  CHECK(alula_tiles_open(&tiles, made.index.data(), length, key.data(), 32, nullptr) == ALULA_TILES_BAD_POINTER);
  Bytes changed = made.index;
  changed[128 + 8] ^= 1;
  seal(changed);
  CHECK(alula_tiles_open(&tiles, changed.data(), length, key.data(), 32, signature.data()) == ALULA_TILES_FORGED);
  const float at[3] = {0, 0, 0};
  const alula_map* map;
  CHECK(alula_tiles_select(&tiles, at, at, &map) == ALULA_TILES_NOT_LOADED);  // not open
  alula_tiles_request_data request;
  CHECK(!alula_tiles_request(&tiles, &request));

  // an image that is complete and valid, but not the one of the index
  CHECK(opened(tiles, made.index) == ALULA_TILES_READY);
  CHECK(alula_tiles_loaded(&tiles, made.whole.data()) == ALULA_TILES_NO_REQUEST);
  CHECK(alula_tiles_select(&tiles, at, at, &map) == ALULA_TILES_NOT_LOADED);
  CHECK(alula_tiles_request(&tiles, &request));
  Bytes empty = box_map({});
  empty.resize(request.bytes);
  CHECK(alula_tiles_loaded(&tiles, empty.data()) == ALULA_TILES_DAMAGED);
  CHECK(alula_tiles_select(&tiles, at, at, &map) == ALULA_TILES_NOT_LOADED);
  CHECK(alula_tiles_request(&tiles, &request));  // still
  CHECK(alula_tiles_loaded(&tiles, made.image[request.tile].data()) == ALULA_TILES_READY);
}

void test_what_is_not_whole_is_refused() {
  const Bytes& good = world().index;
  alula_tiles tiles;
  for (std::uint32_t length = 0; length < good.size(); ++length) {
    const Bytes cut(good.begin(), good.begin() + length);
    CHECK(alula_tiles_open(&tiles, cut.data(), length, nullptr, 0, nullptr) != ALULA_TILES_READY);
  }
  CHECK(alula_tiles_open(nullptr, good.data(), 128, nullptr, 0, nullptr) == ALULA_TILES_BAD_POINTER);
  CHECK(alula_tiles_open(&tiles, nullptr, 128, nullptr, 0, nullptr) == ALULA_TILES_BAD_POINTER);
  for (std::size_t at = 0; at < 128 + 80; ++at) {
    for (const int change : {1, 0x80, 0xFF}) {
      Bytes bad = good;
      bad[at] = static_cast<std::uint8_t>(bad[at] ^ change);
      CHECK(opened(tiles, bad) != ALULA_TILES_READY);
      seal(bad);  // whatever the numbers are, nothing outside the bytes is read
      if (opened(tiles, bad) != ALULA_TILES_READY) continue;
      for (const float x : {-1e9F, -3.0F, 2.0F, 1e9F}) {
        const float p[3] = {x, -x, 0};
        const alula_map* map;
        alula_tiles_request_data request;
        (void)!alula_tiles_select(&tiles, p, p, &map);
        CHECK(alula_tiles_request(&tiles, &request) && request.tile < world().image.size());
      }
    }
  }
  const auto with = [&](std::size_t at, std::uint32_t value) {
    Bytes bad = good;
    put(bad, at, value, 4);
    seal(bad);
    return opened(tiles, bad);
  };
  CHECK(with(16, 0) == ALULA_TILES_MALFORMED && with(16, 1U << 31) == ALULA_TILES_MALFORMED);
  CHECK(with(24, 0) == ALULA_TILES_MALFORMED && with(28, 0) == ALULA_TILES_MALFORMED);
  CHECK(with(32, 0) == ALULA_TILES_MALFORMED && with(32, kEdge) == ALULA_TILES_MALFORMED);
  CHECK(with(8, 1U << 30) == ALULA_TILES_MALFORMED && with(36, 64) == ALULA_TILES_MALFORMED);
  CHECK(with(72, 1U << 30) == ALULA_TILES_TRUNCATED && with(76, 0x7F800000U) == ALULA_TILES_MALFORMED);
}

}  // namespace

int main() {
  test_hashes_are_those_of_the_standards();
  test_commands_across_borders_are_those_of_the_whole_map();
  test_the_stack_gives_the_velocities_of_the_whole_map();
  test_a_geofence_that_moves_is_as_one_that_starts_on_the_tile();
  test_a_tile_that_never_comes_is_a_wall();
  test_a_vehicle_at_a_border_does_not_switch_to_and_fro();
  test_the_rim_has_what_lies_beyond();
  test_a_position_that_jumps_has_no_map_until_its_tile_is_there();
  test_what_is_signed_is_flown_and_nothing_else();
  test_what_is_not_whole_is_refused();
  return alula_failures == 0 ? 0 : 1;
}
