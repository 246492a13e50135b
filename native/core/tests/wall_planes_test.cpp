// The walls that filters among moving obstacles see are those of an exhaustive search over all obstacles in reach.
#include <algorithm>
#include <cmath>
#include <vector>

#include "allocations.hpp"
#include "alula/base/random.hpp"
#include "alula/filters/adapters.hpp"
#include "boxes.hpp"
#include "check.hpp"

namespace alula::flight {
namespace {

using geometry::Vec3;

constexpr double kMaxSpeed = 3, kMaxAcceleration = 4, kRadius = 0.1;
constexpr std::size_t kBoxes = 400;

// Boxes of 0.1 to 0.5 m in a room of 6 m.
struct Room {
  std::vector<Vec3> low, high;
  std::shared_ptr<const HullMap> map;

  Room() {
    Boxes boxes;
    const RandomStream random{3, 0};
    for (std::size_t i = 0; i < kBoxes; ++i) {
      const auto u = random.uniforms(i, 1), s = random.uniforms(i, 2);
      low.push_back({6 * u[0], 6 * u[1], 6 * u[2]});
      high.push_back(low[i] + Vec3{0.1 + 0.4 * s[0], 0.1 + 0.4 * s[1], 0.1 + 0.4 * s[2]});
      boxes.add(low[i], high[i]);
    }
    map = std::make_shared<const HullMap>(std::make_shared<const PolytopeSet>(boxes.set()));
  }
};

struct Seen {
  double distance, spare;
};

// Distances of the ALULA_WALLS boxes with the least to spare, in ascending order; of points outside all boxes.
std::vector<double> by_exhaustive_search(const Room& room, Vec3 p, Vec3 v) {
  std::vector<Seen> all;
  const double braking = kMaxAcceleration / 2;
  for (std::size_t i = 0; i < kBoxes; ++i) {
    Vec3 apart;
    for (int k = 0; k < 3; ++k) apart[k] = p[k] - std::clamp(p[k], room.low[i][k], room.high[i][k]);
    const double d = norm(apart);
    if (d < 5 * kMaxSpeed)
      all.push_back({d, std::sqrt(2 * braking * std::max(0.0, d - kRadius)) + dot(apart, v) / d});
  }
  std::sort(all.begin(), all.end(), [](const Seen& a, const Seen& b) { return a.spare < b.spare; });
  all.resize(std::min<std::size_t>(all.size(), ALULA_WALLS));
  std::vector<double> distances;
  for (const Seen& each : all) distances.push_back(each.distance);
  std::sort(distances.begin(), distances.end());
  return distances;
}

void test_walls_are_those_with_the_least_to_spare() {
  const Room room;
  WallPlanes planes(room.map, kMaxSpeed, kMaxAcceleration, kRadius);
  const RandomStream random{4, 0};
  std::size_t compared = 0, counted = 0;
  for (std::uint64_t i = 0; i < 400; ++i) {
    const auto u = random.uniforms(i, 1);
    const Vec3 p{6 * u[0], 6 * u[1], 6 * u[2]}, v = (i % 3) * random.normals(i, 2);
    MapMemory memory = room.map->memory();
    if (room.map->distance(p, 1, memory) < 0.01) continue;
    const std::vector<double> expected = by_exhaustive_search(room, p, v);
    const std::size_t before = allocations;
    const std::span<const alula_wall> walls = planes.at(p, v);
    counted += allocations - before;
    CHECK(walls.size() == expected.size());
    for (std::size_t k = 0; k < walls.size(); ++k)
      CHECK(std::abs(static_cast<double>(walls[k].distance_m) - expected[k]) < 1e-5);
    ++compared;
  }
  CHECK(compared > 200);
  CHECK(counted == 0);
}

}  // namespace
}  // namespace alula::flight

int main() {
  alula::flight::test_walls_are_those_with_the_least_to_spare();
  return alula_failures == 0 ? 0 : 1;
}
