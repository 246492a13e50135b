#include "alula/planning/corridor.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "alula/base/parallel.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula {
namespace {

using geometry::Box;
using geometry::HalfSpace;
using geometry::Vec3;

constexpr double kUnit = 0x1p-53;
constexpr int kBisections = 60;
constexpr int kProjections = 60;

double largest(const Box& box) {
  double most = 0;
  for (int i = 0; i < 3; ++i) most = std::max({most, std::abs(box.lower[i]), std::abs(box.upper[i])});
  return most;
}

// Convex hulls as obstacles.
struct HullView {
  const PolytopeSet& set;

  // min over the obstacle of n . y, rounded down: three products and two sums, for |n|_inf <= 1 + 4 u.
  double support(std::uint32_t k, Vec3 n) const {
    double least = std::numeric_limits<double>::infinity(), size = 0;
    for (const Vec3 v : set.polytope(k).vertices) {
      least = std::min(least, dot(n, v));
      size = std::max(size, std::abs(v.x) + std::abs(v.y) + std::abs(v.z));
    }
    return least - 8 * kUnit * size;
  }
  Box box(std::uint32_t k) const { return set.box(k); }

  // From a point of the segment to the nearest of the obstacle; zero where they meet.
  Vec3 towards(std::uint32_t k, Vec3 a, Vec3 b) const {
    const Vec3 ends[2] = {a, b};
    return -hull_distance(ends, set.polytope(k).vertices, std::numeric_limits<double>::infinity()).apart;
  }
  double distance(std::uint32_t k, Vec3 a, Vec3 b, double enough, std::vector<double>& scratch) const {
    return signed_distance(set.polytope(k), a, b, enough, scratch);
  }

  // Direction from the polytope with these vertices to the obstacle.
  Vec3 between(std::uint32_t k, std::span<const Vec3> vertices) const {
    return -hull_distance(vertices, set.polytope(k).vertices, std::numeric_limits<double>::infinity()).apart;
  }
};

// Ellipsoids, each grown by a ball, as obstacles.
struct EllipsoidView {
  const EllipsoidSet& set;

  double support(std::uint32_t k, Vec3 n) const {
    const auto [e, grown] = set.grown(k);
    double squared = 0, extent = 0;
    for (int i = 0; i < 3; ++i) {
      const double reach = e.semi[i] * dot(e.axis[i], n);
      squared += reach * reach;
      extent += e.semi[i];
    }
    const double size = std::abs(e.centre.x) + std::abs(e.centre.y) + std::abs(e.centre.z) + extent + grown;
    // Axes from rotating the unit vectors: 10 u an entry, as in separation.hpp, 18 u for the norm, 6 u for the sums.
    return dot(n, e.centre) - std::sqrt(squared) - grown * (1 + 8 * kUnit) - 64 * kUnit * size;
  }
  Box box(std::uint32_t k) const {
    const auto [e, grown] = set.grown(k);
    Box box = bounds(e);
    box.lower = box.lower - Vec3{grown, grown, grown};
    box.upper = box.upper + Vec3{grown, grown, grown};
    return box;
  }

  Vec3 towards(std::uint32_t k, Vec3 a, Vec3 b) const {
    const auto [e, grown] = set.grown(k);
    // The distance is convex along the segment: bisect its slope.
    double low = 0, high = 1;
    const Vec3 along = b - a;
    for (int i = 0; i < kBisections && high - low > 1e-13; ++i) {
      const double middle = i == 0 ? 0 : i == 1 ? 1 : 0.5 * (low + high);
      const double slope = dot(signed_distance(e, a + middle * along).normal, along);
      if (i == 0 && slope >= 0)
        high = 0;
      else if (i == 1 && slope <= 0)
        low = 1;
      else if (i > 1)
        (slope < 0 ? low : high) = middle;
    }
    const auto found = signed_distance(e, a + 0.5 * (low + high) * along);
    return found.value - grown > 0 ? -(found.value - grown) * found.normal : Vec3{};
  }
  double distance(std::uint32_t k, Vec3 a, Vec3 b, double enough, std::vector<double>&) const {
    const auto [e, grown] = set.grown(k);
    return signed_distance(e, a, b, enough + grown) - grown;
  }

