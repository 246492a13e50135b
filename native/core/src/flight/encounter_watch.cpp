#include "alula/flight/encounter_watch.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::norm;
using geometry::Vec3;

constexpr int kLooks = 8;      // samples in a window
constexpr int kRefinings = 4;  // Newton steps from the best sample, on the derivative of the squared distance

// Position and velocity.
std::pair<Vec3, Vec3> relative(const alula_track& track, const alula_vehicle_state& vehicle) {
  Vec3 p, v;
  for (int k = 0; k < 3; ++k) {
    p[k] = static_cast<double>(track.position[k]) - static_cast<double>(vehicle.position[k]);
    v[k] = static_cast<double>(track.velocity[k]) - static_cast<double>(vehicle.velocity[k]);
  }
  return {p, v};
}

// Entry of a symmetric matrix given as its lower triangle, row by row.
double entry(const float* triangle, int i, int j) {
  return static_cast<double>(triangle[i >= j ? i * (i + 1) / 2 + j : j * (j + 1) / 2 + i]);
}

}  // namespace

double risk_of(const alula_track& track, const alula_vehicle_state& vehicle, Vec3 command, double radius,
               double window) {
  const auto [p, v] = relative(track, vehicle);
  if (dot(p, v) >= 0) return 0;
  const auto at = [p = p, v = v, command](double t) { return p + t * v - t * t / 2 * command; };
  double t = 0, least = dot(p, p);
  for (int i = 1; i <= kLooks; ++i) {
    const double then = window * i / kLooks, squared = dot(at(then), at(then));
    if (squared < least) least = squared, t = then;
  }
  for (int i = 0; i < kRefinings; ++i) {
    const Vec3 r = at(t), rate = v - t * command;
    const double slope = dot(r, rate), bend = dot(rate, rate) - dot(r, command);
    if (!(bend > 0)) break;
    const double next = std::clamp(t - slope / bend, 0.0, window);
    if (!(dot(at(next), at(next)) <= dot(r, r))) break;
    t = next;
  }
  const Vec3 miss = at(t);
  const double distance = norm(miss), slack = distance - radius;
  if (!(slack > 0)) return 1;
  constexpr int own[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  double variance = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const double both = entry(track.covariance, i, j) + static_cast<double>(vehicle.covariance[own[i][j]]) +
                          t * (entry(track.covariance, i + 3, j) + entry(track.covariance, i, j + 3)) +
                          t * t * entry(track.covariance, i + 3, j + 3);
      variance += miss[i] * both * miss[j];
    }
  }
  variance = std::max(0.0, variance) / (distance * distance);
  const double cantelli = variance / (variance + slack * slack);
  return cantelli <= 3.0 / 8 ? 4.0 / 9 * cantelli : 4.0 / 3 * cantelli - 1.0 / 3;  // unimodal errors
}

double turn_to(std::span<const alula_track> tracks, const alula_vehicle_state& vehicle, double yaw,
               double half_azimuth_rad, Vec3 course) {
  double least = 0, most = 0, urgent = 0, urgency = 0;
  bool has_track = false;
  const auto bearing = [&](double y, double x) {
    return std::remainder(std::atan2(y, x) - yaw, 2 * std::numbers::pi);
  };
  for (const alula_track& t : tracks) {
    const auto [p, v] = relative(t, vehicle);
    const double closing = -dot(p, v);
    if (!(closing > 0)) continue;
    const double angle = bearing(p.y, p.x);
    least = has_track ? std::min(least, angle) : angle;
    most = has_track ? std::max(most, angle) : angle;
    has_track = true;
    const double now = closing / std::max(dot(p, p), 1e-6);  // closing speed over distance
    if (now > urgency) urgency = now, urgent = angle;
  }
  if (!has_track) return bearing(course.y, course.x);
  return most - least <= 2 * half_azimuth_rad ? (least + most) / 2 : urgent;
}

void RiskWindows::reset(double window_s, double dt_s) {
  window_s_ = window_s;
  ticks_ = std::max<std::int64_t>(1, std::llround(window_s / dt_s));
  closed_ = 0, tick_ = 0;
  open_.clear();
}

double RiskWindows::sum() const {
  double all = closed_;
  for (const auto& [id, risk] : open_) all += risk;
  return all;
}

void RiskWindows::add(std::span<const alula_track> tracks, const alula_vehicle_state& vehicle, Vec3 command,
                      double radius_m) {
  if (tick_++ % ticks_ == 0) {
    closed_ = sum();
    open_.clear();
  }
  for (const alula_track& t : tracks) {
    const double risk = risk_of(t, vehicle, command, radius_m + static_cast<double>(t.radius_m), window_s_);
    if (!(risk > 0)) continue;
    const auto found = std::find_if(open_.begin(), open_.end(), [&](const auto& o) { return o.first == t.id; });
    if (found == open_.end()) {
      open_.emplace_back(t.id, risk);
    } else {
      found->second = std::max(found->second, risk);
    }
  }
}

}  // namespace alula::flight
