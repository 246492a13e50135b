#include "alula/cover/outer_solid.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <numeric>
#include <stdexcept>

#include "alula/cover/facet_cap.hpp"

namespace alula {

namespace {

__extension__ using Wide = __int128;
using Normal = std::array<std::int64_t, 3>;

Normal cross_product(const Normal& a, const Normal& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

std::int64_t dot_product(const Normal& a, const Normal& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

Wide magnitude(Wide a) { return a < 0 ? -a : a; }

Wide gcd(Wide a, Wide b) {
  while (b != 0) {
    const Wide rest = a % b;
    a = b, b = rest;
  }
  return magnitude(a);
}

// The point N / D in lowest terms, D > 0.
struct Corner {
  std::array<Wide, 3> n;
  Wide d;
  auto operator<=>(const Corner&) const = default;
};

class Enumerator {
 public:
  explicit Enumerator(std::span<const LatticePlane> planes) { localise(planes); }

  OuterSolid run() {
    edge_.resize(plane_.size());
    for (std::size_t p = 0; p < plane_.size(); ++p)
      for (std::size_t q = p + 1; q < plane_.size(); ++q) add_edge(p, q);
    OuterSolid result;
    for (std::size_t p = 0; p < plane_.size(); ++p) {
      const bool is_first = result.triangle.empty();
      add_facet(p, result);
      const auto is_below = [&](const auto& corner) { return side(corner.first, p) < 0; };
      if (is_first && !result.triangle.empty() && std::none_of(corner_.begin(), corner_.end(), is_below))
        throw std::invalid_argument("planes bound no volume");
    }
    if (result.triangle.empty()) throw std::invalid_argument("planes bound no volume");
    for (const Corner* c : order_) {
      for (std::size_t i = 0; i < 3; ++i) {
        result.point.push_back(static_cast<double>(c->n[i]) / static_cast<double>(c->d) +
                               static_cast<double>(lower_[i]));
        result.is_lattice = result.is_lattice && c->d == 1;
      }
    }
    return result;
  }

 private:
  // Offsets relative to the lower corner of the box that the axis planes give.
  void localise(std::span<const LatticePlane> planes) {
    std::array<bool, 6> is_found{};
    std::array<std::int64_t, 3> upper{};
    for (const LatticePlane& plane : planes) {
      for (std::size_t i = 0; i < 3; ++i) {
        if (plane.normal[i] > kOuterNormal || plane.normal[i] < -kOuterNormal)
          throw std::invalid_argument("a normal is too long");
        if (plane.normal[(i + 1) % 3] != 0 || plane.normal[(i + 2) % 3] != 0) continue;
        if (plane.offset > kLatticeLimit || plane.offset < -kLatticeLimit)
          throw std::invalid_argument("a box is out of range");
        if (plane.normal[i] == 1) is_found[i] = true, upper[i] = plane.offset;
        if (plane.normal[i] == -1) is_found[i + 3] = true, lower_[i] = -plane.offset;
      }
    }
    for (const bool found : is_found)
      if (!found) throw std::invalid_argument("a plane of the bounding box is missing");
    for (std::size_t i = 0; i < 3; ++i)
      if (upper[i] <= lower_[i] || upper[i] - lower_[i] > kLatticeLimit)
        throw std::invalid_argument("planes bound no volume");
    for (const LatticePlane& plane : planes) {
      const Wide offset = Wide{plane.offset} - dot_product(plane.normal, lower_);
      if (magnitude(offset) >= Wide{1} << 37) {
        if (offset > 0) continue;  // beyond the box
        throw std::invalid_argument("planes bound no volume");
      }
      plane_.push_back({plane.normal, static_cast<std::int64_t>(offset)});
    }
  }

  // The intersection of three planes with linearly independent normals.
  Corner meet(std::size_t p, std::size_t q, std::size_t r) const {
    const Normal &a = plane_[p].normal, &b = plane_[q].normal, &c = plane_[r].normal;
    const Normal bc = cross_product(b, c), ca = cross_product(c, a), ab = cross_product(a, b);
    Corner result;
    result.d = Wide{a[0]} * bc[0] + Wide{a[1]} * bc[1] + Wide{a[2]} * bc[2];
    for (std::size_t i = 0; i < 3; ++i)
      result.n[i] = Wide{plane_[p].offset} * bc[i] + Wide{plane_[q].offset} * ca[i] + Wide{plane_[r].offset} * ab[i];
    if (result.d < 0) {
      result.d = -result.d;
      for (Wide& n : result.n) n = -n;
    }
    return result;
  }

  // Positive if the corner is outside plane r.
  Wide side(const Corner& c, std::size_t r) const {
    const LatticePlane& plane = plane_[r];
    return plane.normal[0] * c.n[0] + plane.normal[1] * c.n[1] + plane.normal[2] * c.n[2] - plane.offset * c.d;
  }

  const Corner* known(Corner c) {
    const Wide divisor = gcd(gcd(gcd(c.n[0], c.n[1]), c.n[2]), c.d);
    for (Wide& n : c.n) n /= divisor;
    c.d /= divisor;
    return &corner_.try_emplace(c, -1).first->first;
  }

  // Adds the segment that the other planes leave of the line of planes p and q.
  void add_edge(std::size_t p, std::size_t q) {
    const Normal along = cross_product(plane_[p].normal, plane_[q].normal);
    if (along == Normal{0, 0, 0}) return;
    constexpr std::size_t kNone = SIZE_MAX;
    std::size_t ahead = kNone, behind = kNone;
    Corner front{}, back{};
    for (std::size_t r = 0; r < plane_.size(); ++r) {
      const std::int64_t slope = dot_product(plane_[r].normal, along);
      if (slope > 0 && (ahead == kNone || side(front, r) > 0)) ahead = r, front = meet(p, q, r);
      if (slope < 0 && (behind == kNone || side(back, r) > 0)) behind = r, back = meet(p, q, r);
    }
    if (ahead == kNone || behind == kNone) throw std::invalid_argument("planes bound no volume");
    if (side(front, behind) >= 0) return;  // nothing, or a point
    for (std::size_t r = 0; r < plane_.size(); ++r)
      if (r != p && r != q && dot_product(plane_[r].normal, along) == 0 && side(front, r) > 0) return;
    const Corner *from = known(back), *to = known(front);
    edge_[p].push_back({from, to});
    edge_[q].push_back({to, from});
  }

  // Adds the facet of a plane as a fan of triangles; its edges run counter-clockwise.
  void add_facet(std::size_t p, OuterSolid& result) {
    std::map<const Corner*, const Corner*> next;
    for (const auto& [from, to] : edge_[p]) next[from] = to;
    if (next.size() < 3) return;
    const Corner* const first = next.begin()->first;
    std::vector<const Corner*> loop;
    for (const Corner* at = first; loop.empty() || at != first; at = next.at(at)) loop.push_back(at);
    // Start from the smallest corner, so the result does not depend on addresses.
    std::rotate(loop.begin(),
                std::min_element(loop.begin(), loop.end(), [](const Corner* a, const Corner* b) { return *a < *b; }),
                loop.end());
    for (const Corner* c : loop) {
      std::int64_t& id = corner_.at(*c);
      if (id < 0) id = static_cast<std::int64_t>(order_.size()), order_.push_back(c);
    }
    for (std::size_t k = 2; k < loop.size(); ++k)
      for (const std::size_t i : {std::size_t{0}, k - 1, k}) result.triangle.push_back(corner_.at(*loop[i]));
  }

  Normal lower_{};
  std::vector<LatticePlane> plane_;
  std::map<Corner, std::int64_t> corner_;  // with its row, once assigned
  std::vector<const Corner*> order_;
  std::vector<std::vector<std::pair<const Corner*, const Corner*>>> edge_;
};

}  // namespace

OuterSolid outer_solid(std::span<const LatticePlane> planes) { return Enumerator(planes).run(); }

}  // namespace alula
