#include "alula/flight/autopilot.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <stdexcept>

namespace alula::flight {
namespace {

constexpr double kFarthest = 2;  // error of the position that the motion keeps [m]

Vec3 level(Vec3 v) { return {v.x, v.y, 0}; }

// Within the limit of the acceleration that removes an error of the velocity.
Vec3 removing(Vec3 error, double acceleration, double jerk, double h) {
  return limited(std::min(jerk / acceleration, 1 / h) * error, acceleration);
}

}  // namespace

void check(const FollowingOptions& o) {
  const auto is_size = [](double value) { return value >= 0 && std::isfinite(value); };
  const double limits[] = {o.horizontal_acceleration_m_s2, o.horizontal_jerk_m_s3, o.vertical_acceleration_m_s2,
                           o.vertical_jerk_m_s3};
  const bool is_good = std::all_of(std::begin(limits), std::end(limits),
                                   [&](double each) { return is_size(each) && (each > 0) == (limits[0] > 0); });
  if (!is_good)
    throw std::invalid_argument("shaped set-points need limits of acceleration and jerk, both horizontally and up");
  if (!is_size(o.lag_s) || !is_size(o.position_gain_per_s) || !is_size(o.velocity_gain_per_s) ||
      !is_size(o.climb_gain_per_s))
    throw std::invalid_argument("lag and gains of an autopilot must be >= 0");
}

void Autopilot::reset(const State& x) {
  const FollowingOptions& o = options_;
  p_ = x.p, v_ = x.v, a_ = {};
  if (o.is_on()) a_ = removing({0, 0, -x.v.z}, o.vertical_acceleration_m_s2, o.vertical_jerk_m_s3, 1e-3);
  acting_ = a_;
}

Vec3 Autopilot::follow_velocity(double h, Vec3 u, const State& x) {
  advance(h);
  const Vec3 error = u - v_;
  const FollowingOptions& o = options_;
  turn_towards(h, removing(level(error), o.horizontal_acceleration_m_s2, o.horizontal_jerk_m_s3, h) +
                      removing({0, 0, error.z}, o.vertical_acceleration_m_s2, o.vertical_jerk_m_s3, h));
  return followed(h, x);
}

Vec3 Autopilot::follow_acceleration(double h, Vec3 u, const State& x) {
  advance(h);
  turn_towards(h, u);
  return followed(h, x);
}

void Autopilot::advance(double h) {
  p_ = p_ + h * v_ + h * h / 2 * a_;
  v_ = v_ + h * a_;
}

void Autopilot::turn_towards(double h, Vec3 wanted) {
  const Vec3 change = wanted - a_;
  const double up = options_.vertical_jerk_m_s3 * h;
  a_ = a_ + limited(level(change), options_.horizontal_jerk_m_s3 * h);
  a_.z += std::clamp(change.z, -up, up);
}

Vec3 Autopilot::followed(double h, const State& x) {
  const FollowingOptions& o = options_;
  p_ = x.p + limited(p_ - x.p, kFarthest);
  const Vec3 error = v_ + o.position_gain_per_s * (p_ - x.p) - x.v;
  const double k = o.velocity_gain_per_s;
  const Vec3 wanted = a_ + geometry::by_axis({k, k, o.climb_gain_per_s}, error);
  acting_ = acting_ + (o.lag_s > 0 ? 1 - std::exp(-h / o.lag_s) : 1) * (wanted - acting_);
  return acting_;
}

}  // namespace alula::flight
