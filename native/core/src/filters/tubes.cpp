#include "alula/filters/tubes.hpp"

#include <algorithm>
#include <cmath>

#include "alula/base/require.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::Mat3;
using geometry::norm;
using geometry::Vec3;

constexpr double kOutward = 1 + 1e-9;  // beyond the rounding of an eigenvalue and of a distance

// An upper bound on the largest eigenvalue of a symmetric matrix, off by rounding only (Smith 1961).
double largest_eigenvalue(const Mat3& m) {
  const double mean = (m[0][0] + m[1][1] + m[2][2]) / 3;
  const double off = m[0][1] * m[0][1] + m[0][2] * m[0][2] + m[1][2] * m[1][2];
  const Vec3 d{m[0][0] - mean, m[1][1] - mean, m[2][2] - mean};
  const double spread = std::sqrt((dot(d, d) + 2 * off) / 6);
  double cosine = 1;  // at most
  if (spread > 1e-6 * std::abs(mean)) {
    const double half_det = (d.x * (d.y * d.z - m[1][2] * m[1][2]) - m[0][1] * (m[0][1] * d.z - m[1][2] * m[0][2]) +
                             m[0][2] * (m[0][1] * m[1][2] - d.y * m[0][2])) /
                            (2 * spread * spread * spread);
    cosine = std::cos(std::acos(std::clamp(half_det, -1.0, 1.0)) / 3);
  }
  return mean + 2 * spread * cosine + 1e-7 * spread;
}

}  // namespace

Tubes::Tubes(double horizon_s, double risk, double acceleration_m_s2)
    : horizon_(horizon_s), deviations_(std::sqrt((1 - risk) / risk)), acceleration_(acceleration_m_s2) {
  require(horizon_s > 0 && std::isfinite(horizon_s), "the horizon of tubes must be positive");
  require(risk > 0 && risk < 1, "the risk of tubes must lie between 0 and 1");
  require(is_size(acceleration_m_s2), "the acceleration of moving obstacles must not be negative");
  tubes_.reserve(ALULA_OBSTACLES);
}

void Tubes::set(std::span<const alula_track> tracks, Vec3 own) {
  clear();
  if (tracks.empty()) return;
  const bool is_known = is_size(own.x) && is_size(own.y) && is_size(own.z);
  if (!is_known || tracks.size() > ALULA_OBSTACLES) return void(is_everywhere_ = true);
  for (const alula_track& track : tracks) {
    const auto covariance = [&](int i, int j) {
      return static_cast<double>(track.covariance[i * (i + 1) / 2 + j]);  // i >= j
    };
    Tube& tube = tubes_.emplace_back();
    for (int i = 0; i < 3; ++i) tube.p[i] = track.position[i], tube.v[i] = track.velocity[i];
    bool is_finite = geometry::is_finite(tube.p) && geometry::is_finite(tube.v) && track.radius_m >= 0;
    for (int node = 0; node <= kTubeNodes; ++node) {
      const double t = horizon_ * node / kTubeNodes;
      Mat3 spread{};
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j <= i; ++j) {
          const double both = covariance(3 + i, j) + covariance(3 + j, i);
          spread[i][j] = covariance(i, j) + t * both + t * t * covariance(3 + i, 3 + j);
          if (i == j) is_finite = is_finite && covariance(i, i) >= 0 && covariance(3 + i, 3 + i) >= 0;
          if (i == j) spread[i][i] += own[i];
          spread[j][i] = spread[i][j];
        }
      const double found = largest_eigenvalue(spread), variance = found < 0 ? 0 : found;  // NaN stays
      tube.radius[static_cast<std::size_t>(node)] =
          kOutward * (track.radius_m + deviations_ * std::sqrt(variance) + acceleration_ * t * t / 2);
      is_finite = is_finite && std::isfinite(tube.radius[static_cast<std::size_t>(node)]);
    }
    is_everywhere_ = is_everywhere_ || !is_finite;
  }
}

double Tubes::radius(const Tube& tube, double t) const {
  const double at = std::clamp(t / horizon_, 0.0, 1.0) * kTubeNodes;
  const int node = std::min(kTubeNodes - 1, static_cast<int>(at));
  const auto i = static_cast<std::size_t>(node);
  return tube.radius[i] + (at - node) * (tube.radius[i + 1] - tube.radius[i]);
}

// In the frame that moves with the tube's centre the point goes along a chord, and the tube is at most as large as at
// one of the two ends, as its radius is convex there.
bool Tubes::is_clear_of(const Tube& tube, Vec3 a, Vec3 b, double from, double to, double radius, double off) const {
  const double needed = radius + off + std::max(this->radius(tube, from), this->radius(tube, to));
  const Vec3 start = a - (tube.p + from * tube.v), d = b - (tube.p + to * tube.v) - start;
  const double length2 = dot(d, d);
  const double at = length2 > 0 ? std::clamp(-dot(start, d) / length2, 0.0, 1.0) : 0;
  const Vec3 nearest = start + at * d;
  return norm(nearest) > kOutward * needed;
}

bool Tubes::comes_near(const Tube& tube, Vec3 p, double reach) const {
  const double largest = std::max(tube.radius.front(), tube.radius.back());  // convex: at one of the ends
  const Vec3 d = horizon_ * tube.v, start = p - tube.p;
  const double length2 = dot(d, d);
  const double at = length2 > 0 ? std::clamp(dot(start, d) / length2, 0.0, 1.0) : 0;
  return !(norm(start - at * d) > kOutward * (reach + largest));
}

}  // namespace alula::flight