  Vec3 between(std::uint32_t k, std::span<const Vec3> vertices) const {
    const auto [e, grown] = set.grown(k);
    (void)grown;
    Vec3 nearest{}, normal{};
    for (const Vec3 v : vertices) nearest = nearest + (1 / static_cast<double>(vertices.size())) * v;
    for (int i = 0; i < kProjections; ++i) {
      const auto found = signed_distance(e, nearest);
      normal = found.normal;
      if (!(found.value > 0)) break;
      const Vec3 surface = nearest - found.value * found.normal;
      const Vec3 apart = hull_distance(vertices, {&surface, 1}, std::numeric_limits<double>::infinity()).apart;
      if (norm(surface + apart - nearest) < 1e-12) break;
      nearest = surface + apart;
    }
    return -normal;
  }
};

// One cell while it is built.
class Inflation {
 public:
  Inflation(Vec3 a, Vec3 b, double radius, double reach, const Box& bounds) : a_(a), b_(b), radius_(radius) {
    box_.include(a), box_.include(b);
    for (int i = 0; i < 3; ++i) {
      box_.lower[i] = std::max(box_.lower[i] - reach, std::min(bounds.lower[i], box_.lower[i]));
      box_.upper[i] = std::min(box_.upper[i] + reach, std::max(bounds.upper[i], box_.upper[i]));
      Vec3 n{};
      n[i] = -1;
      planes_.push_back({n, -box_.lower[i]});
      n[i] = 1;
      planes_.push_back({n, box_.upper[i]});
    }
    slack_ = 1e-12 * (1 + largest(box_) + radius);
  }

  const std::vector<HalfSpace>& planes() const { return planes_; }
  bool is_free() const { return is_free_; }

  void keep_away(const HullView& view) {
    struct Near {
      double distance;
      std::uint32_t k;
    };
    std::vector<Near> near;
    std::vector<double> scratch;
    view.set.tree().near(box_, radius_, [&](std::uint32_t k) {
      if (is_separated(view.box(k))) return;
      near.push_back({view.distance(k, a_, b_, std::numeric_limits<double>::infinity(), scratch), k});
    });
    std::sort(near.begin(), near.end(), [](const Near& p, const Near& q) {
      return p.distance != q.distance ? p.distance < q.distance : p.k < q.k;
    });
    for (const Near& each : near) separate(view, each.k, each.distance);
  }

  void keep_away(const EllipsoidView& view) {
    std::vector<geometry::Bvh::Pending> heap;
    std::vector<double> scratch;
    const double none = std::numeric_limits<double>::infinity();
    const auto bound = [&](std::uint32_t, const Box& box) {
      return is_separated(box) ? none : geometry::squared_distance_bound(box, a_, b_ - a_);
    };
    view.set.tree().visit_least(heap, none, bound, [&](std::uint32_t, std::uint32_t k) {
      if (is_separated(view, k)) return;
      separate(view, k, view.distance(k, a_, b_, none, scratch));
    });
  }

 private:
  bool is_separated(const Box& box) const {
    return std::any_of(planes_.begin(), planes_.end(), [&](const HalfSpace& p) {
      double least = 0;
      for (int i = 0; i < 3; ++i) least += p.normal[i] * (p.normal[i] > 0 ? box.lower[i] : box.upper[i]);
      return least - slack_ >= p.offset + radius_;
    });
  }

  template <class View>
  bool is_separated(const View& view, std::uint32_t k) const {
    return std::any_of(planes_.begin(), planes_.end(),
                       [&](const HalfSpace& p) { return view.support(k, p.normal) >= p.offset + radius_ + slack_; });
  }

  template <class View>
  void separate(const View& view, std::uint32_t k, double distance) {
    if (is_separated(view, k)) return;
    const Vec3 towards = view.towards(k, a_, b_);
    const double length = norm(towards);
    if (!(distance >= radius_) || !(length > 0)) {
      is_free_ = false;
      return;
    }
    const Vec3 n = (1 / length) * towards;
    planes_.push_back({n, view.support(k, n) - radius_ - 2 * slack_});
  }

  Vec3 a_, b_;
  double radius_, slack_ = 0;
  Box box_;
  std::vector<HalfSpace> planes_;
  bool is_free_ = true;
};

// A cell as it is checked: its rows, and vertices with the triples of rows that meet there.
class Cell {
 public:
  Cell(std::span<const double> normals, std::span<const double> offsets) {
    for (std::size_t i = 0; i < offsets.size(); ++i) {
      rows_.push_back({geometry::from_rows(&normals[3 * i]), offsets[i]});
      const double length = norm(rows_.back().normal);
      if (!(length > 0) || !std::isfinite(length) || !std::isfinite(offsets[i])) rows_.clear();
      if (rows_.empty()) return;
      // Scaled once; what that costs in rounding enters the bound below as an error of the row.
      rows_.back() = {(1 / length) * rows_.back().normal, offsets[i] / length};
    }
    find_vertices();
  }

