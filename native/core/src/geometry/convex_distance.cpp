#include "alula/geometry/convex_distance.hpp"

#include <array>
#include <cstddef>

#include "alula/base/constants.hpp"

namespace alula::geometry {
namespace {

// The point of smallest norm in the hull of up to four points, with the points that span it.
class Simplex {
 public:
  explicit Simplex(Vec3 first) : points_{first}, closest_(first) {}

  Vec3 closest() const { return closest_; }

  // Adds a point and moves to the closest point of the larger hull; false, and no change, when
  // that is not closer, which in exact arithmetic happens only at the optimum.
  bool add(Vec3 p) {
    const double before = dot(closest_, closest_);
    double best = before;
    Simplex result(p);
    for (unsigned subset = 0; subset < (1u << count_); ++subset) {
      Simplex face(p);
      for (int i = 0; i < count_; ++i) {
        if (subset >> i & 1u)
          face.points_[static_cast<std::size_t>(face.count_++)] = points_[static_cast<std::size_t>(i)];
      }
      if (!face.project()) continue;
      const double squared = dot(face.closest_, face.closest_);
      if (squared < best) best = squared, result = face;
    }
    if (!(best < before)) return false;
    *this = result;
    return true;
  }

 private:
  // Closest point of the affine hull; false when it is not inside the hull or is not determined.
  bool project() {
    const Vec3 o = points_[0];
    const Vec3 e = points_[1] - o, f = points_[2] - o, g = points_[3] - o;
    if (count_ == 1) {
      closest_ = o;
      return true;
    }
    const double oe = -dot(o, e), ee = dot(e, e);
    if (count_ == 2) {
      if (!(oe >= 0 && oe <= ee && ee > 0)) return false;
      closest_ = o + (oe / ee) * e;
      return true;
    }
    if (count_ == 3) {
      const double of = -dot(o, f), ef = dot(e, f), ff = dot(f, f);
      const double determinant = ee * ff - ef * ef;
      const double s = oe * ff - of * ef, t = of * ee - oe * ef;
      if (!(determinant > 0 && s >= 0 && t >= 0 && s + t <= determinant)) return false;
      // The normal of the triangle gives the height with less rounding than the barycentrics.
      const Vec3 n = cross(e, f);
      const double height = dot(o, n) / dot(n, n);
      closest_ = height * n;
      return true;
    }
    // Four points: the origin is inside when it is on the inner side of all faces.
    const double volume = dot(e, cross(f, g));
    const double s = -dot(o, cross(f, g)) / volume, t = -dot(e, cross(o, g)) / volume,
                 u = -dot(e, cross(f, o)) / volume;
    if (!(s >= 0 && t >= 0 && u >= 0 && s + t + u <= 1)) return false;
    closest_ = Vec3{};
    return true;
  }

  static Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }

  std::array<Vec3, 4> points_{};
  int count_ = 1;
  Vec3 closest_;
};

// The point of a set that lies farthest along -direction.
Vec3 lowest(std::span<const Vec3> points, Vec3 direction, double sign) {
  Vec3 best = points[0];
  double lowest = sign * dot(best, direction);
  for (const Vec3 p : points.subspan(1)) {
    const double at = sign * dot(p, direction);
    if (at < lowest) lowest = at, best = p;
  }
  return best;
}

}  // namespace

Bracket hull_distance(std::span<const Vec3> a, std::span<const Vec3> b, double enough) {
  Simplex simplex(a[0] - b[0]);
  Vec3 v = simplex.closest();
  double lower = 0, upper = norm(v);
  for (int step = 0; step < 64; ++step) {
    v = simplex.closest();
    upper = norm(v);
    if (!(upper > 0)) return {0, 0, v};
    const Vec3 w = lowest(a, v, 1) - lowest(b, v, -1);
    lower = std::max(lower, dot(v, w) / upper);
    if (lower >= enough || upper - lower <= 2 * kEpsilon * upper || !simplex.add(w)) break;
  }
  return {std::min(lower, upper), upper, v};
}

double minimum_of_maximum(std::span<const double> value, std::span<const double> slope) {
  struct Line {
    double t, height, slope;  // the active line at t, and the function's value there
  };
  const auto active = [&](double t, bool steepest) {
    Line best{t, -std::numeric_limits<double>::infinity(), 0};
    for (std::size_t l = 0; l < value.size(); ++l) {
      const double height = value[l] + t * slope[l];
      const bool tie = height == best.height && (steepest ? slope[l] > best.slope : slope[l] < best.slope);
      if (height > best.height || tie) best.height = height, best.slope = slope[l];
    }
    return best;
  };
  Line left = active(0, true), right = active(1, false);
  if (left.slope >= 0) return left.height;
  if (right.slope <= 0) return right.height;
  for (std::size_t step = 0; step < 2 * value.size() + 2; ++step) {
    const double t =
        (left.height - right.height - left.slope * left.t + right.slope * right.t) / (right.slope - left.slope);
    if (!(t > left.t && t < right.t)) break;
    const Line middle = active(t, true);
    if (middle.slope == 0 || middle.slope == right.slope) return middle.height;
    if (middle.slope < 0 && middle.slope == left.slope) return middle.height;
    (middle.slope < 0 ? left : right) = middle;
  }
  return std::min(left.height, right.height);
}

SignedDistance signed_distance(const PolytopeView& polytope, Vec3 p, double enough) {
  SignedDistance result{-std::numeric_limits<double>::infinity(), {}};
  for (std::size_t l = 0; l < polytope.offsets.size(); ++l) {
    const Vec3 n = from_rows(&polytope.normals[3 * l]);
    const double height = dot(n, p) - polytope.offsets[l];
    if (height > result.value) result = {height, n};
  }
  if (result.value <= 0 || result.value >= enough) return result;
  const Bracket outside = hull_distance({&p, 1}, polytope.vertices, enough);
  if (outside.lower > result.value) result.value = outside.lower;
  if (outside.lower > 0) result.normal = (1 / outside.upper) * outside.apart;
  return result;
}

double signed_distance(const PolytopeView& polytope, Vec3 a, Vec3 b, double enough, std::vector<double>& scratch) {
  if (a.x == b.x && a.y == b.y && a.z == b.z) return signed_distance(polytope, a, enough).value;
  const std::size_t planes = polytope.offsets.size();
  scratch.resize(2 * planes);
  const std::span<double> value(scratch.data(), planes), slope(scratch.data() + planes, planes);
  const Vec3 d = b - a;
  for (std::size_t l = 0; l < planes; ++l) {
    const Vec3 n = from_rows(&polytope.normals[3 * l]);
    value[l] = dot(n, a) - polytope.offsets[l];
    slope[l] = dot(n, d);
  }
  const double depth = minimum_of_maximum(value, slope);
  if (depth <= 0 || depth >= enough) return depth;
  const Vec3 ends[2] = {a, b};
  return std::max(depth, hull_distance(ends, polytope.vertices, enough).lower);
}

}  // namespace alula::geometry
