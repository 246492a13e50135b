#include "alula/lattice_hull.hpp"

#include <algorithm>
#include <cstdlib>
#include <numeric>
#include <stdexcept>

namespace alula {

void LatticeBox::add(const Lattice& p) {
  for (int i = 0; i < 3; ++i) lower[i] = std::min(lower[i], p[i]), upper[i] = std::max(upper[i], p[i]);
}

void LatticeBox::add(const LatticeBox& other) {
  for (int i = 0; i < 3; ++i)
    lower[i] = std::min(lower[i], other.lower[i]), upper[i] = std::max(upper[i], other.upper[i]);
}

bool LatticeBox::touches(const LatticeBox& other) const {
  for (int i = 0; i < 3; ++i)
    if (lower[i] > other.upper[i] || other.lower[i] > upper[i]) return false;
  return true;
}

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

constexpr std::size_t kOrderFrom = 48;  // fewer points are inserted in the order they come

// Brings points that are extreme in the 26 directions of a cube to the front: a large first hull
// leaves most of the others inside.
void extremes_first(std::vector<Point>& points) {
  std::vector<std::size_t> chosen;
  for (int d = 0; d < 27; ++d) {
    const Point direction{d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1};
    std::size_t best = 0;
    for (std::size_t i = 1; i < points.size(); ++i)
      if (dot(points[i], direction) > dot(points[best], direction)) best = i;
    chosen.push_back(best);
  }
  std::sort(chosen.begin(), chosen.end());
  chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
  for (std::size_t i = 0; i < chosen.size(); ++i) std::swap(points[i], points[chosen[i]]);
}

}  // namespace

std::int32_t HullBuilder::add_facet(std::int32_t a, std::int32_t b, std::int32_t c) {
  const Point n = cross(minus(point_[b], point_[a]), minus(point_[c], point_[a]));
  std::int32_t f;
  if (free_.empty()) {
    f = static_cast<std::int32_t>(facet_.size());
    facet_.emplace_back(), stamp_.push_back(0);
    nx_.emplace_back(), ny_.emplace_back(), nz_.emplace_back(), offset_.emplace_back();
  } else {
    f = free_.back();
    free_.pop_back();
  }
  facet_[f].vertex = {a, b, c};
  nx_[f] = n[0], ny_[f] = n[1], nz_[f] = n[2];
  offset_[f] = dot(n, point_[a]);
  return f;
}

// A large first tetrahedron; its points are moved to slots 0 to 3.
void HullBuilder::start() {
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
  add_facet(0, 1, 2), add_facet(1, 0, 3), add_facet(2, 1, 3), add_facet(0, 2, 3);
  facet_[0].neighbour = {1, 2, 3};
  facet_[1].neighbour = {0, 3, 2};
  facet_[2].neighbour = {0, 1, 3};
  facet_[3].neighbour = {0, 2, 1};
}

