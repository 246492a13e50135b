#include "alula/planning/search.hpp"

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <stdexcept>
#include <utility>

#include "alula/base/constants.hpp"

namespace alula {
namespace {

using geometry::Vec3;

double travel_cost(double length, double clearance, double radius, double comfort) {
  const double lacking = comfort > 0 ? std::clamp(1 - (clearance - radius) / comfort, 0.0, 1.0) : 0.0;
  return length * (1 + lacking);
}

// The 26 steps of the lattice; number 13 is (0, 0, 0).
constexpr std::uint8_t kSteps = 27, kFromStart = 13, kUnseen = 255;

class Search {
 public:
  Search(const ObstacleMap& map, const Lattice& lattice, Vec3 goal, double radius, double comfort)
      : map_(map), memory_(map.memory()), lattice_(lattice), goal_(goal), radius_(radius), comfort_(comfort) {
    std::size_t cells = 1;
    for (int i = 0; i < 3; ++i) {
      const std::int64_t n = lattice.count[i];
      if (n < 1 || static_cast<std::size_t>(n) > Lattice::kMaxCells / cells)
        throw std::invalid_argument("the lattice is empty or too large");
      cells *= static_cast<std::size_t>(n);
      blocks_[i] = (n + kEdge - 1) / kEdge;
    }
    total_ = cells;
    // Beyond this neither the cost nor the proof of an edge changes.
    cap_ = radius + std::max(comfort, 2 * lattice.spacing);
    table_.assign(static_cast<std::size_t>(blocks_[0] * blocks_[1] * blocks_[2]), kNone);
    for (std::uint8_t step = 0; step < kSteps; ++step)
      for (int i = 0; i < 3; ++i) step_[step][i] = step / (i == 0 ? 9 : i == 1 ? 3 : 1) % 3 - 1;
  }

  SearchResult run(Vec3 start, Control& control) {
    const std::vector<Link> first = links(start);
    if (first.empty()) return {SearchStatus::start_isolated, {}, 0};
    last_ = links(goal_);
    if (last_.empty()) return {SearchStatus::goal_isolated, {}, 0};
    std::sort(last_.begin(), last_.end(), [](const Link& a, const Link& b) { return a.node.id < b.node.id; });
    for (const Link& link : last_) {
      const double away = norm(position(link.node) - goal_);
      beyond_ = std::max(beyond_, lattice_length(position(link.node) - goal_) - away);
    }
    for (const Link& link : first) relax(link.node, link.cost, kFromStart, true);

    double goal_cost = kInfinity;
    Node goal_parent{};
    std::size_t expanded = 0;
    while (!queue_.empty()) {
      std::pop_heap(queue_.begin(), queue_.end());
      const Entry entry = queue_.back();
      queue_.pop_back();
      if (entry.estimate >= goal_cost) break;
      const Node node = node_of(entry.id);
      Block& block = this->block(node);
      if (block.is_closed[node.local()] != 0 || entry.cost != block.cost[node.local()]) continue;
      if (block.is_proven[node.local()] == 0 && !prove(node, entry.cost)) continue;
      block.is_closed[node.local()] = 1;
      if (++expanded % 1024 == 0) control.poll(std::min(expanded, total_ - 1), total_);
      const auto link = std::lower_bound(last_.begin(), last_.end(), entry.id,
                                         [](const Link& a, std::uint32_t id) { return a.node.id < id; });
      if (link != last_.end() && link->node.id == entry.id && entry.cost + link->cost < goal_cost)
        goal_cost = entry.cost + link->cost, goal_parent = node;
      expand(node, entry.cost);
    }
    control.poll(total_, total_);
    if (goal_cost == kInfinity) return {SearchStatus::no_path, {}, expanded};
    return {SearchStatus::found, trace(start, goal_parent), expanded};
  }

 private:
  static constexpr std::int64_t kEdge = 4;  // of a block, in lattice points
  static constexpr std::size_t kBlock = 64;
  static constexpr std::uint32_t kNone = 0xffffffffu;

  // A lattice point, and its number: that of its block, and that within the block.
  struct Node {
    std::int64_t at[3];
    std::uint32_t id;
    std::size_t local() const { return id % kBlock; }
  };

  // Lattice points that were looked at; costs are lower bounds until they are proven.
  struct Block {
    float clearance[kBlock];
    double cost[kBlock];
    std::uint8_t step[kBlock];  // that led to the point
    std::uint8_t is_proven[kBlock], is_closed[kBlock];
  };

  struct Link {
    Node node;
    double cost;
  };

