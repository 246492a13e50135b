// Attitude as Modified Rodrigues Parameters, sigma = e tan(theta / 4).
//
// R(sigma) takes inertial components to body components, v_B = R v_I; the body's thrust axis in inertial
// components is R^T e3. omega is the angular velocity of the body relative to the inertial frame in
// body components [rad/s]. All maps are smooth for finite sigma; the one singularity is theta = 2 pi.
// Switch to the shadow set (|sigma| > 1) between control ticks only, never within a rollout.
#pragma once

#include "alula/geometry/mat3.hpp"

namespace alula::flight {

using geometry::Mat3;
using geometry::Vec3;

// R = I + (8 H^2 - 4 (1 - n) H) / (1 + n)^2 with n = |sigma|^2, H = hat(sigma).
inline Mat3 body_from_inertial(Vec3 sigma) {
  const double n = geometry::dot(sigma, sigma), scale = 1 / ((1 + n) * (1 + n));
  const Mat3 h = geometry::hat(sigma);
  return geometry::identity() + scale * (8.0 * (h * h) - 4 * (1 - n) * h);
}

// Z in sigma' = Z omega: Z = ((1 - n) I + 2 H + 2 sigma sigma^T) / 4.
inline Mat3 rate_matrix(Vec3 sigma) {
  const double n = geometry::dot(sigma, sigma);
  return 0.25 * ((1 - n) * geometry::identity() + 2.0 * geometry::hat(sigma) + 2.0 * geometry::outer(sigma, sigma));
}

// The third row of R, b = R^T e3, without computing the others.
inline Vec3 thrust_axis(Vec3 sigma) {
  const double n = geometry::dot(sigma, sigma), scale = 4 / ((1 + n) * (1 + n)), m = 1 - n;
  return {scale * (2 * sigma.z * sigma.x + m * sigma.y), scale * (2 * sigma.z * sigma.y - m * sigma.x),
          1 + scale * 2 * (sigma.z * sigma.z - n)};
}

// R y without forming R: y + (8 sigma x (sigma x y) - 4 (1 - n) sigma x y) / (1 + n)^2.
inline Vec3 to_body(Vec3 sigma, Vec3 y) {
  const double n = geometry::dot(sigma, sigma), scale = 4 / ((1 + n) * (1 + n));
  const Vec3 once = geometry::cross(sigma, y);
  return y + scale * (2.0 * geometry::cross(sigma, once) - (1 - n) * once);
}

// Z omega without forming Z.
inline Vec3 attitude_rate(Vec3 sigma, Vec3 omega) {
  const double n = geometry::dot(sigma, sigma), along = 2 * geometry::dot(sigma, omega);
  return 0.25 * ((1 - n) * omega + 2.0 * geometry::cross(sigma, omega) + along * sigma);
}

// Z^-1 = 16 / (1 + n)^2 Z^T.
inline Mat3 inverse_rate_matrix(Vec3 sigma) {
  const double n = geometry::dot(sigma, sigma);
  return 16 / ((1 + n) * (1 + n)) * geometry::transpose(rate_matrix(sigma));
}

// d(Z omega) / d sigma = (sigma omega^T - omega sigma^T - hat(omega) + (sigma . omega) I) / 2.
inline Mat3 rate_jacobian(Vec3 sigma, Vec3 omega) {
  return 0.5 * (geometry::outer(sigma, omega) - geometry::outer(omega, sigma) - geometry::hat(omega) +
                geometry::dot(sigma, omega) * geometry::identity());
}

// The same attitude with |sigma| <= 1: -sigma / |sigma|^2 when |sigma| > 1.
inline Vec3 shadowed(Vec3 sigma) {
  const double n = geometry::dot(sigma, sigma);
  return n > 1 ? -1 / n * sigma : sigma;
}

// The attitude after a further turn of the body by the rotation vector `turn` [rad, body axes], |sigma| <= 1.
// By unit quaternions from body to inertial components, q = (1 - n, 2 sigma) / (1 + n).
inline Vec3 turned(Vec3 sigma, Vec3 turn) {
  const double n = geometry::dot(sigma, sigma), a = (1 - n) / (1 + n);
  const Vec3 v = 2 / (1 + n) * sigma;
  const double angle = geometry::norm(turn), b = std::cos(angle / 2);
  const Vec3 w = (angle > 0 ? std::sin(angle / 2) / angle : 0.5) * turn;
  const double scalar = a * b - geometry::dot(v, w);
  const Vec3 vector = a * w + b * v + geometry::cross(v, w);
  return 1 / (1 + std::abs(scalar)) * (scalar < 0 ? -vector : vector);
}

}  // namespace alula::flight
