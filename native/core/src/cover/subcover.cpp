#include "alula/cover/subcover.hpp"

#include <algorithm>
#include <array>
#include <queue>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

constexpr std::size_t kTileVoxels = 65536;   // of the tiles that are covered by disjoint sets, each by itself
constexpr std::size_t kWeighingShare = 700;  // of the time, in Share::kWhole, before the first choice

// Calls visit(first, last, dx, dy) for the runs of voxel numbers in a voxel's neighbourhood.
template <class Visit>
void for_runs(const Occupancy& occupancy, std::uint32_t voxel, int block, Visit&& visit) {
  const Lattice v = occupancy.voxels()[voxel];
  for (int dx = -block; dx <= block; ++dx) {
    for (int dy = -block; dy <= block; ++dy) {
      const Occupancy::Column* column = occupancy.find(v[0] + dx, v[1] + dy);
      if (column == nullptr) continue;
      const std::uint32_t first = occupancy.lower(*column, v[2] - block);
      const std::uint32_t last = occupancy.lower(*column, v[2] + block + 1);
      if (last > first) visit(first, last, dx, dy);
    }
  }
}

std::uint32_t neighbour_mask(const Occupancy& occupancy, std::uint32_t voxel) {
  std::uint32_t mask = 0;
  const std::int32_t z = occupancy.voxels()[voxel][2];
  for_runs(occupancy, voxel, 1, [&](std::uint32_t first, std::uint32_t last, int dx, int dy) {
    for (std::uint32_t u = first; u < last; ++u)
      mask |= 1u << (9 * (dx + 1) + 3 * (dy + 1) + occupancy.voxels()[u][2] - z + 1);
  });
  return mask;
}

double cluster_weight(const Occupancy& occupancy, std::uint32_t voxel, int block, HullBuilder& hull,
                      ExcessMeter& excess, std::vector<Lattice>& cluster) {
  cluster.clear();
  for_runs(occupancy, voxel, block, [&](std::uint32_t first, std::uint32_t last, int, int) {
    cluster.insert(cluster.end(), occupancy.voxels().begin() + first, occupancy.voxels().begin() + last);
  });
  hull.build_voxels(cluster);
  return excess(hull);
}

std::vector<double> cluster_weights(const Occupancy& occupancy, int block, unsigned jobs, Control& control) {
  const std::size_t count = occupancy.size();
  InterruptOnly quiet(control);
  std::vector<std::uint32_t> mask, pattern(count), sample;
  if (block == 1) {
    mask.resize(count);
    parallel_chunks(count, 4096, jobs, quiet, [&](std::size_t begin, std::size_t end) {
      for (std::size_t v = begin; v < end; ++v) mask[v] = neighbour_mask(occupancy, static_cast<std::uint32_t>(v));
    });
    std::vector<std::uint32_t> order(count);
    for (std::uint32_t v = 0; v < count; ++v) order[v] = v;
    std::sort(order.begin(), order.end(),
              [&](std::uint32_t a, std::uint32_t b) { return mask[a] != mask[b] ? mask[a] < mask[b] : a < b; });
    for (std::size_t i = 0; i < count; ++i) {
      if (i == 0 || mask[order[i]] != mask[order[i - 1]]) sample.push_back(order[i]);
      pattern[order[i]] = static_cast<std::uint32_t>(sample.size() - 1);
    }
  } else {
    sample.resize(count);
    for (std::uint32_t v = 0; v < count; ++v) sample[v] = pattern[v] = v;
  }
  std::vector<double> of_pattern(sample.size());
  parallel_chunks(sample.size(), 256, jobs, control, [&](std::size_t begin, std::size_t end) {
    HullBuilder hull;
    ExcessMeter excess(occupancy);
    std::vector<Lattice> cluster;
    for (std::size_t p = begin; p < end; ++p)
      of_pattern[p] = cluster_weight(occupancy, sample[p], block, hull, excess, cluster);
  });
  std::vector<double> weight(count);
  for (std::size_t v = 0; v < count; ++v) weight[v] = of_pattern[pattern[v]];
  return weight;
}

struct CandidateCluster {
  double price;                    // weight per newly covered voxel
  std::uint32_t uncovered, voxel;  // number of newly covered voxels; centre of the cluster
  // The best candidate is the top of a heap.
  bool operator<(const CandidateCluster& other) const {
    if (price != other.price) return price > other.price;
    if (uncovered != other.uncovered) return uncovered < other.uncovered;
    return voxel > other.voxel;
  }
};

