#include "alula/cover/facet_cap.hpp"

#include <algorithm>
#include <numeric>
#include <queue>
#include <stdexcept>

#include "alula/base/parallel.hpp"
#include "alula/cover/budget.hpp"

namespace alula {

namespace {

using Normal = std::array<std::int64_t, 3>;

std::int64_t longest(const Normal& n) { return std::max({std::abs(n[0]), std::abs(n[1]), std::abs(n[2])}); }

// The primitive normal, |n_i| <= kShortNormal, with the nearest direction; ties go to the shorter one.
Normal shortened(const Normal& n) {
  const std::int64_t length = longest(n);
  if (length <= kShortNormal) {
    const std::int64_t divisor = std::gcd(std::gcd(n[0], n[1]), n[2]);
    return {n[0] / divisor, n[1] / divisor, n[2] / divisor};
  }
  const std::array<double, 3> unit{static_cast<double>(n[0]) / static_cast<double>(length),
                                   static_cast<double>(n[1]) / static_cast<double>(length),
                                   static_cast<double>(n[2]) / static_cast<double>(length)};
  Normal best{};
  double smallest = 1;
  for (std::int64_t scale = 1; scale <= kShortNormal; ++scale) {
    Normal candidate;
    double error = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      const double exact = unit[i] * static_cast<double>(scale);
      candidate[i] = static_cast<std::int64_t>(std::round(exact));
      error = std::max(error, std::abs(exact - static_cast<double>(candidate[i])) / static_cast<double>(scale));
    }
    if (error < smallest) smallest = error, best = candidate;
  }
  const std::int64_t divisor = std::gcd(std::gcd(best[0], best[1]), best[2]);
  return {best[0] / divisor, best[1] / divisor, best[2] / divisor};
}

bool is_axis(const LatticePlane& plane) {
  return std::abs(plane.normal[0]) + std::abs(plane.normal[1]) + std::abs(plane.normal[2]) == 1;
}

std::vector<LatticePlane> box_planes(const LatticeBox& box) {
  std::vector<LatticePlane> planes;
  for (std::size_t i = 0; i < 3; ++i) {
    LatticePlane low{{0, 0, 0}, -box.lower[i]}, high{{0, 0, 0}, box.upper[i]};
    low.normal[i] = -1, high.normal[i] = 1;
    planes.push_back(low), planes.push_back(high);
  }
  return planes;
}

// True if a hull may stay unchanged: it has at most `cap` planes and its normals are short enough.
bool fits(const LatticePolytope& hull, std::size_t cap) {
  return hull.plane.size() <= cap && std::all_of(hull.plane.begin(), hull.plane.end(), [](const LatticePlane& p) {
           return longest(p.normal) <= kOuterNormal;
         });
}

LatticePolytope outer(LatticePolytope hull, std::span<const RankedPlane> oblique) {
  hull.plane = box_planes(bounds(hull.vertex));
  for (const RankedPlane& ranked : oblique) hull.plane.push_back(ranked.plane);
  std::sort(hull.plane.begin(), hull.plane.end());
  return hull;
}

}  // namespace

LatticePlane supporting_plane(const Normal& normal, std::span<const Lattice> points) {
  std::int64_t offset = INT64_MIN;
  for (const Lattice& p : points) offset = std::max(offset, normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2]);
  return {normal, offset};
}

LatticePolytope kdop(const LatticePolytope& hull, std::size_t k) {
  if (k != 6 && k != 14 && k != 18 && k != 26) throw std::invalid_argument("k of a k-DOP must be 6, 14, 18 or 26");
  LatticePolytope result{hull.vertex, {}};
  for (std::int64_t x = -1; x <= 1; ++x)
    for (std::int64_t y = -1; y <= 1; ++y)
      for (std::int64_t z = -1; z <= 1; ++z) {
        const std::int64_t sides = std::abs(x) + std::abs(y) + std::abs(z);
        if (sides == 1 || (sides == 2 && k >= 18) || (sides == 3 && (k == 14 || k == 26)))
          result.plane.push_back(supporting_plane({x, y, z}, hull.vertex));
      }
  return result;  // sorted as the loops run
}

void FacetRanker::set_lines(const LatticeBox& box) {
  const std::int32_t ex = box.upper[0] - box.lower[0], ey = box.upper[1] - box.lower[1];
  const int nx = sample_lines(ex), ny = sample_lines(ey);
  const double step_x = static_cast<double>(ex) / nx, step_y = static_cast<double>(ey) / ny;
  const double height = box.upper[2] - box.lower[2];
  area_ = step_x * step_y;
  base_z_ = box.lower[2];
  line_.clear();
  for (int i = 0; i < nx; ++i)
    for (int j = 0; j < ny; ++j) {
      Line line{(i + 0.5) * step_x, (j + 0.5) * step_y, 0, height, 0, 0, nullptr};
      line.column = occupancy_->find(box.lower[0] + static_cast<std::int32_t>(line.x),
                                     box.lower[1] + static_cast<std::int32_t>(line.y));
      line.filled_low = filled(line, 0), line.filled_high = filled(line, height);
      line_.push_back(line);
    }
}

