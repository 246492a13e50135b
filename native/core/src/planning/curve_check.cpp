#include "alula/planning/curve_check.hpp"

#include <algorithm>
#include <array>
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

}  // namespace

std::vector<CurveProof> check_curves(const PolytopeSet& obstacles, std::span<const double> control_points,
                                     std::span<const double> slack, double radius, std::uint32_t max_depth,
                                     unsigned jobs, Control& control) {
  if (control_points.size() != 24 * slack.size()) throw std::invalid_argument("8 control points per curve");
  std::vector<CurveProof> result(slack.size());
  parallel_chunks(slack.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Piece piece;
      for (std::size_t j = 0; j < 8; ++j) piece[j] = geometry::from_rows(&control_points[24 * i + 3 * j]);
      result[i] = Checker(obstacles, radius, slack[i], max_depth).run(piece);
    }
  });
  return result;
}

}  // namespace alula
