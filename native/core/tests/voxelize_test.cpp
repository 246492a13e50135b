// Voxels and their proof are the same for any number of threads, and a missing voxel is always found. A tally by
// opacity is that of the voxels of the rows of each rank.
#include "alula/cover/voxelize.hpp"

#include <random>

#include "alula/cover/separation.hpp"
#include "check.hpp"

using namespace alula;

namespace {

constexpr double kEdge = 0.1;
constexpr std::size_t kEllipsoids = 9000;  // more than one batch of the threads

struct Scene {
  std::vector<float> mean, scale, quat;

  Scene() {
    std::mt19937 random(3);
    const auto draw = [&] { return std::uniform_real_distribution<float>(-1, 1)(random); };
    for (std::size_t i = 0; i < kEllipsoids; ++i) {
      for (int a = 0; a < 3; ++a) mean.push_back(2 * draw()), scale.push_back(0.11f + 0.1f * draw());
      for (int a = 0; a < 4; ++a) quat.push_back(a == 0 ? 1 : draw());
    }
  }
  Splats splats() const { return {mean, scale, quat}; }
};

void test_voxels_are_proven() {
  const Scene scene;
  Control control;
  for (const double inflation : {0.0, 0.04}) {
    const Level level{1.5, inflation};
    const Box6 crop{-1.5, -1.5, -1.5, 1.5, 1.5, 1.5};
    const Voxelized one = voxelize(scene.splats(), level, kEdge, crop, std::nullopt, 2, 1, control);
    const Voxelized many = voxelize(scene.splats(), level, kEdge, crop, std::nullopt, 2, 5, control);
    CHECK(one.voxels.index == many.voxels.index && one.voxels.count == many.voxels.count);
    CHECK(one.reach == many.reach && one.voxels.below == many.voxels.below);
    std::vector<std::int32_t> index = one.voxels.index;
    for (const unsigned jobs : {1u, 5u})
      CHECK(unproven_voxels(scene.splats(), level, kEdge, crop, 2, index, jobs, control).total == 0);

    std::size_t most = 0;  // the voxel that most ellipsoids touch cannot be touched by rounding alone
    for (std::size_t v = 0; v < one.voxels.count.size(); ++v)
      if (one.voxels.count[v] > one.voxels.count[most]) most = v;
    const auto begin = index.begin() + static_cast<std::ptrdiff_t>(3 * most);
    const std::vector<std::int32_t> lost(begin, begin + 3);
    index.erase(begin, begin + 3);
    const Unproven first = unproven_voxels(scene.splats(), level, kEdge, crop, 2, index, 1, control);
    const Unproven again = unproven_voxels(scene.splats(), level, kEdge, crop, 2, index, 5, control);
    CHECK(first.total == 1 && first.voxel == lost);
    CHECK(again.voxel == first.voxel && again.ellipsoid == first.ellipsoid);
  }
}

void test_tally_is_that_of_the_voxels() {
  Scene scene;
  std::mt19937 random(4);
  std::vector<float> opacity;
  for (float& m : scene.mean) m = 8 + 5 * m;  // in cells; some lie outside
  for (float& s : scene.scale) s *= 4;
  for (std::size_t i = 0; i < kEllipsoids; ++i)
    opacity.push_back(std::uniform_real_distribution<float>(0, 1)(random));
  const std::vector<float> limit{0.2f, 0.5f, 0.99f};
  const Index3 size{14, 12, 13};
  Control control;
  const OpacityTally one = tally_opacity(scene.splats(), opacity, limit, {0, 0, 0}, 1, size, 1, control);
  const OpacityTally many = tally_opacity(scene.splats(), opacity, limit, {0, 0, 0}, 1, size, 5, control);
  CHECK(one.gaussians == many.gaussians && one.cells == many.cells);

  std::int64_t above_rows = 0, above_cells = 0;  // of higher ranks
  for (std::size_t rank = limit.size() + 1; rank-- > 0;) {
    Scene part;
    part.mean.clear(), part.scale.clear(), part.quat.clear();
    for (std::size_t i = 0; i < kEllipsoids; ++i) {
      if (rank > 0 && opacity[i] < limit[rank - 1]) continue;
      const auto copy = [i](const std::vector<float>& from, std::vector<float>& to, std::size_t width) {
        for (std::size_t a = 0; a < width; ++a) to.push_back(from[width * i + a]);
      };
      copy(scene.mean, part.mean, 3), copy(scene.scale, part.scale, 3), copy(scene.quat, part.quat, 4);
    }
    const auto rows = static_cast<std::int64_t>(part.mean.size() / 3);
    const auto index = voxelize(part.splats(), {1, 0}, 1, std::nullopt, std::nullopt, 1, 2, control).voxels.index;
    std::int64_t cells = 0;
    for (std::size_t v = 0; v < index.size(); v += 3) {
      bool inside = true;
      for (std::size_t a = 0; a < 3; ++a) inside &= index[v + a] >= 0 && index[v + a] < size[a];
      cells += inside;
    }
    CHECK(one.gaussians[rank] == rows - above_rows && one.cells[rank] == cells - above_cells);
    CHECK(cells > above_cells && rows > above_rows);
    above_rows = rows, above_cells = cells;
  }
}

}  // namespace

int main() {
  test_voxels_are_proven();
  test_tally_is_that_of_the_voxels();
  return alula_failures != 0;
}
