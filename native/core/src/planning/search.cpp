#include "alula/planning/search.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "alula/base/parallel.hpp"

namespace alula {
namespace {

using geometry::Vec3;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

double travel_cost(double length, double clearance, double radius, double comfort) {
  const double lacking = comfort > 0 ? std::clamp(1 - (clearance - radius) / comfort, 0.0, 1.0) : 0.0;
  return length * (1 + lacking);
}

class Search {
 public:
  Search(const PolytopeSet& obstacles, const Lattice& lattice, Vec3 goal, double radius, double comfort)
      : obstacles_(obstacles), lattice_(lattice), goal_(goal), radius_(radius), comfort_(comfort) {
    for (const std::int64_t n : lattice.count) {
      if (n < 1 || static_cast<std::size_t>(n) > Lattice::kMaxCells / cells_) {
        throw std::invalid_argument("the lattice is empty or too large");
      }
      cells_ *= static_cast<std::size_t>(n);
    }
    // Beyond this neither the cost nor the proof of an edge changes.
    cap_ = radius + std::max(comfort, 2 * lattice.spacing);
    clearance_.assign(cells_, std::numeric_limits<float>::quiet_NaN());
    cost_.assign(cells_, kInfinity);
    parent_.assign(cells_, kUnseen);
    closed_.assign(cells_, 0);
  }

  SearchResult run(Vec3 start, Control& control) {
    const std::vector<Link> first = links(start);
    if (first.empty()) return {SearchStatus::start_isolated, {}, 0};
    last_ = links(goal_);
    if (last_.empty()) return {SearchStatus::goal_isolated, {}, 0};
    std::sort(last_.begin(), last_.end(), [](const Link& a, const Link& b) { return a.node < b.node; });
    for (const Link& link : first) relax(link.node, link.cost, kFromStart);

    double goal_cost = kInfinity;
    std::uint32_t goal_parent = 0;
    std::size_t expanded = 0;
    while (!queue_.empty()) {
      std::pop_heap(queue_.begin(), queue_.end());
      const Entry entry = queue_.back();
      queue_.pop_back();
      if (entry.estimate >= goal_cost) break;
      if (closed_[entry.node] != 0) continue;
      closed_[entry.node] = 1;
      if (++expanded % 1024 == 0) control.poll(std::min(expanded, cells_ - 1), cells_);
      const auto link = std::lower_bound(last_.begin(), last_.end(), entry.node,
                                         [](const Link& a, std::uint32_t node) { return a.node < node; });
      if (link != last_.end() && link->node == entry.node && entry.cost + link->cost < goal_cost) {
        goal_cost = entry.cost + link->cost, goal_parent = entry.node;
      }
      expand(entry.node, entry.cost);
    }
    control.poll(cells_, cells_);
    if (goal_cost == kInfinity) return {SearchStatus::no_path, {}, expanded};
    return {SearchStatus::found, trace(start, goal_parent), expanded};
  }

 private:
  static constexpr std::uint8_t kUnseen = 255, kFromStart = 13;  // 13 is the step (0, 0, 0)

  struct Link {
    std::uint32_t node;
    double cost;
  };

  struct Entry {
    double estimate, cost;
    std::uint32_t node;
    bool operator<(const Entry& other) const {  // the top of the heap is the greatest
      if (estimate != other.estimate) return estimate > other.estimate;
      if (cost != other.cost) return cost < other.cost;
      return node > other.node;
    }
  };

  Vec3 position(std::uint32_t node) const {
    const auto nz = static_cast<std::uint32_t>(lattice_.count[2]), ny = static_cast<std::uint32_t>(lattice_.count[1]);
    return lattice_.origin +
           lattice_.spacing * Vec3{double(node / nz / ny), double(node / nz % ny), double(node % nz)};
  }

  // Clearance of a node, rounded down to single precision, which keeps it a lower bound.
  double clearance(std::uint32_t node) {
    float& known = clearance_[node];
    if (std::isnan(known)) {
      const Vec3 p = position(node);
      const double exact = obstacles_.clearance(p, p, cap_, nearest_, scratch_);
      known = std::nextafter(static_cast<float>(exact), -std::numeric_limits<float>::infinity());
    }
    return known;
  }

