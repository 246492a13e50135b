// Quadratic program for the nearest wrench, or rate of thrust and torque, within the rows of a tick and rotor limits.
#pragma once

#include <vector>

#include "alula/filters/backup_flow.hpp"
#include "alula/filters/options.hpp"
#include "alula/qp/qp.hpp"

namespace alula::flight {

//   minimise 1/2 sum_j ((u_j - nominal_j) / range_j)^2 + 1/2 weight xi^2   subject to   row_i . u >= bound_i
//
// over four inputs, the first of which makes the thrust T = thrust_at_zero + per_unit u_0; the others are the
// torque. Rows are scaled to unit length in u_j / range_j, so results do not depend on units.
class WrenchProgram {
 public:
  WrenchProgram(const Quadrotor& vehicle, std::size_t rows, QpSolver solver = {});

  // Starts a tick; the range of u_0 is that of T unless given. Adds the rotors' 8 rows f_min <= G^-1 u <= f_max.
  void start(const Vec4& nominal, double thrust_at_zero = 0, double per_unit = 1, double range = 0);
  void add(const WrenchRow& row, std::uint32_t item);  // row of an ellipsoid
  void add_limit(const WrenchRow& row);                // row of the vehicle
  // -V' - rate V + xi >= 0, affine in T, from the errors and the thrust axis. After all others.
  void track(const TrackingRow& tracking, const Nominal& nominal, Vec3 thrust_axis, double gravity);

  std::size_t barrier_rows() const { return barriers_; }
  double range(std::size_t j) const { return range_[j]; }
  double slack(std::size_t i, const Vec4& u) const;       // slack of row i, scaled
  bool holds(const Vec4& u, double tolerance = 0) const;  // every row except the soft one
  bool clears(const Vec4& u) const;                       // every row of an ellipsoid
  bool tracks(const Vec4& u) const;                       // the soft row with xi = 0

  // The minimiser nearest to `target`. Returns false and sets report.infeasible if there is none. Sets active,
  // iterations.
  bool solve(const Vec4& target, Vec4& u, FilterReport& report);

  // u = base + s (nominal - base) with the largest s in [0, 1] for which every row holds; base itself may break rows.
  // Returns false and sets report.infeasible if there is no such s.
  bool interpolate(const Vec4& base, Vec4& u, FilterReport& report);

  Wrench wrench(const Vec4& u) const { return {zero_ + unit_ * u[0], {u[1], u[2], u[3]}}; }

 private:
  void push(const Vec4& row, double bound, double soft);

  Quadrotor vehicle_;
  Vec4 nominal_{}, wrench_range_{}, range_{};
  double zero_ = 0, unit_ = 1, weight_ = 0;
  bool impossible_ = false;  // a row is not finite, or is zero with a bound that no input satisfies
  std::size_t barriers_ = 0;
  std::vector<double> row_, bound_, dense_;  // scaled rows (m, 4); rows of the program with slack (m, 5)
  std::vector<std::int64_t> item_;           // -1 for a limit
  QpSolver solver_;
};

// A torque that tilts the thrust towards `direction`, as a fraction of the maximum: it breaks the symmetry of a
// head-on course.
Vec3 tilting_torque(const WrenchProgram& program, const State& x, Vec3 direction, double fraction);

// Side to which a head-on course is bent, always the same: left of the course, level.
Vec3 side_of(Vec3 v);

// True if the course p + t v meets the ellipsoid so nearly along its A-axis that no row prefers a side.
bool is_head_on(const Cone& cone);

}  // namespace alula::flight
