// Collision cone backup filter of a quadrotor: rows of first order over (T, tau) along the backup flow.
//
// Phi_k, k = 0..N, is the flow of the backup policy over the horizon from the state. The program enforces for each
// candidate i
//
//   h_i' + alpha_R h_i >= 0 at Phi_k      the cone, unless |v(Phi_k)| < min_speed, the ray there recedes, its
//                                         level passes `far` above the boundary, or i contains the vehicle now
//   gamma_i' + alpha_T gamma_i >= 0 at Phi_N
//   f_min <= G^-1 u <= f_max
//
// nearest to the nominal wrench, or on the line from pi_b to it. Rows at Phi_0 depend on the thrust alone, because
// torque does not change v immediately. Close to an obstacle they demand thrusts beyond the limits of the rotors,
// where rows of later nodes turn the vehicle instead. They are left out unless `first_node` is 0, as in the paper. As
// the flow comes to rest, h' / h tends to -2 |slowest pole|, so late rows reject pi_b itself unless alpha_R is well
// above that. A solution does not imply h_b = min(h_i(Phi_k), gamma_i(Phi_N)) >= 0, nor the reverse. Both are
// reported: `margin` is h_b. Without a solution the backup policy is flown.
//
// Source: Tscholl, Nakka, Gunter 2026 (FastBridge), eq. 21-23.
#pragma once

#include "alula/filters/options.hpp"
#include "alula/filters/pruning.hpp"
#include "alula/filters/shielded.hpp"
#include "alula/filters/wrench_program.hpp"

namespace alula::flight {

class ConeBackup final : public SafetyFilter {
 public:
  // `solver` solves the program. The shield certifies against `surroundings`, without a map against the ellipsoids of
  // the index for its radius. Rows also steer around the obstacles of `others`, if it has a map. Throws
  // std::invalid_argument for invalid options.
  ConeBackup(const BackupPolicy& policy, std::shared_ptr<const EllipsoidIndex> index,
             const ConeBackupOptions& options = {}, QpSolver solver = {}, Surroundings surroundings = {},
             Surroundings others = {});

  CommandKind kind() const override { return CommandKind::wrench; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { shield_.reset(), pruner_.reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<ConeBackup>(*this); }
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
