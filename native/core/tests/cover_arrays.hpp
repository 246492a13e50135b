// The flat arrays of a cover, as check_hulls() takes them.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/cover/cover_check.hpp"
#include "alula/cover/merge.hpp"

namespace alula {

struct CoverArrays {
  std::vector<std::int32_t> vertex, member;
  std::vector<std::int64_t> normal, offset, vertex_start{0}, plane_start{0}, member_start{0};

  CoverArrays(const Occupancy& occupancy, const Cover& cover) {
    for (std::size_t h = 0; h < cover.hull.size(); ++h) {
      for (const Lattice& v : cover.hull[h].vertex) vertex.insert(vertex.end(), v.begin(), v.end());
      for (const LatticePlane& p : cover.hull[h].plane) {
        normal.insert(normal.end(), p.normal.begin(), p.normal.end());
        offset.push_back(p.offset);
      }
      for (const std::uint32_t m : cover.members[h])
        member.insert(member.end(), occupancy.voxels()[m].begin(), occupancy.voxels()[m].end());
      vertex_start.push_back(static_cast<std::int64_t>(vertex.size() / 3));
      plane_start.push_back(static_cast<std::int64_t>(offset.size()));
      member_start.push_back(static_cast<std::int64_t>(member.size() / 3));
    }
  }
  CoverView view(bool is_outer = false) const {
    return {vertex, vertex_start, normal, offset, plane_start, member, member_start, is_outer};
  }
};

}  // namespace alula
