// Protocol of the filters among moving obstacles: own state, tracks, walls and the nominal acceleration in, an
// acceleration out. The state is measured and the tracks are estimated; filters never see the truth.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "alula/filters/options.hpp"
#include "alula/geometry/vec3.hpp"
#include "alula/qp/qp.hpp"
#include "alula_dr_acbf.h"

namespace alula::flight {

// The numbers of `alula_filter_status`.
enum class MovingStatus : std::uint8_t { ok = 0, filtered = 1, recovering = 3, refused = 4 };

struct MovingReport {
  MovingStatus status = MovingStatus::refused;
  geometry::Vec3 acceleration;  // |a|_inf <= a_max [m/s^2]
  std::uint8_t mode = 0;        // alula_avoidance_mode
  bool warned = false;
  double risk_m = 0;         // largest CVaR of the warning [m]
  std::int64_t urgent = -1;  // index of the most urgent track
  double horizon_s = 0;
  bool feasible = true;
  std::uint32_t rows = 0, iterations = 0;
  // Violation of the method's and the walls' rows by the flown command, as an acceleration [m/s^2]: at most 0 where
  // they hold, minus infinity without rows. Each method's source defines the unit of its rows.
  double violation = 0;
  double risk_left = 0;  // sum over obstacles with a row of Cantelli's bound at the command, each at most 1
};

class MovingFilter {
 public:
  virtual ~MovingFilter() = default;
  virtual MovingReport filter(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                              std::span<const alula_wall> walls, geometry::Vec3 nominal) = 0;
  // Reports the acceleration that is flown after a refusal; the next tick uses it.
  virtual void flown(geometry::Vec3 acceleration) = 0;
  virtual void reset() = 0;
  virtual std::unique_ptr<MovingFilter> clone() const = 0;
};

enum class MovingMethod : std::uint8_t {
  none,        // nominal acceleration
  dr_acbf,     // native/onboard
  dr_acbf_qp,  // the same rows through the general solver of qp.hpp
  mpc,         // p = 20, m = 3 on a double integrator
  cbf_qp,      // barrier on the velocity
  rp_cbf       // robust policy CBF: rollouts of the avoidance policy
};

struct MovingFilterOptions {
  alula_dr_acbf_config config;  // for all methods: they share the warning and the manoeuvre
  MpcOptions mpc;
  CbfQpOptions cbf_qp;
  RpCbfOptions rp_cbf;
  QpBackend backend;  // if set, solves the programs of dr_acbf_qp, mpc, cbf_qp and rp_cbf
};

// Throws std::invalid_argument for invalid options.
std::unique_ptr<MovingFilter> make_moving_filter(MovingMethod method, const MovingFilterOptions& options);

}  // namespace alula::flight
