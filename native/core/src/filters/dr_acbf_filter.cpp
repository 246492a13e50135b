// Onboard filter behind the MovingFilter interface, with its own projection or with the general QP solver.
#include <algorithm>
#include <stdexcept>

#include "alula/filters/moving_guide.hpp"

namespace alula::flight {

using geometry::Vec3;

namespace {

class DrAcbf final : public MovingFilter {
 public:
  DrAcbf(const MovingFilterOptions& options, bool with_qp) : with_qp_(with_qp), nearest_(options.backend) {
    if (alula_dr_acbf_init(&filter_, &options.config) != ALULA_READY) {
      throw std::invalid_argument("the parameters of a filter among moving obstacles are out of range");
    }
  }

  MovingReport filter(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                      std::span<const alula_wall> walls, Vec3 nominal) override {
    filter_.projector = with_qp_ ? &DrAcbf::project : nullptr;
    filter_.projector_context = this;
    alula_dr_acbf_result result;
    const alula_filter_status status = alula_dr_acbf_filter(
        &filter_, &vehicle, tracks.data(), static_cast<std::uint32_t>(tracks.size()), walls.data(),
        static_cast<std::uint32_t>(walls.size()), to_float(nominal).data(), &result);
    if (status == ALULA_FILTER_REFUSED) return {};
    MovingReport report = moving_report(static_cast<MovingStatus>(status),
                                        status == ALULA_FILTER_OK ? nominal : to_vec3(result.a), result.guidance);
    report.horizon_s = result.horizon_s;
    report.feasible = result.feasible != 0;
    report.rows = result.rows;
    report.iterations = result.iterations;
    if (result.rows > 0) report.violation = result.violation;
    if (result.rows > walls.size()) report.risk_left = risk_left(result);
    return report;
  }
  void flown(Vec3 a) override { alula_dr_acbf_flown(&filter_, to_float(a).data()); }
  void reset() override { alula_dr_acbf_reset(&filter_); }
  std::unique_ptr<MovingFilter> clone() const override { return std::make_unique<DrAcbf>(*this); }

 private:
  // The lambda for which the row would hold with equality, n . a = b(H), and the corresponding probability.
  double risk_left(const alula_dr_acbf_result& result) const {
    const double h = result.horizon_s;
    double sum = 0;
    for (std::uint32_t i = 0; i < filter_.avoidance.count; ++i) {
      const alula_encounter& m = filter_.avoidance.encounter[i];
      if (!m.has_row) continue;
      const double bound = alula_row_bound(&filter_.config, &m, result.horizon_s, 0);
      const double slack = (bound - dot(to_vec3(m.los), to_vec3(result.a))) * h * h / 2;
      const double variance = m.sigma2_p + h * h * m.sigma2_v;
      sum += slack > 0 ? variance / (variance + slack * slack) : 1;
    }
    return sum;
  }

  static void project(void* context, const alula_half_space* row, std::uint32_t count, float limit, const float a0[3],
                      alula_projection* result) {
    NearestPoint& nearest = static_cast<DrAcbf*>(context)->nearest_;
    nearest.clear();
    for (std::uint32_t i = 0; i < count; ++i) nearest.add(to_vec3(row[i].normal), row[i].bound);
    nearest.add_box(limit);
    Vec3 x = to_vec3(a0);
    int iterations = 0;
    result->feasible = nearest.solve(to_vec3(a0), x, iterations);
    result->iterations = static_cast<std::uint32_t>(iterations);
    result->basis_count = 0;
    result->violation = -FLT_MAX;
    for (int k = 0; k < 3; ++k) result->a[k] = std::clamp(static_cast<float>(x[k]), -limit, limit);
    for (std::uint32_t i = 0; i < count; ++i) {
      const double excess = dot(to_vec3(row[i].normal), to_vec3(result->a)) - static_cast<double>(row[i].bound);
      result->violation = std::max(result->violation, static_cast<float>(excess));
    }
  }

  bool with_qp_;
  NearestPoint nearest_;
  alula_dr_acbf filter_;
};

}  // namespace

std::unique_ptr<MovingFilter> make_dr_acbf(const MovingFilterOptions& options, bool with_qp) {
  return std::make_unique<DrAcbf>(options, with_qp);
}

}  // namespace alula::flight