  struct Entry {
    double estimate, cost;
    std::uint32_t id;
    bool operator<(const Entry& other) const {  // the top of the heap is the greatest
      if (estimate != other.estimate) return estimate > other.estimate;
      if (cost != other.cost) return cost < other.cost;
      return id > other.id;
    }
  };

  // Length of the shortest lattice path along a difference of lattice points: a norm, at least the Euclidean one.
  static double lattice_length(Vec3 d) {
    double a = std::abs(d.x), b = std::abs(d.y), c = std::abs(d.z);
    if (a < b) std::swap(a, b);
    if (b < c) std::swap(b, c);
    if (a < b) std::swap(a, b);
    return (a - b) + std::sqrt(2.0) * (b - c) + std::sqrt(3.0) * c;
  }

  Node node_at(std::int64_t i, std::int64_t j, std::int64_t k) const {
    const std::int64_t block = ((i / kEdge) * blocks_[1] + j / kEdge) * blocks_[2] + k / kEdge;
    const std::int64_t local = ((i % kEdge) * kEdge + j % kEdge) * kEdge + k % kEdge;
    return {{i, j, k}, static_cast<std::uint32_t>(block * static_cast<std::int64_t>(kBlock) + local)};
  }

  Node node_of(std::uint32_t id) const {
    const std::int64_t block = id / kBlock, local = id % kBlock;
    return {{block / (blocks_[1] * blocks_[2]) * kEdge + local / 16,
             block / blocks_[2] % blocks_[1] * kEdge + local / 4 % 4, block % blocks_[2] * kEdge + local % 4},
            id};
  }

  bool is_inside(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return i >= 0 && j >= 0 && k >= 0 && i < lattice_.count[0] && j < lattice_.count[1] && k < lattice_.count[2];
  }

  Vec3 position(const Node& node) const {
    return lattice_.origin + lattice_.spacing * Vec3{double(node.at[0]), double(node.at[1]), double(node.at[2])};
  }

  Block& block(const Node& node) {
    std::uint32_t& slot = table_[node.id / kBlock];
    if (slot == kNone) {
      slot = static_cast<std::uint32_t>(block_.size());
      block_.push_back(make_block(node));
    }
    return block_[slot];
  }

  // One distance, that of the middle of the block, may tell those of all its points.
  Block make_block(const Node& node) {
    const double from_middle = 0.5 * (kEdge - 1) * std::sqrt(3.0) * lattice_.spacing * (1 + 1e-9);
    Vec3 middle = lattice_.origin;
    for (int i = 0; i < 3; ++i)
      middle[i] += lattice_.spacing * (static_cast<double>(node.at[i] / kEdge * kEdge) + 0.5 * (kEdge - 1));
    const double d = map_.distance(middle, cap_ + from_middle, memory_);
    const float known = d - from_middle >= cap_     ? down(cap_)
                        : d + from_middle < radius_ ? -std::numeric_limits<float>::infinity()
                                                    : std::numeric_limits<float>::quiet_NaN();
    Block made;
    std::fill_n(made.clearance, kBlock, known);
    std::fill_n(made.cost, kBlock, kInfinity);
    std::fill_n(made.step, kBlock, kUnseen);
    std::fill_n(made.is_proven, kBlock, std::uint8_t{0});
    std::fill_n(made.is_closed, kBlock, std::uint8_t{0});
    return made;
  }

  // Rounded to single precision, not above the value.
  static float down(double value) {
    return std::nextafter(static_cast<float>(value), -std::numeric_limits<float>::infinity());
  }

  // A lower bound on the clearance of a lattice point, at most the cap.
  double clearance(const Node& node, Block& block) {
    float& known = block.clearance[node.local()];
    if (std::isnan(known)) known = down(std::min(cap_, map_.distance(position(node), cap_, memory_)));
    return known;
  }

  // Cost of a straight segment, infinite when it is not free.
  double straight_cost(Vec3 a, Vec3 b) {
    const double clearance = map_.segment_distance(a, b, radius_ + comfort_, memory_);
    return clearance >= radius_ ? travel_cost(norm(b - a), clearance, radius_, comfort_) : kInfinity;
  }

  // Lattice points in the block of 4 x 4 x 4 around a point that a free segment joins to it.
  std::vector<Link> links(Vec3 p) {
    std::int64_t low[3];
    for (int i = 0; i < 3; ++i)
      low[i] = static_cast<std::int64_t>(std::floor((p[i] - lattice_.origin[i]) / lattice_.spacing)) - 1;
    std::vector<Link> result;
    for (std::int64_t n = 0; n < 64; ++n) {
      const std::int64_t i = low[0] + n / 16, j = low[1] + n / 4 % 4, k = low[2] + n % 4;
      if (!is_inside(i, j, k)) continue;
      const Node node = node_at(i, j, k);
      const double cost = straight_cost(p, position(node));
      if (cost < kInfinity) result.push_back({node, cost});
    }
    return result;
  }