  const std::vector<HalfSpace>& rows() const { return rows_; }
  const std::vector<Vec3>& vertices() const { return vertices_; }

  // Contains the cell, rounded outward; not finite if no bound is found.
  Box box() const {
    Box box;
    for (int i = 0; i < 3; ++i) {
      Vec3 n{};
      n[i] = -1;
      box.lower[i] = -highest(n);
      n[i] = 1;
      box.upper[i] = highest(n);
    }
    return box;
  }

  // True where the axes' rows bound the cell, as they do for cells that are made here.
  bool is_bounded() const {
    int sides = 0;
    for (int i = 0; i < 3; ++i) {
      for (const double sign : {-1.0, 1.0}) {
        sides += std::any_of(rows_.begin(), rows_.end(), [&](const HalfSpace& r) {
          Vec3 n{};
          n[i] = sign;
          return r.normal.x == n.x && r.normal.y == n.y && r.normal.z == n.z;
        });
      }
    }
    return sides == 6;
  }

  // Upper bound on w . x over the cell, |w| <= 1 + 4 u; infinite if none is found.
  double highest(Vec3 w) const {
    double best = std::numeric_limits<double>::infinity();
    const double top = dot(w, *std::max_element(vertices_.begin(), vertices_.end(),
                                                [&](Vec3 p, Vec3 q) { return dot(w, p) < dot(w, q); }));
    const double size = largest(outer_);
    for (std::size_t i = 0; i < vertices_.size(); ++i) {
      if (dot(w, vertices_[i]) < top - 1e-7 * (1 + size)) continue;
      const HalfSpace &p = rows_[triple_[i][0]], &q = rows_[triple_[i][1]], &r = rows_[triple_[i][2]];
      const Vec3 qr = cross(q.normal, r.normal), rp = cross(r.normal, p.normal), pq = cross(p.normal, q.normal);
      const double volume = dot(p.normal, qr);
      const Vec3 y{std::max(0.0, dot(w, qr) / volume), std::max(0.0, dot(w, rp) / volume),
                   std::max(0.0, dot(w, pq) / volume)};
      const Vec3 rest = w - (y.x * p.normal + y.y * q.normal + y.z * r.normal);
      // Sums of at most 8 terms; the rows' normals and offsets have relative errors of 4 u.
      const double sum = y.x + y.y + y.z;
      const double offset = y.x * std::abs(p.offset) + y.y * std::abs(q.offset) + y.z * std::abs(r.offset);
      const double error = 16 * kUnit * (offset + (1 + sum) * 3 * size);
      const double left = (std::abs(rest.x) + std::abs(rest.y) + std::abs(rest.z)) * size;
      best = std::min(best, y.x * p.offset + y.y * q.offset + y.z * r.offset + left + error);
    }
    return best;
  }

 private:
  void find_vertices() {
    for (const HalfSpace& r : rows_) {
      for (int i = 0; i < 3; ++i) {
        if (r.normal[i] == 1) outer_.upper[i] = std::max(outer_.upper[i], r.offset);
        if (r.normal[i] == -1) outer_.lower[i] = std::min(outer_.lower[i], -r.offset);
      }
    }
    const double tolerance = 1e-9 * (1 + (is_bounded() ? largest(outer_) : 0));
    const auto count = static_cast<std::uint32_t>(rows_.size());
    for (std::uint32_t i = 0; i < count; ++i) {
      for (std::uint32_t j = i + 1; j < count; ++j) {
        const Vec3 line = cross(rows_[i].normal, rows_[j].normal);
        for (std::uint32_t k = j + 1; k < count; ++k) {
          const double volume = dot(line, rows_[k].normal);
          if (std::abs(volume) < 1e-9) continue;
          const Vec3 sum = rows_[i].offset * cross(rows_[j].normal, rows_[k].normal) +
                           rows_[j].offset * cross(rows_[k].normal, rows_[i].normal) + rows_[k].offset * line;
          const Vec3 p = (1 / volume) * sum;
          const bool inside = std::all_of(rows_.begin(), rows_.end(), [&](const HalfSpace& r) {
            return dot(r.normal, p) <= r.offset + tolerance;
          });
          if (!inside) continue;
          vertices_.push_back(p);
          triple_.push_back({i, j, k});
        }
      }
    }
  }

