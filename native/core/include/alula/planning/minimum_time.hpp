// Curves of minimum time through a chain of convex cells, within convex limits of their derivatives.
//
// A curve has K pieces of degree 7 and four continuous derivatives: a spline with knots of multiplicity 3, given by
// 3 K + 5 de Boor points D and the durations T of its pieces. The Bernstein points of piece k are convex
// combinations, with weights that depend on T_{k-2} .. T_{k+2}, of D_{3k} .. D_{3k+7}. The curve lies in the hull of
// its Bernstein points, and each derivative in that of its own:
//   P_i,  V_i = 7 (P_{i+1} - P_i) / T,  A_i = 6 (V_{i+1} - V_i) / T,  J_i = 5 (..) / T,  S_i = 4 (..) / T.
// So the curve is in its cell and within its limits when these points are. For fixed T that is a set of linear and
// second-order cone constraints on D; in T it is smooth.
//
// minimise sum_k T_k over D and T by a barrier method: t sum_k T_k - sum log(slack) for growing t, each by Newton's
// method with the Hessian of the barrier in the points y, J^T (d^2 phi / dy^2) J, a positive definite band matrix.
// Every iterate is strictly feasible. The result is a local minimum; for its own D the multipliers of the barrier
// bound the distance to the minimum of the convex problem with fixed ratios T_i / T_j by nu / t, nu the number of
// constraints. O(K) per iteration.
//
// The knot of a via with an opening is a variable in place of the de Boor point that it determines; for a disc only
// in its plane.
//
// Source: Bernstein hulls and the corridor: Gao et al. 2018; barrier: Nesterov and Nemirovskii 1994.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "alula/geometry/vec3.hpp"

namespace alula {

inline constexpr double kUnlimited = std::numeric_limits<double>::infinity();

// Bounds of derivatives at every instant; all sets are convex and contain 0.
struct MotionLimits {
  double speed = kUnlimited;         // |v| [m/s]
  double acceleration = kUnlimited;  // |a| [m/s^2]
  double jerk = kUnlimited;          // |j| [m/s^3]
  double snap = kUnlimited;          // |s| [m/s^4]
  double gravity = 9.81;
  double most_thrust = kUnlimited;    // |a + g e3| [m/s^2]
  double least_thrust = -kUnlimited;  // a_z + g [m/s^2]
  double tilt = kUnlimited;           // tangent of the angle between a + g e3 and the vertical
};

// State at the start of a curve. The snap is free where the vehicle moves, and zero at rest.
struct StartState {
  geometry::Vec3 p, v, a, j;
  bool moving = false;
};

// Where the curve may pass a via: a ball, or with a unit normal the disc across it, which is then passed along the
// normal, and which the two pieces beside it meet nowhere else.
struct Opening {
  geometry::Vec3 centre, normal;
  double radius = 0;  // 0: at the joint alone
};

struct TimeProblem {
  std::span<const double> normals;          // of all cells, {x : normal . x <= offset}, 3 numbers a row
  std::span<const double> offsets;          // a number a row
  std::span<const std::int64_t> row_start;  // of each cell, and the end
  std::span<const std::uint32_t> cell;      // of each piece, ascending; neighbours are equal or consecutive
  MotionLimits limits;
  StartState start;
  geometry::Vec3 goal;  // at rest, with zero acceleration, jerk and snap
  // Points at the end of pieces: of the first straight curve, which stops there; of vias, which the curve passes.
  std::span<const geometry::Vec3> joint;  // K - 1, strictly inside the cells of both pieces
  std::span<const std::uint8_t> is_via;   // K - 1
  double least_duration = 0.01;           // of a piece [s]
  std::span<const Opening> opening = {};  // K - 1 or none; the joint lies strictly inside of it
  std::span<const double> speed = {};     // K or none: limits of single pieces, where they are lower [m/s]
};

struct TimeOptions {
  double gap = 2e-3;     // nu / t at the end, in units of the total time
  int most_steps = 400;  // of Newton's method, in all
  double stretch = 1;    // at least 1; above, the time becomes so many times the minimum, and snap is minimised
};

enum class TimeStatus : std::uint8_t { solved, stopped_early, infeasible };

struct TimeCurve {
  TimeStatus status = TimeStatus::infeasible;
  std::vector<geometry::Vec3> point;  // 8 Bernstein points a piece
  std::vector<double> duration;       // [s]
  int steps = 0;
};

// A stopped curve (out of steps) is feasible too. Infeasible: from a state of motion, no curve was found; or from
// rest, a joint or the goal is not inside its cells. Throws std::invalid_argument for sizes that do not fit.
// Results do not depend on anything but the arguments.
TimeCurve minimum_time(const TimeProblem& problem, const TimeOptions& options);

}  // namespace alula
