#include <algorithm>
#include <cmath>

#include "alula/encounter.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::norm;
using geometry::Vec3;

constexpr int kLooks = 8;      // in a window, and then Newton's steps on the derivative of the squared distance
constexpr int kRefinings = 4;  // from the best of them

// Entry of a symmetric matrix given as its lower triangle, row by row.
double entry(const float* triangle, int i, int j) {
  return static_cast<double>(triangle[i >= j ? i * (i + 1) / 2 + j : j * (j + 1) / 2 + i]);
}

}  // namespace

double risk_of(const alula_track& track, const alula_vehicle_state& vehicle, Vec3 command, double radius,
               double window) {
  Vec3 p, v;
  for (int k = 0; k < 3; ++k) {
    p[k] = static_cast<double>(track.position[k]) - static_cast<double>(vehicle.position[k]);
    v[k] = static_cast<double>(track.velocity[k]) - static_cast<double>(vehicle.velocity[k]);
  }
  if (dot(p, v) >= 0) return 0;
  const auto at = [&](double t) { return p + t * v - t * t / 2 * command; };
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
  return variance / (variance + slack * slack);
}

}  // namespace alula::flight
