// A barrier on the velocity: 2 P . (v_i - v) + (d^2 - R_eff^2) / T >= 0, min |v - v_avoid|^2, a = clip((v - v_e) /
// t_v), where v_avoid is the velocity that the manoeuvre's acceleration reaches in t_v. The violation reported is the
// row violation at the velocity that the flown command reaches in t_v, divided by 2 d and by t_v: an acceleration.
#include <algorithm>
#include <stdexcept>

#include "alula/filters/moving_guide.hpp"

namespace alula::flight {

using geometry::Vec3;

namespace {

class CbfQp final : public MovingFilter {
 public:
  explicit CbfQp(const MovingFilterOptions& options)
      : options_(options.cbf_qp), guide_(options.config), nearest_(options.backend) {
    if (!(options_.horizon_s > 0 && options_.horizon_s < 1e3 && options_.velocity_time_s > 0 &&
          options_.velocity_time_s < 1e3)) {
      throw std::invalid_argument("cbf_qp: times must be above 0");
    }
  }

  MovingReport filter(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                      std::span<const alula_wall> walls, Vec3 nominal) override {
    alula_guidance guidance;
    if (!guide_.step(vehicle, tracks, walls, nominal, guidance)) return {};
    const Vec3 target = to_vec3(guidance.desired), v = to_vec3(vehicle.velocity);
    nearest_.clear();
    for (std::size_t i = 0; i < tracks.size() && guide_.binds(guidance); ++i) {
      const alula_encounter& m = guide_.encounters()[i];
      if (!m.active) continue;
      const Vec3 n = to_vec3(m.los);
      const double d = std::max(1e-3, static_cast<double>(m.distance_m)),
                   r = alula_effective_clearance(&guide_.config(), &m, static_cast<float>(options_.horizon_s));
      nearest_.add(n, dot(n, to_vec3(tracks[i].velocity)) + (d * d - r * r) / (2 * options_.horizon_s * d));
    }
    const double time = options_.velocity_time_s;
    Vec3 a = target;
    bool holds = true;
    int iterations = 0;
    if (nearest_.size() > 0) {
      const Vec3 towards = v + time * target;
      Vec3 command = towards;
      holds = nearest_.solve(towards, command, iterations);
      if (!holds) command = nearest_.least_violation(towards, guide_.config().v_max);
      // Unchanged where no row acts: v + (x - v) may round differently.
      if (norm(command - towards) > 1e-12) a = (1 / time) * (command - v);
    }
    MovingReport report = guide_.finish(guidance, vehicle, walls, nominal, a, holds);
    report.feasible = holds;
    report.rows = static_cast<std::uint32_t>(nearest_.size());
    report.iterations = static_cast<std::uint32_t>(iterations);
    guide_.missed(nearest_.violation(v + time * report.acceleration) / time, report);
    return report;
  }
  void flown(Vec3 a) override { guide_.flown(a); }
  void reset() override { guide_.reset(); }
  std::unique_ptr<MovingFilter> clone() const override { return std::make_unique<CbfQp>(*this); }

 private:
  CbfQpOptions options_;
  Guide guide_;
  NearestPoint nearest_;
};

}  // namespace

std::unique_ptr<MovingFilter> make_cbf_qp(const MovingFilterOptions& options) {
  return std::make_unique<CbfQp>(options);
}

}  // namespace alula::flight
