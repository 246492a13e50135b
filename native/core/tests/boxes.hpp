// A set of boxes as polytopes.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/geometry/clearance.hpp"

namespace alula {

struct Boxes {
  std::vector<double> normals, offsets, vertices;
  std::vector<std::int64_t> plane_start{0}, vertex_start{0};

  void add(geometry::Vec3 low, geometry::Vec3 high) {
    for (int i = 0; i < 3; ++i) {
      for (int side = 0; side < 2; ++side) {
        for (int j = 0; j < 3; ++j) normals.push_back(i == j ? (side == 0 ? 1 : -1) : 0);
        offsets.push_back(side == 0 ? high[i] : -low[i]);
      }
    }
    for (int corner = 0; corner < 8; ++corner) {
      for (int i = 0; i < 3; ++i) vertices.push_back((corner >> i & 1) != 0 ? high[i] : low[i]);
    }
    plane_start.push_back(static_cast<std::int64_t>(offsets.size()));
    vertex_start.push_back(static_cast<std::int64_t>(vertices.size() / 3));
  }

  PolytopeSet set() const { return {normals, offsets, plane_start, vertices, vertex_start}; }
};

}  // namespace alula
