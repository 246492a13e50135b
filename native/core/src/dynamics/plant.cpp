#include "alula/dynamics/plant.hpp"

#include <algorithm>
#include <cmath>

#include "alula/base/constants.hpp"
#include "alula/base/require.hpp"

namespace alula::flight {
namespace {

using geometry::multiply;

enum Channel : std::uint32_t { kPosition, kVelocity, kAttitude, kRate, kGust };

}  // namespace

void check(const SensorOptions& o) {
  require(is_size(o.position_noise_m) && is_size(o.velocity_noise_m_s) && is_size(o.attitude_noise_rad) &&
              is_size(o.rate_noise_rad_s),
          "noise needs standard deviations >= 0");
  require(is_size(o.noise_time_s), "a correlation time must be >= 0");
  require(is_size(o.delay_s) && o.delay_s <= 10, "a delay must be in 0..10 s");
}

void check(const PlantOptions& o) {
  require(is_size(o.motor_time_constant_s), "the time constant of the motors must be >= 0");
  require(is_size(o.linear_drag) && is_size(o.quadratic_drag), "drag must be >= 0");
  require(geometry::is_finite(o.wind_m_s), "the wind must be finite");
  require(is_size(o.gust_m_s), "gusts need standard deviations >= 0");
  require(o.gust_time_s > 0 && std::isfinite(o.gust_time_s), "the time of gusts must be positive");
  check(o.sensor);
}

Sensor::Sensor(const SensorOptions& options, RandomStream random) : options_(options), random_(random), ring_(8) {
  check(options);
  reset({});
}

void Sensor::reset(const State& x) {
  oldest_ = 0, count_ = 1;
  ring_[0] = {0, x};
  steps_ = 0, time_ = 0;
  if (options_.noise_time_s > 0)
    position_error_ = random_.normals(0, kPosition), velocity_error_ = random_.normals(0, kVelocity);
}

void Sensor::record(double time, const State& x) {
  if (options_.noise_time_s > 0) {
    const double kept = std::exp((time_ - time) / options_.noise_time_s), fresh = std::sqrt(1 - kept * kept);
    ++steps_;
    position_error_ = kept * position_error_ + fresh * random_.normals(steps_, kPosition);
    velocity_error_ = kept * velocity_error_ + fresh * random_.normals(steps_, kVelocity);
  }
  time_ = time;
  if (options_.delay_s == 0) {  // only the newest is measured
    at(0) = {time, x};
    return;
  }
  if (count_ == ring_.size()) {
    std::rotate(ring_.begin(), ring_.begin() + static_cast<std::ptrdiff_t>(oldest_), ring_.end());
    oldest_ = 0;
    ring_.resize(2 * ring_.size());
  }
  at(count_++) = {time, x};
  while (count_ > 1 && at(1).time <= time - options_.delay_s + kSameTime)
    oldest_ = (oldest_ + 1) % ring_.size(), --count_;
}

// The state at the exact age: between two steps the path is the cubic through their positions and velocities, and the
// body turns by its mean rates.
State Sensor::delayed() const {
  const Sample& a = at(0);
  const double since = time_ - options_.delay_s - a.time;
  if (count_ < 2 || !(since > kSameTime)) return a.x;
  const Sample& b = at(1);
  const double h = b.time - a.time, s = since / h;
  const Vec3 mean = 1 / h * (b.x.p - a.x.p), rates = a.x.omega + s / 2 * (b.x.omega - a.x.omega);
  State x = a.x;
  x.v = (1 - s) * (1 - 3 * s) * a.x.v + s * (3 * s - 2) * b.x.v + 6 * s * (1 - s) * mean;
  x.p = a.x.p + since * ((1 - s) * (1 - s) * a.x.v + s * (s - 1) * b.x.v + s * (3 - 2 * s) * mean);
  x.sigma = turned(a.x.sigma, since * rates);
  x.omega = a.x.omega + s * (b.x.omega - a.x.omega);
  return x;
}

State Sensor::measured(std::uint64_t step) const {
  State x = delayed();
  const auto noise = [&](double deviation, Channel channel) { return deviation * random_.normals(step, channel); };
  if (options_.noise_time_s > 0) {
    x.p += options_.position_noise_m * position_error_;
    x.v += options_.velocity_noise_m_s * velocity_error_;
  } else {
    if (options_.position_noise_m > 0) x.p += noise(options_.position_noise_m, kPosition);
    if (options_.velocity_noise_m_s > 0) x.v += noise(options_.velocity_noise_m_s, kVelocity);
  }
  if (options_.attitude_noise_rad > 0) x.sigma = turned(x.sigma, noise(options_.attitude_noise_rad, kAttitude));
  if (options_.rate_noise_rad_s > 0) x.omega += noise(options_.rate_noise_rad_s, kRate);
  return x;
}

Plant::Plant(const Quadrotor& quadrotor, const PlantOptions& options, RandomStream random)
    : quadrotor_(quadrotor), options_(options), random_(random), sensor_(options.sensor, random) {
  check(options);
  has_drag_ = !is_zero(options.linear_drag) || !is_zero(options.quadratic_drag);
  has_gusts_ = has_drag_ && !is_zero(options.gust_m_s);
  reset({});
}

void Plant::reset(const State& x) {
  x_ = x;
  time_ = 0, steps_ = 0;
  command_ = wrench_ = quadrotor_.limited({quadrotor_.hover_thrust(), {}});
  rotor_ = quadrotor_.rotor_thrust(wrench_);
  gust_ = has_gusts_ ? multiply(options_.gust_m_s, random_.normals(0, kGust)) : Vec3{};
  sensor_.reset(x);
}

void Plant::switch_shadow() { x_.sigma = shadowed(x_.sigma); }

State Plant::derivative(const State& x, const Wrench& u) const {
  if (!has_drag_) return quadrotor_.derivative(x, u);
  const Mat3 R = body_from_inertial(x.sigma);
  const Vec3 air = R * (x.v - wind());
  const Vec3 drag = multiply(options_.linear_drag + geometry::norm(air) * options_.quadratic_drag, air);
  return quadrotor_.derivative(x, u, -1 / quadrotor_.mass() * geometry::transposed_times(R, drag));
}

void Plant::step(double dt, const Wrench& command) {
  if (is_finite(command)) command_ = quadrotor_.saturated(command);
  const double lag = options_.motor_time_constant_s;
  if (lag == 0) {
    wrench_ = command_;
    x_ = has_drag_ ? rk4_step(x_, dt, [&](double, const State& x) { return derivative(x, wrench_); })
                   : quadrotor_.step(x_, wrench_, dt);
  } else {
    x_ = following_step(quadrotor_, lag, x_, rotor_, command_, dt,
                        [&](const State& x, const Wrench& u) { return derivative(x, u); });
    wrench_ = quadrotor_.wrench(rotor_);
  }
  time_ += dt, ++steps_;
  if (has_gusts_) {
    const double kept = std::exp(-dt / options_.gust_time_s);
    gust_ = kept * gust_ + std::sqrt(1 - kept * kept) * multiply(options_.gust_m_s, random_.normals(steps_, kGust));
  }
  sensor_.record(time_, x_);
}

DoubleIntegrator::DoubleIntegrator(double max_acceleration, const SensorOptions& sensor, RandomStream random)
    : max_acceleration_(max_acceleration), sensor_(sensor, random) {
  require(max_acceleration > 0, "the largest acceleration must be positive");
}

void DoubleIntegrator::reset(const State& x) {
  x_ = {x.p, {}, x.v, {}};
  acceleration_ = {};
  time_ = 0, steps_ = 0;
  sensor_.reset(x_);
}

void DoubleIntegrator::step(double dt, Vec3 acceleration) {
  if (geometry::is_finite(acceleration)) {
    const double size = geometry::norm(acceleration);
    acceleration_ = size > max_acceleration_ ? max_acceleration_ / size * acceleration : acceleration;
  }
  x_.p += dt * x_.v + dt * dt / 2 * acceleration_;
  x_.v += dt * acceleration_;
  time_ += dt, ++steps_;
  sensor_.record(time_, x_);
}

}  // namespace alula::flight
