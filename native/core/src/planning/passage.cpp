#include "alula/planning/passage.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "alula/base/require.hpp"

namespace alula {
namespace {

using geometry::norm;
using geometry::Vec3;

constexpr std::uint32_t kNone = 0xffffffffu;
constexpr double kRounding = 1e-12;  // of a distance, as a fraction of the coordinates
constexpr std::size_t kRoots = 32768;
constexpr std::uint32_t kDeepest = 20;  // levels of cells
constexpr int kPassageBisections = 24;
constexpr double kAvoid = 20;         // of doubtful cells, in lengths
constexpr double kClosed = 0.1;       // of `enough`: points that only less may join count as not connected
constexpr int kPatience = 12;         // ways that turned out to be none before cells become finer
constexpr double kUndecided = 0.125;  // of the tolerance

// A division of a box into cells, each into eight on demand.
class Cells {
 public:
  struct Cell {
    Vec3 centre;
    double distance = std::numeric_limits<double>::quiet_NaN();  // of the centre; not above cap + rho
    std::uint32_t child = kNone;                                 // first of eight
    std::uint32_t level = 0;
  };

  Cells(const ObstacleMap& map, Vec3 lower, Vec3 upper, double edge, double cap)
      : map_(map), memory_(map.memory()), lower_(lower), cap_(cap) {
    const Vec3 size = upper - lower;
    edge = std::max(edge, std::cbrt(size.x * size.y * size.z / kRoots));
    std::size_t cells = 1;
    for (int i = 0; i < 3; ++i) {
      count_[i] = static_cast<std::uint32_t>(std::clamp(std::ceil(size[i] / edge), 1.0, 1024.0));
      half_[i] = 0.5 * size[i] / count_[i];
      cells *= count_[i];
    }
    cell_.resize(cells);
    for (std::uint32_t n = 0; n < cells; ++n) {
      const std::uint32_t at[3] = {n / (count_[1] * count_[2]), n / count_[2] % count_[1], n % count_[2]};
      for (int i = 0; i < 3; ++i) cell_[n].centre[i] = lower[i] + (2 * at[i] + 1) * half_[i];
    }
    double extent = 0;
    for (int i = 0; i < 3; ++i) extent = std::max({extent, std::abs(lower[i]), std::abs(upper[i])});
    for (std::uint32_t level = 0; level <= kDeepest; ++level)
      rho_[level] = std::ldexp(norm(half_), -static_cast<int>(level)) + kRounding * extent;
  }

  std::size_t size() const { return cell_.size(); }
  const Cell& at(std::uint32_t n) const { return cell_[n]; }
  Vec3 half(std::uint32_t n) const { return std::ldexp(1.0, -static_cast<int>(cell_[n].level)) * half_; }
  double rho(std::uint32_t n) const { return rho_[cell_[n].level]; }
  MapMemory& memory() { return memory_; }

  double distance(std::uint32_t n) {
    Cell& cell = cell_[n];
    if (std::isnan(cell.distance)) cell.distance = map_.distance(cell.centre, cap_ + rho(n), memory_);
    return cell.distance;
  }
  // Bounds of the clearance of all points of a cell.
  double least(std::uint32_t n) { return distance(n) - rho(n); }
  double most(std::uint32_t n) { return distance(n) + rho(n); }

  bool can_split(std::uint32_t n) const { return cell_[n].level < kDeepest; }

  void split(std::uint32_t n) {
    const Vec3 quarter = 0.5 * half(n), centre = cell_[n].centre;
    const std::uint32_t level = cell_[n].level + 1;
    cell_[n].child = static_cast<std::uint32_t>(cell_.size());
    for (int k = 0; k < 8; ++k) {
      const Vec3 to{k & 4 ? quarter.x : -quarter.x, k & 2 ? quarter.y : -quarter.y, k & 1 ? quarter.z : -quarter.z};
      cell_.push_back({centre + to, std::numeric_limits<double>::quiet_NaN(), kNone, level});
    }
  }

  // The undivided cell that contains a point of the box.
  std::uint32_t leaf(Vec3 p) const {
    std::uint32_t at[3];
    for (int i = 0; i < 3; ++i)
      at[i] = static_cast<std::uint32_t>(
          std::clamp(std::floor((p[i] - lower_[i]) / (2 * half_[i])), 0.0, static_cast<double>(count_[i] - 1)));
    std::uint32_t n = root(at);
    while (cell_[n].child != kNone) {
      const Vec3 c = cell_[n].centre;
      n = cell_[n].child + (p.x > c.x ? 4u : 0u) + (p.y > c.y ? 2u : 0u) + (p.z > c.z ? 1u : 0u);
    }
    return n;
  }

