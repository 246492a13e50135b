// Safety filters compared on an inverted pendulum, x = (theta, theta').
//
//   theta'' = sin theta + u                                                                          (11)
//   u_B = -sin theta + k (r - theta'),  r = cut(gain ((theta_max - d) - |theta|), -cap, 0) sign theta  (12)
//   h_B = eps - |theta'|,  h = theta_max - |theta|                                              (13, 14)
//
// Both filters simulate the flow phi under u_B with N steps (explicit midpoint rule). `regulation` is the rule of the
// geofence, u = lambda u_des + (1 - lambda) u_B, with the regulation function lambda = 1 - exp(-beta max(h_I, 0)).
// `backup_qp` also integrates the sensitivity of the flow along drift and input, and returns the nearest u with
//
//   d/dt h(phi_k(x)) + alpha h(phi_k(x)) >= 0 for all k,  d/dt h_B(phi_N(x)) + alpha h_B(phi_N(x)) >= 0
//
// (a row per side of h and h_B); if there is no such u, it returns u_B.
//
// Source: Singletary et al. 2022 (arXiv 2201.04331), example 1; the rows: Chen, Jankovic, Santillo, Ames 2021.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/filters/barrier_rows.hpp"

namespace alula::flight {

struct PendulumState {
  double angle = 0, rate = 0;  // [rad, rad/s]
};

struct PendulumOptions {
  double largest_angle = 1;  // theta_max
  double end_rate = 0.1;     // eps
  double k = 3;
  double push_distance = 0.1, push_gain = 1, push_rate = 0.1;
  double horizon_s = 3;
  int steps = 100;
  double beta = 15;           // of the regulation function
  double alpha = 5;           // of the QP
  double largest_input = 20;  // of u_des and the QP
};

// Throws std::invalid_argument for numbers out of range.
void check(const PendulumOptions& options);

struct PendulumReport {
  double u = 0;
  double h_i = 0;
  double lambda = 0;           // value of the regulation function
  std::size_t rows = 0;        // of the QP
  bool is_infeasible = false;  // the QP had no feasible input; u_B was returned
};

enum class PendulumRule : std::uint8_t { regulation, backup_qp };

// Not thread-safe: one per thread.
class PendulumFilter {
 public:
  PendulumFilter(PendulumRule rule, const PendulumOptions& options);
  PendulumReport filter(const PendulumState& x, double u_des);
  double backup(const PendulumState& x) const;

 private:
  PendulumReport regulate(const PendulumState& x, double u_des) const;
  PendulumReport program(const PendulumState& x, double u_des);

  PendulumRule rule_;
  PendulumOptions options_;
  BarrierRows<1> rows_;
};

// One RK4 step with u held.
PendulumState step_pendulum(const PendulumState& x, double u, double dt);

}  // namespace alula::flight
