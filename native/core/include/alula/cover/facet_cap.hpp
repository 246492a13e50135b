// Outer polytopes: hulls of voxels replaced by fewer half-spaces that contain them.
//
// An outer polytope has the six planes of the hull's bounding box, which bound it, and further
// planes of short integer normals, each with the exact support of the hull as its offset. So it
// contains the hull for every choice of planes; volumes only rank the planes.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/occupancy.hpp"

namespace alula {

inline constexpr std::int64_t kOuterNormal = (1 << 15) - 1;  // maximum |n_i| in any outer polytope
inline constexpr std::int64_t kShortNormal = 127;            // maximum |n_i| of the oblique planes chosen here

// The plane of the given outward normal that supports points.
LatticePlane supporting_plane(const std::array<std::int64_t, 3>& normal, std::span<const Lattice> points);

// The k-DOP of a hull for k = 6, 14, 18 or 26: the normals are the axes, with the corners, the edges or both of a
// cube. All k planes are present; vertices stay those of the hull. Throws std::invalid_argument for another k.
LatticePolytope kdop(const LatticePolytope& hull, std::size_t k);

// Oblique planes of a hull, the most useful first: each plane removes the maximum free volume,
// measured along vertical lines as in ExcessMeter, from what the box and the planes before it leave.
// The removed volume is submodular, so stale values are upper bounds and lazy greedy evaluation is exact.
struct RankedPlane {
  LatticePlane plane;
  double gain;  // [voxels], not increasing
};

// Ranks planes until `most` are chosen or no volume is left to remove. One per thread.
class FacetRanker {
 public:
  explicit FacetRanker(const Occupancy& occupancy) : occupancy_(&occupancy) {}
  std::vector<RankedPlane> operator()(const LatticePolytope& hull, std::size_t most);

 private:
  struct Line {
    double x, y, low, high, filled_low, filled_high;
    const Occupancy::Column* column;
  };
  struct Candidate {
    LatticePlane plane;
    double x, y, z, offset;  // local to the box
    double gain;
    std::size_t round;  // round in which `gain` was computed
  };

  void set_lines(const LatticeBox& box);
  void set_candidates(const LatticePolytope& hull, const LatticeBox& box);
  double removed(const Candidate& plane) const;
  void cut(const Candidate& plane);
  double filled(const Line& line, double z) const {
    return line.column == nullptr ? 0 : occupancy_->filled(*line.column, base_z_ + z);
  }

  const Occupancy* occupancy_;
  std::int32_t base_z_ = 0;
  double area_ = 1;  // area that one line represents [voxels^2]
  std::vector<Line> line_;
  std::vector<Candidate> candidate_;
};

// Replaces each hull of more than `cap` facets, or with normals beyond kOuterNormal, by an outer
// polytope of at most `cap` planes, cap >= 6; vertices stay those of the hull. The total is at most
// `planes` planes, at least six per hull. The planes go to the hulls where they remove the most volume: gains
// decrease along each hull's ranking, so choosing the largest gains is optimal.
void cap_facets(const Occupancy& occupancy, std::vector<LatticePolytope>& hulls, std::size_t cap, std::size_t planes,
                unsigned jobs, Control& control);

// The outer polytope of one hull.
LatticePolytope capped(FacetRanker& rank, LatticePolytope hull, std::size_t cap);

}  // namespace alula
