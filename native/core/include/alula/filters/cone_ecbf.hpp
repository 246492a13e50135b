// Exponential collision cone filter of a quadrotor: rows of third order over (u_T'', tau).
//
// With the thrust extended by two integrators, u_T = T / m, the snap is affine in (u_T'', tau) and so is
// h''' of each cone. The program keeps h''' + 3 l h'' + 3 l^2 h' + l^3 h >= 0 (a triple pole at -l) for every
// candidate outside, an escape row of fourth order on gamma for every one that contains the vehicle, and the rotors'
// limits on T = m (u_T + u_T' dt + u_T'' dt^2 / 2) and tau, with bounds on T and T' against wind-up of the extension:
//
//   minimise |u_T'' - nom|^2 / range^2 + |tau - tau_nom|^2 / range^2,
//   nom = T''_nom / m + 2 zeta w (T'_nom / m - u_T') + w^2 (T_nom / m - u_T),
//
// or nearest to the smooth nominal snap of alula/filters/smooth_nominal.hpp while rows hold the vehicle back and
// until it is released.
//
// A row keeps h >= 0 only if psi_1 and psi_2 are >= 0 too. When an ellipsoid becomes a candidate with h > 0 and a
// negative psi_1 or psi_2, its pole is moved left, up to `lambda_max`, until both are >= 0. If that fails, safety
// depends on the shield. A row with h < 0 makes h tend to 0 from below, with a pole of `return_time` over the time
// delta / beta to the ellipsoid. It ends near the surface, so the index should be grown by more than the shield's
// radius.
//
// At low speed h is of little use: it is quadratic in v, so beside an obstacle its rows brake to a stop, and the
// binding row changes from tick to tick. Below `min_speed_m_s` all rows are on gamma, (d/dt + k)^4 gamma >= 0 with
// the `escape_rate` k. They cover every ellipsoid near and not only those ahead: the vehicle slides along obstacles.
//
// Source: Tscholl, Nakka, Gunter 2026 (FastBridge), section III-D; `difference` is its finite-difference cascade.
#pragma once

#include "alula/filters/options.hpp"
#include "alula/filters/pruning.hpp"
#include "alula/filters/shielded.hpp"
#include "alula/filters/smooth_nominal.hpp"
#include "alula/filters/wrench_program.hpp"

namespace alula::flight {

// Choice of lambda: a pole slower than the time to contact (at most a second within the gate) demands the turn too
// early; braking satisfies such a row, so flights end short of their goals. A pole that is much faster turns later
// than the rotors can at speed, head-on, and the shield stops the vehicle.
class ConeEcbf final : public SafetyFilter {
 public:
  // `solver` solves the program. The shield certifies against `surroundings`, without a map against the ellipsoids of
  // the index for its radius. Rows also steer around the obstacles of `others`, if it has a map. Throws
  // std::invalid_argument for invalid options, in particular w dt >= 1.
  ConeEcbf(const BackupPolicy& policy, std::shared_ptr<const EllipsoidIndex> index,
           const ConeEcbfOptions& options = {}, QpSolver solver = {}, Surroundings surroundings = {},
           Surroundings others = {});

  CommandKind kind() const override { return CommandKind::wrench; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { shield_.reset(), smooth_.reset(), pruner_.reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<ConeEcbf>(*this); }
  const ConeEcbfOptions& options() const { return options_; }

 private:
  double pole(const Cone& c, const ConeRates& d) const;  // pole of the row of an ellipsoid ahead
  bool add_rows(const FlightState& state, const SnapMap& map, std::span<const Found> near, bool moves,
                FilterReport& report, bool& inside);

  BackupPolicy policy_;
  ConeEcbfOptions options_;
  Pruner pruner_;
  RoomyEllipsoids roomy_;
  Shield shield_;
  WrenchProgram program_;
  SmoothNominal smooth_;
  double affine_zero_ = 0, affine_unit_ = 1;  // u_T'' of the variable
};

// The smallest pole from lambda to `most` at which psi_1 = h' + l h and psi_2 = h'' + 2 l h' + l^2 h are not
// negative; lambda when there is none.
double ecbf_pole(double h, double h1, double h2, double lambda, double most);

}  // namespace alula::flight
