#include "alula/geometry/ellipsoid_distance.hpp"

#include "alula/base/constants.hpp"
#include "alula/base/lanes.hpp"

namespace alula::geometry {
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

using std::abs, std::sqrt;

// The dual function of one ellipsoid (Real = double), or of four at once.
//
// g = sum (semi_i n_i)^2 at a multiplier mu >= 0, n_i = z_i / (mu + semi_i^2): it decreases to 1 at the closest
// point. For a segment z is that of the optimal t for mu, and changes with mu.
template <class Real>
struct Dual {
  Real g{0.0}, fall{0.0};  // fall = -g' / 2
  Real bound{0.0};         // mu (sum z_i n_i - 1), a lower bound on the squared distance
};

template <class Real>
struct PointDual {
  Real z[3], squared[3];

  Dual<Real> operator()(Real mu) const {
    Dual<Real> d;
    Real sum{0.0};
    for (int i = 0; i < 3; ++i) {
      const Real w = 1.0 / (mu + squared[i]), n = z[i] * w, part = squared[i] * n * n;
      d.g += part, d.fall += part * w, sum += z[i] * n;
    }
    d.bound = mu * (sum - 1.0);
    return d;
  }
};

template <class Real>
struct SegmentDual {
  Real z[3], dz[3], squared[3];

  Dual<Real> operator()(Real mu) const {
    Real w[3], across{0.0}, along{0.0};
    for (int i = 0; i < 3; ++i) {
      w[i] = 1.0 / (mu + squared[i]);
      across += w[i] * z[i] * dz[i];
      along += w[i] * dz[i] * dz[i];
    }
    const Real best = -across / along, t = select(best < 0.0, Real{0.0}, select(best > 1.0, Real{1.0}, best));
    Dual<Real> d;
    Real bend{0.0}, sum{0.0};
    for (int i = 0; i < 3; ++i) {
      const Real at = z[i] + t * dz[i], n = at * w[i], part = squared[i] * n * n;
      d.g += part, d.fall += part * w[i], sum += at * n;
      bend += n * w[i] * dz[i];
    }
    d.fall = select(t == best, d.fall + mu * bend * bend / along, d.fall);
    d.bound = mu * (sum - 1.0);
    return d;
  }
};

// Maximises the dual from a start multiplier, with g > 1 at 0. Newton's iteration on 1 / sqrt(g), which is concave
// except where the closest point of a segment leaves an end; the bracket catches a step that is too long. Lanes that
// are `done` are skipped.
constexpr double kClose = 1e-8;  // of sqrt(g) to 1: the bound is flat there, so its error is the square of this

template <class Real, class Function, class Is>
Real maximise(const Function& dual, Real mu, Dual<Real> at, Real size, Real enough, Is done) {
  const Real needed = enough * enough * (1 + 1e-12) + 8 * kEpsilon * size;
  Real low{0.0}, high{kInfinity};
  Is beyond = done & (!done);
  for (int step = 0; step < 100; ++step) {
    beyond = beyond | ((!done) & (at.bound >= needed));
    const Real h = sqrt(at.g);
    done = done | beyond | (abs(h - 1.0) <= kClose);
    if (all(done)) break;
    const Is above = h > 1.0;
    low = select(above, mu, low), high = select(above, high, mu);
    Real next = mu + (h - 1.0) * at.g / at.fall;
    next = select((next > low) & (next < high), next, select(high < kInfinity, 0.5 * (low + high), mu));
    done = done | !(abs(next - mu) > 8 * kEpsilon * mu);
    if (all(done)) break;
    mu = select(done, mu, next);
    at = dual(mu);
  }
  return select(beyond, Real{kInfinity}, sqrt(larger(at.bound, Real{0.0})));
}

// The distance, except of lanes that are `special` or `done`.
template <class Real, class Is>
Real point_below(const Real (&semi)[3], const Real (&point)[3], Real enough, Is done, Is& special) {
  PointDual<Real> dual;
  Real most{0.0}, reach2{0.0}, beyond{0.0}, size{0.0};
  for (int i = 0; i < 3; ++i) {
    const Real squared = semi[i] * semi[i], z2 = point[i] * point[i];
    dual.z[i] = point[i], dual.squared[i] = squared;
    most = larger(most, squared);
    reach2 += squared * z2;
    size += z2 + squared;
    beyond = larger(beyond, semi[i] * abs(point[i]) - squared);
  }
  // Both are lower bounds of the multiplier; the second is tight for an ellipsoid that is small beside its distance.
  const Real mu = larger(beyond, sqrt(reach2) - most) * (1 - 4 * kEpsilon), start = larger(mu, Real{0.0});
  const Dual<Real> at = dual(start);
  special = (mu <= 0.0) & (at.g <= 1.0);
  return maximise(dual, start, at, size, enough, done | special);
}

template <class Real, class Is>
Real segment_below(const Real (&semi)[3], const Real (&start)[3], const Real (&along)[3], Real enough, Is done,
                   Is& special) {
  SegmentDual<Real> dual;
  Real most{0.0}, reach2{0.0}, size{0.0};
  const Real length2 = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
  const Real best = -(start[0] * along[0] + start[1] * along[1] + start[2] * along[2]) / length2;
  const Real t = select(best < 0.0, Real{0.0}, select(best > 1.0, Real{1.0}, best));
  for (int i = 0; i < 3; ++i) {
    const Real squared = semi[i] * semi[i], middle = start[i] + t * along[i];
    dual.z[i] = start[i], dual.dz[i] = along[i], dual.squared[i] = squared;
    most = larger(most, squared);
    reach2 += squared * middle * middle;
    size += start[i] * start[i] + along[i] * along[i] + squared;
  }
  // Tight for an ellipsoid that is small beside its distance.
  Real mu = larger(Real{0.0}, sqrt(reach2) - most);
  Dual<Real> at = dual(mu);
  const Is beyond = (at.g <= 1.0) & (mu > 0.0);
  if (any(beyond)) mu = select(beyond, Real{0.0}, mu), at = dual(mu);
  special = at.g <= 1.0;
  return maximise(dual, mu, at, size, enough, done | special);
}

}  // namespace