  // Calls visit(leaf) for the undivided cells that touch cell n.
  template <class Visit>
  void touching(std::uint32_t n, Visit&& visit) const {
    const Vec3 centre = cell_[n].centre, mine = half(n);
    std::uint32_t first[3], last[3];
    for (int i = 0; i < 3; ++i) {
      const double at = (centre[i] - lower_[i]) / (2 * half_[i]),
                   reach = 0.5 * mine[i] / half_[i] * (1 + 1e-6) + 1e-9;
      first[i] = static_cast<std::uint32_t>(std::max(0.0, std::floor(at - reach)));
      last[i] = static_cast<std::uint32_t>(std::min(std::floor(at + reach), static_cast<double>(count_[i] - 1)));
    }
    std::uint32_t at[3];
    for (at[0] = first[0]; at[0] <= last[0]; ++at[0])
      for (at[1] = first[1]; at[1] <= last[1]; ++at[1])
        for (at[2] = first[2]; at[2] <= last[2]; ++at[2]) descend(root(at), n, centre, mine, visit);
  }

 private:
  std::uint32_t root(const std::uint32_t* at) const { return (at[0] * count_[1] + at[1]) * count_[2] + at[2]; }

  template <class Visit>
  void descend(std::uint32_t n, std::uint32_t other, Vec3 centre, Vec3 theirs, Visit& visit) const {
    if (n == other) return;
    const Vec3 mine = half(n), apart = cell_[n].centre - centre;
    for (int i = 0; i < 3; ++i)
      if (std::abs(apart[i]) > (mine[i] + theirs[i]) * (1 + 1e-9) + 1e-12 * std::abs(centre[i])) return;
    if (cell_[n].child == kNone) {
      visit(n);
      return;
    }
    for (std::uint32_t k = 0; k < 8; ++k) descend(cell_[n].child + k, other, centre, theirs, visit);
  }

  const ObstacleMap& map_;
  MapMemory memory_;
  Vec3 lower_, half_;
  std::uint32_t count_[3];
  double cap_;
  std::array<double, kDeepest + 1> rho_;
  std::vector<Cell> cell_;
};

class Flood {
 public:
  Flood(const ObstacleMap& map, Vec3 lower, Vec3 upper, Vec3 start, Vec3 goal, const PassageOptions& options)
      : map_(map),
        options_(options),
        start_(start),
        goal_(goal),
        cells_(map, lower, upper, 2 * options.enough, options.enough) {
    result_.upper = std::min({options.enough, map.distance(start, options.enough, cells_.memory()),
                              map.distance(goal, options.enough, cells_.memory())});
  }

  Passage run(Control& control) {
    for (bool goes_on = result_.upper > 0; goes_on;) {
      control.poll(std::min(cells_.size(), options_.most_cells - 1), options_.most_cells);
      const double level = flood(control);
      result_.upper = std::min(result_.upper, std::max(level, result_.lower));
      if (level < 0) break;
      const std::vector<std::uint32_t> way = trace();
      take(way);
      if (result_.lower <= 0 && result_.upper <= kClosed * options_.enough) break;
      goes_on = result_.lower < result_.upper - (is_decided() ? options_.tolerance : 0) &&
                cells_.size() < options_.most_cells;
      if (goes_on) goes_on = refine(way);
      if (++tried_ % kPatience == 0) fineness_ *= 0.5;
    }
    result_.cells = cells_.size();
    return std::move(result_);
  }

 private:
  struct Entry {
    double level, cost;  // with the distance to the goal
    std::uint32_t cell;
    bool operator<(const Entry& other) const {  // the top of the heap is the greatest
      if (level != other.level) return level < other.level;
      if (cost != other.cost) return cost > other.cost;
      return cell > other.cell;
    }
  };

  // Coarse cells tell little. Those whose centre is not free are divided further, the more ways turned out to be
  // none.
  bool is_coarse(std::uint32_t n) {
    const double rho = cells_.rho(n);
    return rho > 0.5 * options_.enough || (rho > fineness_ && cells_.distance(n) < target_);
  }
  bool is_fine(std::uint32_t n) const { return 2 * cells_.rho(n) <= tolerance() || !cells_.can_split(n); }

