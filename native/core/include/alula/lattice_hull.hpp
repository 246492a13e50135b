// Exact convex hulls of integer points.
//
// Coordinates are taken relative to the lower corner of the points' bounding box, of extent L on
// its longest axis. A facet's normal is the cross product of two edges of a triangle in an L x L
// square, so |n_i| <= L^2 (twice the triangle's projected area), and |n . x| <= 3 L^3 for local x.
// With L <= 2^20 that is below 2^62: every predicate is exact in 64 bits. Offsets in the points'
// own coordinates stay below 3 L^2 2^20 < 2^62 because coordinates are limited to +-2^20 too.
//
// Points are inserted one by one; a facet is visible only when the point is strictly outside it.
// The strictly visible facets of a convex polytope project injectively onto a convex shadow, so
// their boundary is one simple cycle, and a point on the line of a boundary edge would lie in the
// plane of the visible facet next to it: no new facet is ever degenerate, and nothing is perturbed.
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <span>
#include <vector>

namespace alula {

using Lattice = std::array<std::int32_t, 3>;

inline constexpr std::int32_t kLatticeLimit = 1 << 20;  // of coordinates and of extents

// {x : normal . x <= offset}; the normal points outward.
struct LatticePlane {
  std::array<std::int64_t, 3> normal;
  std::int64_t offset;
  auto operator<=>(const LatticePlane&) const = default;
};

// A full-dimensional polytope: its extreme points and its facets' planes, each once and sorted;
// normals are primitive (gcd 1).
struct LatticePolytope {
  std::vector<Lattice> vertex;
  std::vector<LatticePlane> plane;
};

// Lower corner and extent of a box of lattice points.
struct LatticeBox {
  Lattice lower, upper;

  static LatticeBox empty() { return {{INT32_MAX, INT32_MAX, INT32_MAX}, {INT32_MIN, INT32_MIN, INT32_MIN}}; }
  void add(const Lattice& p);
  void add(const LatticeBox& other);
  bool touches(const LatticeBox& other) const;  // closed boxes
};

LatticeBox bounds(std::span<const Lattice> points);

// Builds hulls; keeps its memory between them. One per thread.
class HullBuilder {
 public:
  // A facet's plane in coordinates local to box().lower, not reduced; values are exact integers
  // up to L = 2^17 and rounded to 53 bits beyond.
  struct LocalPlane {
    double x, y, z, offset;
  };

  // Throws std::invalid_argument when the points span no volume or exceed kLatticeLimit.
  void build(std::span<const Lattice> points);

  // Hull of the closed unit cubes [v, v + 1] of voxels sorted by x, y, z; never degenerate.
  void build_voxels(std::span<const Lattice> voxels);

  const LatticeBox& box() const { return box_; }
  std::span<const LocalPlane> local_planes() const { return local_; }  // one per facet
  LatticePolytope polytope() const;

 private:
  struct Facet {
    std::array<std::int32_t, 3> vertex, neighbour;  // neighbour[e] across vertex[e], vertex[e + 1]
  };
  using Point = std::array<std::int64_t, 3>;

  std::int32_t add_facet(std::int32_t a, std::int32_t b, std::int32_t c);
  void start();
  void insert(std::int32_t p);
  void group_facets();

  LatticeBox box_{};
  std::vector<Point> point_;
  std::vector<Facet> facet_;
  std::vector<std::int64_t> nx_, ny_, nz_, offset_;  // all zero for a free slot: never visible
  std::vector<std::int32_t> free_, visible_, stamp_, first_facet_, fresh_;
  std::int32_t round_ = 0;
  std::vector<std::int32_t> group_, group_facet_, stack_;
  std::vector<LocalPlane> local_;
  std::vector<Lattice> corner_;
};

// The corners of voxels sorted by x, y, z, without those that cannot be extreme: of each lattice
// column the lowest and the highest, of each row of columns those on its 2-D hull.
void extreme_corners(std::span<const Lattice> voxels, std::vector<Lattice>& corners);

}  // namespace alula
