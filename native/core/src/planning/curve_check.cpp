#include "alula/planning/curve_check.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "alula/base/parallel.hpp"

namespace alula {
namespace {

using geometry::Box;
using geometry::Vec3;
using Piece = std::array<Vec3, 8>;

// The halves of a curve, by de Casteljau's construction at 1/2.
std::pair<Piece, Piece> halve(Piece points) {
  Piece left;
  for (std::size_t level = 0; level < 8; ++level) {
    left[level] = points[0];
    for (std::size_t i = 0; i + 1 < 8 - level; ++i) points[i] = 0.5 * (points[i] + points[i + 1]);
    // After the loop points[7 - level] is the last point of this level: the right half, backwards.
  }
  return {left, points};
}

class Checker {
 public:
  Checker(const PolytopeSet& obstacles, double radius, double slack, std::uint32_t max_depth)
      : obstacles_(obstacles), needed_(radius + slack), slack_(slack), max_depth_(max_depth) {
    proof_.proven = true;
    proof_.clearance = 2 * radius;
  }

  CurveProof run(const Piece& piece) {
    Box box;
    for (const Vec3 p : piece) box.include(p);
    std::vector<std::uint32_t> near;
    obstacles_.tree().near(box, 2 * needed_, [&](std::uint32_t k) {
      const double reach = 2 * needed_;
      if (squared_distance(obstacles_.box(k), box) <= reach * reach * (1 + 1e-12)) near.push_back(k);
    });
    std::sort(near.begin(), near.end());
    check(piece, near, 0);
    return proof_;
  }

 private:
  void check(const Piece& piece, const std::vector<std::uint32_t>& near, std::uint32_t depth) {
    proof_.depth = std::max(proof_.depth, depth);
    std::vector<std::uint32_t> undecided;
    for (const std::uint32_t k : near) {
      const auto vertices = obstacles_.polytope(k).vertices;
      const double gap = hull_distance(piece, vertices, 2 * needed_).lower;
      if (gap >= needed_) {
        ++proof_.pairs;
        proof_.clearance = std::min(proof_.clearance, gap - slack_);
        continue;
      }
      const bool touches = at(k, piece.front()) < needed_ || at(k, piece.back()) < needed_;
      if (touches || depth == max_depth_) {
        ++proof_.pairs;
        proof_.proven = false;
        proof_.clearance = std::min(proof_.clearance, std::min(gap, at(k, piece.front())));
        return;
      }
      undecided.push_back(k);
    }
    if (undecided.empty()) return;
    const auto [left, right] = halve(piece);
    check(left, undecided, depth + 1);
    if (proof_.proven) check(right, undecided, depth + 1);
  }

  double at(std::uint32_t k, Vec3 p) {
    return geometry::signed_distance(obstacles_.polytope(k), p, p, needed_, scratch_);
  }

  const PolytopeSet& obstacles_;
  const double needed_, slack_;
  const std::uint32_t max_depth_;
  CurveProof proof_;
  std::vector<double> scratch_;
};

// The same in an obstacle map.
class MapChecker {
 public:
  MapChecker(const ObstacleMap& map, MapMemory& memory, double radius, double slack, std::uint32_t max_depth)
      : map_(map), memory_(memory), radius_(radius), slack_(slack), max_depth_(max_depth) {
    proof_.proven = true;
    proof_.clearance = 2 * radius;
  }

  CurveProof run(const Piece& piece) {
    check(piece, 0);
    return proof_;
  }

 private:
  void check(const Piece& piece, std::uint32_t depth) {
    proof_.depth = std::max(proof_.depth, depth);
    const Vec3 a = piece.front(), b = piece.back();
    double delta = 0;
    for (const Vec3 p : piece) delta = std::max(delta, distance_to_chord(p, a, b));
    const double upto = 2 * radius_ + slack_ + delta, error = 1e-8 * (upto + norm(b - a)) + 1e-9;
    const double chord = map_.segment_distance(a, b, upto + 2 * error, memory_) - error;
    const double bound = chord - delta - slack_;
    if (bound >= radius_) {
      ++proof_.pairs;
      proof_.clearance = std::min(proof_.clearance, bound);
      return;
    }
    const double ends = std::min(map_.distance(a, upto, memory_), map_.distance(b, upto, memory_));
    if (ends < radius_ || depth == max_depth_ || !std::isfinite(delta)) {
      ++proof_.pairs;
      proof_.proven = false;
      proof_.clearance = std::min({proof_.clearance, std::max(bound, 0.0), std::max(ends, 0.0)});
      return;
    }
    const auto [left, right] = halve(piece);
    check(left, depth + 1);
    if (proof_.proven) check(right, depth + 1);
  }

  static double distance_to_chord(Vec3 p, Vec3 a, Vec3 b) {
    const Vec3 d = b - a;
    const double squared = dot(d, d);
    const double along = squared > 0 ? std::clamp(dot(p - a, d) / squared, 0.0, 1.0) : 0.0;
    return norm(p - a - along * d);
  }

  const ObstacleMap& map_;
  MapMemory& memory_;
  const double radius_, slack_;
  const std::uint32_t max_depth_;
  CurveProof proof_;
};

// check(piece, slack) of each curve.
template <class Check>
std::vector<CurveProof> check_each(std::span<const double> control_points, std::span<const double> slack,
                                   unsigned jobs, Control& control, Check&& check) {
  if (control_points.size() != 24 * slack.size()) throw std::invalid_argument("8 control points per curve");
  std::vector<CurveProof> result(slack.size());
  parallel_chunks(slack.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Piece piece;
      for (std::size_t j = 0; j < 8; ++j) piece[j] = geometry::from_rows(&control_points[24 * i + 3 * j]);
      result[i] = check(piece, slack[i]);
    }
  });
  return result;
}

}  // namespace

std::vector<CurveProof> check_curves(const PolytopeSet& obstacles, std::span<const double> control_points,
                                     std::span<const double> slack, double radius, std::uint32_t max_depth,
                                     unsigned jobs, Control& control) {
  return check_each(control_points, slack, jobs, control, [&](const Piece& piece, double error) {
    return Checker(obstacles, radius, error, max_depth).run(piece);
  });
}

std::vector<CurveProof> check_curves(const ObstacleMap& map, std::span<const double> control_points,
                                     std::span<const double> slack, double radius, std::uint32_t max_depth,
                                     unsigned jobs, Control& control) {
  return check_each(control_points, slack, jobs, control, [&](const Piece& piece, double error) {
    MapMemory memory = map.memory();
    return MapChecker(map, memory, radius, error, max_depth).run(piece);
  });
}

}  // namespace alula
