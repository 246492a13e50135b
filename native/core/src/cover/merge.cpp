#include "alula/cover/merge.hpp"

#include <algorithm>
#include <atomic>
#include <numeric>
#include <queue>
#include <string_view>

#include "alula/base/parallel.hpp"
#include "alula/cover/greedy_merge.hpp"
#include "alula/cover/retighten.hpp"

namespace alula {

namespace {

constexpr std::size_t kTileSets =
    4096;  // maximum number of sets of a tile: their elements fit in a processor's cache
constexpr std::size_t kSetsPerRest = 8;   // tiles merge until a fraction of the sets is left,
constexpr std::size_t kSetsPerEnd = 16;   // each of them somewhat further, and take back what was too much
constexpr double kExpectedGrowth = 0.05;  // where sets are tiled: 0.6 of the measurements, and as good a cover
constexpr std::size_t kTileShare = 700;   // of the time, in Share::kWhole, before tiles are joined
constexpr std::size_t kStageShare = 850;  // of the rest, before hulls are tightened for the first time

std::uint64_t fingerprint_of(const Occupancy& occupancy, const VoxelSets& sets, MergeRule rule, bool is_tiled) {
  const auto bytes = [](const auto& list) {
    return std::string_view(reinterpret_cast<const char*>(list.data()), list.size() * sizeof(list[0]));
  };
  const std::uint64_t kind = fingerprint(rule == MergeRule::kPaper ? "paper" : is_tiled ? "tiles" : "increase");
  return fingerprint(bytes(sets.start),
                     fingerprint(bytes(sets.member), fingerprint(bytes(occupancy.voxels()), kind)));
}

using TileSets = std::vector<std::vector<std::uint32_t>>;

// Divides the sets into boxes of space with about equally many sets, at most kTileSets each.
TileSets tile_sets(const Occupancy& occupancy, const VoxelSets& sets) {
  std::vector<std::uint32_t> number(sets.size());
  std::iota(number.begin(), number.end(), 0u);
  const auto place = [&](std::uint32_t set) -> const Lattice& { return occupancy.voxels()[sets[set].front()]; };
  TileSets tiles;
  const auto divide = [&](auto& self, std::size_t begin, std::size_t end) -> void {
    if (end - begin <= kTileSets) {
      tiles.emplace_back(number.begin() + static_cast<std::ptrdiff_t>(begin),
                         number.begin() + static_cast<std::ptrdiff_t>(end));
      std::sort(tiles.back().begin(), tiles.back().end());
      return;
    }
    LatticeBox box = LatticeBox::empty();
    for (std::size_t i = begin; i < end; ++i) box.add(place(number[i]));
    std::size_t axis = 0;
    for (std::size_t i = 1; i < 3; ++i)
      if (box.upper[i] - box.lower[i] > box.upper[axis] - box.lower[axis]) axis = i;
    const std::size_t middle = begin + (end - begin) / 2;
    const auto at = [&](std::size_t i) { return number.begin() + static_cast<std::ptrdiff_t>(i); };
    std::nth_element(at(begin), at(middle), at(end), [&](std::uint32_t a, std::uint32_t b) {
      return place(a)[axis] != place(b)[axis] ? place(a)[axis] < place(b)[axis] : a < b;
    });
    self(self, begin, middle), self(self, middle, end);
  };
  divide(divide, 0, number.size());
  return tiles;
}

// Counts the merges of all tiles; one for each tile, `merges` is common.
class TileControl final : public Control {
 public:
  TileControl(const Stop& stop, std::atomic<std::size_t>& merges) : stop_(stop), merges_(merges) {}
  void poll(std::size_t, std::size_t) override {
    stop_.check();
    ++merges_;
  }

 private:
  const Stop& stop_;
  std::atomic<std::size_t>& merges_;
};

// Reports the merges of all tiles instead of the number of finished tiles.
class TilesControl final : public Control {
 public:
  TilesControl(Control& outer, const std::atomic<std::size_t>& merges, std::size_t total)
      : outer_(outer), merges_(merges), total_(total) {}
  void poll(std::size_t, std::size_t) override { outer_.poll(std::min(merges_.load(), total_), total_); }

