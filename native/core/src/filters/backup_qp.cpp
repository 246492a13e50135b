#include "alula/filters/backup_qp.hpp"

#include <cmath>
#include <stdexcept>

namespace alula::flight {

namespace {

RacerModel model_of(const alula_racer_model& m) {
  return {
      m.gravity, {m.thrust[0], m.thrust[1], m.thrust[2]}, m.rate_gain, {m.max_rate[0], m.max_rate[1], m.max_rate[2]}};
}

}  // namespace

BackupQp::BackupQp(const Geofence& geofence, double alpha)
    : fence_(geofence.fence()),
      config_(geofence.config()),
      alpha_(alpha),
      controller_(fence_, config_, geofence.hover_throttle()),
      model_(model_of(config_.model)) {
  if (fence_.image) throw std::invalid_argument("backup-qp takes a box and faces, not a map");
  if (!(alpha > 0) || !std::isfinite(alpha)) throw std::invalid_argument("alpha must be positive");
}

// x with the derivatives x' = f(x) + g(x) u: v by gravity and thrust, the rates by their decay and commands.
RacerFlow<BackupQp::Number> BackupQp::start(const RacerState& x) const {
  RacerFlow<Number> s;
  const Vec3 axis = racer_axis(x.q);
  const double c = model_.rate_gain;
  for (std::size_t i = 0; i < 3; ++i) {
    const int k = static_cast<int>(i);
    s.p[i] = {x.p[k], {x.v[k]}};
    s.v[i] = {x.v[k], {i == 2 ? -model_.gravity : 0, axis[k]}};
    s.w[i] = {x.omega[k], {-c * x.omega[k]}};
    s.w[i].d[2 + i] = c;
  }
  const Vec4& q = x.q;
  const Vec3& w = x.omega;
  s.q[0] = {q[0], {-0.5 * (q[1] * w.x + q[2] * w.y + q[3] * w.z)}};
  s.q[1] = {q[1], {0.5 * (q[0] * w.x + q[2] * w.z - q[3] * w.y)}};
  s.q[2] = {q[2], {0.5 * (q[0] * w.y - q[1] * w.z + q[3] * w.x)}};
  s.q[3] = {q[3], {0.5 * (q[0] * w.z + q[1] * w.y - q[2] * w.x)}};
  return s;
}

BackupQpReport BackupQp::filter(const RacerState& x, const RacerCommand& pilot) {
  const alula_racer_state onboard = to_onboard(x);
  if (!alula_racer_state_is_valid(&onboard) || !is_finite(pilot)) {
    throw std::invalid_argument("a racer's state and command must be plausible");
  }
  const BackupHold hold = controller_.hold(x);
  const double kept = static_cast<double>(config_.radius_m) + config_.reserve_m, most = model_.acceleration(1);
  const Vec3& rate = model_.max_rate;
  BackupQpReport report;
  report.h_i = std::numeric_limits<double>::infinity();
  rows_.begin({model_.acceleration(0), -rate.x, -rate.y, -rate.z}, {most, rate.x, rate.y, rate.z});
  const auto add = [&](const Number& h) {
    report.h_i = std::min(report.h_i, h.value);
    rows_.add(h.value, h.d[0], {h.d[1], h.d[2], h.d[3], h.d[4]}, alpha_);
  };
  const auto add_node = [&](const std::array<Number, 3>& p) {
    for (std::size_t i = 0; fence_.box && i < 3; ++i) {
      add(p[i] - Number(fence_.box->lower[static_cast<int>(i)] + kept));
      add(Number(fence_.box->upper[static_cast<int>(i)] - kept) - p[i]);
    }
    for (const auto& n : fence_.faces) {
      add(Number(n[3] - kept) - (Number(n[0]) * p[0] + Number(n[1]) * p[1] + Number(n[2]) * p[2]));
    }
  };
  RacerFlow<Number> s = start(x);
  FlowCommand<Number> last{};
  const FlowCommand<Number> first = controller_.command(hold, s);
  add_node(s.p);
  for (std::uint32_t k = 0; k < config_.steps; ++k) {
    controller_.advance(config_.step_s, hold, s, last, k == 0);
    add_node(s.p);
  }
  const Number speed = root(s.v[0] * s.v[0] + s.v[1] * s.v[1] + s.v[2] * s.v[2] + Number(1e-12));
  add(Number(config_.end_gain) * (Number(config_.end_speed_m_s) - speed));
  if (report.h_i > 0 || !has_hold_) hold_ = hold, has_hold_ = true;

  const std::array<double, 4> target{model_.acceleration(pilot.throttle), pilot.rates.x, pilot.rates.y,
                                     pilot.rates.z};
  const QpResult found = rows_.nearest(target, {most, rate.x, rate.y, rate.z});
  report.rows = rows_.size();
  report.is_infeasible = found.status != QpStatus::optimal;
  if (report.is_infeasible) {
    FlowCommand<Number> u = first;
    if (!(report.h_i > 0)) u = controller_.command(hold_, start(x));  // as the geofence does: continue the safe flow
    report.command = {u.throttle.value, {u.rates[0].value, u.rates[1].value, u.rates[2].value}};
    return report;
  }
  report.is_passed = found.active_count == 0;
  report.command =
      report.is_passed ? pilot : RacerCommand{model_.throttle_for(found.x[0]), {found.x[1], found.x[2], found.x[3]}};
  return report;
}

}  // namespace alula::flight
