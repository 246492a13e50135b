// Dual numbers: values with their derivatives along N directions (forward-mode differentiation). A flow integrated
// with them carries its sensitivity: the variational equation of exactly the integration steps taken.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace alula {

template <std::size_t N>
struct Dual {
  double value = 0;
  std::array<double, N> d{};

  Dual() = default;
  Dual(double v) : value(v) {}  // a constant; implicit, so that formulas look the same as with doubles
  Dual(double v, const std::array<double, N>& along) : value(v), d(along) {}

  template <class F>
  static Dual made(double v, F&& along) {
    Dual r(v);
    for (std::size_t i = 0; i < N; ++i) r.d[i] = along(i);
    return r;
  }

  friend Dual operator+(const Dual& a, const Dual& b) {
    return made(a.value + b.value, [&](std::size_t i) { return a.d[i] + b.d[i]; });
  }
  friend Dual operator-(const Dual& a, const Dual& b) {
    return made(a.value - b.value, [&](std::size_t i) { return a.d[i] - b.d[i]; });
  }
  friend Dual operator-(const Dual& a) {
    return made(-a.value, [&](std::size_t i) { return -a.d[i]; });
  }
  friend Dual operator*(const Dual& a, const Dual& b) {
    return made(a.value * b.value, [&](std::size_t i) { return a.d[i] * b.value + a.value * b.d[i]; });
  }
  friend Dual operator/(const Dual& a, const Dual& b) {
    const double inverse = 1 / b.value, quotient = a.value * inverse;
    return made(quotient, [&](std::size_t i) { return (a.d[i] - quotient * b.d[i]) * inverse; });
  }
  friend bool operator<(const Dual& a, const Dual& b) { return a.value < b.value; }
  friend bool operator>(const Dual& a, const Dual& b) { return a.value > b.value; }
};

// f(a), given the slope of f at a.
template <std::size_t N>
Dual<N> chained(const Dual<N>& a, double value, double slope) {
  return Dual<N>::made(value, [&](std::size_t i) { return slope * a.d[i]; });
}

inline double sine(double a) { return std::sin(a); }
inline double cosine(double a) { return std::cos(a); }
inline double root(double a) { return std::sqrt(a); }

template <std::size_t N>
Dual<N> sine(const Dual<N>& a) {
  return chained(a, std::sin(a.value), std::cos(a.value));
}
template <std::size_t N>
Dual<N> cosine(const Dual<N>& a) {
  return chained(a, std::cos(a.value), -std::sin(a.value));
}
template <std::size_t N>
Dual<N> root(const Dual<N>& a) {  // square root of a positive value
  const double r = std::sqrt(a.value);
  return chained(a, r, 0.5 / r);
}

template <class S>
S cut(const S& x, double low, double high) {
  return x < S(low) ? S(low) : x > S(high) ? S(high) : x;
}

}  // namespace alula
