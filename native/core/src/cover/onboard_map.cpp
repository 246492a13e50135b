#include "alula/cover/onboard_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <stdexcept>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/geometry/facet_area.hpp"

namespace alula {

namespace {

using ShortNormal = std::array<std::int32_t, 3>;

constexpr std::size_t kMostPlanes = 255;  // a byte counts them
constexpr std::uint32_t kMostHullDepth = 0xFFFF, kMostKdopDepth = 0x7FF;
constexpr double kLeastFacet = 1e-6;  // [voxel faces]; a plane with a smaller facet is not worth its bytes

struct CutPlane {
  ShortNormal normal;
  std::int64_t depth;  // depth of the cut from the box corner that is farthest along the normal
};

struct QuantisedHull {
  Lattice lower, upper;
  std::vector<CutPlane> plane;
};

// The normals of {-1, 0, 1}^3 with two or three components, in lexicographic order.
std::vector<ShortNormal> oblique_directions() {
  std::vector<ShortNormal> all;
  for (std::int32_t x = -1; x <= 1; ++x)
    for (std::int32_t y = -1; y <= 1; ++y)
      for (std::int32_t z = -1; z <= 1; ++z)
        if (std::abs(x) + std::abs(y) + std::abs(z) >= 2) all.push_back({x, y, z});
  return all;
}

std::int32_t largest_component(const ShortNormal& n) {
  return std::max({std::abs(n[0]), std::abs(n[1]), std::abs(n[2])});
}

bool is_oblique(const ShortNormal& n) { return (n[0] != 0) + (n[1] != 0) + (n[2] != 0) >= 2; }

// The normal with |n_i| <= largest that is nearest to `exact` in angle; among equally near ones the shortest.
ShortNormal nearest_normal(const std::int64_t* exact, std::int32_t largest) {
  const std::array<double, 3> n{static_cast<double>(exact[0]), static_cast<double>(exact[1]),
                                static_cast<double>(exact[2])};
  const double longest = std::max({std::abs(n[0]), std::abs(n[1]), std::abs(n[2])});
  ShortNormal best{};
  if (longest <= largest) {
    for (std::size_t i = 0; i < 3; ++i) best[i] = static_cast<std::int32_t>(exact[i]);
    return best;
  }
  double smallest = 2;  // sin^2 of the angle, times |exact|^2 / longest^2
  for (std::int32_t m = 1; m <= largest; ++m) {
    const double scale = m / longest;
    std::array<double, 3> r{};
    for (std::size_t i = 0; i < 3; ++i) r[i] = std::round(n[i] * scale);
    const double square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2];
    double sine = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      const std::size_t j = (i + 1) % 3, k = (i + 2) % 3;
      const double c = (n[j] * r[k] - n[k] * r[j]) / longest;
      sine += c * c;
    }
    sine /= square;
    if (sine >= smallest) continue;
    smallest = sine;
    for (std::size_t i = 0; i < 3; ++i) best[i] = static_cast<std::int32_t>(r[i]);
  }
  return best;
}

// n . (the farthest corner of the box) - max over the vertices of n . v; not negative.
std::int64_t depth_of(const ShortNormal& n, const QuantisedHull& hull, std::span<const std::int32_t> vertex) {
  std::int64_t support = INT64_MIN, corner = 0;
  for (std::size_t v = 0; v < vertex.size(); v += 3)
    support = std::max(support, std::int64_t{n[0]} * vertex[v] + std::int64_t{n[1]} * vertex[v + 1] +
                                    std::int64_t{n[2]} * vertex[v + 2]);
  for (std::size_t i = 0; i < 3; ++i) corner += std::int64_t{n[i]} * (n[i] > 0 ? hull.upper[i] : hull.lower[i]);
  return corner - support;
}

