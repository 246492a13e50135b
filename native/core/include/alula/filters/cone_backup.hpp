// The collision cone backup filter of a quadrotor: rows of first order over (T, tau) along the backup flow.
//
// With Phi_k, k = 0..N, the backup policy's flow over the horizon from the state, the program keeps for each
// candidate i
//
//   h_i' + alpha_R h_i >= 0 at Phi_k      the cone, unless |v(Phi_k)| < min_speed, the ray there recedes, its
//                                         level passes `far` above the boundary, or i is around the vehicle now
//   gamma_i' + alpha_T gamma_i >= 0 at Phi_N
//   f_min <= G^-1 u <= f_max
//
// nearest to the nominal wrench, or on the line from pi_b to it. Rows at Phi_0 see the thrust alone, as torque does
// not move v at once: close to an obstacle they ask for thrusts that the rotors do not have, where rows of later
// nodes turn the vehicle instead. They are left out unless `first_node` is 0, as printed. As the flow comes to rest
// h' / h tends to -2 |slowest pole|, so late rows refuse pi_b itself unless alpha_R is well above that; neither does
// a solution imply h_b = min(h_i(Phi_k), gamma_i(Phi_N)) >= 0 nor the reverse. Both are reported: `margin` is h_b.
// Without a solution the backup policy is flown.
//
// Source: Tscholl, Nakka, Gunter 2026 (FastBridge), eq. 21-23.
#pragma once

#include "alula/filters/pruning.hpp"
#include "alula/filters/shielded.hpp"
#include "alula/filters/wrench_program.hpp"

namespace alula::flight {

enum class BackupSolver : std::uint8_t {
  active_set,    // the nearest input, by the program
  interpolation  // the largest share between pi_b and the nominal input that holds all rows, in closed form
};

struct ConeBackupOptions {
  double horizon_s = 1.5;
  int nodes = 20;
  int first_node = 1;  // of the running rows; 0 as printed
  int steps = 0;       // RK4 steps between nodes; 0: as few as keep them shorter than the time constant of the rates
  double alpha_running = 10, alpha_terminal = 5;  // alpha_R, alpha_T [1/s]
  double min_speed_m_s = 0.1;
  double far = std::numeric_limits<double>::infinity();  // of h / beta: how far above 0 gamma stays along the ray
  BackupSolver solver = BackupSolver::active_set;
  double lateral_bias = 0.1;  // torque of a head-on nominal, as a share of the largest
  TrackingRow tracking;
  bool shielded = true;
  double room_m = 0.08;     // kept by the rows beyond the radius when shielded: they steer before the shield stops
  bool try_nominal = true;  // without a solution, let the shield look between backup and nominal
  ShieldOptions shield;     // its tick_s is that of the filter
  Pruning pruning;
};

class ConeBackup final : public SplatFilter {
 public:
  // `solver` solves the program. Throws std::invalid_argument for options that mean nothing.
  ConeBackup(const BackupPolicy& policy, std::shared_ptr<const EllipsoidIndex> index,
             const ConeBackupOptions& options = {}, QpSolver solver = {});

  InputKind kind() const override { return InputKind::wrench; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { shield_.reset(); }
  std::unique_ptr<SplatFilter> clone() const override { return std::make_unique<ConeBackup>(*this); }
  const ConeBackupOptions& options() const { return options_; }

 private:
  Manoeuvre plan(const State& x, std::span<const Found> near);
  bool add_rows(const State& x, std::span<const Found> near, FilterReport& report, bool& inside);

  BackupPolicy policy_;
  ConeBackupOptions options_;
  Pruner pruner_;
  RoomyEllipsoids roomy_;
  Shield shield_;
  BackupFlow flow_;
  WrenchProgram program_;
};

}  // namespace alula::flight
