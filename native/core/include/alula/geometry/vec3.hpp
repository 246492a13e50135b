// Three-dimensional vectors and axis-aligned boxes.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "alula/base/require.hpp"

namespace alula::geometry {

struct Vec3 {
  double x = 0, y = 0, z = 0;

  double& operator[](int i) { return i == 0 ? x : i == 1 ? y : z; }
  double operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
};

inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(double s, Vec3 a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline double norm(Vec3 a) { return std::sqrt(dot(a, a)); }
inline Vec3 by_axis(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline bool is_zero(Vec3 a) { return a.x == 0 && a.y == 0 && a.z == 0; }
inline bool is_size(Vec3 a) { return alula::is_size(a.x) && alula::is_size(a.y) && alula::is_size(a.z); }
inline Vec3 from_rows(const double* row) { return {row[0], row[1], row[2]}; }

// A vector scaled down to a length of at most `most`.
inline Vec3 limited(Vec3 a, double most) {
  const double length = norm(a);
  return length > most ? most / length * a : a;
}

// A number for each axis; one number stands for three equal ones.
struct PerAxis : Vec3 {
  PerAxis(double all = 0) : Vec3{all, all, all} {}
  PerAxis(Vec3 each) : Vec3(each) {}

  bool is_even() const { return x == y && y == z; }
  double most() const { return std::max(x, std::max(y, z)); }
  double least() const { return std::min(x, std::min(y, z)); }
};

struct Box {
  Vec3 lower{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(),
             std::numeric_limits<double>::infinity()};
  Vec3 upper{-std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(),
             -std::numeric_limits<double>::infinity()};

  void include(Vec3 p) {
    for (int i = 0; i < 3; ++i) lower[i] = std::min(lower[i], p[i]), upper[i] = std::max(upper[i], p[i]);
  }
  void include(const Box& other) { include(other.lower), include(other.upper); }
};

// Squared distance of two boxes; 0 when they meet.
inline double squared_distance(const Box& a, const Box& b) {
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    const double gap = std::max(0.0, std::max(a.lower[i] - b.upper[i], b.lower[i] - a.upper[i]));
    sum += gap * gap;
  }
  return sum;
}

// A lower bound on the squared distance of the segment a + t d, 0 <= t <= 1, and a box. The
// function is convex in t, so two tangents bound it from below where they meet. Each secant step
// tightens the bound, and a step that lands in the right quadratic piece makes it exact.
inline double squared_distance_bound(const Box& box, Vec3 a, Vec3 d) {
  struct Tangent {
    double t, value, slope;
  };
  const auto tangent = [&](double t) {
    Tangent result{t, 0, 0};
    for (int i = 0; i < 3; ++i) {
      const double p = a[i] + t * d[i];
      const double out = p < box.lower[i] ? p - box.lower[i] : p > box.upper[i] ? p - box.upper[i] : 0.0;
      result.value += out * out;
      result.slope += 2 * out * d[i];
    }
    return result;
  };
  Tangent left = tangent(0), right = tangent(1);
  if (left.slope >= 0) return left.value;
  if (right.slope <= 0) return right.value;
  for (int step = 0; step < 4; ++step) {
    const double t = left.t - left.slope * (right.t - left.t) / (right.slope - left.slope);
    if (!(t > left.t && t < right.t)) break;
    const Tangent middle = tangent(t);
    if (middle.slope == 0) return middle.value;
    (middle.slope < 0 ? left : right) = middle;
  }
  const double meet =
      (right.value - left.value + left.slope * left.t - right.slope * right.t) / (left.slope - right.slope);
  return std::max(0.0, left.value + left.slope * (meet - left.t));
}

}  // namespace alula::geometry
