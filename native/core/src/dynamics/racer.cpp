#include "alula/dynamics/racer.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace alula::flight {

namespace {

constexpr std::uint32_t kRacerGust = 0x10;  // one of the plant's channels

// The states that RK4 integrates.
struct Motion {
  Vec3 p, v;
  Vec4 q;
};

Motion operator+(const Motion& a, const Motion& b) {
  return {a.p + b.p, a.v + b.v, {a.q[0] + b.q[0], a.q[1] + b.q[1], a.q[2] + b.q[2], a.q[3] + b.q[3]}};
}
Motion operator*(double s, const Motion& a) {
  return {s * a.p, s * a.v, {s * a.q[0], s * a.q[1], s * a.q[2], s * a.q[3]}};
}

Vec4 attitude_rate(const Vec4& q, Vec3 w) {
  return {-0.5 * (q[1] * w.x + q[2] * w.y + q[3] * w.z), 0.5 * (q[0] * w.x + q[2] * w.z - q[3] * w.y),
          0.5 * (q[0] * w.y - q[1] * w.z + q[3] * w.x), 0.5 * (q[0] * w.z + q[1] * w.y - q[2] * w.x)};
}

// Rotates between body and world, by q v q* and its inverse.
Vec3 rotated(const Vec4& q, Vec3 a, double sign) {
  const Vec3 axis{sign * q[1], sign * q[2], sign * q[3]};
  const Vec3 t = 2.0 * geometry::cross(axis, a);
  return a + q[0] * t + geometry::cross(axis, t);
}

bool is_positive(double x) { return std::isfinite(x) && x > 0; }

}  // namespace

double RacerModel::throttle_for(double acceleration) const {
  const double c = acceleration - thrust[0], b = thrust[1];
  if (!(c > 0)) return 0;
  return std::clamp(2 * c / (b + std::sqrt(b * b + 4 * thrust[2] * c)), 0.0, 1.0);
}

void check(const RacerModel& model) {
  for (const double a : model.thrust) {
    if (!std::isfinite(a)) throw std::invalid_argument("a racer's thrust map must be finite");
  }
  if (model.thrust[1] < 0 || model.thrust[2] < 0 || !is_positive(model.gravity) ||
      !(model.acceleration(1) > model.gravity) || !(model.acceleration(0) < model.gravity)) {
    throw std::invalid_argument("a racer's thrust must rise with the throttle, from below hovering to above");
  }
  if (!is_positive(model.rate_gain) || !is_size(model.max_rate)) {
    throw std::invalid_argument("a racer's rate gain and rates must be positive");
  }
}

void check(const RacerOptions& o) {
  if (!is_positive(o.mass) || !is_positive(o.mass_scale) || !is_positive(o.thrust_scale) ||
      !is_positive(o.rate_gain_scale) || !is_positive(o.gust_time_s) || !is_positive(o.sag_time_s)) {
    throw std::invalid_argument("a racer's mass, scales and times must be positive");
  }
  if (!(o.delay_s >= 0 && o.delay_s <= 1) || !(o.sag_share >= 0 && o.sag_share < 1)) {
    throw std::invalid_argument("a racer's delay is 0 to 1 s and its sag 0 to 1");
  }
  if (!is_size(o.linear_drag) || !is_size(o.quadratic_drag) || !is_size(o.gust_m_s) ||
      !geometry::is_finite(o.wind_m_s)) {
    throw std::invalid_argument("a racer's drag and gusts must be finite and not negative");
  }
}

Vec3 racer_axis(const Vec4& q) {
  return {2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]), 1 - 2 * (q[1] * q[1] + q[2] * q[2])};
}

Racer::Racer(const RacerModel& model, const RacerOptions& options, RandomStream random)
    : model_(model), options_(options), random_(random) {
  check(model);
  check(options);
  has_air_ = !is_zero(options.linear_drag) || !is_zero(options.quadratic_drag);
  hover_.throttle = model.throttle_for(model.gravity);
  reset({});
}

void Racer::reset(const RacerState& x) {
  x_ = x;
  pending_.clear();
  next_ = 0;
  sag_ = time_ = dt_ = 0;
  steps_ = 0;
  gust_ = by_axis(options_.gust_m_s, random_.normals(0, kRacerGust));
}

Vec3 Racer::acceleration(const Vec3& v, const Vec4& q, double thrust) const {
  Vec3 a = thrust * racer_axis(q);
  a.z -= model_.gravity;
  if (!has_air_) return a;
  const Vec3 air = rotated(q, v - (options_.wind_m_s + gust_), -1);
  const Vec3 force = by_axis(options_.linear_drag + geometry::norm(air) * options_.quadratic_drag, air);
  return a - 1 / (options_.mass * options_.mass_scale) * rotated(q, force, 1);
}

void Racer::step(double dt, const RacerCommand& command) {
  if (dt_ != dt) {
    dt_ = dt;
    decay_ = std::exp(-model_.rate_gain * options_.rate_gain_scale * dt);
    half_decay_ = std::exp(-model_.rate_gain * options_.rate_gain_scale * dt / 2);
  }
  if (pending_.empty()) {
    pending_.assign(1 + static_cast<std::size_t>(std::lround(options_.delay_s / dt)), hover_);
  }
  const std::size_t last = (next_ + pending_.size() - 1) % pending_.size();
  RacerCommand u = is_finite(command) ? command : pending_[last];
  u.throttle = std::clamp(u.throttle, 0.0, 1.0);
  for (int i = 0; i < 3; ++i) u.rates[i] = std::clamp(u.rates[i], -model_.max_rate[i], model_.max_rate[i]);
  pending_[next_] = u;
  next_ = (next_ + 1) % pending_.size();
  u = pending_[next_];  // the oldest; with one entry the newest

  const double scale = options_.thrust_scale / options_.mass_scale * (1 - options_.sag_share * sag_);
  const double thrust = scale * model_.acceleration(u.throttle);
  const Vec3 away = x_.omega - u.rates;
  const auto f = [&](double t, const Motion& m) -> Motion {
    const double left = t == 0 ? 1 : (t == dt ? decay_ : half_decay_);
    return {m.v, acceleration(m.v, m.q, thrust), attitude_rate(m.q, u.rates + left * away)};
  };
  const Motion after = rk4_step(Motion{x_.p, x_.v, x_.q}, dt, f);
  double square = 0;
  for (const double c : after.q) square += c * c;
  const double unit = 1 / std::sqrt(square);
  x_ = {after.p, after.v, after.q, u.rates + decay_ * away};
  for (double& c : x_.q) c *= unit;

  sag_ += (1 - std::exp(-dt / options_.sag_time_s)) * (u.throttle * u.throttle - sag_);
  ++steps_;
  time_ += dt;
  if (is_zero(options_.gust_m_s)) return;
  const double kept = std::exp(-dt / options_.gust_time_s);
  gust_ = kept * gust_ + std::sqrt(1 - kept * kept) * by_axis(options_.gust_m_s, random_.normals(steps_, kRacerGust));
}

}  // namespace alula::flight
