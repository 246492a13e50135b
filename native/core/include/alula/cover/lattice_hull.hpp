// Exact convex hulls of integer points.
//
// Coordinates are taken relative to the lower corner of the points' bounding box, of extent L on
// its longest axis. A facet's normal is the cross product of two edges of a triangle in an L x L
// square, so |n_i| <= L^2 (twice the triangle's projected area), and |n . x| <= 3 L^3 for local x.
// With L <= 2^20 that is below 2^62: every predicate is exact in 64 bits. Offsets in the points'
// own coordinates stay below 3 L^2 2^20 < 2^62 because coordinates are limited to +-2^20 too.
//
// Points are inserted one by one (incremental hull); a facet is visible only when the point is strictly outside it.
// The strictly visible facets of a convex polytope project injectively onto a convex shadow, so
// their boundary is one simple cycle, and a point on the line of a boundary edge would lie in the
// plane of the visible facet next to it: no new facet is ever degenerate, and nothing is perturbed.
#pragma once

#include <algorithm>
#include <array>
#include <compare>
#include <cstdint>
#include <span>
#include <vector>

namespace alula {

using Lattice = std::array<std::int32_t, 3>;

inline constexpr std::int32_t kLatticeLimit = 1 << 20;  // limit of coordinates and extents

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
  void add(const Lattice& p) {
    for (int i = 0; i < 3; ++i) lower[i] = std::min(lower[i], p[i]), upper[i] = std::max(upper[i], p[i]);
  }
  void add(const LatticeBox& other) {
    for (int i = 0; i < 3; ++i)
      lower[i] = std::min(lower[i], other.lower[i]), upper[i] = std::max(upper[i], other.upper[i]);
  }
  bool touches(const LatticeBox& other) const {  // closed boxes
    for (int i = 0; i < 3; ++i)
      if (lower[i] > other.upper[i] || other.lower[i] > upper[i]) return false;
    return true;
  }
};

LatticeBox bounds(std::span<const Lattice> points);

inline double volume(const LatticeBox& box) {
  double product = 1;
  for (int i = 0; i < 3; ++i) product *= box.upper[i] - box.lower[i];
  return product;
}

// A triangle of a hull's boundary, counter-clockwise from outside.
struct HullFacet {
  std::array<std::int32_t, 3> vertex, neighbour;  // neighbour[e] across vertex[e], vertex[e + 1]
};

// The triangulated boundary of a hull; some points may lie inside a face or an edge.
struct HullMesh {
  std::vector<Lattice> point;
  std::vector<HullFacet> facet;
};

// Builds hulls; keeps its memory between them. One per thread.
//
// Arithmetic is exact in float up to L = 177 (3 L^3 < 2^24), in double up to 2^17 (3 L^3 < 2^53)
// and in int64; the narrowest type is used, and all give the same hulls. A difference n . x - d of two
// exact numbers may be rounded, which keeps its sign.
class HullBuilder {
 public:
  // A facet's plane in coordinates local to box().lower, not reduced; values are exact integers
  // up to L = 2^17 and rounded to 53 bits beyond. Planes may repeat.
  struct LocalPlane {
    double x, y, z, offset;
  };

  // Throws std::invalid_argument when the points span no volume or exceed kLatticeLimit.
  void build(std::span<const Lattice> points);

  // Hull of a hull and further points; the cost depends on the points outside the hull.
  void build_union(const HullMesh& mesh, std::span<const Lattice> points);

  // Hull of the closed unit cubes [v, v + 1] of voxels sorted by x, y, z; never degenerate.
  void build_voxels(std::span<const Lattice> voxels);

  // The corners of voxels sorted by x, y, z that may be extreme; valid until the next call.
  std::span<const Lattice> corners(std::span<const Lattice> voxels);

  // Hull of points and of voxels sorted by x, y, z, of which one may be none.
  void build_mixed(std::span<const Lattice> points, std::span<const Lattice> voxels);

  const LatticeBox& box() const { return box_; }
  bool is_box() const { return is_box_; }  // the hull fills box()
  std::span<const LocalPlane> local_planes() const { return local_; }
  LatticePolytope polytope();
  HullMesh mesh();

  // The extreme points, in no particular order, and the number of facets.
  struct Outline {
    std::vector<Lattice> vertex;
    std::size_t planes;
  };
  Outline outline();

 private:
  using Point = std::array<std::int64_t, 3>;
  template <class T>
  using Corner = std::array<T, 4>;  // x, y, z and nothing
  template <class T>
  struct Planes {
    std::vector<T> x, y, z, offset;  // all zero for a free slot, which is never visible
    std::vector<Corner<T>> point;
  };

  // A column of voxels of one row.
  struct Span {
    std::int32_t y, low, high;
  };

  template <class Run>
  void with_planes(Run&& run);
  template <class T>
  void reserve(Planes<T>& planes);
  template <class T>
  void put_points(Planes<T>& planes);
  template <class T>
  void put_plane(Planes<T>& planes, std::int32_t facet);
  template <class T>
  void put_plane(Planes<T>& planes, std::int32_t facet, const Corner<T>& a, const Corner<T>& b, const Corner<T>& c);
  template <class T>
  void start(Planes<T>& planes);
  template <class T>
  void insert(Planes<T>& planes, std::int32_t p);
  template <class T>
  void list_planes(const Planes<T>& planes);
  template <class T>
  void group_facets(const Planes<T>& planes);
  std::int32_t far_vertex(const HullFacet& facet, int edge) const;
  std::vector<Lattice> extreme_points();
  template <class T>
  LatticePolytope grouped(const Planes<T>& planes);
  void set_points(std::span<const Lattice> points, std::span<const Lattice> more);
  void add_corners(std::span<const Lattice> voxels);
  void add_plane(std::int32_t plane);

  LatticeBox box_{};
  bool is_box_ = false;
  std::vector<Point> point_;
  std::int32_t facets_ = 0;  // slots in use, free ones among them
  std::vector<HullFacet> facet_;
  Planes<float> narrow_;
  Planes<double> middle_;
  Planes<std::int64_t> wide_;
  std::vector<std::int32_t> free_, visible_, stamp_, first_facet_, fresh_;
  std::int32_t round_ = 0;
  std::vector<std::int32_t> group_, group_facet_, stack_;
  std::vector<std::array<std::int32_t, 3>> seen_;  // facets at a point
  std::vector<LocalPlane> local_;
  std::vector<Lattice> corner_;
  std::vector<Span> row_, previous_, lines_;
  std::vector<std::array<std::int32_t, 2>> chain_;
};

}  // namespace alula