  void relax(const Node& node, double cost, std::uint8_t step, bool is_proven) {
    Block& block = this->block(node);
    const std::size_t local = node.local();
    if (!(cost < block.cost[local])) return;
    block.cost[local] = cost, block.step[local] = step, block.is_proven[local] = is_proven ? 1 : 0;
    const Vec3 to_goal = goal_ - position(node);
    queue_.push_back({cost + std::max(norm(to_goal), lattice_length(to_goal) - beyond_), cost, node.id});
    std::push_heap(queue_.begin(), queue_.end());
  }

  // An edge between two lattice points: its cost, and the bound on its clearance that theirs give.
  struct Edge {
    double cost, bound;
  };

  Edge edge(std::uint8_t step, double here, double there) const {
    const std::int64_t turns = std::abs(step_[step][0]) + std::abs(step_[step][1]) + std::abs(step_[step][2]);
    const double length = lattice_.spacing * std::sqrt(double(turns));
    return {travel_cost(length, std::min(here, there), radius_, comfort_),
            0.5 * (here + there - length * (1 + 1e-12))};
  }

  bool is_free(const Node& a, const Node& b) {
    return map_.segment_distance(position(a), position(b), radius_, memory_) >= radius_;
  }

  // Replaces the assumptions about a point by what is true: its clearance, and the proof and the cost of the edge
  // that leads to it or, if that is not free, of the best from the closed points. True if nothing changed.
  bool prove(const Node& node, double assumed) {
    Block& block = this->block(node);
    const std::size_t local = node.local();
    const double there = clearance(node, block);
    block.cost[local] = kInfinity;
    if (!(there >= radius_)) {
      block.is_closed[local] = 1;
      return false;
    }
    const std::uint8_t step = block.step[local];
    double best = cost_by(node, step, there, kInfinity);
    if (best <= assumed) {
      block.cost[local] = best, block.is_proven[local] = 1;
      return true;
    }
    std::uint8_t by = best < kInfinity ? step : kUnseen;
    for (std::uint8_t other = 0; other < kSteps; ++other) {
      if (other == kFromStart || other == step) continue;
      const double cost = cost_by(node, other, there, best);
      if (cost < best) best = cost, by = other;
    }
    if (by != kUnseen) relax(node, best, by, true);
    return false;
  }

  // Cost of a point by the proven edge of a step from a closed one; infinite without it or if not below `limit`.
  double cost_by(const Node& node, std::uint8_t step, double there, double limit) {
    const std::int64_t i = node.at[0] - step_[step][0], j = node.at[1] - step_[step][1],
                       k = node.at[2] - step_[step][2];
    if (!is_inside(i, j, k)) return kInfinity;
    const Node from = node_at(i, j, k);
    Block& block = this->block(from);
    if (block.is_closed[from.local()] == 0 || block.cost[from.local()] == kInfinity) return kInfinity;
    const Edge edge = this->edge(step, block.clearance[from.local()], there);
    const double cost = block.cost[from.local()] + edge.cost;
    return cost < limit && (edge.bound >= radius_ || is_free(from, node)) ? cost : kInfinity;
  }

  Node before(const Node& node, std::uint8_t step) const {
    return node_at(node.at[0] - step_[step][0], node.at[1] - step_[step][1], node.at[2] - step_[step][2]);
  }

  void expand(const Node& node, double cost) {
    const double here = clearance(node, block(node));
    for (std::uint8_t step = 0; step < kSteps; ++step) {
      const std::int64_t i = node.at[0] + step_[step][0], j = node.at[1] + step_[step][1],
                         k = node.at[2] + step_[step][2];
      if (step == kFromStart || !is_inside(i, j, k)) continue;
      const Node next = node_at(i, j, k);
      Block& block = this->block(next);
      if (block.is_closed[next.local()] != 0 || !(cost < block.cost[next.local()])) continue;
      const float known = block.clearance[next.local()];
      if (known < radius_) continue;
      const Edge edge = this->edge(step, here, std::isnan(known) ? cap_ : double{known});
      relax(next, cost + edge.cost, step, !std::isnan(known) && edge.bound >= radius_);
    }
  }

  std::vector<Vec3> trace(Vec3 start, Node node) {
    std::vector<Vec3> path{goal_};
    for (;;) {
      path.push_back(position(node));
      const std::uint8_t step = block(node).step[node.local()];
      if (step == kFromStart) break;
      node = before(node, step);
    }
    path.push_back(start);
    std::reverse(path.begin(), path.end());
    return path;
  }