 private:
  Control& outer_;
  const std::atomic<std::size_t>& merges_;
  std::size_t total_;
};

// Appends a step to a cover's history and curve, its elements renumbered.
void append(Cover& cover, const MergeStep& step, std::uint32_t left, std::uint32_t right) {
  const CurvePoint& before = cover.curve.back();
  cover.history.push_back({std::min(left, right), std::max(left, right), step.merge.weight});
  cover.curve.push_back({before.hulls - 1, before.excess + step.excess,
                         static_cast<std::size_t>(static_cast<std::ptrdiff_t>(before.planes) + step.planes)});
}

// Merges each tile by itself, then takes the merges of all tiles in the order of their keys until `rest` elements
// are left.
Cover merge_tiles(const Occupancy& occupancy, const VoxelSets& sets, const MergeOptions& options, std::size_t rest,
                  unsigned jobs, Control& control, EvaluationLog* log) {
  const TileSets tiles = tile_sets(occupancy, sets);
  std::vector<MergeSteps> found(tiles.size());
  std::atomic<std::size_t> polls{0};
  TilesControl all(control, polls, 2 * sets.size());  // about one for each set and one for each merge
  parallel_chunks(tiles.size(), 1, jobs, all, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    for (std::size_t t = begin; t < end; ++t) {
      TileControl counted(stop, polls);
      MergeOptions alone;
      alone.rule = options.rule;
      alone.budget.form = options.budget.form;
      alone.expected_growth = kExpectedGrowth;
      alone.max_hulls = std::max<std::size_t>(1, tiles[t].size() / kSetsPerEnd);
      std::size_t before = 0;
      for (std::size_t i = 0; i < t; ++i) before += tiles[i].size();
      found[t] =
          greedy_merge(occupancy, sets, tiles[t], alone, 1, counted, log, static_cast<std::uint32_t>(2 * before));
    }
  });

  Cover cover;
  CurvePoint start{sets.size(), 0, 0};
  for (const MergeSteps& steps : found) start.excess += steps.start.excess, start.planes += steps.start.planes;
  cover.curve.push_back(start);
  std::vector<std::vector<std::uint32_t>> number = tiles;  // of each tile's elements in the cover
  std::vector<std::size_t> next(tiles.size(), 0);
  const auto later = [&](std::size_t a, std::size_t b) {
    const double x = found[a].step[next[a]].key, y = found[b].step[next[b]].key;
    return x != y ? x > y : a > b;
  };
  std::priority_queue<std::size_t, std::vector<std::size_t>, decltype(later)> queue(later);
  for (std::size_t t = 0; t < tiles.size(); ++t)
    if (!found[t].step.empty()) queue.push(t);
  while (!queue.empty() && cover.curve.back().hulls > rest) {
    const std::size_t t = queue.top();
    queue.pop();
    const MergeStep& step = found[t].step[next[t]++];
    number[t].push_back(static_cast<std::uint32_t>(sets.size() + cover.history.size()));
    append(cover, step, number[t][step.merge.left], number[t][step.merge.right]);
    if (next[t] < found[t].step.size()) queue.push(t);
  }
  return cover;
}

// Numbers of the elements that remain after the merges of the history, ascending.
std::vector<std::uint32_t> remaining(std::size_t leaves, std::span<const Merge> history) {
  std::vector<bool> is_merged(leaves + history.size(), false);
  for (const Merge& m : history) is_merged[m.left] = is_merged[m.right] = true;
  std::vector<std::uint32_t> number;
  for (std::uint32_t e = 0; e < is_merged.size(); ++e)
    if (!is_merged[e]) number.push_back(e);
  return number;
}

}  // namespace

