// The nearest acceleration that holds the rows of a tick.
#pragma once

#include <vector>

#include "alula/filters/collision_cone.hpp"
#include "alula/qp/qp.hpp"

namespace alula::flight {

// The same half-space with a row of unit length, so that its slack is an acceleration. A bound of -infinity is that
// of what holds for all inputs; with +infinity it holds for none, or a number of it is not finite.
AccelerationRow normalised(const AccelerationRow& row);

//   minimise 1/2 |a - a_nom|^2 + 1/2 weight xi^2   subject to   row_i . a >= bound_i,  |a_j| <= limit,
//                                                               soft . a + xi >= soft bound
// xi >= 0 needs no row: only the soft one moves it, and only upward. Rows are normalised, so their slack is an
// acceleration.
class AccelerationProgram {
 public:
  static constexpr double kTolerance = 1e-9;         // of a row [m/s^2], and relative to |a|
  static constexpr double kBackendTolerance = 1e-6;  // the same of what a backend solved, which proves nothing

  explicit AccelerationProgram(std::size_t rows, QpSolver solver = {});

  void start(Vec3 nominal);
  void add(const AccelerationRow& row, std::uint32_t item);
  void limit(double each_axis);                              // |a_j| <= each_axis
  void add_soft(const AccelerationRow& row, double weight);  // after all others, at most once

  Vec3 nominal() const { return nominal_; }
  void set_nominal(Vec3 nominal) { nominal_ = nominal; }
  std::size_t rows() const { return item_.size(); }                            // hard ones of ellipsoids
  Vec3 row(std::size_t i) const { return {row_[i].x, row_[i].y, row_[i].z}; }  // unit length
  double slack(std::size_t i, Vec3 a) const { return geometry::dot(row_[i], a) - bound_[i]; }

  // Whether `a` is finite and holds every hard row and limit to `tolerance`; optionally the soft one, too.
  bool holds(Vec3 a, double tolerance, bool with_soft) const;

  // The three ways to end a tick, in the order to try them. An input comes back only as checked against the rows
  // in the program; the status is that of the name, or `recovering` when the place is `unsafe`.
  bool accept(FilterReport& report, bool unsafe) const;  // `ok`: the nominal input holds all, bit by bit
  bool solve(FilterReport& report, bool unsafe);         // `filtered`, with active; or sets infeasible
  // Along the path of flight, a = -v min(rate, limit / |v|), within the box: `filtered` if that holds all hard rows
  // and `recovering` if not. It keeps the direction of v, so changes no sign of a cone's h, and
  // h' + 2 rate h = 0 where no limit is reached.
  void brake(FilterReport& report, Vec3 v, double rate, double limit) const;

 private:
  Vec3 nominal_;
  bool impossible_ = false;  // a row without direction that nothing satisfies, or one that is not finite
  double limit_ = 0, weight_ = 0;
  std::vector<Vec3> row_;
  std::vector<double> bound_, dense_;
  std::vector<std::uint32_t> item_;
  QpSolver solver_;
};

}  // namespace alula::flight
