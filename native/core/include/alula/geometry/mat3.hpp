// Three by three matrices for the vectors of vec3.hpp.
#pragma once

#include "alula/geometry/vec3.hpp"

namespace alula::geometry {

// Row-major; zero unless initialised.
struct Mat3 {
  double m[3][3] = {};

  double* operator[](int row) { return m[row]; }
  const double* operator[](int row) const { return m[row]; }
  Vec3 row(int i) const { return {m[i][0], m[i][1], m[i][2]}; }
  Vec3 column(int j) const { return {m[0][j], m[1][j], m[2][j]}; }
};

inline Mat3 identity() { return {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}; }
inline Mat3 diagonal(Vec3 d) { return {{{d.x, 0, 0}, {0, d.y, 0}, {0, 0, d.z}}}; }

inline Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
inline Vec3& operator+=(Vec3& a, Vec3 b) { return a = a + b; }
inline Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline Vec3 multiply(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }  // componentwise
inline Vec3 divide(Vec3 a, Vec3 b) { return {a.x / b.x, a.y / b.y, a.z / b.z}; }    // componentwise

// hat(a) b = a x b.
inline Mat3 hat(Vec3 a) { return {{{0, -a.z, a.y}, {a.z, 0, -a.x}, {-a.y, a.x, 0}}}; }
inline Vec3 vee(const Mat3& m) { return {m[2][1], m[0][2], m[1][0]}; }

inline Vec3 operator*(const Mat3& m, Vec3 v) { return {dot(m.row(0), v), dot(m.row(1), v), dot(m.row(2), v)}; }

inline Mat3 operator*(const Mat3& a, const Mat3& b) {
  Mat3 c;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
  return c;
}

inline Mat3 operator+(const Mat3& a, const Mat3& b) {
  Mat3 c;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c[i][j] = a[i][j] + b[i][j];
  return c;
}

inline Mat3 operator*(double s, const Mat3& a) {
  Mat3 c;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c[i][j] = s * a[i][j];
  return c;
}

inline Mat3 operator-(const Mat3& a, const Mat3& b) { return a + -1.0 * b; }

inline Mat3 transpose(const Mat3& a) {
  return {{{a[0][0], a[1][0], a[2][0]}, {a[0][1], a[1][1], a[2][1]}, {a[0][2], a[1][2], a[2][2]}}};
}

// a^T v, without forming the transpose.
inline Vec3 transposed_times(const Mat3& a, Vec3 v) { return v.x * a.row(0) + v.y * a.row(1) + v.z * a.row(2); }

inline Mat3 outer(Vec3 a, Vec3 b) {
  return {{{a.x * b.x, a.x * b.y, a.x * b.z}, {a.y * b.x, a.y * b.y, a.y * b.z}, {a.z * b.x, a.z * b.y, a.z * b.z}}};
}

inline bool is_finite(Vec3 a) { return std::isfinite(a.x) && std::isfinite(a.y) && std::isfinite(a.z); }

inline constexpr Vec3 e3{0, 0, 1};

}  // namespace alula::geometry