  // Cost of a straight segment, infinite when it is not free.
  double straight_cost(Vec3 a, Vec3 b, double length, double bound) {
    if (bound < radius_ + comfort_) {
      const double exact = obstacles_.clearance(a, b, cap_, nearest_, scratch_);
      if (!(exact >= radius_)) return kInfinity;
      bound = exact;
    }
    return travel_cost(length, bound, radius_, comfort_);
  }

  // Lattice points in the block of 4 x 4 x 4 around a point that a free segment joins to it.
  std::vector<Link> links(Vec3 p) {
    std::int64_t low[3];
    for (int i = 0; i < 3; ++i) {
      low[i] = static_cast<std::int64_t>(std::floor((p[i] - lattice_.origin[i]) / lattice_.spacing)) - 1;
    }
    std::vector<Link> result;
    for (std::int64_t n = 0; n < 64; ++n) {
      const std::int64_t i = low[0] + n / 16, j = low[1] + n / 4 % 4, k = low[2] + n % 4;
      if (i < 0 || j < 0 || k < 0 || i >= lattice_.count[0] || j >= lattice_.count[1] || k >= lattice_.count[2]) {
        continue;
      }
      const auto node = static_cast<std::uint32_t>((i * lattice_.count[1] + j) * lattice_.count[2] + k);
      const Vec3 q = position(node);
      const double cost = straight_cost(p, q, norm(q - p), -kInfinity);
      if (cost < kInfinity) result.push_back({node, cost});
    }
    return result;
  }

  void relax(std::uint32_t node, double cost, std::uint8_t step) {
    if (!(cost < cost_[node])) return;
    cost_[node] = cost;
    parent_[node] = step;
    queue_.push_back({cost + norm(goal_ - position(node)), cost, node});
    std::push_heap(queue_.begin(), queue_.end());
  }

  void expand(std::uint32_t node, double cost) {
    const std::int64_t ny = lattice_.count[1], nz = lattice_.count[2];
    const std::int64_t at[3] = {node / (ny * nz), node / nz % ny, node % nz};
    const Vec3 p = position(node);
    const double here = clearance(node);
    for (std::uint8_t step = 0; step < 27; ++step) {
      if (step == kFromStart) continue;
      const std::int64_t d[3] = {step / 9 - 1, step / 3 % 3 - 1, step % 3 - 1};
      bool outside = false;
      for (int i = 0; i < 3; ++i) outside = outside || at[i] + d[i] < 0 || at[i] + d[i] >= lattice_.count[i];
      if (outside) continue;
      const auto next = static_cast<std::uint32_t>(node + (d[0] * ny + d[1]) * nz + d[2]);
      const double length = lattice_.spacing * std::sqrt(double(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]));
      if (closed_[next] != 0 || !(cost + length < cost_[next])) continue;
      const double there = clearance(next);
      if (!(there >= radius_)) continue;
      const double edge = straight_cost(p, position(next), length, 0.5 * (here + there - length * (1 + 1e-12)));
      if (edge < kInfinity) relax(next, cost + edge, step);
    }
  }

  std::vector<Vec3> trace(Vec3 start, std::uint32_t node) const {
    std::vector<Vec3> path{goal_};
    const std::int64_t ny = lattice_.count[1], nz = lattice_.count[2];
    for (;;) {
      path.push_back(position(node));
      const std::int64_t step = parent_[node];
      if (step == kFromStart) break;
      node = static_cast<std::uint32_t>(node - ((step / 9 - 1) * ny + (step / 3 % 3 - 1)) * nz - (step % 3 - 1));
    }
    path.push_back(start);
    std::reverse(path.begin(), path.end());
    return path;
  }

