// Warning, manoeuvre, walls and reports shared by DR-ACBF and its baselines.
#pragma once

#include <algorithm>
#include <array>
#include <span>
#include <vector>

#include "alula/filters/moving_filter.hpp"
#include "alula/qp/qp.hpp"

namespace alula::flight {

inline geometry::Vec3 to_vec3(const float v[3]) { return {v[0], v[1], v[2]}; }
inline std::array<float, 3> to_float(geometry::Vec3 v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

// The report of a tick that ended with `status`.
MovingReport moving_report(MovingStatus status, geometry::Vec3 acceleration, const alula_guidance& guidance);

// Rows n . x <= b of three variables, and the point nearest to a target.
class NearestPoint {
 public:
  explicit NearestPoint(QpBackend backend = {});

  void clear() { rows_.clear(), bounds_.clear(); }
  void add(geometry::Vec3 n, double b);
  void add_box(double limit);  // |x|_inf <= limit
  std::size_t size() const { return bounds_.size(); }

  // Returns false when no point satisfies the rows, or the solver fails.
  bool solve(geometry::Vec3 target, geometry::Vec3& x, int& iterations);

  // Violation of the rows by x, each row at unit length: at most 0 where all hold, minus infinity without rows that
  // are longer than `shortest`.
  double violation(geometry::Vec3 x, double shortest = 1e-9) const;

  // The point of the box with the smallest violation of the rows, each at unit length.
  geometry::Vec3 least_violation(geometry::Vec3 target, double limit);

 private:
  QpSolver solver_;
  std::vector<double> rows_, bounds_;  // a . x >= b
  std::vector<alula_half_space> unit_;
};

class Guide {
 public:
  // Violation of the method's own rows by the flown command, in addition to that of the walls.
  void missed(double violation, MovingReport& report) const {
    report.violation = std::max(report.violation, violation);
    if (violation > config_.tolerance) report.status = MovingStatus::recovering;
  }

  // Throws std::invalid_argument for an invalid configuration.
  explicit Guide(const alula_dr_acbf_config& config);

  void reset();
  void flown(geometry::Vec3 acceleration);
  // Returns false for input that is refused; then the state is unchanged.
  bool step(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
            std::span<const alula_wall> walls, geometry::Vec3 nominal, alula_guidance& guidance);

  // True if barriers bind in this tick.
  bool binds(const alula_guidance& guidance) const {
    return config_.rows_before_warning != 0 || guidance.mode != ALULA_NOMINAL;
  }
  std::span<const alula_encounter> encounters() const { return {avoidance_.encounter, avoidance_.count}; }
  const alula_avoidance& avoidance() const { return avoidance_; }
  const alula_dr_acbf_config& config() const { return config_; }

  // Clips `a` to the box and projects it onto the walls' rows, as DR-ACBF does; the result is flown. The violation
  // reported is that of the walls.
  MovingReport finish(const alula_guidance& guidance, const alula_vehicle_state& vehicle,
                      std::span<const alula_wall> walls, geometry::Vec3 nominal, geometry::Vec3 a, bool holds);

 private:
  alula_dr_acbf_config config_;
  alula_avoidance avoidance_;
  std::array<float, 3> executed_{};
};

std::unique_ptr<MovingFilter> make_dr_acbf(const MovingFilterOptions& options, bool with_qp);
std::unique_ptr<MovingFilter> make_mpc(const MovingFilterOptions& options);
std::unique_ptr<MovingFilter> make_cbf_qp(const MovingFilterOptions& options);
std::unique_ptr<MovingFilter> make_rp_cbf(const MovingFilterOptions& options);

}  // namespace alula::flight
