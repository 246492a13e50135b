#include "alula/cover/cover_check.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <map>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

__extension__ using Wide = __int128;
using Position = std::array<std::int32_t, 3>;

constexpr std::uint64_t kLongestNormal = (1 << 15) - 1;  // largest |n_i| of an outer polytope
constexpr double kMostPairs = 0x1p32;                    // of a plane and a vertex or member: about ten seconds

Position row(std::span<const std::int32_t> rows, std::size_t i) {
  return {rows[3 * i], rows[3 * i + 1], rows[3 * i + 2]};
}

std::uint64_t magnitude(std::int64_t a) {
  return a < 0 ? ~static_cast<std::uint64_t>(a) + 1 : static_cast<std::uint64_t>(a);
}

struct IntegerHalfSpace {
  std::int64_t x, y, z, offset;

  Wide excess(const Position& p) const { return Wide{x} * p[0] + Wide{y} * p[1] + Wide{z} * p[2] - offset; }
  // Excess of the farthest corner of the voxel [p, p + 1].
  Wide voxel_excess(const Position& p) const {
    return excess(p) + std::max<Wide>(x, 0) + std::max<Wide>(y, 0) + std::max<Wide>(z, 0);
  }
  bool is_primitive() const { return std::gcd(std::gcd(magnitude(x), magnitude(y)), magnitude(z)) == 1; }
  auto operator<=>(const IntegerHalfSpace&) const = default;
};

// When every product is below 2^60, 64 bits hold all sums of voxel_excess.
bool fits_64_bits(std::span<const IntegerHalfSpace> planes, std::span<const Position> positions) {
  std::uint64_t normal = 0, offset = 0, position = 1;
  for (const IntegerHalfSpace& h : planes) {
    normal = std::max({normal, magnitude(h.x), magnitude(h.y), magnitude(h.z)});
    offset = std::max(offset, magnitude(h.offset));
  }
  for (const Position& p : positions)
    for (const std::int32_t c : p) position = std::max(position, magnitude(c));
  return normal < (std::uint64_t{1} << 60) / position && offset < std::uint64_t{1} << 60;
}

// Throws when more pairs of a plane and a vertex or member are to be tested than in any cover of a scene.
class PairBudget {
 public:
  void spend(std::size_t planes, std::size_t points) {
    if ((spent_ += static_cast<double>(planes) * static_cast<double>(points)) > kMostPairs)
      throw std::overflow_error("a hull has " + std::to_string(planes) + " half-planes and " +
                                std::to_string(points) +
                                " vertices or extreme members, more than this check has time for");
  }
  // Whether the hulls so far leave as many.
  bool leaves(std::size_t planes, std::size_t points) const {
    return spent_ + static_cast<double>(planes) * static_cast<double>(points) <= kMostPairs;
  }

 private:
  std::atomic<double> spent_{0};
};

class HullCheck {
 public:
  HullCheck(const CoverView& cover, std::size_t hull, std::vector<Violation>& found, PairBudget& budget,
            const Stop& stop)
      : hull_(static_cast<std::int64_t>(hull)),
        is_outer_(cover.is_outer),
        found_(found),
        budget_(budget),
        stop_(stop) {
    first_vertex_ = cover.vertex_start[hull], first_plane_ = cover.plane_start[hull];
    first_member_ = cover.member_start[hull];
    for (std::int64_t i = first_vertex_; i < cover.vertex_start[hull + 1]; ++i)
      vertex_.push_back(row(cover.vertex, static_cast<std::size_t>(i)));
    for (std::int64_t i = first_plane_; i < cover.plane_start[hull + 1]; ++i) {
      const std::size_t p = static_cast<std::size_t>(i);
      plane_.push_back({cover.plane_normal[3 * p], cover.plane_normal[3 * p + 1], cover.plane_normal[3 * p + 2],
                        cover.plane_offset[p]});
    }
    for (std::int64_t i = first_member_; i < cover.member_start[hull + 1]; ++i)
      member_.push_back(row(cover.member_index, static_cast<std::size_t>(i)));
  }

  void run() {
    if (vertex_.empty() || plane_.empty() || member_.empty()) {
      report(Fault::kEmptyHull, -1);
      return;
    }
    budget_.spend(plane_.size(), vertex_.size());
    check_order();
    is_outer_ ? check_supports() : check_facets();
    check_members();
  }

 private:
  void report(Fault fault, std::int64_t at, std::int64_t other = -1) { found_.push_back({fault, hull_, at, other}); }

