// When something that starts to move can be where something else is that keeps its velocity.
#pragma once

#include <cmath>

#include "alula/geometry/mat3.hpp"

namespace alula::flight {

// The least t >= 0 with |r + v t| = s t. Where there is none, the t at which |r + v t| - s t is least, at most 1e4:
// whoever starts at 0 with speed s cannot reach r + v t, and comes nearest to it then.
double meeting_time(geometry::Vec3 r, geometry::Vec3 v, double s);

// The least t >= 0 with |a + w t| = d, for |a| < d; infinite when w is 0.
inline double leaving_time(geometry::Vec3 a, geometry::Vec3 w, double d) {
  const double A = dot(w, w), B = dot(a, w), C = d * d - dot(a, a), root = B + std::sqrt(B * B + A * C);
  return root > 0 ? C / root : (std::sqrt(B * B + A * C) - B) / A;
}

// The same for a speed that varies: `at(s)` is one of the times above and `reach(t)` the way gone by t, s = reach(t)
// / t. A fixed point by Steffensen's method, from `guess` > 0.
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
