#include <algorithm>

#include "alula/cover/lattice_hull.hpp"

namespace alula {

void extreme_corners(std::span<const Lattice> voxels, std::vector<Lattice>& corners) {
  struct Span {
    std::int32_t y, low, high;
  };
  corners.clear();
  std::vector<Span> row, previous, merged;
  std::vector<std::array<std::int32_t, 2>> chain;

  // Emits the corners with x = plane that the columns of two neighbouring rows of voxels have.
  auto emit = [&](std::int32_t plane) {
    merged.clear();
    for (const auto* rows : {&previous, &row})
      for (const Span& s : *rows) merged.push_back(s), merged.push_back({s.y + 1, s.low, s.high});
    std::sort(merged.begin(), merged.end(), [](const Span& a, const Span& b) { return a.y < b.y; });
    std::size_t kept = 0;
    for (std::size_t i = 0; i < merged.size(); ++i) {
      if (kept > 0 && merged[kept - 1].y == merged[i].y) {
        merged[kept - 1].low = std::min(merged[kept - 1].low, merged[i].low);
        merged[kept - 1].high = std::max(merged[kept - 1].high, merged[i].high);
      } else {
        merged[kept++] = merged[i];
      }
    }
    for (const int side : {-1, 1}) {
      chain.clear();
      for (std::size_t i = 0; i < kept; ++i) {
        const std::array<std::int32_t, 2> p{merged[i].y, side > 0 ? merged[i].high : merged[i].low};
        while (chain.size() >= 2) {
          const auto &a = chain[chain.size() - 2], &b = chain.back();
          const std::int64_t turn =
              std::int64_t{b[0] - a[0]} * (p[1] - a[1]) - std::int64_t{b[1] - a[1]} * (p[0] - a[0]);
          if (side * turn < 0) break;
          chain.pop_back();
        }
        chain.push_back(p);
      }
      for (const auto& p : chain) corners.push_back({plane, p[0], p[1]});
    }
  };

  for (std::size_t i = 0; i < voxels.size();) {
    const std::int32_t x = voxels[i][0];
    row.clear();
    for (; i < voxels.size() && voxels[i][0] == x; ++i) {
      const std::int32_t y = voxels[i][1], z = voxels[i][2];
      if (row.empty() || row.back().y != y) row.push_back({y, z, z + 1});
      row.back().high = z + 1;
    }
    emit(x);
    previous.swap(row);
    if (i == voxels.size() || voxels[i][0] != x + 1) {
      row.clear();
      emit(x + 1);
      previous.clear();
    }
  }
}

}  // namespace alula
