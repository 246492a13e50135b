// Counting, order and budgets of alula/cover/voxel_grid.hpp.
#include "alula/cover/voxel_grid.hpp"

#include <map>
#include <random>
#include <stdexcept>

#include "alula/base/parallel.hpp"
#include "check.hpp"

using namespace alula;

namespace {

std::vector<OverlapGrid::Run> random_runs(std::size_t count) {
  std::mt19937 random(5);
  const auto draw = [&](int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); };
  std::vector<OverlapGrid::Run> runs;
  for (std::size_t i = 0; i < count; ++i) {
    const int far = draw(0, 9) == 0 ? 2147480000 : 0, z = draw(-20, 20);
    runs.push_back({draw(-9, 9) + far, draw(-9, 9) - far, z, z + draw(0, 30)});
  }
  return runs;
}

void test_counts_and_order() {
  const auto runs = random_runs(5000);
  std::map<Index3, std::uint32_t> expected;
  for (const auto& run : runs)
    for (int z = run.first; z <= run.last; ++z) ++expected[{run.x, run.y, z}];
  for (const unsigned jobs : {1u, 6u}) {
    OverlapGrid grid;
    Control control;
    parallel_chunks(runs.size(), 100, jobs, control, [&](std::size_t begin, std::size_t end) {
      OverlapGrid::Writer writer(grid);
      for (std::size_t i = begin; i < end; ++i) writer.add(runs[i]);
      writer.finish();
    });
    for (const std::uint32_t minimum : {0u, 1u, 3u}) {
      const VoxelCounts found = grid.collect(minimum, jobs, control);
      std::size_t at = 0;
      for (const auto& [voxel, count] : expected) {
        if (count < minimum) continue;
        CHECK(at < found.count.size() && found.count[at] == count);
        for (std::size_t a = 0; a < 3; ++a) CHECK(found.index[3 * at + a] == voxel[a]);
        ++at;
      }
      CHECK(at == found.count.size());
    }
  }
}

bool refuses(std::size_t max_voxels, std::size_t max_bricks, const OverlapGrid::Run& step, int count) {
  OverlapGrid grid(max_voxels, max_bricks);
  try {
    OverlapGrid::Writer writer(grid);
    for (int i = 0; i < count; ++i) writer.add({step.x * i, step.y * i, step.first, step.last});
    writer.finish();
    Control control;
    CHECK(grid.collect(1, 1, control).count.size() == std::size_t(count) * std::size_t(step.last - step.first + 1));
  } catch (const std::overflow_error&) {
    return true;
  }
  return false;
}

void test_budgets() {
  CHECK(!refuses(1000, 100000, {1, 0, 0, 9}, 100));
  CHECK(refuses(999, 100000, {1, 0, 0, 9}, 100));
  CHECK(!refuses(100000, 64 * 64, {4, 4, 0, 0}, 1000));
  CHECK(refuses(100000, 500, {4, 4, 0, 0}, 1000));
}

void test_crop_range_is_exact() {
  const double g = 0.1;  // a little above 1/10: 0.3 lies below 3 g, whose nearest double lies above
  const CropRange range = crop_range(Box6{0.3, -0.3, 3 * g, 0.3, -0.3, 3 * g}, g);
  CHECK(range.lower[0] == 2 && range.upper[0] == 2);
  CHECK(range.lower[1] == -3 && range.upper[1] == -3);
  CHECK(range.lower[2] == 3 && range.upper[2] == 3);
  const CropRange corners = crop_range(Box6{0.75, -0.75, 0, 0.75, 0.5, 0.1}, 0.25);
  CHECK(corners.lower[0] == 2 && corners.upper[0] == 3);
  CHECK(corners.lower[1] == -4 && corners.upper[1] == 2);
  CHECK(corners.lower[2] == -1 && corners.upper[2] == 0);
}

void test_voxel_set() {
  const std::vector<std::int32_t> index{-1, -1, -1, 0, 7, 8, -8, -1, 5};
  const VoxelSet set(index);
  CHECK(set.brick({1, 0, 0}) == nullptr);
  const auto* bits = set.brick({-1, -1, -1});
  CHECK(bits != nullptr && (*bits)[7] == std::uint64_t{1} << 63);
  bits = set.brick({-1, -1, 0});
  CHECK(bits != nullptr && (*bits)[0] == std::uint64_t{1} << (7 * 8 + 5));
}

}  // namespace

int main() {
  test_counts_and_order();
  test_budgets();
  test_crop_range_is_exact();
  test_voxel_set();
  return alula_failures != 0;
}