  void check_order() {
    for (std::size_t i = 0; i < plane_.size(); ++i) {
      if (!plane_[i].is_primitive()) report(Fault::kBadNormal, first_plane_ + static_cast<std::int64_t>(i));
      if (i > 0 && !(plane_[i - 1] < plane_[i]))
        report(Fault::kRepeated, first_plane_ + static_cast<std::int64_t>(i));
    }
    for (std::size_t i = 1; i < vertex_.size(); ++i)
      if (!(vertex_[i - 1] < vertex_[i])) report(Fault::kRepeated, first_vertex_ + static_cast<std::int64_t>(i));
    for (std::size_t i = 1; i < member_.size(); ++i)
      if (!(member_[i - 1] < member_[i])) report(Fault::kMemberOrder, first_member_ + static_cast<std::int64_t>(i));
  }

  void check_supports() {
    std::array<bool, 6> is_found{};
    for (std::size_t p = 0; p < plane_.size(); ++p) {
      stop_.check();
      const IntegerHalfSpace& plane = plane_[p];
      const std::int64_t at = first_plane_ + static_cast<std::int64_t>(p);
      std::size_t farthest = 0;
      for (std::size_t v = 1; v < vertex_.size(); ++v)
        if (plane.excess(vertex_[v]) > plane.excess(vertex_[farthest])) farthest = v;
      const Wide excess = plane.excess(vertex_[farthest]);
      const std::int64_t vertex = first_vertex_ + static_cast<std::int64_t>(farthest);
      if (excess > 0) report(Fault::kVertexOutside, vertex, at);
      if (excess < 0) report(Fault::kLoosePlane, at, vertex);
      const std::array<std::int64_t, 3> n{plane.x, plane.y, plane.z};
      const std::array<std::uint64_t, 3> length{magnitude(n[0]), magnitude(n[1]), magnitude(n[2])};
      if (*std::max_element(length.begin(), length.end()) > kLongestNormal) report(Fault::kLongNormal, at);
      for (std::size_t i = 0; i < 3; ++i)
        if (length[i] == 1 && length[(i + 1) % 3] == 0 && length[(i + 2) % 3] == 0)
          is_found[n[i] > 0 ? i : i + 3] = true;
    }
    if (!std::all_of(is_found.begin(), is_found.end(), [](bool found) { return found; })) report(Fault::kOpenBox, -1);
  }

  void check_facets() {
    std::map<std::pair<std::size_t, std::size_t>, std::vector<std::size_t>> edges;  // edge to its planes
    std::vector<bool> is_corner(vertex_.size(), false);
    std::vector<std::size_t> on;
    for (std::size_t p = 0; p < plane_.size(); ++p) {
      stop_.check();
      on.clear();
      bool has_below = false, has_outside = false;
      for (std::size_t v = 0; v < vertex_.size(); ++v) {
        const Wide excess = plane_[p].excess(vertex_[v]);
        if (excess > 0 && !has_outside) {
          has_outside = true;
          report(Fault::kVertexOutside, first_vertex_ + static_cast<std::int64_t>(v),
                 first_plane_ + static_cast<std::int64_t>(p));
        }
        if (excess == 0) on.push_back(v);
        has_below = has_below || excess < 0;
      }
      const std::vector<std::size_t> corner = polygon(plane_[p], on);
      if (corner.size() < 3 || !has_below) {
        report(Fault::kUnsupportedPlane, first_plane_ + static_cast<std::int64_t>(p));
        continue;
      }
      for (std::size_t i = 0; i < corner.size(); ++i) {
        is_corner[corner[i]] = true;
        edges[std::minmax(corner[i], corner[(i + 1) % corner.size()])].push_back(p);
      }
    }
    for (const auto& [edge, planes] : edges)
      if (planes.size() != 2) report(Fault::kOpenEdge, first_plane_ + static_cast<std::int64_t>(planes[0]));
    for (std::size_t v = 0; v < vertex_.size(); ++v)
      if (!is_corner[v]) report(Fault::kIdleVertex, first_vertex_ + static_cast<std::int64_t>(v));
  }

