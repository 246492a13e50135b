#include "alula/filters/smooth_nominal.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

constexpr double kMost = 8;             // maximum |a*| where cones demand more [m/s^2]
constexpr double kReturnsPerTime = 2;   // rate of a row with h < 0 times the time to its ellipsoid
constexpr double kMostReturnRate = 20;  // maximum of that rate [1/s]
constexpr double kMostSpeedUp = 20;     // maximum change of the reference speed that counts [m/s^2]

Vec3 at_most(Vec3 v, double length) {
  const double norm = geometry::norm(v);
  return norm > length ? length / norm * v : v;
}

}  // namespace

SmoothNominal::SmoothNominal(std::size_t rows, const SmoothNominalOptions& options)
    : options_(options), program_(rows) {
  const SmoothNominalOptions& o = options_;
  const bool good = o.release_rad_s >= 0 && o.release_growth_1_s > 0 && o.attitude_rad_s > o.release_rad_s &&
                    o.position_rad_s > 0 && o.catch_up_m_s > 0 && o.acceleration > 0 && o.speed_m_s > 0 &&
                    o.cone_rate_1_s > 0 && o.cone_rate_1_s <= kMostReturnRate &&
                    std::isfinite(o.attitude_rad_s + o.position_rad_s + o.acceleration);
  if (!good)
    throw std::invalid_argument(
        "the smooth nominal needs 0 <= release_rad_s < nominal_attitude_rad_s, positive rates and limits, and "
        "nominal_cone_rate_1_s <= 20");
}

double SmoothNominal::pole() const { return options_.release_rad_s * std::exp(options_.release_growth_1_s * since_); }

bool SmoothNominal::is_releasing() const { return is_on() && pole() < options_.attitude_rad_s; }

void SmoothNominal::start(double dt) {
  since_ += dt, dt_ = dt;
  program_.start({});
}

void SmoothNominal::add(const Cone& c, bool on_gamma, std::uint32_t item) {
  if (!is_on()) return;
  const double rate = options_.cone_rate_1_s;
  if (on_gamma) return program_.add(escape_row(c, rate), item);
  const double returning = kReturnsPerTime * c.beta / std::abs(c.delta);
  program_.add(cone_row(c, c.h > 0 ? rate : std::clamp(returning, rate, kMostReturnRate)), item);
}

Vec3 SmoothNominal::snap(const SnapMap& map, Vec3 v, const Nominal& nominal) {
  const SmoothNominalOptions& o = options_;
  // A single wrong velocity error must not stiffen the poles for the rest of a flight.
  const double speed = std::max(top_speed_, geometry::norm(v)) + kMostSpeedUp * dt_;
  top_speed_ = std::max(top_speed_, std::min(speed, geometry::norm(v - nominal.velocity_error)));
  const double p1 = is_releasing() ? pole() : o.release_rad_s, p2 = o.attitude_rad_s;
  const double faster = std::max(1.0, top_speed_ / o.speed_m_s), most = std::max(1.0, p2 / o.position_rad_s),
               haste = std::min(faster * std::sqrt(faster), most), q = haste * o.position_rad_s;
  const double c2 = p1 * p2 + 2 * q * (p1 + p2) + q * q, c1 = 2 * q * p1 * p2 + q * q * (p1 + p2),
               c0 = q * q * p1 * p2;
  const Vec3 behind = at_most(nominal.position_error, haste * o.catch_up_m_s * c1 / c0);
  const Vec3 pull = at_most(1 / c2 * (c1 * nominal.velocity_error + c0 * behind), haste * o.acceleration);
  Vec3 target = nominal.reference_acceleration - pull;
  program_.set_nominal(target);
  if (!program_.holds(target, 0, false)) {
    FilterReport found;
    if (program_.solve(found, false)) target = at_most(found.acceleration, kMost);
  }
  const Vec3 own = c2 * (target - map.acceleration) - (p1 + p2 + 2 * q) * map.jerk;
  const Vec3 back = p1 * p2 * (nominal.acceleration - map.acceleration) - (p1 + p2) * map.jerk;
  const double weight = 1 - std::log(p1 / o.release_rad_s) / std::log(p2 / o.release_rad_s);
  return weight * own + (1 - weight) * back;
}

}  // namespace alula::flight