Cover merge(const Occupancy& occupancy, const VoxelSets& sets, const MergeOptions& options, unsigned jobs,
            Control& control, EvaluationLog* log) {
  const std::size_t rest = sets.size() / kSetsPerRest, hulls = std::max(options.max_hulls, options.finest_hulls);
  const bool is_counted =
      options.rule == MergeRule::kIncrease && options.max_growth <= 0 && hulls > 0 && !options.budget.is_limit();
  const bool is_tiled = is_counted && sets.size() > kTileSets && hulls + hulls / 2 <= rest;
  const bool is_staged = is_counted && options.finest_hulls == 0;
  if (log != nullptr) log->open(fingerprint_of(occupancy, sets, options.rule, is_tiled));
  Share tiling(control, 0, kTileShare), joining(control, is_tiled ? kTileShare : 0, Share::kWhole);
  Cover cover;
  VoxelSets last = sets;
  if (is_tiled) {
    cover = merge_tiles(occupancy, sets, options, rest, jobs, tiling, log);
    last = merged_sets(sets, cover.history);
  }
  std::vector<std::uint32_t> number = remaining(sets.size(), cover.history);
  // Merges the sets `last`, which have these numbers in the cover, and replaces them by what remains.
  const auto go_on = [&](std::size_t max_hulls, Control& part, EvaluationLog* part_log) {
    std::vector<std::uint32_t> whole(last.size());
    std::iota(whole.begin(), whole.end(), 0u);
    MergeOptions some = options;
    some.max_hulls = max_hulls;
    if (is_tiled) some.expected_growth = kExpectedGrowth;
    const MergeSteps steps = greedy_merge(occupancy, last, whole, some, jobs, part, part_log,
                                          is_tiled ? static_cast<std::uint32_t>(2 * sets.size()) : 0);
    (cover.curve.empty() ? cover.curve.emplace_back() : cover.curve.back()) = steps.start;
    std::vector<Merge> history;
    for (const MergeStep& step : steps.step) {
      history.push_back(step.merge);
      const std::uint32_t made = static_cast<std::uint32_t>(sets.size() + cover.history.size());
      append(cover, step, number[step.merge.left], number[step.merge.right]);
      number.push_back(made);
    }
    cover.within_budget = steps.within_budget;
    std::vector<std::uint32_t> kept;
    for (const std::uint32_t i : remaining(last.size(), history)) kept.push_back(number[i]);
    number = std::move(kept);
    last = merged_sets(last, history);
  };
  if (is_staged) {
    Share early(joining, 0, kStageShare), late(joining, kStageShare, Share::kWhole);
    go_on(options.max_hulls + options.max_hulls * 3 / 10, early, log);
    if (last.size() > options.max_hulls) {
      Cover tight;
      tight.hull = hulls_of(occupancy, last, jobs, late);
      tight.members = std::move(last);
      InterruptOnly quiet(late);
      std::vector<std::uint32_t> kept;
      for (const std::size_t h : retighten(occupancy, tight, {}, jobs, quiet)) kept.push_back(number[h]);
      number = std::move(kept);
      last = std::move(tight.members);
      go_on(options.max_hulls, late, nullptr);
    }
  } else {
    go_on(options.max_hulls, joining, log);
  }
  cover.members = std::move(last);
  cover.hull = hulls_of(occupancy, cover.members, jobs, joining);
  return cover;
}

std::vector<LatticePolytope> hulls_of(const Occupancy& occupancy, const VoxelSets& members, unsigned jobs,
                                      Control& control) {
  std::vector<LatticePolytope> hulls(members.size());
  InterruptOnly quiet(control);
  parallel_chunks(hulls.size(), 8, jobs, quiet, [&](std::size_t begin, std::size_t end) {
    HullBuilder builder;
    std::vector<Lattice> voxels;
    for (std::size_t h = begin; h < end; ++h) {
      voxels.clear();
      for (const std::uint32_t v : members[h]) voxels.push_back(occupancy.voxels()[v]);
      builder.build_voxels(voxels);
      hulls[h] = builder.polytope();
    }
  });
  return hulls;
}

VoxelSets merged_sets(const VoxelSets& sets, std::span<const Merge> history) {
  const std::size_t leaves = sets.size();
  VoxelSets result;
  std::vector<std::uint32_t> stack, members;
  for (const std::uint32_t e : remaining(leaves, history)) {
    members.clear();
    stack.assign(1, e);
    while (!stack.empty()) {
      const std::uint32_t id = stack.back();
      stack.pop_back();
      if (id < leaves) {
        members.insert(members.end(), sets[id].begin(), sets[id].end());
      } else {
        stack.push_back(history[id - leaves].left), stack.push_back(history[id - leaves].right);
      }
    }
    std::sort(members.begin(), members.end());
    members.erase(std::unique(members.begin(), members.end()), members.end());
    result.member.insert(result.member.end(), members.begin(), members.end());
    result.close();
  }
  return result;
}

void sort_hulls(Cover& cover) {
  std::vector<std::size_t> order(cover.hull.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const auto left = cover.members[a], right = cover.members[b];
    if (!std::equal(left.begin(), left.end(), right.begin(), right.end()))
      return std::lexicographical_compare(left.begin(), left.end(), right.begin(), right.end());
    return a < b;
  });
  std::vector<LatticePolytope> hull;
  VoxelSets members;
  for (const std::size_t i : order) {
    hull.push_back(std::move(cover.hull[i]));
    members.member.insert(members.member.end(), cover.members[i].begin(), cover.members[i].end());
    members.close();
  }
  cover.hull = std::move(hull);
  cover.members = std::move(members);
}

}  // namespace alula