  // The extreme points, in cyclic order, of vertices in a common plane: their convex hull after
  // dropping the axis along which the normal is longest, which keeps the plane one to one.
  std::vector<std::size_t> polygon(const IntegerHalfSpace& plane, std::vector<std::size_t> on) const {
    const std::array<std::uint64_t, 3> length{magnitude(plane.x), magnitude(plane.y), magnitude(plane.z)};
    const std::size_t drop =
        static_cast<std::size_t>(std::max_element(length.begin(), length.end()) - length.begin());
    const std::size_t a = (drop + 1) % 3, b = (drop + 2) % 3;
    std::sort(on.begin(), on.end(), [&](std::size_t i, std::size_t j) {
      return std::pair(vertex_[i][a], vertex_[i][b]) < std::pair(vertex_[j][a], vertex_[j][b]);
    });
    auto turn = [&](std::size_t i, std::size_t j, std::size_t k) {
      const Position &p = vertex_[i], &q = vertex_[j], &r = vertex_[k];
      return (Wide{q[a]} - p[a]) * (Wide{r[b]} - p[b]) - (Wide{q[b]} - p[b]) * (Wide{r[a]} - p[a]);
    };
    std::vector<std::size_t> chain;
    for (int side = 0; side < 2; ++side) {
      const std::size_t floor = chain.size() + 1;  // the chain of each side turns left throughout
      for (const std::size_t v : on) {
        while (chain.size() > floor && turn(chain[chain.size() - 2], chain.back(), v) <= 0) chain.pop_back();
        chain.push_back(v);
      }
      if (!chain.empty()) chain.pop_back();  // the first of the other side
      std::reverse(on.begin(), on.end());
    }
    return chain;
  }

  // Members are inside when the extreme ones are, because hulls are convex; all are tested only to name the faults.
  void check_members() {
    const bool is_narrow = fits_64_bits(plane_, member_);
    std::vector<Position> sorted = member_;
    if (!std::is_sorted(sorted.begin(), sorted.end())) std::sort(sorted.begin(), sorted.end());
    const std::vector<Position> extreme = extremes(sorted);
    budget_.spend(plane_.size(), extreme.size());
    for (std::size_t i = 0; i < extreme.size(); ++i) {
      if (i % 64 == 0) stop_.check();
      if (first_crossed(extreme[i], is_narrow) == plane_.size()) continue;
      name_members(extreme[i], is_narrow);
      break;
    }
    check_corners(sorted);
  }

  // The first plane that a voxel crosses; the number of planes when there is none.
  std::size_t first_crossed(const Position& v, bool is_narrow) const {
    std::size_t p = 0;
    if (is_narrow) {
      for (; p < plane_.size(); ++p) {
        const IntegerHalfSpace& h = plane_[p];
        const std::int64_t far = h.x * (v[0] + std::int64_t{h.x > 0}) + h.y * (v[1] + std::int64_t{h.y > 0}) +
                                 h.z * (v[2] + std::int64_t{h.z > 0});
        if (far > h.offset) break;
      }
    } else {
      while (p < plane_.size() && plane_[p].voxel_excess(v) <= 0) ++p;
    }
    return p;
  }

  // Members that span the convex hull of all, which are sorted: of each column in z the two ends, and of the columns
  // of equal x the convex chains of the upper and of the lower ends.
  static std::vector<Position> extremes(const std::vector<Position>& sorted) {
    std::vector<Position> result, upper, lower;
    const auto keep = [](std::vector<Position>& chain, const Position& next, int sign) {
      const auto is_idle = [&](const Position& a, const Position& b) {
        return sign * ((Wide{b[1]} - a[1]) * (Wide{next[2]} - a[2]) - (Wide{b[2]} - a[2]) * (Wide{next[1]} - a[1])) >=
               0;
      };
      while (chain.size() > 1 && is_idle(chain[chain.size() - 2], chain.back())) chain.pop_back();
      chain.push_back(next);
    };
    for (std::size_t begin = 0, end = 0; begin < sorted.size(); begin = end) {
      while (end < sorted.size() && sorted[end][0] == sorted[begin][0] && sorted[end][1] == sorted[begin][1]) ++end;
      keep(lower, sorted[begin], -1);
      keep(upper, sorted[end - 1], 1);
      if (end < sorted.size() && sorted[end][0] == sorted[begin][0]) continue;
      result.insert(result.end(), lower.begin(), lower.end());
      result.insert(result.end(), upper.begin(), upper.end());
      lower.clear(), upper.clear();
    }
    return result;
  }

  // Names the members that are outside, or the one that is known to be if there are too many to test.
  void name_members(const Position& outside, bool is_narrow) {
    const bool is_affordable = budget_.leaves(plane_.size(), member_.size());
    if (is_affordable) budget_.spend(plane_.size(), member_.size());
    for (std::size_t m = 0; m < member_.size(); ++m) {
      if (m % 64 == 0) stop_.check();
      if (!is_affordable && member_[m] != outside) continue;
      if (const std::size_t p = first_crossed(member_[m], is_narrow); p < plane_.size()) report_member(m, p);
    }
  }

