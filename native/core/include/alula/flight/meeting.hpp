// Earliest meeting of two movers: one starts to move, the other keeps its velocity.
#pragma once

#include <cmath>

#include "alula/geometry/mat3.hpp"

namespace alula::flight {

// The smallest t >= 0 with |r + v t| = s t: the time at which a mover that starts at 0 with speed s reaches r + v t.
// If it cannot reach it, the t at which |r + v t| - s t is minimal, at most 1e4: the time of its nearest approach.
double meeting_time(geometry::Vec3 r, geometry::Vec3 v, double s);

// The smallest t >= 0 with |a + w t| = d, for |a| < d; infinite when w is 0.
inline double leaving_time(geometry::Vec3 a, geometry::Vec3 w, double d) {
  const double A = dot(w, w), B = dot(a, w), C = d * d - dot(a, a), root = B + std::sqrt(B * B + A * C);
  return root > 0 ? C / root : (std::sqrt(B * B + A * C) - B) / A;
}

// The same for a varying speed: `at(s)` is one of the times above and `reach(t)` the distance travelled by t,
// s = reach(t) / t. A fixed point by Steffensen's method, starting at `guess` > 0.
template <class At, class Reach>
double with_mean_speed(At&& at, Reach&& reach, double guess) {
  const auto next = [&](double t) { return at(reach(t) / t); };
  double t = guess;
  for (int round = 0; round < 50; ++round) {
    const double first = next(t);
    if (!(std::abs(first - t) > 1e-12 * t) || !(first > 0) || !std::isfinite(first)) return first;
    const double second = next(first), bend = second - 2 * first + t;
    const double better = t - (first - t) * (first - t) / bend;
    t = better > 0 && std::isfinite(better) ? better : first;
  }
  return t;
}

}  // namespace alula::flight