  const PolytopeSet& obstacles_;
  const Lattice& lattice_;
  const Vec3 goal_;
  const double radius_, comfort_;
  double cap_ = 0;
  std::size_t cells_ = 1;
  std::vector<float> clearance_;
  std::vector<double> cost_;
  std::vector<std::uint8_t> parent_, closed_;
  std::vector<Entry> queue_;
  std::vector<Link> last_;
  std::uint32_t nearest_ = 0xffffffffu;
  std::vector<double> scratch_;
};

std::vector<Vec3> subdivide(const std::vector<Vec3>& path, double spacing) {
  std::vector<Vec3> result;
  for (std::size_t i = 0; i + 1 < path.size(); ++i) {
    const Vec3 d = path[i + 1] - path[i];
    const double pieces = std::max(1.0, std::ceil(norm(d) / spacing));
    for (double k = 0; k < pieces; ++k) result.push_back(path[i] + (k / pieces) * d);
  }
  result.push_back(path.back());
  return result;
}

// Drops corners that do not turn. Cutting a free line into parts again lowers its cost and does not change it.
std::vector<Vec3> without_straight_corners(const PolytopeSet& obstacles, const std::vector<Vec3>& path,
                                           double radius) {
  std::uint32_t nearest = 0xffffffffu;
  std::vector<double> scratch;
  std::vector<Vec3> result{path[0]};
  for (std::size_t i = 1; i + 1 < path.size(); ++i) {
    const Vec3 from = result.back(), to = path[i + 1], chord = to - from, part = path[i] - from;
    const double along = std::clamp(dot(part, chord) / dot(chord, chord), 0.0, 1.0);
    const bool turns = norm(part - along * chord) > 1e-9 * norm(chord);
    if (turns || obstacles.clearance(from, to, radius, nearest, scratch) < radius) result.push_back(path[i]);
  }
  result.push_back(path.back());
  return result;
}

}  // namespace

SearchResult find_path(const PolytopeSet& obstacles, const Lattice& lattice, Vec3 start, Vec3 goal, double radius,
                       double comfort, Control& control) {
  return Search(obstacles, lattice, goal, radius, comfort).run(start, control);
}

std::vector<Vec3> tighten_path(const PolytopeSet& obstacles, const std::vector<Vec3>& path, double radius,
                               double comfort, double spacing, int rounds, unsigned jobs, Control& control) {
  constexpr std::size_t kReach = 128;
  if (path.size() < 2) return path;
  std::vector<Vec3> corners = path;
  for (int round = 0; round < rounds; ++round) {
    const std::vector<Vec3> points = subdivide(corners, spacing);
    std::vector<double> cost(points.size() * kReach, kInfinity);  // from point i to point i + 1 + k
    parallel_chunks(points.size(), 4, jobs, control, [&](std::size_t begin, std::size_t end) {
      std::uint32_t nearest = 0xffffffffu;
      std::vector<double> scratch;
      for (std::size_t i = begin; i < end; ++i) {
        for (std::size_t k = 0; k < kReach && i + 1 + k < points.size(); ++k) {
          const Vec3 a = points[i], b = points[i + 1 + k];
          const double clearance = obstacles.clearance(a, b, radius + comfort, nearest, scratch);
          // A part of a free segment is free, despite the rounding of the points on it.
          if (!(clearance >= radius) && k > 0) continue;
          cost[i * kReach + k] = travel_cost(norm(b - a), clearance, radius, comfort);
        }
      }
    });
    std::vector<double> least(points.size(), kInfinity);
    std::vector<std::size_t> from(points.size(), 0);
    least[0] = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      for (std::size_t k = 0; k < kReach && i + 1 + k < points.size(); ++k) {
        const double through = least[i] + cost[i * kReach + k];
        if (through < least[i + 1 + k]) least[i + 1 + k] = through, from[i + 1 + k] = i;
      }
    }
    corners.clear();
    for (std::size_t i = points.size() - 1; i > 0; i = from[i]) corners.push_back(points[i]);
    corners.push_back(points[0]);
    std::reverse(corners.begin(), corners.end());
    corners = without_straight_corners(obstacles, corners, radius);
  }
  return corners;
}

}  // namespace alula