// Removes planes without a facet of their own, then the planes with the smallest facets beyond kMostPlanes.
void drop_idle_planes(QuantisedHull& hull) {
  std::vector<CutPlane>& plane = hull.plane;
  geometry::FacetArea facet({static_cast<double>(hull.upper[0]) - hull.lower[0],
                             static_cast<double>(hull.upper[1]) - hull.lower[1],
                             static_cast<double>(hull.upper[2]) - hull.lower[2]});
  for (const CutPlane& p : plane) {
    const geometry::Vec3 n{static_cast<double>(p.normal[0]), static_cast<double>(p.normal[1]),
                           static_cast<double>(p.normal[2])};
    double corner = 0;
    for (std::size_t i = 0; i < 3; ++i)
      if (p.normal[i] > 0) corner += p.normal[i] * (static_cast<double>(hull.upper[i]) - hull.lower[i]);
    facet.add(n, corner - static_cast<double>(p.depth));
  }
  std::vector<std::pair<double, std::size_t>> kept;
  for (std::size_t l = 0; l < plane.size(); ++l) {
    const double area = facet(l);
    if (area > kLeastFacet)
      kept.emplace_back(-area, l);
    else
      facet.remove(l);
  }
  if (kept.size() > kMostPlanes) {
    std::sort(kept.begin(), kept.end());
    kept.resize(kMostPlanes);
  }
  std::vector<CutPlane> left;
  for (const auto& [area, l] : kept) left.push_back(plane[l]);
  std::sort(left.begin(), left.end(), [](const CutPlane& a, const CutPlane& b) { return a.normal < b.normal; });
  plane = std::move(left);
}

QuantisedHull quantise(std::span<const std::int32_t> vertex, std::span<const std::int64_t> normal,
                       std::int32_t largest, const std::vector<ShortNormal>& directions) {
  const std::span<const Lattice> points(reinterpret_cast<const Lattice*>(vertex.data()), vertex.size() / 3);
  const LatticeBox box = bounds(points);
  QuantisedHull hull{box.lower, box.upper, {}};
  for (std::size_t i = 0; i < 3; ++i)
    if (points.empty() || hull.lower[i] >= hull.upper[i]) throw std::invalid_argument("a hull has no volume");
  std::vector<ShortNormal> candidate;
  bool is_exact = true;
  for (std::size_t p = 0; p < normal.size(); p += 3) {
    for (std::size_t i = 0; i < 3; ++i) is_exact = is_exact && std::llabs(normal[p + i]) <= largest;
    candidate.push_back(nearest_normal(&normal[p], largest));
  }
  if (!is_exact && largest == 1) candidate = directions;
  std::sort(candidate.begin(), candidate.end());
  candidate.erase(std::unique(candidate.begin(), candidate.end()), candidate.end());
  for (const ShortNormal& n : candidate) {
    if (!is_oblique(n)) continue;
    const std::int64_t depth = depth_of(n, hull, vertex);
    if (depth > 0) hull.plane.push_back({n, depth});
  }
  drop_idle_planes(hull);
  return hull;
}

int shift_of(const QuantisedHull& hull, std::uint32_t most) {
  std::int64_t deepest = 0;
  for (const CutPlane& p : hull.plane) deepest = std::max(deepest, p.depth);
  int shift = 0;
  while ((deepest >> shift) > most) ++shift;
  return shift;
}

void put16(std::vector<std::uint8_t>& bytes, std::uint32_t value) {
  bytes.push_back(static_cast<std::uint8_t>(value & 0xFF));
  bytes.push_back(static_cast<std::uint8_t>(value >> 8 & 0xFF));
}

class RecordWriter {
 public:
  RecordWriter(const Lattice& origin, bool is_kdop, std::int32_t largest, const std::vector<ShortNormal>& directions)
      : origin_(origin), is_kdop_(is_kdop), largest_(largest), directions_(directions) {}

  // Writes the record of a hull and counts it in `records`.
  std::vector<std::uint8_t> operator()(QuantisedHull& hull, MapRecords& records) const {
    int shift = shift_of(hull, is_kdop_ ? kMostKdopDepth : kMostHullDepth);
    if (shift > 0 && !is_kdop_) {  // with longer normals the unit 2^shift is a smaller distance
      for (CutPlane& p : hull.plane) {
        const std::int32_t factor = largest_ / largest_component(p.normal);
        for (std::int32_t& n : p.normal) n *= factor;
        p.depth *= factor;
      }
      shift = shift_of(hull, kMostHullDepth);
    }
    std::erase_if(hull.plane, [&](const CutPlane& p) { return p.depth >> shift == 0; });
    std::vector<std::uint8_t> bytes;
    for (const Lattice& corner : {hull.lower, hull.upper})
      for (std::size_t i = 0; i < 3; ++i) put16(bytes, local(corner[i], origin_[i]));
    bytes.push_back(static_cast<std::uint8_t>(hull.plane.size()));
    bytes.push_back(static_cast<std::uint8_t>(shift));
    for (const CutPlane& p : hull.plane) {
      const std::uint32_t depth = static_cast<std::uint32_t>(p.depth >> shift);  // rounds down, which is outward
      if (is_kdop_) {
        const auto number = std::lower_bound(directions_.begin(), directions_.end(), p.normal) - directions_.begin();
        put16(bytes, static_cast<std::uint32_t>(number) | depth << 5);
      } else {
        for (const std::int32_t n : p.normal) bytes.push_back(static_cast<std::uint8_t>(n & 0xFF));
        put16(bytes, depth);
      }
      records.largest_normal = std::max(records.largest_normal, largest_component(p.normal));
    }
    records.planes += hull.plane.size();
    records.largest_shift = std::max(records.largest_shift, shift);
    return bytes;
  }

