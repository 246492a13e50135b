// Voxels and their proof are the same for any number of threads, and a missing voxel is always found.
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

}  // namespace

int main() {
  test_voxels_are_proven();
  return alula_failures != 0;
}
