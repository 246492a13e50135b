// Backup-set barrier with gradients on the racing drone: the baseline for the geofence.
//
//   argmin |u - u_des|^2   s.t.  d/dt h_l(phi_k(x)) + alpha h_l(phi_k(x)) >= 0 for all nodes k and faces l,
//                                d/dt h_B(phi_N(x)) + alpha h_B(phi_N(x)) >= 0,  u within its limits
//
// with d/dt along f(x) + g(x) u. The input is u = (thrust acceleration, omega_des), in which the model is affine; the
// throttle follows by the inverse of the thrust map. The flow is the geofence's, with its N steps. It carries its
// sensitivity along f and the four columns of g: the derivative of the discrete steps themselves. Rows that every
// input within the limits satisfies are left out, which does not change the solution. Margins and hold are those of
// the geofence's flow without its error estimate: radius and reserve. Without a solution u_B is flown.
//
// Source: Chen, Jankovic, Santillo, Ames 2021 (arXiv 2104.11332); Singletary et al. 2022, (3), (5) to (7).
#pragma once

#include "alula/filters/barrier_rows.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/racer_flow.hpp"

namespace alula::flight {

struct BackupQpReport {
  RacerCommand command;
  double h_i = 0;
  std::size_t rows = 0;
  bool is_infeasible = false;
  bool is_passed = false;  // the pilot's command, bit by bit: it satisfies all rows
};

// Supports the box and faces of the fence only; throws std::invalid_argument for a map. Not thread-safe: one per
// thread.
class BackupQp {
 public:
  BackupQp(const Geofence& geofence, double alpha);

  double alpha() const { return alpha_; }
  void reset() { has_hold_ = false; }
  // Throws std::invalid_argument for values that are not finite.
  BackupQpReport filter(const RacerState& x, const RacerCommand& pilot);

 private:
  using Number = Dual<5>;  // derivatives along f and each input

  RacerFlow<Number> start(const RacerState& x) const;

  Fence fence_;
  alula_geofence_config config_;
  double alpha_;
  BackupController controller_;
  RacerModel model_;
  BarrierRows<4> rows_;
  BackupHold hold_{};
  bool has_hold_ = false;
};

}  // namespace alula::flight
