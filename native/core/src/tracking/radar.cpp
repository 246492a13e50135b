#include "alula/tracking/radar.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "alula/base/require.hpp"

namespace alula::flight {
namespace {

using geometry::Mat3;
using geometry::Vec3;

constexpr double kLeastSigma = 1e-4;   // of a position, which keeps covariances regular [m]
constexpr double kLeastRange = 1e-3;   // smallest measured range [m]
constexpr std::uint32_t kPerItem = 4;  // channels per obstacle or false detection

// A level frame: forward, left, up.
struct Frame {
  explicit Frame(double yaw) : forward{std::cos(yaw), std::sin(yaw), 0}, left{-std::sin(yaw), std::cos(yaw), 0} {}
  Vec3 forward, left;
};

// Range, azimuth to the left of forward, elevation.
struct Polar {
  double range = 0, azimuth = 0, elevation = 0;
};

Polar polar_of(const Frame& frame, Vec3 p) {
  const double x = dot(p, frame.forward), y = dot(p, frame.left);
  return {norm(p), std::atan2(y, x), std::atan2(p.z, std::hypot(x, y))};
}

struct Sigmas {
  explicit Sigmas(const RadarOptions& o)
      : range(o.noise_scale * o.sigma_range_m),
        azimuth(o.noise_scale * o.sigma_azimuth_rad),
        elevation(o.noise_scale * o.sigma_elevation_rad),
        range_rate(o.noise_scale * o.sigma_range_rate_m_s),
        position(std::max(kLeastSigma, o.noise_scale * o.position_sigma_m)) {}
  double range, azimuth, elevation, range_rate, position;
};

// T diag(sigma_r^2, (d sigma_az)^2, (d sigma_el)^2) T^T with T along the line of sight, to its left and upwards.
Detection detection_at(const RadarOptions& o, const Sigmas& sigma, const Frame& frame, const Kinematics& own,
                       const Polar& at, double relative_rate) {
  const double ca = std::cos(at.azimuth), sa = std::sin(at.azimuth);
  const double ce = std::cos(at.elevation), se = std::sin(at.elevation);
  const Vec3 outwards = ca * frame.forward + sa * frame.left, left = ca * frame.left - sa * frame.forward;
  const Vec3 los = ce * outwards + se * geometry::e3, upwards = ce * geometry::e3 - se * outwards;
  const double across = at.range * sigma.azimuth, along_up = at.range * sigma.elevation;
  const double own_variance = o.own_position_sigma_m * o.own_position_sigma_m;
  Detection d;
  d.position = own.p + at.range * los;
  d.covariance = sigma.range * sigma.range * outer(los, los) + across * across * outer(left, left) +
                 along_up * along_up * outer(upwards, upwards) + own_variance * geometry::identity();
  d.has_doppler = true;
  d.los = los;
  d.range_rate = relative_rate + dot(los, own.v);
  d.range_rate_sigma = std::hypot(sigma.range_rate, o.own_velocity_sigma_m_s);
  return d;
}

}  // namespace

void check(const RadarOptions& o) {
  require(o.rate_hz > 0 && std::isfinite(o.rate_hz), "the rate of a sensor must be positive");
  require(o.half_azimuth_rad > 0 && o.half_azimuth_rad <= std::numbers::pi && o.half_elevation_rad > 0 &&
              o.half_elevation_rad <= std::numbers::pi / 2,
          "half a field of view must be in (0, pi] of azimuth and (0, pi / 2] of elevation");
  require(o.max_range_m > 0 && std::isfinite(o.max_range_m), "the range of a sensor must be positive");
  require(o.detection_probability >= 0 && o.detection_probability <= 1, "a probability must be in 0..1");
  require(is_size(o.sigma_range_m) && is_size(o.sigma_azimuth_rad) && is_size(o.sigma_elevation_rad) &&
              is_size(o.sigma_range_rate_m_s) && is_size(o.noise_scale) && is_size(o.position_sigma_m) &&
              is_size(o.own_position_sigma_m) && is_size(o.own_velocity_sigma_m_s),
          "noise needs standard deviations >= 0");
  require(o.kind != SensorKind::radar ||
              (o.sigma_range_m * o.noise_scale > 0 && o.noise_scale * o.sigma_azimuth_rad > 0 &&
               o.noise_scale * o.sigma_elevation_rad > 0 && o.noise_scale * o.sigma_range_rate_m_s > 0),
          "a radar needs noise; without any the covariance of a detection is singular");
  require(o.clutter_per_scan >= 0 && o.clutter_per_scan <= 100, "clutter must be in 0..100 per scan");
  require(is_size(o.clutter_range_rate_m_s), "the range rate of clutter must be >= 0");
  require(is_size(o.delay_s) && o.delay_s <= 10, "a delay must be in 0..10 s");
}

bool FieldOfView::holds(Vec3 mean, const Mat3& covariance, double margin) const {
  const Frame frame(yaw);
  const Vec3 p = mean - position;
  const Polar at = polar_of(frame, p);
  if (!(at.range > 0)) return true;
  const auto deviation = [&](Vec3 along) { return std::sqrt(std::max(0.0, dot(along, covariance * along))); };
  if (!(at.range + margin * deviation(1 / at.range * p) <= max_range_m)) return false;
  const double ca = std::cos(at.azimuth), sa = std::sin(at.azimuth);
  const Vec3 outwards = ca * frame.forward + sa * frame.left, left = ca * frame.left - sa * frame.forward;
  const double flat = std::max(std::hypot(p.x, p.y), kLeastRange);
  const Vec3 upwards = flat / at.range * geometry::e3 - p.z / at.range * outwards;
  const auto within = [&](double angle, double sigma, double half, double all) {
    return half >= all || std::abs(angle) + margin * sigma <= half;
  };
  return within(at.azimuth, deviation(left) / flat, half_azimuth_rad, std::numbers::pi) &&
         within(at.elevation, deviation(upwards) / at.range, half_elevation_rad, std::numbers::pi / 2);
}

FieldOfView field_of_view(const RadarOptions& o, const Kinematics& own, double yaw) {
  constexpr double everywhere = std::numeric_limits<double>::infinity();
  const bool is_radar = o.kind == SensorKind::radar;
  return {own.p, yaw, is_radar ? o.half_azimuth_rad : std::numbers::pi,
          is_radar ? o.half_elevation_rad : std::numbers::pi / 2,
          o.kind == SensorKind::ideal ? everywhere : o.max_range_m};
}

Kinematics own_state(const RadarOptions& o, const Kinematics& vehicle, const RandomStream& random,
                     std::uint64_t step) {
  Kinematics own = vehicle;
  if (o.own_position_sigma_m > 0) own.p += o.own_position_sigma_m * random.normals(step, channel::kOwnState);
  if (o.own_velocity_sigma_m_s > 0) own.v += o.own_velocity_sigma_m_s * random.normals(step, channel::kOwnState + 1);
  return own;
}

void scan(const RadarOptions& o, const Kinematics& vehicle, double yaw, std::span<const Kinematics> truth,
          const RandomStream& random, std::uint64_t step, std::vector<Detection>& out) {
  const Frame frame(yaw);
  const Sigmas sigma(o);
  const Kinematics own = own_state(o, vehicle, random, step);
  const bool is_radar = o.kind == SensorKind::radar;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const Vec3 relative = truth[i].p - vehicle.p;
    if (!geometry::is_finite(relative) || !geometry::is_finite(truth[i].v)) continue;
    const std::uint32_t from = channel::kDetection + kPerItem * static_cast<std::uint32_t>(i);
    const Polar at = polar_of(frame, relative);
    if (o.kind != SensorKind::ideal) {
      const auto [found, drop, unused, spare] = random.uniforms(step, from);
      if (!(at.range <= o.max_range_m) || !(found < o.detection_probability)) continue;
    }
    const Vec3 noise = random.normals(step, from + 1);
    if (!is_radar) {
      Detection d;
      d.position = truth[i].p + sigma.position * noise;
      d.covariance = sigma.position * sigma.position * geometry::identity();
      out.push_back(d);
      continue;
    }
    if (!(at.range > 0 && std::abs(at.azimuth) <= o.half_azimuth_rad &&
          std::abs(at.elevation) <= o.half_elevation_rad))
      continue;
    const double cosine = std::max(std::cos(at.elevation), kLeastRange);  // the azimuth is undefined straight up
    const Polar measured{std::max(kLeastRange, at.range + sigma.range * noise.x),
                         at.azimuth + sigma.azimuth / cosine * noise.y, at.elevation + sigma.elevation * noise.z};
    const double rate =
        dot(1 / at.range * relative, truth[i].v - vehicle.v) + sigma.range_rate * random.normals(step, from + 2).x;
    out.push_back(detection_at(o, sigma, frame, own, measured, rate));
  }
  if (!is_radar || o.clutter_per_scan == 0) return;
  const int ghosts = poisson(o.clutter_per_scan, random.uniforms(step, channel::kClutter)[0]);
  for (int i = 0; i < ghosts; ++i) {
    const auto u = random.uniforms(step, channel::kClutter + 1 + static_cast<std::uint32_t>(i));
    const Polar at{std::max(kLeastRange, o.max_range_m * std::cbrt(u[0])), (2 * u[1] - 1) * o.half_azimuth_rad,
                   std::asin((2 * u[2] - 1) * std::sin(o.half_elevation_rad))};
    Detection d = detection_at(o, sigma, frame, own, at, 0);
    d.range_rate = (2 * u[3] - 1) * o.clutter_range_rate_m_s;
    out.push_back(d);
  }
}

}  // namespace alula::flight