void HullBuilder::insert(std::int32_t p) {
  const auto [x, y, z] = point_[p];
  visible_.clear();
  const std::int32_t count = static_cast<std::int32_t>(facet_.size());
  ++round_;
  const std::int64_t *nx = nx_.data(), *ny = ny_.data(), *nz = nz_.data(), *offset = offset_.data();
  for (std::int32_t f = 0; f < count; ++f)
    if (nx[f] * x + ny[f] * y + nz[f] * z > offset[f]) visible_.push_back(f), stamp_[f] = round_;
  if (visible_.empty()) return;
  fresh_.clear();
  for (const std::int32_t f : visible_) {
    for (int e = 0; e < 3; ++e) {
      const std::int32_t outer = facet_[f].neighbour[e];
      if (stamp_[outer] == round_) continue;
      const std::int32_t a = facet_[f].vertex[e], b = facet_[f].vertex[(e + 1) % 3];
      const std::int32_t made = add_facet(a, b, p);  // free slots are never visible ones
      facet_[made].neighbour[0] = outer;
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
  for (const std::int32_t f : visible_) {
    nx_[f] = ny_[f] = nz_[f] = offset_[f] = 0;
    facet_[f].vertex[0] = -1;
    free_.push_back(f);
  }
}

// Facets whose triangles share a plane and an edge become one; a plane touches a convex polytope
// in one connected face, so groups and planes are the same.
void HullBuilder::group_facets() {
  group_.assign(facet_.size(), -1);
  group_facet_.clear();
  local_.clear();
  for (std::int32_t seed = 0; seed < static_cast<std::int32_t>(facet_.size()); ++seed) {
    if (group_[seed] >= 0 || facet_[seed].vertex[0] < 0) continue;
    const std::int32_t id = static_cast<std::int32_t>(group_facet_.size());
    const Point n{nx_[seed], ny_[seed], nz_[seed]};
    const auto height = [&n, o = offset_[seed]](const Point& p) { return static_cast<std::uint64_t>(dot(n, p) - o); };
    group_facet_.push_back(seed);
    local_.push_back({static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2]),
                      static_cast<double>(offset_[seed])});
    group_[seed] = id;
    stack_.assign(1, seed);
    while (!stack_.empty()) {
      const Facet& facet = facet_[stack_.back()];
      stack_.pop_back();
      for (int e = 0; e < 3; ++e) {
        const std::int32_t g = facet.neighbour[e];
        if (group_[g] >= 0) continue;
        const auto& [a, b, c] = facet_[g].vertex;
        // Two of the three are on the plane; the sum wraps around, the third one's distance does not.
        if (height(point_[a]) + height(point_[b]) + height(point_[c]) == 0) {
          group_[g] = id;
          stack_.push_back(g);
        }
      }
    }
  }
}

void HullBuilder::build(std::span<const Lattice> points) {
  if (points.empty()) throw std::invalid_argument("no points");
  box_ = bounds(points);
  for (int i = 0; i < 3; ++i) {
    if (box_.lower[i] < -kLatticeLimit || box_.upper[i] > kLatticeLimit ||
        box_.upper[i] - box_.lower[i] > kLatticeLimit)
      throw std::invalid_argument("points exceed the exact range of 2^20 lattice steps");
  }
  point_.resize(points.size());
  for (std::size_t i = 0; i < points.size(); ++i)
    for (int c = 0; c < 3; ++c) point_[i][c] = points[i][c] - box_.lower[c];
  if (point_.size() >= kOrderFrom) extremes_first(point_);
  facet_.clear(), stamp_.clear(), free_.clear();
  nx_.clear(), ny_.clear(), nz_.clear(), offset_.clear();
  round_ = 0;
  first_facet_.assign(point_.size(), -1);
  start();
  for (std::int32_t p = 4; p < static_cast<std::int32_t>(point_.size()); ++p) insert(p);
  group_facets();
}

void HullBuilder::build_voxels(std::span<const Lattice> voxels) {
  extreme_corners(voxels, corner_);
  build(corner_);
}

LatticePolytope HullBuilder::polytope() const {
  LatticePolytope result;
  result.plane.reserve(group_facet_.size());
  for (const std::int32_t f : group_facet_) {
    const std::int64_t divisor = std::gcd(std::gcd(nx_[f], ny_[f]), nz_[f]);
    LatticePlane plane{{nx_[f] / divisor, ny_[f] / divisor, nz_[f] / divisor}, offset_[f] / divisor};
    for (int i = 0; i < 3; ++i) plane.offset += plane.normal[i] * box_.lower[i];
    result.plane.push_back(plane);
  }
  // A point of the boundary is extreme exactly when three facets meet in it.
  std::vector<std::array<std::int32_t, 3>> seen(point_.size(), {-1, -1, -1});
  for (std::size_t f = 0; f < facet_.size(); ++f) {
    if (facet_[f].vertex[0] < 0) continue;
    for (const std::int32_t v : facet_[f].vertex) {
      std::array<std::int32_t, 3>& known = seen[static_cast<std::size_t>(v)];
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
    if (seen[v][2] < 0) continue;
    Lattice p;
    for (int i = 0; i < 3; ++i) p[i] = static_cast<std::int32_t>(point_[v][i]) + box_.lower[i];
    result.vertex.push_back(p);
  }
  std::sort(result.plane.begin(), result.plane.end());
  std::sort(result.vertex.begin(), result.vertex.end());
  return result;
}

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

}  // namespace alula