  std::vector<HalfSpace> rows_;
  std::vector<Vec3> vertices_;
  std::vector<std::array<std::uint32_t, 3>> triple_;
  Box outer_;  // of the rows along the axes
};

template <class View>
void prove(const Cell& cell, const View& view, double radius, CellProof& proof) {
  const Box box = cell.box();
  if (!std::isfinite(largest(box))) {
    proof = {};
    return;
  }
  view.set.tree().near(box, 2 * radius, [&](std::uint32_t k) {
    const double far = 2 * radius;
    if (squared_distance(view.box(k), box) > far * far * (1 + 1e-12)) return;
    ++proof.pairs;
    const Vec3 towards = view.between(k, cell.vertices());
    const double length = norm(towards);
    // Along a unit vector up to 4 u.
    const auto gap_along = [&](Vec3 w) { return (view.support(k, w) - cell.highest(w)) * (1 - 8 * kUnit); };
    double gap = length > 0 ? std::max(0.0, gap_along((1 / length) * towards)) : 0;
    if (!(gap >= radius)) {  // to the last digit, or after too few projections
      for (const HalfSpace& row : cell.rows()) gap = std::max(gap, gap_along(row.normal));
    }
    proof.clearance = std::min(proof.clearance, gap);
    if (!(gap >= radius)) proof.proven = false;
  });
}

}  // namespace

Corridor corridor_cells(const CorridorMap& map, std::span<const double> from, std::span<const double> to,
                        double radius, double reach, const geometry::Box& bounds, unsigned jobs, Control& control) {
  if (from.size() != to.size() || !(radius > 0) || !(reach >= 0)) {
    throw std::invalid_argument("segments, radius and reach of a corridor do not fit");
  }
  const std::size_t count = from.size() / 3;
  std::vector<std::vector<HalfSpace>> planes(count);
  Corridor result;
  result.is_free.resize(count);
  parallel_chunks(count, 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Inflation cell(geometry::from_rows(&from[3 * i]), geometry::from_rows(&to[3 * i]), radius, reach, bounds);
      for (const PolytopeSet* set : map.hulls) cell.keep_away(HullView{*set});
      for (const EllipsoidSet* set : map.ellipsoids) cell.keep_away(EllipsoidView{*set});
      planes[i] = cell.planes();
      result.is_free[i] = cell.is_free() ? 1 : 0;
    }
  });
  result.start.push_back(0);
  for (const auto& cell : planes) {
    for (const HalfSpace& p : cell) {
      result.normals.insert(result.normals.end(), {p.normal.x, p.normal.y, p.normal.z});
      result.offsets.push_back(p.offset);
    }
    result.start.push_back(static_cast<std::int64_t>(result.offsets.size()));
  }
  return result;
}

std::vector<CellProof> check_cells(const CorridorMap& map, std::span<const double> normals,
                                   std::span<const double> offsets, std::span<const std::int64_t> start,
                                   double radius, unsigned jobs, Control& control) {
  bool good = normals.size() == 3 * offsets.size() && !start.empty() && start.front() == 0 &&
              start.back() == static_cast<std::int64_t>(offsets.size()) && radius > 0;
  for (std::size_t i = 0; good && i + 1 < start.size(); ++i) good = start[i] <= start[i + 1];
  if (!good) throw std::invalid_argument("the rows of the cells do not fit together");
  std::vector<CellProof> result(start.size() - 1);
  parallel_chunks(result.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const auto first = static_cast<std::size_t>(start[i]), rows = static_cast<std::size_t>(start[i + 1]) - first;
      const Cell cell(normals.subspan(3 * first, 3 * rows), offsets.subspan(first, rows));
      if (cell.vertices().empty() || !cell.is_bounded()) continue;
      result[i] = {true, 2 * radius, 0};
      for (const PolytopeSet* set : map.hulls) prove(cell, HullView{*set}, radius, result[i]);
      for (const EllipsoidSet* set : map.ellipsoids) prove(cell, EllipsoidView{*set}, radius, result[i]);
    }
  });
  return result;
}

}  // namespace alula
