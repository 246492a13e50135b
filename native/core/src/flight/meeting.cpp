#include "alula/flight/meeting.hpp"

#include <algorithm>

namespace alula::flight {
namespace {

constexpr double kLongest = 1e4;  // [s]

}  // namespace

double meeting_time(geometry::Vec3 r, geometry::Vec3 v, double s) {
  // (v.v - s^2) t^2 + 2 (r.v) t + r.r = 0; the smaller positive root is r.r / (sqrt(disc) - r.v).
  const double A = dot(v, v) - s * s, B = dot(r, v), C = dot(r, r), disc = B * B - A * C;
  if (C == 0) return 0;
  // Clamped from below because products of tiny numbers underflow.
  if (disc >= 0 && (A < 0 || B < 0)) return std::clamp(C / (std::sqrt(disc) - B), 0.0, kLongest);
  // With u along v and q across it, u = |v| t + r.v / |v|: |v| u / sqrt(u^2 + q^2) = s.
  const double speed = norm(v);
  if (speed == 0) return 0;
  const double along = B / speed, q = std::sqrt(std::max(0.0, C - along * along));
  const double u = q > 0 ? q * s / std::sqrt(std::max(0.0, speed * speed - s * s)) : 0;
  return std::clamp((u - along) / speed, 0.0, kLongest);
}

}  // namespace alula::flight