  // Finer while it is not decided whether the passage is wide enough.
  bool is_decided() const { return result_.upper < options_.enough; }
  double tolerance() const { return is_decided() ? options_.tolerance : kUndecided * options_.tolerance; }

  // Cost of a way through a cell, per length: cells whose centre is not free enough are avoided.
  double rate(std::uint32_t n) {
    const double lacking = (target_ - cells_.distance(n)) / cells_.rho(n);
    return 1 + kAvoid * std::clamp(lacking, 0.0, 1.0);
  }

  void push(std::uint32_t n, std::uint32_t from) {
    if (visited_[n] != 0) return;
    const double level = std::min(cells_.most(n), target_);
    if (level <= result_.lower) return;  // no passage that is better than the one found
    const double cost = from == n ? 0 : cost_[from] + norm(cells_.at(n).centre - cells_.at(from).centre) * rate(n);
    if (!(cost < cost_[n])) return;
    from_[n] = from, cost_[n] = cost;
    queue_.push_back({level, cost + norm(goal_ - cells_.at(n).centre), n});
    std::push_heap(queue_.begin(), queue_.end());
  }

  // Visits cells from that of the start, those with the highest bound first, until that of the goal. Returns the
  // lowest bound on the way, or a negative number if no way is better than the one found.
  double flood(Control& control) {
    from_.assign(cells_.size(), kNone);
    visited_.assign(cells_.size(), 0);
    cost_.assign(cells_.size(), std::numeric_limits<double>::infinity());
    queue_.clear();
    double level = target_ = result_.upper;
    const std::uint32_t first = cells_.leaf(start_);
    push(first, first);
    for (std::size_t taken = 0; !queue_.empty();) {
      std::pop_heap(queue_.begin(), queue_.end());
      const Entry entry = queue_.back();
      queue_.pop_back();
      const std::uint32_t n = entry.cell;
      if (visited_[n] != 0 || cells_.at(n).child != kNone) continue;
      if (++taken % 1024 == 0) control.poll(std::min(cells_.size(), options_.most_cells - 1), options_.most_cells);
      if (cells_.least(n) < target_ && is_coarse(n) && cells_.size() < options_.most_cells) {
        cells_.split(n);
        from_.resize(cells_.size(), kNone);
        visited_.resize(cells_.size(), 0);
        cost_.resize(cells_.size(), std::numeric_limits<double>::infinity());
        for (std::uint32_t k = cells_.at(n).child; k < cells_.size(); ++k) join(k);
        continue;
      }
      visited_[n] = 1;
      level = std::min(level, entry.level);
      if (n == cells_.leaf(goal_)) return level;
      cells_.touching(n, [&](std::uint32_t other) { push(other, n); });
    }
    return -1;
  }

  // Queues a new cell if the start is in it or it touches a visited one; of several, the one with the highest bound.
  void join(std::uint32_t n) {
    if (cells_.leaf(start_) == n) return push(n, n);
    std::uint32_t best = kNone;
    cells_.touching(n, [&](std::uint32_t other) {
      if (visited_[other] == 0) return;
      if (best == kNone || std::pair(cells_.least(best), other) < std::pair(cells_.least(other), best)) best = other;
    });
    if (best != kNone) push(n, best);
  }

  std::vector<std::uint32_t> trace() const {
    std::vector<std::uint32_t> way{cells_.leaf(goal_)};
    while (from_[way.back()] != way.back()) way.push_back(from_[way.back()]);
    std::reverse(way.begin(), way.end());
    return way;
  }

  // Takes the polyline through the centres if it is wider than the one found.
  void take(const std::vector<std::uint32_t>& way) {
    std::vector<Vec3> path{start_};
    for (const std::uint32_t n : way) path.push_back(cells_.at(n).centre);
    path.push_back(goal_);
    double least = options_.enough;
    std::size_t narrow = 0;
    for (std::size_t i = 0; i + 1 < path.size() && least > result_.lower; ++i) {
      const double here = map_.segment_distance(path[i], path[i + 1], least, cells_.memory());
      if (here < least) least = here, narrow = i;
    }
    if (!(least > result_.lower)) return;
    result_.lower = least;
    Vec3 a = path[narrow], b = path[narrow + 1];
    for (int k = 0; k < kPassageBisections; ++k) {
      const Vec3 middle = 0.5 * (a + b);
      const double upto = 2 * options_.enough, before = map_.segment_distance(a, middle, upto, cells_.memory());
      (before <= map_.segment_distance(middle, b, upto, cells_.memory()) ? b : a) = middle;
    }
    result_.narrowest = 0.5 * (a + b);
    result_.path = std::move(path);
  }