 private:
  static std::uint32_t local(std::int32_t coordinate, std::int32_t origin) {
    const std::int64_t value = std::int64_t{coordinate} - origin;
    if (value < INT16_MIN || value > INT16_MAX) throw std::overflow_error("a coordinate does not fit into 16 bits");
    return static_cast<std::uint32_t>(value) & 0xFFFF;
  }

  Lattice origin_;
  bool is_kdop_;
  std::int32_t largest_;
  const std::vector<ShortNormal>& directions_;
};

// The bits of the centre's coordinates, x first, interleaved from the highest.
std::uint64_t morton_code(const QuantisedHull& hull, const Lattice& origin) {
  std::uint64_t code = 0;
  for (int bit = 17; bit >= 0; --bit) {
    for (std::size_t i = 0; i < 3; ++i) {
      const std::int64_t twice = std::int64_t{hull.lower[i]} + hull.upper[i] - 2 * std::int64_t{origin[i]} + 65536;
      code = code << 1 | static_cast<std::uint64_t>(twice >> bit & 1);
    }
  }
  return code;
}

void check(const HullView& hulls, int largest_normal) {
  if (largest_normal < 1 || largest_normal > 127) throw std::invalid_argument("the largest normal is 1 to 127");
  auto partition = [](std::span<const std::int64_t> start, std::size_t rows) {
    return !start.empty() && start.front() == 0 && start.back() == static_cast<std::int64_t>(rows) &&
           std::is_sorted(start.begin(), start.end());
  };
  if (hulls.vertex_start.size() != hulls.plane_start.size() ||
      !partition(hulls.vertex_start, hulls.vertex.size() / 3) ||
      !partition(hulls.plane_start, hulls.plane_normal.size() / 3))
    throw std::invalid_argument("starts do not partition the rows");
}

}  // namespace

MapRecords encode_map_records(const HullView& hulls, const Lattice& origin, int largest_normal, unsigned jobs,
                              Control& control) {
  check(hulls, largest_normal);
  const std::vector<ShortNormal> directions = oblique_directions();
  const std::size_t count = hulls.vertex_start.size() - 1;
  std::vector<QuantisedHull> quantised(count);
  parallel_chunks(count, 16, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t h = begin; h < end; ++h) {
      auto rows = [h](auto all, std::span<const std::int64_t> start) {
        return all.subspan(3 * static_cast<std::size_t>(start[h]),
                           3 * static_cast<std::size_t>(start[h + 1] - start[h]));
      };
      quantised[h] = quantise(rows(hulls.vertex, hulls.vertex_start), rows(hulls.plane_normal, hulls.plane_start),
                              largest_normal, directions);
    }
  });
  MapRecords records;
  std::int32_t largest = 1;
  for (const QuantisedHull& hull : quantised)
    for (const CutPlane& p : hull.plane) largest = std::max(largest, largest_component(p.normal));
  records.is_kdop = largest == 1;

  const RecordWriter write(origin, records.is_kdop, largest_normal, directions);
  struct Entry {
    std::uint64_t code;
    std::vector<std::uint8_t> bytes;
    bool operator<(const Entry& other) const {
      if (code != other.code) return code < other.code;
      return std::lexicographical_compare(bytes.begin(), bytes.end(), other.bytes.begin(), other.bytes.end());
    }
  };
  std::vector<Entry> entry;
  entry.reserve(count);
  for (QuantisedHull& hull : quantised) {
    std::vector<std::uint8_t> bytes = write(hull, records);
    entry.push_back({morton_code(hull, origin), std::move(bytes)});
  }
  std::sort(entry.begin(), entry.end());
  for (const Entry& e : entry) records.bytes.insert(records.bytes.end(), e.bytes.begin(), e.bytes.end());
  return records;
}

}  // namespace alula