// The runs of voxel numbers in the neighbourhoods of the voxels begin .. end - 1. They are stored for the common
// block of 1, where there are at most nine, because the greedy cover needs each many times.
class Neighbourhoods {
 public:
  Neighbourhoods(const Occupancy& occupancy, int block, std::size_t begin, std::size_t end)
      : occupancy_(occupancy), block_(block), begin_(begin) {
    if (block != 1) return;
    runs_.resize(end - begin);
    for (std::size_t v = begin; v < end; ++v) {
      Runs& runs = runs_[v - begin];
      for_runs(occupancy, static_cast<std::uint32_t>(v), 1, [&](std::uint32_t first, std::uint32_t last, int, int) {
        runs.first[runs.count] = first;
        runs.length[runs.count++] = static_cast<std::uint8_t>(last - first);
      });
    }
  }

  // Calls visit(number) for the voxels around one, including itself.
  template <class Visit>
  void each(std::uint32_t voxel, Visit&& visit) const {
    if (block_ == 1) {
      const Runs& runs = runs_[voxel - begin_];
      for (std::size_t i = 0; i < runs.count; ++i)
        for (std::uint32_t u = runs.first[i]; u < runs.first[i] + runs.length[i]; ++u) visit(u);
    } else {
      for_runs(occupancy_, voxel, block_, [&](std::uint32_t first, std::uint32_t last, int, int) {
        for (std::uint32_t u = first; u < last; ++u) visit(u);
      });
    }
  }

 private:
  struct Runs {
    std::array<std::uint32_t, 9> first;
    std::array<std::uint8_t, 9> length;
    std::uint8_t count = 0;
  };
  const Occupancy& occupancy_;
  int block_;
  std::size_t begin_;
  std::vector<Runs> runs_;
};

// Covers the voxels begin .. end - 1 by clusters of voxels among them; calls done(newly covered) after each choice.
// Candidates only get worse as voxels are covered, so a candidate that is still on top after its update is the best
// of all (lazy greedy).
template <class Done>
VoxelSets chosen(const Occupancy& occupancy, int block, std::span<const double> weight, std::size_t begin,
                 std::size_t end, bool is_disjoint, Done&& done) {
  const Neighbourhoods around(occupancy, block, begin, end);
  std::vector<std::uint8_t> covered(end - begin, 0);
  const auto each = [&](std::uint32_t v, auto&& visit) {
    around.each(v, [&](std::uint32_t u) {
      if (u >= begin && u < end) visit(u);
    });
  };
  std::vector<std::uint32_t> uncovered(end - begin, 0);  // around each voxel
  for (std::size_t v = begin; v < end; ++v)
    each(static_cast<std::uint32_t>(v), [&](std::uint32_t) { ++uncovered[v - begin]; });
  const auto candidate = [&](std::uint32_t v) {
    const std::uint32_t left = uncovered[v - begin];
    return CandidateCluster{left == 0 ? 0 : weight[v] / left, left, v};
  };
  std::vector<CandidateCluster> all(end - begin);
  for (std::size_t v = begin; v < end; ++v) all[v - begin] = candidate(static_cast<std::uint32_t>(v));
  std::priority_queue<CandidateCluster> queue(std::less<CandidateCluster>{}, std::move(all));
  VoxelSets result;
  std::size_t left = end - begin;
  while (left > 0) {
    const CandidateCluster now = candidate(queue.top().voxel);
    queue.pop();
    if (now.uncovered == 0) continue;
    if (!queue.empty() && now < queue.top()) {
      queue.push(now);
      continue;
    }
    each(now.voxel, [&](std::uint32_t u) {
      const bool is_new = covered[u - begin] == 0;
      if (!is_disjoint || is_new) result.member.push_back(u);
      if (!is_new) return;
      covered[u - begin] = 1;
      each(u, [&](std::uint32_t v) { --uncovered[v - begin]; });
    });
    result.close();
    left -= now.uncovered;
    done(now.uncovered);
  }
  return result;
}

}  // namespace

VoxelSets subcover(const Occupancy& occupancy, int block, bool is_disjoint, unsigned jobs, Control& control) {
  Share weighing(control, 0, kWeighingShare), choosing(control, kWeighingShare, Share::kWhole);
  const std::vector<double> weight = cluster_weights(occupancy, block, jobs, weighing);
  const std::size_t count = occupancy.size();
  if (!is_disjoint) {
    std::size_t covered = 0, sets = 0;
    return chosen(occupancy, block, weight, 0, count, false, [&](std::uint32_t newly) {
      covered += newly;
      if (++sets % 256 == 0) choosing.poll(covered, count);
    });
  }
  std::vector<VoxelSets> part((count + kTileVoxels - 1) / kTileVoxels);
  parallel_chunks(count, kTileVoxels, jobs, choosing, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    part[begin / kTileVoxels] =
        chosen(occupancy, block, weight, begin, end, true, [&](std::uint32_t) { stop.check(); });
  });
  VoxelSets result;
  for (const VoxelSets& sets : part)
    for (std::size_t i = 0; i < sets.size(); ++i) {
      result.member.insert(result.member.end(), sets[i].begin(), sets[i].end());
      result.close();
    }
  return result;
}

}  // namespace alula
