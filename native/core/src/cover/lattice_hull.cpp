#include "alula/cover/lattice_hull.hpp"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numeric>
#include <stdexcept>

#include "alula/base/wide.hpp"

// The incremental convex hull, one algorithm from top to bottom: the choice and order of the points, the insertion of
// points, and the conversion to polytopes and meshes.
namespace alula {

LatticeBox bounds(std::span<const Lattice> points) {
  LatticeBox box = LatticeBox::empty();
  for (const Lattice& p : points) box.add(p);
  return box;
}

namespace {

using Point = std::array<std::int64_t, 3>;

Point minus(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

Point cross(const Point& a, const Point& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

std::int64_t dot(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

constexpr std::size_t kOrderFrom = 48;  // fewer points are inserted in the given order

// Moves points that are extreme in the 26 directions of a cube to the front: most other points are inside a large
// first hull.
void extremes_first(std::vector<Point>& points) {
  std::array<std::size_t, 26> chosen{};
  std::array<std::int64_t, 13> low, high;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto [x, y, z] = points[i];
    const std::array<std::int64_t, 13> along{x,     y,     z,         x + y,     x - y,     x + z,    x - z,
                                             y + z, y - z, x + y + z, x + y - z, x - y + z, x - y - z};
    if (i == 0) low = high = along;
    for (std::size_t d = 0; d < along.size(); ++d) {
      if (along[d] < low[d]) low[d] = along[d], chosen[2 * d] = i;
      if (along[d] > high[d]) high[d] = along[d], chosen[2 * d + 1] = i;
    }
  }
  std::sort(chosen.begin(), chosen.end());
  const auto end = std::unique(chosen.begin(), chosen.end());
  std::size_t front = 0;
  for (auto it = chosen.begin(); it != end; ++it) std::swap(points[front++], points[*it]);
}

// Lists the facets below `count` that the point (x, y, z) lies strictly above, ascending. The arrays of planes have
// a multiple of kBlock elements.
constexpr std::int32_t kBlock = 32;

template <class T>
[[gnu::always_inline]] inline std::int32_t list_above(const T* nx, const T* ny, const T* nz, const T* offset,
                                                      std::int32_t count, T x, T y, T z, std::int32_t* above) {
  using Vector __attribute__((vector_size(32))) = T;
  using Flags = decltype(Vector{} > Vector{});
  constexpr int kWidth = 32 / static_cast<int>(sizeof(T));
  Flags lane;
  for (int i = 0; i < kWidth; ++i) lane[i] = 1 << i;
  std::int32_t found = 0;
  for (std::int32_t f = 0; f < count; f += kBlock) {
    Flags flags{};
    for (int v = 0; v < kBlock; v += kWidth) {
      Vector a, b, c, d;
      std::memcpy(&a, nx + f + v, sizeof a), std::memcpy(&b, ny + f + v, sizeof b);
      std::memcpy(&c, nz + f + v, sizeof c), std::memcpy(&d, offset + f + v, sizeof d);
      flags |= (a * x + b * y + c * z - d > 0) & (lane << v);
    }
    std::uint32_t bits = 0;
    for (int i = 0; i < kWidth; ++i) bits |= static_cast<std::uint32_t>(flags[i]);
    if (count - f < kBlock) bits &= (1u << (count - f)) - 1;
    for (; bits != 0; bits &= bits - 1) above[found++] = f + std::countr_zero(bits);
  }
  return found;
}

ALULA_WIDE std::int32_t facets_above(const float* nx, const float* ny, const float* nz, const float* offset,
                                     std::int32_t count, const std::array<float, 4>& p, std::int32_t* above) {
  return list_above(nx, ny, nz, offset, count, p[0], p[1], p[2], above);
}

ALULA_WIDE std::int32_t facets_above(const double* nx, const double* ny, const double* nz, const double* offset,
                                     std::int32_t count, const std::array<double, 4>& p, std::int32_t* above) {
  return list_above(nx, ny, nz, offset, count, p[0], p[1], p[2], above);
}

std::int32_t facets_above(const std::int64_t* nx, const std::int64_t* ny, const std::int64_t* nz,
                          const std::int64_t* offset, std::int32_t count, const std::array<std::int64_t, 4>& p,
                          std::int32_t* above) {
  return list_above(nx, ny, nz, offset, count, p[0], p[1], p[2], above);
}

}  // namespace

template <class Run>
void HullBuilder::with_planes(Run&& run) {
  std::int32_t extent = 0;
  for (int i = 0; i < 3; ++i) extent = std::max(extent, box_.upper[i] - box_.lower[i]);
  if (extent <= 177) {
    run(narrow_);
  } else if (extent <= (1 << 17)) {
    run(middle_);
  } else {
    run(wide_);
  }
}

// Reserves memory for the maximum number of facets: 2 n - 4, and n new ones beside the visible ones.
template <class T>
void HullBuilder::reserve(Planes<T>& planes) {
  const std::size_t points = point_.size(), slots = (3 * points + 8 + kBlock - 1) / kBlock * kBlock;
  if (facet_.size() < slots) facet_.resize(slots), stamp_.resize(slots);
  if (visible_.size() < slots) visible_.resize(slots);
  if (planes.x.size() < slots)
    for (auto* values : {&planes.x, &planes.y, &planes.z, &planes.offset}) values->resize(slots);
  if (first_facet_.size() < points) first_facet_.resize(points);
  free_.clear();
  if (round_ > std::numeric_limits<std::int32_t>::max() / 2) {  // stamps of earlier hulls are below the next round
    std::fill(stamp_.begin(), stamp_.end(), 0);
    round_ = 0;
  }
  facets_ = 0;
}

template <class T>
void HullBuilder::put_points(Planes<T>& planes) {
  planes.point.resize(point_.size());
  for (std::size_t p = 0; p < point_.size(); ++p)
    for (std::size_t i = 0; i < 3; ++i) planes.point[p][i] = static_cast<T>(static_cast<std::int32_t>(point_[p][i]));
}

template <class T>
void HullBuilder::put_plane(Planes<T>& planes, std::int32_t f) {
  const auto& [a, b, c] = facet_[f].vertex;
  put_plane(planes, f, planes.point[a], planes.point[b], planes.point[c]);
}

template <class T>
[[gnu::always_inline]] inline void HullBuilder::put_plane(Planes<T>& planes, std::int32_t f, const Corner<T>& q,
                                                          const Corner<T>& r, const Corner<T>& p) {
  const T ux = q[0] - p[0], uy = q[1] - p[1], uz = q[2] - p[2], vx = r[0] - p[0], vy = r[1] - p[1], vz = r[2] - p[2];
  const T x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
  planes.x[f] = x, planes.y[f] = y, planes.z[f] = z;
  planes.offset[f] = x * p[0] + y * p[1] + z * p[2];
}

// Builds a large first tetrahedron; its points are moved to slots 0 to 3.
template <class T>
void HullBuilder::start(Planes<T>& planes) {
  const auto [low, high] = std::minmax_element(point_.begin(), point_.end());
  const std::size_t i0 = static_cast<std::size_t>(low - point_.begin());
  std::size_t i1 = static_cast<std::size_t>(high - point_.begin());
  std::swap(point_[0], point_[i0]);
  if (i1 == 0) i1 = i0;
  if (point_.size() < 4 || point_[i1] == point_[0]) throw std::invalid_argument("points span no volume");
  std::swap(point_[1], point_[i1]);
  double widest = 0;
  std::size_t i2 = 0, i3 = 0;
  for (std::size_t i = 2; i < point_.size(); ++i) {
    const Point n = cross(minus(point_[1], point_[0]), minus(point_[i], point_[0]));
    double area = 0;
    for (const std::int64_t c : n) area += static_cast<double>(c) * static_cast<double>(c);
    if (area > widest) widest = area, i2 = i;
  }
  if (i2 == 0) throw std::invalid_argument("points span no volume");
  std::swap(point_[2], point_[i2]);
  const Point n = cross(minus(point_[1], point_[0]), minus(point_[2], point_[0]));
  std::int64_t highest = 0, height = 0;
  for (std::size_t i = 3; i < point_.size(); ++i) {
    const std::int64_t h = dot(n, minus(point_[i], point_[0]));
    if (std::abs(h) > highest) highest = std::abs(h), height = h, i3 = i;
  }
  if (i3 == 0) throw std::invalid_argument("points span no volume");
  std::swap(point_[3], point_[i3]);
  if (height > 0) std::swap(point_[1], point_[2]);  // point 3 lies below facet 0 1 2
  facets_ = 4;
  facet_[0] = {{0, 1, 2}, {1, 2, 3}};
  facet_[1] = {{1, 0, 3}, {0, 3, 2}};
  facet_[2] = {{2, 1, 3}, {0, 1, 3}};
  facet_[3] = {{0, 2, 3}, {0, 2, 1}};
  put_points(planes);
  for (std::int32_t f = 0; f < 4; ++f) put_plane(planes, f);
}

template <class T>
void HullBuilder::insert(Planes<T>& planes, std::int32_t p) {
  const Corner<T> point = planes.point[p];
  const std::int32_t visible = facets_above(planes.x.data(), planes.y.data(), planes.z.data(), planes.offset.data(),
                                            facets_, point, visible_.data());
  if (visible == 0) return;
  ++round_;
  for (std::int32_t i = 0; i < visible; ++i) stamp_[visible_[i]] = round_;
  fresh_.clear();
  for (std::int32_t i = 0; i < visible; ++i) {
    const HullFacet& seen = facet_[visible_[i]];
    for (int e = 0; e < 3; ++e) {
      const std::int32_t outer = seen.neighbour[e];
      if (stamp_[outer] == round_) continue;
      const std::int32_t a = seen.vertex[e], b = seen.vertex[e == 2 ? 0 : e + 1];
      std::int32_t made = facets_;
      if (free_.empty()) {
        ++facets_;
      } else {  // free slots are never visible facets
        made = free_.back();
        free_.pop_back();
      }
      stamp_[made] = 0;
      facet_[made].vertex = {a, b, p};
      facet_[made].neighbour[0] = outer;
      put_plane(planes, made, planes.point[a], planes.point[b], point);
      int back = 0;
      while (facet_[outer].vertex[back] != b) ++back;
      facet_[outer].neighbour[back] = made;
      first_facet_[a] = made;
      fresh_.push_back(made);
    }
  }
  for (const std::int32_t made : fresh_) {
    const std::int32_t next = first_facet_[facet_[made].vertex[1]];
    facet_[made].neighbour[1] = next;
    facet_[next].neighbour[2] = made;
  }
  for (std::int32_t i = 0; i < visible; ++i) {
    const std::int32_t f = visible_[i];
    planes.x[f] = planes.y[f] = planes.z[f] = planes.offset[f] = 0;
    facet_[f].vertex[0] = -1;
    free_.push_back(f);
  }
}

// The vertex of the neighbour across an edge that is not on that edge.
std::int32_t HullBuilder::far_vertex(const HullFacet& facet, int edge) const {
  const auto& [a, b, c] = facet_[facet.neighbour[edge]].vertex;
  return a ^ b ^ c ^ facet.vertex[edge] ^ facet.vertex[edge == 2 ? 0 : edge + 1];
}

// Lists one plane per facet, except facets in the same plane as an earlier neighbour.
template <class T>
void HullBuilder::list_planes(const Planes<T>& planes) {
  local_.clear();
  is_box_ = true;
  for (std::int32_t f = 0; f < facets_; ++f) {
    if (facet_[f].vertex[0] < 0) continue;
    const T x = planes.x[f], y = planes.y[f], z = planes.z[f], offset = planes.offset[f];
    is_box_ = is_box_ && (x != 0) + (y != 0) + (z != 0) == 1;
    bool is_new = true;
    for (int e = 0; e < 3 && is_new; ++e) {
      if (facet_[f].neighbour[e] > f) continue;
      const Corner<T>& q = planes.point[far_vertex(facet_[f], e)];
      is_new = x * q[0] + y * q[1] + z * q[2] != offset;
    }
    if (is_new)
      local_.push_back(
          {static_cast<double>(x), static_cast<double>(y), static_cast<double>(z), static_cast<double>(offset)});
  }
}

void HullBuilder::set_points(std::span<const Lattice> points, std::span<const Lattice> more) {
  box_ = bounds(points);
  box_.add(bounds(more));
  for (int i = 0; i < 3; ++i) {
    if (box_.lower[i] < -kLatticeLimit || box_.upper[i] > kLatticeLimit ||
        box_.upper[i] - box_.lower[i] > kLatticeLimit)
      throw std::invalid_argument("points exceed the exact range of 2^20 lattice steps");
  }
  point_.clear();
  for (const auto& list : {points, more})
    for (const Lattice& p : list)
      point_.push_back({p[0] - box_.lower[0], p[1] - box_.lower[1], p[2] - box_.lower[2]});
}

// Adds the corners of voxels sorted by x, y, z, without those that cannot be extreme: only the lowest and the highest
// corner of each lattice column, and only the corners on the 2-D hull of each row of columns.
void HullBuilder::add_corners(std::span<const Lattice> voxels) {
  row_.clear(), previous_.clear();
  for (std::size_t i = 0; i < voxels.size();) {
    const std::int32_t x = voxels[i][0];
    row_.clear();
    for (; i < voxels.size() && voxels[i][0] == x; ++i) {
      const std::int32_t y = voxels[i][1], z = voxels[i][2];
      if (row_.empty() || row_.back().y != y) row_.push_back({y, z, z + 1});
      row_.back().high = z + 1;
    }
    add_plane(x);
    previous_.swap(row_);
    if (i == voxels.size() || voxels[i][0] != x + 1) {
      row_.clear();
      add_plane(x + 1);
      previous_.clear();
    }
  }
}

// Adds the corners with x = plane that the columns of two neighbouring rows of voxels have.
void HullBuilder::add_plane(std::int32_t plane) {
  lines_.clear();
  const auto add = [this](const Span& s) {
    if (lines_.empty() || lines_.back().y != s.y) {
      lines_.push_back(s);
    } else {
      lines_.back().low = std::min(lines_.back().low, s.low),
      lines_.back().high = std::max(lines_.back().high, s.high);
    }
  };
  for (std::size_t i = 0, j = 0; i < previous_.size() || j < row_.size();) {
    Span s;
    if (j == row_.size() || (i < previous_.size() && previous_[i].y < row_[j].y)) {
      s = previous_[i++];
    } else {
      s = row_[j++];
      if (i < previous_.size() && previous_[i].y == s.y) {
        s.low = std::min(s.low, previous_[i].low), s.high = std::max(s.high, previous_[i].high);
        ++i;
      }
    }
    add(s);
    ++s.y;
    add(s);
  }
  for (const int side : {-1, 1}) {
    chain_.clear();
    for (const Span& line : lines_) {
      const std::array<std::int32_t, 2> p{line.y, side > 0 ? line.high : line.low};
      while (chain_.size() >= 2) {
        const auto &a = chain_[chain_.size() - 2], &b = chain_.back();
        const std::int64_t turn =
            std::int64_t{b[0] - a[0]} * (p[1] - a[1]) - std::int64_t{b[1] - a[1]} * (p[0] - a[0]);
        if (side * turn < 0) break;
        chain_.pop_back();
      }
      chain_.push_back(p);
    }
    for (const auto& p : chain_) corner_.push_back({plane, p[0], p[1]});
  }
}

void HullBuilder::build(std::span<const Lattice> points) {
  if (points.empty()) throw std::invalid_argument("no points");
  set_points(points, {});
  if (point_.size() >= kOrderFrom) extremes_first(point_);
  with_planes([&](auto& planes) {
    reserve(planes);
    start(planes);
    for (std::int32_t p = 4; p < static_cast<std::int32_t>(point_.size()); ++p) insert(planes, p);
    list_planes(planes);
  });
}

void HullBuilder::build_union(const HullMesh& mesh, std::span<const Lattice> points) {
  set_points(mesh.point, points);
  const std::int32_t known = static_cast<std::int32_t>(mesh.point.size());
  // The farthest point in the direction of the new points goes first: most of the others are then inside.
  Point sum{0, 0, 0}, other{0, 0, 0};
  for (std::size_t p = 0; p < point_.size(); ++p)
    for (int i = 0; i < 3; ++i) (p < mesh.point.size() ? sum : other)[i] += point_[p][i];
  Point direction;
  for (int i = 0; i < 3; ++i)
    direction[i] = other[i] / static_cast<std::int64_t>(std::max<std::size_t>(points.size(), 1)) - sum[i] / known;
  std::size_t best = mesh.point.size();
  for (std::size_t p = best + 1; p < point_.size(); ++p)
    if (dot(direction, point_[p]) > dot(direction, point_[best])) best = p;
  if (!points.empty()) std::swap(point_[static_cast<std::size_t>(known)], point_[best]);
  with_planes([&](auto& planes) {
    reserve(planes);
    put_points(planes);
    facets_ = static_cast<std::int32_t>(mesh.facet.size());
    std::copy(mesh.facet.begin(), mesh.facet.end(), facet_.begin());
    for (std::int32_t f = 0; f < facets_; ++f) put_plane(planes, f);
    for (std::int32_t p = known; p < static_cast<std::int32_t>(point_.size()); ++p) insert(planes, p);
    list_planes(planes);
  });
}

void HullBuilder::build_voxels(std::span<const Lattice> voxels) { build_mixed({}, voxels); }

std::span<const Lattice> HullBuilder::corners(std::span<const Lattice> voxels) {
  corner_.clear();
  add_corners(voxels);
  return corner_;
}

void HullBuilder::build_mixed(std::span<const Lattice> points, std::span<const Lattice> voxels) {
  corner_.assign(points.begin(), points.end());
  add_corners(voxels);
  build(corner_);
}

HullMesh HullBuilder::mesh() {
  HullMesh result;
  std::vector<std::int32_t>& number = group_;
  number.assign(point_.size() + static_cast<std::size_t>(facets_), -1);
  std::int32_t* facet_number = number.data() + point_.size();
  std::int32_t facets = 0;
  for (std::int32_t f = 0; f < facets_; ++f)
    if (facet_[f].vertex[0] >= 0) facet_number[f] = facets++;
  result.facet.reserve(static_cast<std::size_t>(facets));
  for (std::int32_t f = 0; f < facets_; ++f) {
    if (facet_[f].vertex[0] < 0) continue;
    HullFacet facet = facet_[f];
    for (int e = 0; e < 3; ++e) {
      std::int32_t& v = number[static_cast<std::size_t>(facet.vertex[e])];
      if (v < 0) {
        v = static_cast<std::int32_t>(result.point.size());
        Lattice p;
        for (int i = 0; i < 3; ++i) p[i] = static_cast<std::int32_t>(point_[facet.vertex[e]][i]) + box_.lower[i];
        result.point.push_back(p);
      }
      facet.vertex[e] = v;
      facet.neighbour[e] = facet_number[facet.neighbour[e]];
    }
    result.facet.push_back(facet);
  }
  return result;
}

LatticePolytope HullBuilder::polytope() {
  LatticePolytope result;
  with_planes([&](auto& planes) { result = grouped(planes); });
  return result;
}

HullBuilder::Outline HullBuilder::outline() {
  with_planes([&](auto& planes) { group_facets(planes); });
  return {extreme_points(), group_facet_.size()};
}

// Groups triangles that share a plane and an edge into one facet. A plane touches a convex polytope
// in one connected face, so groups and planes correspond one to one.
template <class T>
void HullBuilder::group_facets(const Planes<T>& planes) {
  group_.assign(static_cast<std::size_t>(facets_), -1);
  group_facet_.clear();
  for (std::int32_t seed = 0; seed < facets_; ++seed) {
    if (group_[seed] >= 0 || facet_[seed].vertex[0] < 0) continue;
    const std::int32_t id = static_cast<std::int32_t>(group_facet_.size());
    const T x = planes.x[seed], y = planes.y[seed], z = planes.z[seed], offset = planes.offset[seed];
    const auto is_on = [&](std::int32_t v) {
      const Corner<T>& p = planes.point[v];
      return x * p[0] + y * p[1] + z * p[2] == offset;
    };
    group_facet_.push_back(seed);
    group_[seed] = id;
    stack_.assign(1, seed);
    while (!stack_.empty()) {
      const HullFacet& facet = facet_[stack_.back()];
      stack_.pop_back();
      for (int e = 0; e < 3; ++e) {
        const std::int32_t g = facet.neighbour[e];
        if (group_[g] >= 0 || !is_on(far_vertex(facet, e))) continue;
        group_[g] = id;
        stack_.push_back(g);
      }
    }
  }
}

// A point of the boundary is extreme exactly when three facets meet in it.
std::vector<Lattice> HullBuilder::extreme_points() {
  std::vector<Lattice> result;
  seen_.assign(point_.size(), {-1, -1, -1});
  for (std::int32_t f = 0; f < facets_; ++f) {
    if (facet_[f].vertex[0] < 0) continue;
    for (const std::int32_t v : facet_[f].vertex) {
      auto& [first, second, third] = seen_[static_cast<std::size_t>(v)];
      if (third >= 0 || first == group_[f] || second == group_[f]) continue;
      (first < 0 ? first : second < 0 ? second : third) = group_[f];
    }
  }
  for (std::size_t v = 0; v < point_.size(); ++v) {
    if (seen_[v][2] < 0) continue;
    Lattice p;
    for (int i = 0; i < 3; ++i) p[i] = static_cast<std::int32_t>(point_[v][i]) + box_.lower[i];
    result.push_back(p);
  }
  return result;
}

template <class T>
LatticePolytope HullBuilder::grouped(const Planes<T>& planes) {
  group_facets(planes);
  LatticePolytope result;
  result.plane.reserve(group_facet_.size());
  for (const std::int32_t f : group_facet_) {
    const Point n{static_cast<std::int64_t>(planes.x[f]), static_cast<std::int64_t>(planes.y[f]),
                  static_cast<std::int64_t>(planes.z[f])};
    const std::int64_t divisor = std::gcd(std::gcd(n[0], n[1]), n[2]);
    LatticePlane plane{{n[0] / divisor, n[1] / divisor, n[2] / divisor},
                       static_cast<std::int64_t>(planes.offset[f]) / divisor};
    for (int i = 0; i < 3; ++i) plane.offset += plane.normal[i] * box_.lower[i];
    result.plane.push_back(plane);
  }
  result.vertex = extreme_points();
  std::sort(result.plane.begin(), result.plane.end());
  std::sort(result.vertex.begin(), result.vertex.end());
  return result;
}

}  // namespace alula