  const ObstacleMap& map_;
  MapMemory memory_;
  const Lattice& lattice_;
  const Vec3 goal_;
  const double radius_, comfort_;
  double cap_ = 0;
  double beyond_ = 0;  // by which the lattice length to the goal may exceed the cost of a path
  std::int64_t blocks_[3];
  std::size_t total_ = 0;
  std::int64_t step_[kSteps][3];
  std::vector<std::uint32_t> table_;  // slots of blocks
  std::deque<Block> block_;
  std::vector<Entry> queue_;
  std::vector<Link> last_;
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

// Joins neighbouring points that a free segment of at most `spacing` skips.
std::vector<Vec3> thinned(const ObstacleMap& map, const std::vector<Vec3>& path, double radius, double spacing,
                          MapMemory& memory) {
  std::vector<Vec3> result{path[0]};
  for (std::size_t i = 0; i + 1 < path.size();) {
    std::size_t next = i + 1;
    while (next + 1 < path.size() && norm(path[next + 1] - path[i]) <= spacing &&
           map.segment_distance(path[i], path[next + 1], radius, memory) >= radius)
      ++next;
    result.push_back(path[next]);
    i = next;
  }
  return result;
}

// Drops corners that do not turn. Cutting a free line into parts again lowers its cost and does not change it.
std::vector<Vec3> without_straight_corners(const ObstacleMap& map, const std::vector<Vec3>& path, double radius,
                                           MapMemory& memory) {
  std::vector<Vec3> result{path[0]};
  for (std::size_t i = 1; i + 1 < path.size(); ++i) {
    const Vec3 from = result.back(), to = path[i + 1], chord = to - from, part = path[i] - from;
    const double along = std::clamp(dot(part, chord) / dot(chord, chord), 0.0, 1.0);
    const bool turns = norm(part - along * chord) > 1e-9 * norm(chord);
    if (turns || map.segment_distance(from, to, radius, memory) < radius) result.push_back(path[i]);
  }
  result.push_back(path.back());
  return result;
}

}  // namespace

SearchResult find_path(const ObstacleMap& map, const Lattice& lattice, geometry::Vec3 start, geometry::Vec3 goal,
                       double radius, double comfort, Control& control) {
  return Search(map, lattice, goal, radius, comfort).run(start, control);
}

std::vector<geometry::Vec3> tighten_path(const ObstacleMap& map, const std::vector<geometry::Vec3>& path,
                                         double radius, double comfort, double spacing, int rounds,
                                         Control& control) {
  constexpr std::size_t kReach = 128;
  if (path.size() < 2) return path;
  MapMemory memory = map.memory();
  std::vector<geometry::Vec3> corners = thinned(map, path, radius, spacing, memory);
  for (int round = 0; round < rounds; ++round) {
    const std::vector<geometry::Vec3> points = subdivide(corners, spacing);
    const std::size_t count = points.size();
    const auto cost_of = [&](std::size_t i, std::size_t j) {
      const double clearance = map.segment_distance(points[i], points[j], radius + comfort, memory);
      // A part of a free segment is free, despite the rounding of the points on it.
      return clearance >= radius || j == i + 1
                 ? travel_cost(geometry::norm(points[j] - points[i]), clearance, radius, comfort)
                 : kInfinity;
    };
    std::vector<double> least(count, 0.0);
    std::vector<std::size_t> from(count, 0);
    std::vector<double> step(count, 0.0);  // to each point from the one before
    for (std::size_t i = 1; i < count; ++i)
      step[i] = cost_of(i - 1, i), least[i] = least[i - 1] + step[i], from[i] = i - 1;
    for (std::size_t i = 0; i + 1 < count; ++i) {
      control.poll(i, count);
      if (least[i] + step[i + 1] < least[i + 1]) least[i + 1] = least[i] + step[i + 1], from[i + 1] = i;
      for (std::size_t j = i + 2; j < count && j <= i + kReach; ++j) {
        if (!(least[i] + geometry::norm(points[j] - points[i]) < least[j]))
          continue;  // no straight line would be cheaper
        const double through = least[i] + cost_of(i, j);
        if (through < least[j]) least[j] = through, from[j] = i;
      }
    }
    corners.clear();
    for (std::size_t i = count - 1; i > 0; i = from[i]) corners.push_back(points[i]);
    corners.push_back(points[0]);
    std::reverse(corners.begin(), corners.end());
    corners = without_straight_corners(map, corners, radius, memory);
  }
  return corners;
}

}  // namespace alula