void FacetRanker::set_candidates(const LatticePolytope& hull, const LatticeBox& box) {
  candidate_.clear();
  std::vector<LatticePlane> planes;
  for (const LatticePlane& facet : hull.plane) {
    if (is_axis(facet)) continue;
    const Normal normal = shortened(facet.normal);
    planes.push_back(normal == facet.normal ? facet : supporting_plane(normal, hull.vertex));
  }
  std::sort(planes.begin(), planes.end());
  planes.erase(std::unique(planes.begin(), planes.end()), planes.end());
  for (const LatticePlane& plane : planes) {
    if (is_axis(plane)) continue;
    std::int64_t local = plane.offset;
    for (std::size_t i = 0; i < 3; ++i) local -= plane.normal[i] * box.lower[i];
    candidate_.push_back({plane, static_cast<double>(plane.normal[0]), static_cast<double>(plane.normal[1]),
                          static_cast<double>(plane.normal[2]), static_cast<double>(local), 0, 0});
  }
}

double FacetRanker::removed(const Candidate& plane) const {
  double total = 0;
  if (plane.z > 0) {
    for (const Line& line : line_) {
      const double z = std::max(line.low, (plane.offset - plane.x * line.x - plane.y * line.y) / plane.z);
      if (z < line.high) total += (line.high - z) - (line.filled_high - filled(line, z));
    }
  } else if (plane.z < 0) {
    for (const Line& line : line_) {
      const double z = std::min(line.high, (plane.offset - plane.x * line.x - plane.y * line.y) / plane.z);
      if (z > line.low) total += (z - line.low) - (filled(line, z) - line.filled_low);
    }
  } else {
    for (const Line& line : line_)
      if (plane.x * line.x + plane.y * line.y > plane.offset)
        total += (line.high - line.low) - (line.filled_high - line.filled_low);
  }
  return total * area_;
}

void FacetRanker::cut(const Candidate& plane) {
  for (Line& line : line_) {
    const double room = plane.offset - plane.x * line.x - plane.y * line.y;
    if (plane.z > 0 && room / plane.z < line.high) {
      line.high = room / plane.z;
    } else if (plane.z < 0 && room / plane.z > line.low) {
      line.low = room / plane.z;
    } else if (plane.z == 0 && room < 0) {
      line.high = line.low;
    } else {
      continue;
    }
    if (line.high > line.low) line.filled_low = filled(line, line.low), line.filled_high = filled(line, line.high);
  }
  std::erase_if(line_, [](const Line& line) { return line.high <= line.low; });
}

std::vector<RankedPlane> FacetRanker::operator()(const LatticePolytope& hull, std::size_t most) {
  const LatticeBox box = bounds(hull.vertex);
  set_lines(box);
  set_candidates(hull, box);
  const auto is_worse = [&](std::size_t a, std::size_t b) {
    return candidate_[a].gain != candidate_[b].gain ? candidate_[a].gain < candidate_[b].gain : a > b;
  };
  std::priority_queue<std::size_t, std::vector<std::size_t>, decltype(is_worse)> queue(is_worse);
  for (std::size_t i = 0; i < candidate_.size(); ++i) {
    candidate_[i].gain = removed(candidate_[i]);
    queue.push(i);
  }
  std::vector<RankedPlane> ranked;
  while (!queue.empty() && ranked.size() < most) {
    const std::size_t top = queue.top();
    queue.pop();
    Candidate& best = candidate_[top];
    if (best.round < ranked.size()) {
      best.gain = std::min(best.gain, removed(best));
      best.round = ranked.size();
      queue.push(top);
      continue;
    }
    if (best.gain <= 0) break;
    ranked.push_back({best.plane, best.gain});
    cut(best);
  }
  return ranked;
}

LatticePolytope capped(FacetRanker& rank, LatticePolytope hull, std::size_t cap) {
  if (fits(hull, cap)) return hull;
  const std::vector<RankedPlane> oblique = rank(hull, cap - kBoxPlanes);
  return outer(std::move(hull), oblique);
}

void cap_facets(const Occupancy& occupancy, std::vector<LatticePolytope>& hulls, std::size_t cap, std::size_t planes,
                unsigned jobs, Control& control) {
  if (cap < kBoxPlanes || planes / kBoxPlanes < hulls.size())
    throw std::invalid_argument("a polytope needs six planes");
  std::vector<std::vector<RankedPlane>> ranked(hulls.size());
  InterruptOnly quiet(control);
  parallel_chunks(hulls.size(), 8, jobs, quiet, [&](std::size_t begin, std::size_t end) {
    FacetRanker rank(occupancy);
    for (std::size_t h = begin; h < end; ++h) ranked[h] = rank(hulls[h], cap - kBoxPlanes);
  });
  struct Offer {
    double gain;
    std::size_t hull, place;
  };
  std::vector<Offer> offers;
  for (std::size_t h = 0; h < hulls.size(); ++h)
    for (std::size_t k = 0; k < ranked[h].size(); ++k) offers.push_back({ranked[h][k].gain, h, k});
  std::sort(offers.begin(), offers.end(), [](const Offer& a, const Offer& b) {
    if (a.gain != b.gain) return a.gain > b.gain;
    return a.hull != b.hull ? a.hull < b.hull : a.place < b.place;
  });
  offers.resize(std::min(offers.size(), planes - kBoxPlanes * hulls.size()));
  std::vector<std::size_t> count(hulls.size(), 0);
  for (const Offer& offer : offers) ++count[offer.hull];
  // Planes may remain because the sampling lines miss small volumes; they go to whole hulls within the cap.
  std::size_t left = planes - kBoxPlanes * hulls.size() - offers.size();
  for (std::size_t h = 0; h < hulls.size(); ++h) {
    const std::size_t given = kBoxPlanes + count[h], facets = hulls[h].plane.size();
    if (fits(hulls[h], std::min(cap, given + left))) {
      left -= facets > given ? facets - given : 0;
    } else {
      hulls[h] = outer(std::move(hulls[h]), std::span(ranked[h]).first(count[h]));
    }
  }
}

}  // namespace alula