double distance_below(Vec3 semi, Vec3 point, double enough) {
  const double s[3] = {semi.x, semi.y, semi.z}, z[3] = {point.x, point.y, point.z};
  bool special = false;
  const double distance = point_below(s, z, enough, !(enough > 0), special);
  if (special) return signed_distance({{}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, semi}, point).value;
  return enough > 0 ? distance : kInfinity;
}

double distance_below(Vec3 semi, Vec3 start, Vec3 along, double enough) {
  if (!(dot(along, along) > 0)) return distance_below(semi, start, enough);
  const double s[3] = {semi.x, semi.y, semi.z}, z[3] = {start.x, start.y, start.z},
               dz[3] = {along.x, along.y, along.z};
  bool special = false;
  const double distance = segment_below(s, z, dz, enough, !(enough > 0), special);
  if (special) return signed_distance({{}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, semi}, start, start + along, enough);
  return enough > 0 ? distance : kInfinity;
}

void distances_below(std::span<const Sighted> each, std::span<double> distance) {
  for (std::size_t first = 0; first < each.size(); first += 4) {
    const std::size_t count = std::min<std::size_t>(4, each.size() - first);
    const auto one = [&](std::size_t i) -> const Sighted& { return each[first + std::min(i, count - 1)]; };
    const auto lanes = [&](Vec3 Sighted::* part, int axis) {
      return Lanes{(one(0).*part)[axis], (one(1).*part)[axis], (one(2).*part)[axis], (one(3).*part)[axis]};
    };
    Lanes semi[3], start[3], along[3];
    for (int i = 0; i < 3; ++i) {
      semi[i] = lanes(&Sighted::semi, i), start[i] = lanes(&Sighted::start, i);
      along[i] = lanes(&Sighted::along, i);
    }
    const Lanes enough{one(0).enough, one(1).enough, one(2).enough, one(3).enough};
    const Lanes length2 = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
    const Mask none = !(enough > 0.0);
    const bool moves = all(length2 > 0.0);
    Mask special;
    const Lanes found = moves ? segment_below(semi, start, along, enough, none, special)
                              : point_below(semi, start, enough, none, special);
    const Mask alone = moves ? special | none : special | none | (length2 > 0.0);
    for (std::size_t i = 0; i < count; ++i) {
      const Sighted& e = one(i);
      distance[first + i] = alone[static_cast<int>(i)] ? distance_below(e.semi, e.start, e.along, e.enough)
                                                       : found[static_cast<int>(i)];
    }
  }
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
    // Alternates the intersection of the tangents (good at kinks) and the secant of the slopes (fast where smooth).
    double t = step % 2 == 0 ? left.t - left.slope * width / (right.slope - left.slope) : meet;
    t = std::clamp(t, left.t + 1e-3 * width, right.t - 1e-3 * width);
    const Tangent middle = tangent(t);
    if (middle.slope == 0) return middle.value;
    (middle.slope < 0 ? left : right) = middle;
  }
  return std::min(left.value, right.value);
}

}  // namespace alula::geometry