  // Divides the cells of a way that are not wholly as clear as its bound. False if there are none to divide.
  bool refine(const std::vector<std::uint32_t>& way) {
    bool any = false;
    for (const std::uint32_t n : way) {
      if (cells_.least(n) >= result_.upper - (is_decided() ? options_.tolerance : 0) || is_fine(n)) continue;
      cells_.split(n);
      any = true;
    }
    return any;
  }

  const ObstacleMap& map_;
  const PassageOptions options_;
  const Vec3 start_, goal_;
  Cells cells_;
  std::vector<std::uint32_t>
      from_;  // of a queued cell: the one before, on the way from the start; itself for the first
  std::vector<std::uint8_t> visited_;
  double target_ = 0;  // radius that is tried: the upper bound
  double fineness_ = options_.enough;
  int tried_ = 0;
  std::vector<double> cost_;
  std::vector<Entry> queue_;
  Passage result_;
};

}  // namespace

Passage widest_passage(const ObstacleMap& map, geometry::Vec3 lower, geometry::Vec3 upper, geometry::Vec3 start,
                       geometry::Vec3 goal, const PassageOptions& options, Control& control) {
  require(options.enough > 0 && options.tolerance > 0, "radius and tolerance of a passage must be positive");
  for (int i = 0; i < 3; ++i)
    require(lower[i] <= std::min(start[i], goal[i]) && std::max(start[i], goal[i]) <= upper[i] &&
                lower[i] < upper[i] && std::isfinite(upper[i] - lower[i]),
            "the box must contain start and goal");
  return Flood(map, lower, upper, start, goal, options).run(control);
}

bool nearest_free(const ObstacleMap& map, geometry::Vec3 lower, geometry::Vec3 upper, geometry::Vec3 p, double radius,
                  double tolerance, std::size_t most_cells, geometry::Vec3& found, Control& control) {
  require(radius > 0 && tolerance > 0, "radius and tolerance must be positive");
  Cells cells(map, lower, upper, 4 * radius, radius);
  struct Entry {
    double away;
    std::uint32_t cell;
    bool operator<(const Entry& other) const { return away != other.away ? away > other.away : cell > other.cell; }
  };
  const auto nearest_point = [&](std::uint32_t n) {
    geometry::Vec3 q;
    for (int i = 0; i < 3; ++i) {
      const double c = cells.at(n).centre[i], half = cells.half(n)[i];
      q[i] = std::clamp(p[i], c - half, c + half);
    }
    return q;
  };
  std::vector<Entry> queue;
  const auto push = [&](std::uint32_t n) {
    queue.push_back({geometry::norm(nearest_point(n) - p), n});
    std::push_heap(queue.begin(), queue.end());
  };
  for (std::uint32_t n = 0; n < cells.size(); ++n) push(n);
  double best = std::numeric_limits<double>::infinity();
  const auto take = [&](geometry::Vec3 q) {
    const double away = geometry::norm(q - p);
    if (away < best && map.distance(q, radius, cells.memory()) >= radius) best = away, found = q;
  };
  for (std::size_t taken = 0; !queue.empty() && cells.size() < most_cells; ++taken) {
    std::pop_heap(queue.begin(), queue.end());
    const Entry entry = queue.back();
    queue.pop_back();
    if (entry.away >= best - tolerance) break;
    if (taken % 1024 == 0) control.poll(std::min(cells.size(), most_cells - 1), most_cells);
    const std::uint32_t n = entry.cell;
    if (cells.most(n) < radius) continue;
    take(cells.at(n).centre);
    take(nearest_point(n));
    if (entry.away >= best - tolerance || !cells.can_split(n)) continue;
    cells.split(n);
    for (std::uint32_t k = cells.at(n).child, end = k + 8; k < end; ++k) push(k);
  }
  return best < std::numeric_limits<double>::infinity();
}

}  // namespace alula
