// Quadratic program for the acceleration nearest to the nominal one that satisfies the barrier rows of a tick.
#pragma once

#include <vector>

#include "alula/filters/collision_cone.hpp"
#include "alula/qp/qp.hpp"

namespace alula::flight {

// Scale a half-space to a row of unit length, so that its slack is an acceleration. The bound is -infinity if every
// input satisfies the row, and +infinity if no input does or a number in the row is not finite.
AccelerationRow normalised(const AccelerationRow& row);

//   minimise 1/2 |a - a_nom|^2 + 1/2 weight xi^2   subject to   row_i . a >= bound_i,  |a_j| <= limit,
//                                                               soft . a + xi >= soft bound
// xi >= 0 needs no row: only the soft row changes xi, and only upward. Rows are normalised, so their slack is an
// acceleration.
class AccelerationProgram {
 public:
  static constexpr double kTolerance = 1e-9;  // of a row [m/s^2], and relative to |a|
  static constexpr double kBackendTolerance =
      1e-6;  // the same for a backend's solution, which comes without a guarantee

  explicit AccelerationProgram(std::size_t rows, QpSolver solver = {});

  void start(Vec3 nominal);
  void add(const AccelerationRow& row, std::uint32_t item);
  void limit(double each_axis);                              // |a_j| <= each_axis
  void add_soft(const AccelerationRow& row, double weight);  // after all others, at most once

  Vec3 nominal() const { return nominal_; }
  void set_nominal(Vec3 nominal) { nominal_ = nominal; }
  std::size_t rows() const { return item_.size(); }                            // number of hard rows from ellipsoids
  Vec3 row(std::size_t i) const { return {row_[i].x, row_[i].y, row_[i].z}; }  // unit length
  double slack(std::size_t i, Vec3 a) const { return geometry::dot(row_[i], a) - bound_[i]; }

  // True if `a` is finite and satisfies every hard row and limit to `tolerance`; optionally the soft row too.
  bool holds(Vec3 a, double tolerance, bool with_soft) const;

  // The three ways to end a tick, in the order to try them. Every returned input has been checked against the rows
  // of the program. The status is the one of the name, or `recovering` when the position is `unsafe`.
  bool accept(FilterReport& report,
              bool unsafe) const;  // `ok`: the nominal input satisfies all rows and is returned bit by bit
  bool solve(FilterReport& report, bool unsafe);  // `filtered`, sets active; or sets infeasible
  // Braking along the path, a = -v min(rate, limit / |v|), within the box. The status is `filtered` if this satisfies
  // all hard rows and `recovering` if not. Braking keeps the direction of v, so it does not change the sign of a
  // cone's h, and h' + 2 rate h = 0 where no limit is reached.
  void brake(FilterReport& report, Vec3 v, double rate, double limit) const;

 private:
  Vec3 nominal_;
  bool impossible_ = false;  // a row is not finite, or is zero with a bound that no input satisfies
  double limit_ = 0, weight_ = 0;
  std::vector<Vec3> row_;
  std::vector<double> bound_, dense_;
  std::vector<std::uint32_t> item_;
  QpSolver solver_;
};

}  // namespace alula::flight
