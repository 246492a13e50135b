// Values together with their first and second time derivative, and the product and unit rules for them.
#pragma once

#include <cmath>

#include "alula/geometry/mat3.hpp"

namespace alula::flight {

struct Jet {
  double value = 0, rate = 0, acceleration = 0;
};

struct VectorJet {
  geometry::Vec3 value, rate, acceleration;
};

inline Jet operator+(const Jet& a, const Jet& b) {
  return {a.value + b.value, a.rate + b.rate, a.acceleration + b.acceleration};
}
inline Jet operator-(const Jet& a, const Jet& b) {
  return {a.value - b.value, a.rate - b.rate, a.acceleration - b.acceleration};
}
inline Jet operator*(const Jet& a, const Jet& b) {
  return {a.value * b.value, a.rate * b.value + a.value * b.rate,
          a.acceleration * b.value + 2 * a.rate * b.rate + a.value * b.acceleration};
}

// Square root of a positive value.
inline Jet sqrt(const Jet& a) {
  const double root = std::sqrt(a.value), rate = a.rate / (2 * root);
  return {root, rate, (a.acceleration - 2 * rate * rate) / (2 * root)};
}

inline VectorJet operator+(const VectorJet& a, const VectorJet& b) {
  return {a.value + b.value, a.rate + b.rate, a.acceleration + b.acceleration};
}
inline VectorJet operator*(double s, const VectorJet& a) { return {s * a.value, s * a.rate, s * a.acceleration}; }
inline VectorJet operator-(const VectorJet& a, const VectorJet& b) { return a + -1.0 * b; }

inline VectorJet operator*(const Jet& s, const VectorJet& a) {
  return {s.value * a.value, s.rate * a.value + s.value * a.rate,
          s.acceleration * a.value + 2 * s.rate * a.rate + s.value * a.acceleration};
}

inline Jet dot(const VectorJet& a, const VectorJet& b) {
  using geometry::dot;
  return {dot(a.value, b.value), dot(a.rate, b.value) + dot(a.value, b.rate),
          dot(a.acceleration, b.value) + 2 * dot(a.rate, b.rate) + dot(a.value, b.acceleration)};
}

inline VectorJet cross(const VectorJet& a, const VectorJet& b) {
  using geometry::cross;
  return {cross(a.value, b.value), cross(a.rate, b.value) + cross(a.value, b.rate),
          cross(a.acceleration, b.value) + 2 * cross(a.rate, b.rate) + cross(a.value, b.acceleration)};
}

// y = Y / |Y| with N = |Y| > 0: N' = y . Y', y' = (Y' - N' y) / N, N'' = y . Y'' + y' . Y',
// y'' = (Y'' - N'' y - 2 N' y') / N.
inline VectorJet unit(const VectorJet& a, Jet* norm_out = nullptr) {
  const double n = geometry::norm(a.value);
  const geometry::Vec3 y = 1 / n * a.value;
  const double n_rate = dot(y, a.rate);
  const geometry::Vec3 y_rate = 1 / n * (a.rate - n_rate * y);
  const double n_acceleration = dot(y, a.acceleration) + dot(y_rate, a.rate);
  if (norm_out != nullptr) *norm_out = {n, n_rate, n_acceleration};
  return {y, y_rate, 1 / n * (a.acceleration - n_acceleration * y - 2 * n_rate * y_rate)};
}

}  // namespace alula::flight
