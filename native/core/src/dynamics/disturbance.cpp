#include "alula/dynamics/disturbance.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace alula::flight {

using geometry::cross, geometry::dot, geometry::e3, geometry::norm;

void check(const DisturbanceOptions& options, double gravity) {
  if (!(options.time_s == 0 || (options.time_s >= 0.05 && options.time_s <= 10)))
    throw std::invalid_argument("the time of a disturbance observer must be 0 or in 0.05..10 s");
  if (!(options.max_m_s2 > 0 && options.max_m_s2 < gravity))
    throw std::invalid_argument("a disturbance must be positive and below gravity");
  if (!(options.max_interval_s > 0 && std::isfinite(options.max_interval_s)))
    throw std::invalid_argument("the interval of a disturbance observer must be positive");
}

void DisturbanceObserver::begin(Vec3 thrust_axis, double gravity) {
  reset();
  if (!is_on() || !geometry::is_finite(thrust_axis) || !(thrust_axis.z > 0.5)) return;
  const double lift = -gravity / thrust_axis.z;
  d_ = geometry::limited({lift * thrust_axis.x, lift * thrust_axis.y, 0}, options_.max_m_s2);
}

void DisturbanceObserver::update(double time_s, Vec3 v, Vec3 modelled) {
  if (!is_on() || !geometry::is_finite(v) || !geometry::is_finite(modelled)) return;
  const double interval = time_s - time_;
  if (has_state_ && !(interval > 1e-9)) return;
  time_ = time_s;
  if (!has_state_ || interval > options_.max_interval_s) {
    v_ = v, has_state_ = true;
    return;
  }
  // The continuous poles, exact for held inputs: both at q = exp(-interval / T).
  const double q = std::exp(-interval / options_.time_s);
  v_ = v_ + interval * (modelled + d_);
  const Vec3 error = v - v_;
  v_ = v_ + (1 - q * q) * error;
  d_ = geometry::limited(d_ + (1 - q) * (1 - q) / interval * error, options_.max_m_s2);
  bound_ =
      std::max(bound_ * std::exp(-interval / (2 * options_.time_s)), std::numbers::e * norm(error) / options_.time_s);
}

Level::Level(Vec3 disturbance, double gravity) {
  const Vec3 up = gravity * e3 - disturbance;
  const double length = norm(up);
  scale_ = length / gravity;
  const Vec3 axis = cross(up, e3);
  const double sine = norm(axis);
  if (!(sine > 0)) return;
  turn_ = std::atan2(sine, dot(up, e3)) / sine * axis;
  axis_ = 1 / sine * axis, sine_ = sine / length, cosine_ = dot(up, e3) / length;
}

Vec3 Level::acceleration(Vec3 a) const {
  return scale_ * (cosine_ * a + sine_ * cross(a, axis_) + (1 - cosine_) * dot(axis_, a) * axis_);
}

State Level::operator()(const State& x) const {
  State level = x;
  level.sigma = turned(x.sigma, to_body(x.sigma, turn_));
  return level;
}

}  // namespace alula::flight
