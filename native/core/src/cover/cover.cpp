#include <algorithm>

#include "alula/cover/merge.hpp"

namespace alula {

VoxelSets merged_sets(const VoxelSets& sets, std::span<const Merge> history) {
  const std::size_t leaves = sets.size();
  std::vector<bool> is_merged(leaves + history.size(), false);
  for (const Merge& m : history) is_merged[m.left] = is_merged[m.right] = true;
  VoxelSets result;
  std::vector<std::uint32_t> stack, members;
  for (std::uint32_t e = 0; e < is_merged.size(); ++e) {
    if (is_merged[e]) continue;
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
