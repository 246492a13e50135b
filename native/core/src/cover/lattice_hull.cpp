#include "alula/cover/lattice_hull.hpp"

#include <algorithm>
#include <cstdlib>
#include <numeric>
#include <stdexcept>

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

// The corners of voxels sorted by x, y, z, without those that cannot be extreme: only the lowest and the highest
// corner of each lattice column, and only the corners on the 2-D hull of each row of columns.
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
  const std::size_t points = point_.size(), slots = 3 * points + 8;
  if (facet_.size() < slots) facet_.resize(slots), stamp_.resize(slots);
  if (visible_.size() < slots) visible_.resize(slots);
  if (planes.x.size() < slots)
    for (auto* values : {&planes.x, &planes.y, &planes.z, &planes.offset, &planes.height}) values->resize(slots);
  if (first_facet_.size() < points) first_facet_.resize(points);
  free_.clear();
  std::fill(stamp_.begin(), stamp_.begin() + static_cast<std::ptrdiff_t>(slots), 0);
  round_ = 0;
  facets_ = 0;
}

template <class T>
void HullBuilder::put_plane(Planes<T>& planes, std::int32_t f) {
  const auto& [a, b, c] = facet_[f].vertex;
  const Point &p = point_[a], &q = point_[b], &r = point_[c];
  const auto edge = [&p](const Point& to, int i) { return static_cast<T>(static_cast<std::int32_t>(to[i] - p[i])); };
  const T ux = edge(q, 0), uy = edge(q, 1), uz = edge(q, 2), vx = edge(r, 0), vy = edge(r, 1), vz = edge(r, 2);
  const T x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
  planes.x[f] = x, planes.y[f] = y, planes.z[f] = z;
  planes.offset[f] = x * static_cast<T>(p[0]) + y * static_cast<T>(p[1]) + z * static_cast<T>(p[2]);
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
  for (std::int32_t f = 0; f < 4; ++f) put_plane(planes, f);
}

template <class T>
void HullBuilder::insert(Planes<T>& planes, std::int32_t p) {
  const T x = static_cast<T>(point_[p][0]), y = static_cast<T>(point_[p][1]), z = static_cast<T>(point_[p][2]);
  const std::int32_t count = facets_;
  const T *nx = planes.x.data(), *ny = planes.y.data(), *nz = planes.z.data(), *offset = planes.offset.data();
  T* height = planes.height.data();
  for (std::int32_t f = 0; f < count; ++f) height[f] = nx[f] * x + ny[f] * y + nz[f] * z - offset[f];
  std::int32_t visible = 0;
  for (std::int32_t f = 0; f < count; ++f) {
    visible_[visible] = f;
    visible += height[f] > 0;
  }
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
      put_plane(planes, made);
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
    for (int e = 0; e < 3; ++e) {
      const std::int32_t g = facet_[f].neighbour[e];
      if (g > f) continue;
      const auto& corner = facet_[g].vertex;
      const std::int32_t a = facet_[f].vertex[e], b = facet_[f].vertex[e == 2 ? 0 : e + 1];
      const std::int32_t far = corner[0] ^ corner[1] ^ corner[2] ^ a ^ b;  // the vertex off the common edge
      const Point& q = point_[far];
      is_new = is_new && x * static_cast<T>(q[0]) + y * static_cast<T>(q[1]) + z * static_cast<T>(q[2]) != offset;
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
    facets_ = static_cast<std::int32_t>(mesh.facet.size());
    std::copy(mesh.facet.begin(), mesh.facet.end(), facet_.begin());
    for (std::int32_t f = 0; f < facets_; ++f) put_plane(planes, f);
    for (std::int32_t p = known; p < static_cast<std::int32_t>(point_.size()); ++p) insert(planes, p);
    list_planes(planes);
  });
}

void HullBuilder::build_voxels(std::span<const Lattice> voxels) {
  extreme_corners(voxels, corner_);
  build(corner_);
}

std::vector<Lattice> HullBuilder::build_more(std::span<const Lattice> points, std::span<const Lattice> voxels) {
  extreme_corners(voxels, corner_);
  corner_.insert(corner_.begin(), points.begin(), points.end());
  build(corner_);
  return outline().vertex;
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
      const Point& p = point_[v];
      return x * static_cast<T>(p[0]) + y * static_cast<T>(p[1]) + z * static_cast<T>(p[2]) == offset;
    };
    group_facet_.push_back(seed);
    group_[seed] = id;
    stack_.assign(1, seed);
    while (!stack_.empty()) {
      const HullFacet& facet = facet_[stack_.back()];
      stack_.pop_back();
      for (const std::int32_t g : facet.neighbour) {
        if (group_[g] >= 0) continue;
        const auto& [a, b, c] = facet_[g].vertex;
        if (is_on(a) && is_on(b) && is_on(c)) {
          group_[g] = id;
          stack_.push_back(g);
        }
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
      std::array<std::int32_t, 3>& known = seen_[static_cast<std::size_t>(v)];
      for (std::int32_t& slot : known) {
        if (slot == group_[f]) break;
        if (slot < 0) {
          slot = group_[f];
          break;
        }
      }
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
