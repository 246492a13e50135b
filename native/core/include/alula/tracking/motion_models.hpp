// Kalman filters of one moving point: motion models and radar measurements.
//
// States: position [m], velocity [m/s], then an acceleration [m/s^2] or a rate of turn about z [rad/s]:
//   velocity      (p, v)         white acceleration of spectral density q
//   acceleration  (p, v, a)      white jerk
//   turn          (p, v, omega)  v turns about z at omega (extended filter); white acceleration and rate of omega
// Source: Bar-Shalom, Li, Kirubarajan 2001, ch. 6.2, 6.3, 11.7; Joseph's form of the update, ch. 5.2.
#pragma once

#include <array>
#include <cstdint>

#include "alula/tracking/radar.hpp"

namespace alula::flight {

enum class MotionModel : std::uint8_t { velocity, acceleration, turn };

inline constexpr int kMostStates = 9;
inline constexpr std::array<int, 3> kStates{6, 9, 7};

inline constexpr int states(MotionModel model) { return kStates[static_cast<std::size_t>(model)]; }

// Only the first states(model) rows and columns are used. `P` is symmetric to the bit.
struct Belief {
  double x[kMostStates] = {};
  double P[kMostStates][kMostStates] = {};
};

struct MotionNoise {
  double acceleration = 0, jerk = 0, turn = 0;  // spectral densities
};

void predict(MotionModel model, const MotionNoise& noise, double dt, Belief& belief);
geometry::Vec3 acceleration(MotionModel model, const Belief& belief);

// The position and, if size is 4, the rate along `los`.
struct Measurement {
  int size = 3;
  double z[4] = {};
  double R[4][4] = {};
  double los[3] = {};
};

// Converts a detection; false if it is not finite, is beyond 1e9 (m, m/s), or has no covariance. `los` becomes a unit
// vector. A tenth of a millimetre (per second) is added to R in quadrature, so the covariance of a perfect sensor is
// not singular.
bool measure(const Detection& detection, Measurement& result);

// y = z - H x, with the Cholesky factor L of its covariance H P H' + R.
struct Innovation {
  bool is_valid = false;  // the covariance is positive definite
  double L[4][4] = {};
  double whitened[4] = {};     // inv(L) y
  double distance = 0;         // y' inv(S) y
  double log_determinant = 0;  // of S
};

Innovation innovate(const Belief& belief, const Measurement& measurement);

// The measurement update; does nothing if the innovation is not valid.
void correct(MotionModel model, const Measurement& measurement, const Innovation& innovation, Belief& belief);

}  // namespace alula::flight
