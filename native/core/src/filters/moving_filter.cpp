#include "alula/filters/moving_filter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "alula/filters/moving_guide.hpp"

namespace alula::flight {

using geometry::Vec3;

MovingReport moving_report(MovingStatus status, Vec3 acceleration, const alula_guidance& guidance) {
  MovingReport report;
  report.status = status;
  report.acceleration = acceleration;
  report.mode = static_cast<std::uint8_t>(guidance.mode);
  report.warned = guidance.warned != 0;
  report.risk_m = guidance.risk_m > -FLT_MAX ? guidance.risk_m : -std::numeric_limits<double>::infinity();
  report.urgent = guidance.urgent == ALULA_NO_OBSTACLE ? -1 : static_cast<std::int64_t>(guidance.urgent);
  report.violation = -std::numeric_limits<double>::infinity();
  return report;
}

NearestPoint::NearestPoint(QpBackend backend) {
  if (backend) solver_ = QpSolver::with_backend(std::move(backend));
  const std::size_t most = ALULA_OBSTACLES + ALULA_WALLS + 6;
  solver_.reserve(most);
  rows_.reserve(3 * most);
  bounds_.reserve(most);
  unit_.reserve(most);
}

void NearestPoint::add(Vec3 n, double b) {
  for (int k = 0; k < 3; ++k) rows_.push_back(-n[k]);
  bounds_.push_back(-b);
}

void NearestPoint::add_box(double limit) {
  for (int k = 0; k < 3; ++k) {
    Vec3 n;
    n[k] = 1;
    add(n, limit);
    add(-1 * n, limit);
  }
}

bool NearestPoint::solve(Vec3 target, Vec3& x, int& iterations) {
  constexpr std::array<double, 9> identity{1, 0, 0, 0, 1, 0, 0, 0, 1};
  const std::array<double, 3> gradient{-target.x, -target.y, -target.z};
  const QpResult result = solver_.solve({3, identity, gradient, rows_, bounds_});
  iterations = result.iterations;
  if (result.status != QpStatus::optimal) return false;
  x = {result.x[0], result.x[1], result.x[2]};
  return true;
}

double NearestPoint::violation(Vec3 x, double shortest) const {
  double most = -std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < size(); ++i) {
    const Vec3 n = geometry::from_rows(rows_.data() + 3 * i);
    const double length = norm(n);
    if (length > shortest) most = std::max(most, (bounds_[i] - dot(n, x)) / length);
  }
  return most;
}

Vec3 NearestPoint::least_violation(Vec3 target, double limit) {
  unit_.clear();
  for (std::size_t i = 0; i < size(); ++i) {
    const Vec3 n = -1 * geometry::from_rows(rows_.data() + 3 * i);
    const double length = norm(n);
    if (!(length > 1e-9)) continue;
    const auto unit = to_float((1 / length) * n);
    unit_.push_back({{unit[0], unit[1], unit[2]}, static_cast<float>(-bounds_[i] / length)});
  }
  alula_projection found;
  const auto count = static_cast<std::uint32_t>(unit_.size());
  alula_project_least_violation(unit_.data(), count, count, static_cast<float>(limit), to_float(target).data(),
                                &found);
  return to_vec3(found.a);
}

Guide::Guide(const alula_dr_acbf_config& config) : config_(config) {
  alula_dr_acbf probe;
  if (alula_dr_acbf_init(&probe, &config) != ALULA_READY) {
    throw std::invalid_argument("the parameters of a filter among moving obstacles are out of range");
  }
  avoidance_ = probe.avoidance;
}

void Guide::reset() {
  alula_avoidance_reset(&avoidance_);
  executed_ = {};
}

void Guide::flown(Vec3 acceleration) {
  const auto a = to_float(acceleration);
  if (!std::all_of(a.begin(), a.end(), [](float x) { return std::abs(x) <= ALULA_LARGEST; })) return;
  alula_avoidance_flown(&avoidance_, a.data());
  alula_execute(&config_, a.data(), executed_.data());
}

bool Guide::step(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                 std::span<const alula_wall> walls, Vec3 nominal, alula_guidance& guidance) {
  return alula_avoidance_step(&avoidance_, &vehicle, tracks.data(), static_cast<std::uint32_t>(tracks.size()),
                              walls.data(), static_cast<std::uint32_t>(walls.size()), to_float(nominal).data(),
                              &guidance) == ALULA_READY;
}

MovingReport Guide::finish(const alula_guidance& guidance, const alula_vehicle_state& vehicle,
                           std::span<const alula_wall> walls, Vec3 nominal, Vec3 a, bool holds) {
  const float limit = config_.avoidance.a_max;
  const auto target = to_float(a);
  std::array<float, 3> flown;
  for (std::size_t k = 0; k < 3; ++k) flown[k] = std::clamp(target[k], -limit, limit);
  double missed = -std::numeric_limits<double>::infinity();
  if (!walls.empty()) {
    std::array<alula_half_space, ALULA_WALLS> row;
    for (std::size_t i = 0; i < walls.size(); ++i) {
      row[i] = alula_wall_row(&config_, &walls[i], vehicle.velocity, executed_.data(), avoidance_.command);
    }
    alula_projection found;
    const auto count = static_cast<std::uint32_t>(walls.size());
    alula_project_least_violation(row.data(), count, count, limit, flown.data(), &found);
    std::copy_n(found.a, 3, flown.begin());
    holds = holds && found.violation <= config_.tolerance;
    missed = found.violation;
  }
  this->flown(to_vec3(flown.data()));
  const bool same = guidance.mode == ALULA_NOMINAL && flown == to_float(nominal);
  MovingReport report =
      moving_report(!holds ? MovingStatus::recovering : (same ? MovingStatus::ok : MovingStatus::filtered),
                    same ? nominal : to_vec3(flown.data()), guidance);
  report.violation = missed;
  return report;
}

namespace {

// The nominal acceleration, clipped to the box.
class NoFilter final : public MovingFilter {
 public:
  explicit NoFilter(const MovingFilterOptions& options) : guide_(options.config) {}

  MovingReport filter(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                      std::span<const alula_wall> walls, Vec3 nominal) override {
    alula_guidance guidance;
    if (!guide_.step(vehicle, tracks, walls, nominal, guidance)) return {};
    guide_.reset();
    const double limit = guide_.config().avoidance.a_max;
    MovingReport report = moving_report(MovingStatus::ok, nominal, guidance);
    report.mode = ALULA_NOMINAL;
    for (int k = 0; k < 3; ++k) {
      report.acceleration[k] = std::clamp(nominal[k], -limit, limit);
      if (report.acceleration[k] != nominal[k]) report.status = MovingStatus::filtered;
    }
    return report;
  }
  void flown(Vec3) override {}
  void reset() override { guide_.reset(); }
  std::unique_ptr<MovingFilter> clone() const override { return std::make_unique<NoFilter>(*this); }

 private:
  Guide guide_;
};

}  // namespace

std::unique_ptr<MovingFilter> make_moving_filter(MovingMethod method, const MovingFilterOptions& options) {
  switch (method) {
    case MovingMethod::none:
      return std::make_unique<NoFilter>(options);
    case MovingMethod::dr_acbf:
      return make_dr_acbf(options, false);
    case MovingMethod::dr_acbf_qp:
      return make_dr_acbf(options, true);
    case MovingMethod::mpc:
      return make_mpc(options);
    case MovingMethod::cbf_qp:
      return make_cbf_qp(options);
    case MovingMethod::rp_cbf:
      return make_rp_cbf(options);
  }
  throw std::invalid_argument("no filter among moving obstacles has this number");
}

}  // namespace alula::flight
