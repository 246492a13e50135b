// Flow of the backup policy ahead of a state, its sensitivity to the present input, and the rows made of both.
//
// Phi' = f_cl(Phi), Q' = J_cl(Phi) Q from Phi = x, Q = I. An input moves the flow through g(x) alone, so five
// columns are enough: W = Q g(x), 12 x 4, and q = Q f(x). Both start at W = g(x), q = f(x) and obey W' = J_cl W. One
// RK4 step of the joint system makes the discrete W the exact derivative of the discrete Phi. With the age s_k held,
//
//   d/dt h(Phi_k) = grad h^T (q_k + W_k u),      q_k = f_cl(Phi_k) - W_k pi_b(x)   for a policy without time,
//
// the second equation up to the integration error. Nothing is allocated after construction.
//
// Source: Tscholl, Nakka, Gunter 2026 (FastBridge), eq. 20-22; Chen, Jankovic, Santillo, Ames 2021.
#pragma once

#include <array>
#include <vector>

#include "alula/filters/backup_policy.hpp"
#include "alula/filters/collision_cone.hpp"

namespace alula::flight {

// row . u >= bound over u = (T, tau).
struct WrenchRow {
  Vec4 row{};
  double bound = 0;
};

class BackupFlow {
 public:
  // Makes `nodes` steps of horizon / nodes, each of `steps` RK4 steps. With `drift` the column q is integrated,
  // otherwise it follows from the flow identity; a manoeuvre that holds a velocity needs `drift`.
  // Throws std::invalid_argument if the counts or the horizon are not positive.
  BackupFlow(const BackupPolicy& policy, double horizon_s, int nodes, int steps = 1, bool drift = false);

  const BackupPolicy& policy() const { return policy_; }
  int nodes() const { return nodes_; }
  double horizon() const { return horizon_; }
  double step() const { return step_; }  // RK4 step [s]

  // Integrates the flow; ticks of the manoeuvre are RK4 steps. Throws std::logic_error for a manoeuvre that holds a
  // velocity without `drift`.
  void run(const State& x, const Manoeuvre& manoeuvre = {});

  // Values at node k = 0..nodes, valid after `run`.
  const State& state(int k) const { return node_[static_cast<std::size_t>(k)].x; }
  const Wrench& input() const { return input_; }  // pi_b(x)
  std::array<Vec4, 12> sensitivity(int k) const;  // W_k
  std::array<double, 12> drift(int k) const;      // q_k
  Cone cone(const GrownEllipsoid& e, int k) const { return collision_cone(e, state(k).p, state(k).v); }

  // Rows h' + alpha h >= 0 and gamma' + alpha gamma >= 0 at node k; grad h has parts by p and v, grad gamma by p
  // alone.
  WrenchRow running_row(const Cone& cone, int k, double alpha) const;
  WrenchRow clear_row(const Cone& cone, int k, double alpha) const;

 private:
  // Columns T, tau_x, tau_y, tau_z, f; rows p, sigma, v, omega.
  static constexpr int kColumns = 5;
  using Rows3 = std::array<std::array<double, kColumns>, 3>;
  struct Columns {
    Rows3 p, sigma, v, omega;
  };
  struct Node {
    State x;
    Columns w;
  };
  template <int Count>
  void integrate(const Manoeuvre& manoeuvre);
  template <int Count>
  static void times(const ClosedLoopJacobian& jacobian, const Columns& w, Columns& out);
  WrenchRow row(Vec3 by_p, Vec3 by_v, int k, double level) const;

  BackupPolicy policy_;
  double horizon_, step_;
  int nodes_, steps_;
  bool has_drift_;
  std::vector<Node> node_;
  Wrench input_;
};

}  // namespace alula::flight
