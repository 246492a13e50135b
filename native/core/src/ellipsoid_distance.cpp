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

namespace {

// The closest point y of the surface: point - y = lambda n, n_i = y_i / semi_i^2 = z_i / sum_i.
struct Closest {
  Vec3 z, n, sum;  // along the axes; sum_i = lambda + semi_i^2
  double lambda;
};

Closest closest(const Ellipsoid& ellipsoid, Vec3 point) {
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
  Vec3 n;
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
  return {z, n, {mu + gap.x, mu + gap.y, mu + gap.z}, inside ? std::min(0.0, mu - base) : mu};
}

Vec3 along_axes(const Ellipsoid& ellipsoid, Vec3 local) {
  Vec3 sum;
  for (int i = 0; i < 3; ++i) sum = sum + local[i] * ellipsoid.axis[i];
  return sum;
}

}  // namespace

SignedDistance signed_distance(const Ellipsoid& ellipsoid, Vec3 point) {
  const Closest at = closest(ellipsoid, point);
  const double length = norm(at.n);
  return {at.lambda * length, along_axes(ellipsoid, (1 / length) * at.n)};
}

Projection project(const Ellipsoid& ellipsoid, Vec3 point) {
  const Closest at = closest(ellipsoid, point);
  Projection result;
  result.distance = at.lambda * norm(at.n);
  result.local = at.z;
  result.offset = along_axes(ellipsoid, at.lambda * at.n);
  Vec3 s, u;
  double total = 0;
  for (int i = 0; i < 3; ++i) {
    s[i] = ellipsoid.semi[i] * ellipsoid.semi[i] / at.sum[i];
    u[i] = s[i] * at.n[i];
    total += u[i] * at.n[i];
  }
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      result.hessian[i][j] = 2 * (u[i] * u[j] / total + (i == j ? at.lambda / at.sum[i] : 0.0));
  return result;
}

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// g = sum (semi_i n_i)^2 at a multiplier mu >= 0, n_i = z_i / (mu + semi_i^2): it falls to 1 at the closest point.
// For a segment z is that of the t that is best for mu, and slides along with mu.
struct Dual {
  double g, fall;  // fall = -g' / 2
  double length2;  // |n|^2: the distance is mu |n| where g = 1
  double bound;    // mu (sum z_i n_i - 1): the squared distance is no less
};

struct PointDual {
  double z[3], squared[3];

  Dual operator()(double mu) const {
    Dual d{0, 0, 0, 0};
    double sum = 0;
    for (int i = 0; i < 3; ++i) {
      const double w = 1 / (mu + squared[i]), n = z[i] * w, part = squared[i] * n * n;
      d.g += part, d.fall += part * w, d.length2 += n * n, sum += z[i] * n;
    }
    d.bound = mu * (sum - 1);
    return d;
  }
};

struct SegmentDual {
  double z[3], dz[3], squared[3];

  Dual operator()(double mu) const {
    double w[3], across = 0, along = 0;
    for (int i = 0; i < 3; ++i) {
      w[i] = 1 / (mu + squared[i]);
      across += w[i] * z[i] * dz[i];
      along += w[i] * dz[i] * dz[i];
    }
    const double best = -across / along, t = std::clamp(best, 0.0, 1.0);
    Dual d{0, 0, 0, 0};
    double bend = 0, sum = 0;
    for (int i = 0; i < 3; ++i) {
      const double at = z[i] + t * dz[i], n = at * w[i], part = squared[i] * n * n;
      d.g += part, d.fall += part * w[i], d.length2 += n * n, sum += at * n;
      bend += n * w[i] * dz[i];
    }
    if (t == best) d.fall += mu * bend * bend / along;
    d.bound = mu * (sum - 1);
    return d;
  }
};

// From a multiplier where g > 1 is known at `low`. Newton's iteration on 1 / sqrt(g), which is concave but where the
// closest point of a segment leaves an end; a step too far is caught by the bracket.
template <class Function>
double maximise(const Function& dual, double mu, Dual at, double low, double size, double enough) {
  const double needed = enough * enough * (1 + 1e-12) + 8 * kEpsilon * size;
  double high = kInfinity;
  for (int step = 0; step < 100; ++step) {
    if (at.bound >= needed) return kInfinity;
    const double h = std::sqrt(at.g);
    if (std::abs(h - 1) <= 32 * kEpsilon) break;
    (h > 1 ? low : high) = mu;
    double next = mu + (h - 1) * at.g / at.fall;
    if (!(next > low && next < high)) next = high < kInfinity ? 0.5 * (low + high) : mu;
    if (!(std::abs(next - mu) > 8 * kEpsilon * mu)) break;
    mu = next;
    at = dual(mu);
  }
  return mu * std::sqrt(at.length2);
}

}  // namespace

double distance_below(Vec3 semi, Vec3 point, double enough) {
  PointDual dual{{point.x, point.y, point.z}, {}};
  double most = 0, reach2 = 0, beyond = 0, size = 0;
  for (int i = 0; i < 3; ++i) {
    const double squared = semi[i] * semi[i], z2 = dual.z[i] * dual.z[i];
    dual.squared[i] = squared;
    most = std::max(most, squared);
    reach2 += squared * z2;
    size += z2 + squared;
    beyond = std::max(beyond, semi[i] * std::abs(dual.z[i]) - squared);
  }
  // Both are below the multiplier, and the second is close for what is small beside its distance.
  const double mu = std::max(beyond, std::sqrt(reach2) - most) * (1 - 4 * kEpsilon);
  const Dual at = dual(std::max(mu, 0.0));
  if (mu <= 0 && at.g <= 1) return signed_distance({{}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, semi}, point).value;
  return enough > 0 ? maximise(dual, std::max(mu, 0.0), at, 0, size, enough) : kInfinity;
}

double distance_below(Vec3 semi, Vec3 start, Vec3 along, double enough) {
  const double length2 = dot(along, along);
  if (!(length2 > 0)) return distance_below(semi, start, enough);
  SegmentDual dual{{start.x, start.y, start.z}, {along.x, along.y, along.z}, {}};
  const Vec3 middle = start + std::clamp(-dot(start, along) / length2, 0.0, 1.0) * along;
  double most = 0, reach2 = 0, size = 0;
  for (int i = 0; i < 3; ++i) {
    const double squared = semi[i] * semi[i];
    dual.squared[i] = squared;
    most = std::max(most, squared);
    reach2 += squared * middle[i] * middle[i];
    size += start[i] * start[i] + along[i] * along[i] + squared;
  }
  double mu = std::max(0.0, std::sqrt(reach2) - most);  // close when the ellipsoid is small beside its distance
  Dual at = dual(mu);
  if (at.g <= 1 && mu > 0) mu = 0, at = dual(mu);
  if (at.g <= 1) return signed_distance({{}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, semi}, start, start + along, enough);
  return enough > 0 ? maximise(dual, mu, at, 0, size, enough) : kInfinity;
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
