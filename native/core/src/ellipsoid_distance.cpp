#include "alula/ellipsoid_distance.hpp"

namespace alula::geometry {
namespace {

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

}  // namespace

Ellipsoid gaussian_ellipsoid(const float* mean, const float* scale, const float* quat_wxyz, double k) {
  double w = quat_wxyz[0], x = quat_wxyz[1], y = quat_wxyz[2], z = quat_wxyz[3];
  const double length = std::sqrt(w * w + x * x + y * y + z * z);
  w /= length, x /= length, y /= length, z /= length;
  return {{mean[0], mean[1], mean[2]},
          {{1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
           {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
           {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)}},
          {k * scale[0], k * scale[1], k * scale[2]}};
}

Box bounds(const Ellipsoid& ellipsoid) {
  Box box;
  for (int i = 0; i < 3; ++i) {
    double squared = 0;
    for (int j = 0; j < 3; ++j) {
      const double reach = ellipsoid.semi[j] * ellipsoid.axis[j][i];
      squared += reach * reach;
    }
    const double largest = std::max({ellipsoid.semi.x, ellipsoid.semi.y, ellipsoid.semi.z});
    const double half = std::sqrt(squared) + 8 * kEpsilon * (largest + std::abs(ellipsoid.centre[i]));
    box.lower[i] = ellipsoid.centre[i] - half;
    box.upper[i] = ellipsoid.centre[i] + half;
  }
  return box;
}

SignedDistance signed_distance(const Ellipsoid& ellipsoid, Vec3 point) {
  const Vec3 offset = point - ellipsoid.centre;
  const Vec3 e = ellipsoid.semi;
  Vec3 z;
  int flat = 0;
  double level = 0;
  for (int i = 0; i < 3; ++i) {
    z[i] = dot(offset, ellipsoid.axis[i]);
    if (e[i] < e[flat]) flat = i;
    level += (z[i] / e[i]) * (z[i] / e[i]);
  }
  // mu = lambda + base; gap_i = semi_i^2 - base, without cancellation.
  const bool inside = level <= 1;
  const double base = inside ? e[flat] * e[flat] : 0;
  Vec3 gap;
  double mu = 0;
  for (int i = 0; i < 3; ++i) {
    gap[i] = inside ? (e[i] - e[flat]) * (e[i] + e[flat]) : e[i] * e[i];
    mu = std::max(mu, e[i] * std::abs(z[i]) - gap[i]);
  }
  double h = 0, s = 0;
  const auto evaluate = [&] {
    double squares = 0;
    s = 0;
    for (int i = 0; i < 3; ++i) {
      if (z[i] == 0) continue;
      const double w = e[i] * z[i] / (mu + gap[i]);
      squares += w * w;
      s += w * w / (mu + gap[i]);
    }
    h = std::sqrt(squares);
  };
  bool medial = false;  // the closest point is not unique, or h(0) <= 1 by rounding
  if (mu > 0) {
    evaluate();
  } else {
    medial = true;
    for (int i = 0; i < 3; ++i) medial = medial && (z[i] == 0 || gap[i] > 0);
    if (medial) evaluate();
    medial = medial && h <= 1;
  }
  Vec3 n;  // y_i / semi_i^2, normal to the surface; point - y = lambda n
  if (medial) {
    for (int i = 0; i < 3; ++i) n[i] = z[i] == 0 ? 0 : z[i] / gap[i];
    n[flat] = std::sqrt(std::max(0.0, 1 - h * h)) / e[flat];
    mu = 0;
  } else {
    for (int step = 0; step < 100 && h > 1 + kEpsilon; ++step) {
      const double next = mu + (h - 1) * h * h / s;
      if (!(next > mu)) break;
      mu = next;
      evaluate();
    }
    for (int i = 0; i < 3; ++i) n[i] = z[i] == 0 ? 0 : z[i] / (mu + gap[i]);
  }
  const double length = norm(n);
  const double lambda = inside ? std::min(0.0, mu - base) : mu;
  Vec3 normal;
  for (int i = 0; i < 3; ++i) normal = normal + (n[i] / length) * ellipsoid.axis[i];
  return {lambda * length, normal};
}

double signed_distance(const Ellipsoid& ellipsoid, Vec3 a, Vec3 b, double enough) {
  const Vec3 d = b - a;
  const double length = norm(d);
  struct Tangent {
    double t, value, slope;
  };
  const auto tangent = [&](double t) {
    const SignedDistance at = signed_distance(ellipsoid, a + t * d);
    return Tangent{t, at.value, dot(at.normal, d)};
  };
  // The signed distance is 1-Lipschitz: one evaluation discards most ellipsoids.
  const Tangent centre = tangent(0.5);
  if (length == 0 || centre.slope == 0) return centre.value;
  if (centre.value - 0.5 * length >= enough) return centre.value - 0.5 * length;
  Tangent left = centre, right = centre;
  if (centre.slope > 0) {
    left = tangent(0);
    if (left.slope >= 0) return left.value;
  } else {
    right = tangent(1);
    if (right.slope <= 0) return right.value;
  }
  for (int step = 0; step < 80; ++step) {
    const double width = right.t - left.t;
    const double meet =
        (right.value - left.value + left.slope * left.t - right.slope * right.t) / (left.slope - right.slope);
    const double lower = left.value + left.slope * (meet - left.t);
    const double upper = std::min(left.value, right.value);
    if (lower >= enough) return lower;
    if (upper - lower <= 4 * kEpsilon * (std::abs(upper) + length) || width <= kEpsilon) return upper;
    // Alternately where the tangents meet (good at kinks) and the secant of the slopes (fast where smooth).
    double t = step % 2 == 0 ? left.t - left.slope * width / (right.slope - left.slope) : meet;
    t = std::clamp(t, left.t + 1e-3 * width, right.t - 1e-3 * width);
    const Tangent middle = tangent(t);
    if (middle.slope == 0) return middle.value;
    (middle.slope < 0 ? left : right) = middle;
  }
  return std::min(left.value, right.value);
}

}  // namespace alula::geometry