  void check_corners(const std::vector<Position>& sorted) {
    for (std::size_t i = 0; i < vertex_.size(); ++i) {
      bool is_held = false;
      for (int corner = 0; corner < 8 && !is_held; ++corner) {
        Position v = vertex_[i];
        bool exists = true;
        for (int c = 0; c < 3; ++c) {
          if ((corner >> c & 1) == 0) continue;
          exists = exists && v[static_cast<std::size_t>(c)] != INT32_MIN;
          if (exists) --v[static_cast<std::size_t>(c)];
        }
        is_held = exists && std::binary_search(sorted.begin(), sorted.end(), v);
      }
      if (!is_held) report(Fault::kLooseVertex, first_vertex_ + static_cast<std::int64_t>(i));
    }
  }

  void report_member(std::size_t m, std::size_t p) {
    report(Fault::kMemberOutside, first_member_ + static_cast<std::int64_t>(m),
           first_plane_ + static_cast<std::int64_t>(p));
  }

  std::int64_t hull_;
  bool is_outer_;
  std::int64_t first_vertex_ = 0, first_plane_ = 0, first_member_ = 0;
  std::vector<Violation>& found_;
  PairBudget& budget_;
  const Stop& stop_;
  std::vector<Position> vertex_, member_;
  std::vector<IntegerHalfSpace> plane_;
};

void require_partition(std::span<const std::int64_t> start, std::size_t hulls, std::size_t rows) {
  bool holds = start.size() == hulls + 1 && !start.empty() && start.front() == 0 &&
               start.back() == static_cast<std::int64_t>(rows);
  for (std::size_t i = 1; holds && i < start.size(); ++i) holds = start[i - 1] <= start[i];
  if (!holds) throw std::invalid_argument("starts do not partition the rows");
}

void require_partitions(const CoverView& cover) {
  if (cover.vertex_start.empty()) throw std::invalid_argument("starts do not partition the rows");
  const std::size_t hulls = cover.vertex_start.size() - 1;
  if (cover.plane_normal.size() != 3 * cover.plane_offset.size())
    throw std::invalid_argument("normals and offsets differ in number");
  require_partition(cover.vertex_start, hulls, cover.vertex.size() / 3);
  require_partition(cover.plane_start, hulls, cover.plane_offset.size());
  require_partition(cover.member_start, hulls, cover.member_index.size() / 3);
}

}  // namespace

std::vector<Violation> check_hulls(const CoverView& cover, unsigned jobs, Control& control) {
  require_partitions(cover);
  const std::size_t hulls = cover.vertex_start.size() - 1;
  std::vector<std::vector<Violation>> found(hulls);
  PairBudget budget;
  parallel_chunks(hulls, 1, jobs, control, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    for (std::size_t h = begin; h < end; ++h) HullCheck(cover, h, found[h], budget, stop).run();
  });
  std::vector<Violation> all;
  for (const auto& of_hull : found) all.insert(all.end(), of_hull.begin(), of_hull.end());
  return all;
}

std::vector<Violation> check_occupied(std::span<const std::int32_t> member_index,
                                      std::span<const std::int64_t> member_start,
                                      std::span<const std::int32_t> occupied) {
  require_partition(member_start, std::max<std::size_t>(member_start.size(), 1) - 1, member_index.size() / 3);
  struct Entry {
    Position position;
    std::int64_t row;
    bool operator<(const Entry& other) const {
      return std::pair(position, row) < std::pair(other.position, other.row);
    }
  };
  auto entries = [](std::span<const std::int32_t> rows) {
    std::vector<Entry> result(rows.size() / 3);
    for (std::size_t i = 0; i < result.size(); ++i) result[i] = {row(rows, i), static_cast<std::int64_t>(i)};
    if (!std::is_sorted(result.begin(), result.end())) std::sort(result.begin(), result.end());
    return result;
  };
  const std::vector<Entry> member = entries(member_index), voxel = entries(occupied);
  std::vector<Violation> found;
  std::size_t m = 0, v = 0;
  while (m < member.size() || v < voxel.size()) {
    if (v == voxel.size() || (m < member.size() && member[m].position < voxel[v].position)) {
      const auto after = std::upper_bound(member_start.begin(), member_start.end(), member[m].row);
      found.push_back({Fault::kNotOccupied, after - member_start.begin() - 1, member[m].row, -1});
      ++m;
    } else if (m == member.size() || voxel[v].position < member[m].position) {
      found.push_back({Fault::kNotCovered, -1, voxel[v].row, -1});
      ++v;
    } else {
      const Position same = voxel[v].position;
      while (m < member.size() && member[m].position == same) ++m;
      while (v < voxel.size() && voxel[v].position == same) ++v;
    }
  }
  return found;
}

}  // namespace alula
