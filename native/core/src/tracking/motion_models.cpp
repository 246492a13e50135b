#include "alula/tracking/motion_models.hpp"

#include <algorithm>
#include <cmath>

namespace alula::flight {
namespace {

constexpr double kFloor = 1e-8;    // variance added to a measurement [m^2, m^2/s^2]
constexpr double kPivot = 1e-14;   // minimum fraction of a variance that remains given the other states
constexpr double kFarthest = 1e9;  // limit of measurements and standard deviations [m, m/s]

using Rows = double[kMostStates][kMostStates];

template <int N>
void symmetrize(Rows& P) {
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < i; ++j) P[i][j] = P[j][i] = 0.5 * (P[i][j] + P[j][i]);
}

// P <- F P F' for F that adds dt times the next derivative (and dt^2/2 times the one after), axis by axis.
template <int N>
void shift(double dt, Rows& P) {
  const double half = 0.5 * dt * dt;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < N; ++j) {
      if constexpr (N == 9) {
        P[i][j] += dt * P[i + 3][j] + half * P[i + 6][j];
        P[i + 3][j] += dt * P[i + 6][j];
      } else {
        P[i][j] += dt * P[i + 3][j];
      }
    }
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < 3; ++j) {
      if constexpr (N == 9) {
        P[i][j] += dt * P[i][j + 3] + half * P[i][j + 6];
        P[i][j + 3] += dt * P[i][j + 6];
      } else {
        P[i][j] += dt * P[i][j + 3];
      }
    }
}

// Adds the process noise of white acceleration.
void add_noise(double q, double dt, Rows& P) {
  const double pp = q * dt * dt * dt / 3, pv = q * dt * dt / 2, vv = q * dt;
  for (int i = 0; i < 3; ++i) {
    P[i][i] += pp, P[i + 3][i + 3] += vv;
    P[i][i + 3] += pv, P[i + 3][i] += pv;
  }
}

void predict_velocity(double q, double dt, Belief& b) {
  for (int i = 0; i < 3; ++i) b.x[i] += dt * b.x[i + 3];
  shift<6>(dt, b.P);
  add_noise(q, dt, b.P);
  symmetrize<6>(b.P);
}

void predict_acceleration(double q, double dt, Belief& b) {
  const double half = 0.5 * dt * dt, t3 = dt * dt * dt;
  for (int i = 0; i < 3; ++i) {
    b.x[i] += dt * b.x[i + 3] + half * b.x[i + 6];
    b.x[i + 3] += dt * b.x[i + 6];
  }
  shift<9>(dt, b.P);
  const double pp = q * t3 * dt * dt / 20, pv = q * t3 * dt / 8, pa = q * t3 / 6, vv = q * t3 / 3, va = q * half;
  for (int i = 0; i < 3; ++i) {
    b.P[i][i] += pp, b.P[i + 3][i + 3] += vv, b.P[i + 6][i + 6] += q * dt;
    b.P[i][i + 3] += pv, b.P[i + 3][i] += pv;
    b.P[i][i + 6] += pa, b.P[i + 6][i] += pa;
    b.P[i + 3][i + 6] += va, b.P[i + 6][i + 3] += va;
  }
  symmetrize<9>(b.P);
}

// sin(w t)/w and (1 - cos(w t))/w with their derivatives by w.
struct TurnTerms {
  double along, across, along_w, across_w;
};

TurnTerms turn_terms(double w, double t) {
  const double angle = w * t, square = angle * angle;
  if (std::abs(angle) < 1e-3)
    return {t * (1 - square / 6), t * angle * (0.5 - square / 24), t * t * angle * (-1.0 / 3 + square / 30),
            t * t * (0.5 - square / 8)};
  const double s = std::sin(angle), c = std::cos(angle);
  return {s / w, (1 - c) / w, (angle * c - s) / (w * w), (angle * s - (1 - c)) / (w * w)};
}

void predict_turn(const MotionNoise& noise, double dt, Belief& b) {
  constexpr int N = 7;
  const double w = b.x[6], vx = b.x[3], vy = b.x[4], s = std::sin(w * dt), c = std::cos(w * dt);
  const TurnTerms turn = turn_terms(w, dt);
  double F[N][N] = {};
  for (int i = 0; i < N; ++i) F[i][i] = 1;
  F[0][3] = turn.along, F[0][4] = -turn.across, F[1][3] = turn.across, F[1][4] = turn.along, F[2][5] = dt;
  F[3][3] = c, F[3][4] = -s, F[4][3] = s, F[4][4] = c;
  F[0][6] = turn.along_w * vx - turn.across_w * vy, F[1][6] = turn.across_w * vx + turn.along_w * vy;
  F[3][6] = -dt * (s * vx + c * vy), F[4][6] = dt * (c * vx - s * vy);

  b.x[0] += turn.along * vx - turn.across * vy;
  b.x[1] += turn.across * vx + turn.along * vy;
  b.x[2] += dt * b.x[5];
  b.x[3] = c * vx - s * vy, b.x[4] = s * vx + c * vy;

  double FP[N][N];
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) {
      double sum = 0;
      for (int k = 0; k < N; ++k) sum += F[i][k] * b.P[k][j];
      FP[i][j] = sum;
    }
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) {
      double sum = 0;
      for (int k = 0; k < N; ++k) sum += FP[i][k] * F[j][k];
      b.P[i][j] = sum;
    }
  add_noise(noise.acceleration, dt, b.P);
  b.P[6][6] += noise.turn * dt;
  symmetrize<N>(b.P);
}

// True if P = L D L' with pivots above the level of rounding.
template <int N>
bool is_positive(const Rows& P) {
  double L[N][N], D[N];
  for (int j = 0; j < N; ++j) {
    double pivot = P[j][j];
    for (int k = 0; k < j; ++k) pivot -= L[j][k] * L[j][k] * D[k];
    if (!(pivot > kPivot * P[j][j])) return false;
    D[j] = pivot;
    for (int i = j + 1; i < N; ++i) {
      double sum = P[i][j];
      for (int k = 0; k < j; ++k) sum -= L[i][k] * L[j][k] * D[k];
      L[i][j] = sum / pivot;
    }
  }
  return true;
}

// Weakens correlations until P is positive definite. It is needed only where variances differ by so many orders of
// magnitude that an update loses all digits of the small ones.
template <int N>
void keep_positive(Rows& P) {
  for (double weaken = 1e-14; weaken <= 100 && !is_positive<N>(P); weaken *= 10) {
    for (int i = 0; i < N; ++i) {
      if (!(P[i][i] > kFloor * kPivot)) P[i][i] = kFloor;
      for (int j = 0; j < N; ++j)
        if (i != j) P[i][j] = weaken < 1 ? P[i][j] * (1 - weaken) : 0;
    }
  }
}

// H P with H = (I 0 0; 0 los' 0).
template <int N>
void project(const Rows& P, const Measurement& m, double (&result)[4][N]) {
  for (int j = 0; j < 3; ++j) std::copy_n(P[j], N, result[j]);
  for (int i = 0; i < N; ++i) result[3][i] = m.los[0] * P[3][i] + m.los[1] * P[4][i] + m.los[2] * P[5][i];
}

// P <- P + a' b, rows of the factors being M.
template <int M, int N>
void add_product(const double (&a)[4][N], const double (&b)[4][N], Rows& P) {
  for (int i = 0; i < N; ++i)
    for (int k = 0; k < M; ++k)
      for (int j = 0; j < N; ++j) P[i][j] += a[k][i] * b[k][j];
}

// P <- (I - K H) P (I - K H)' + K R K', grouped as P1 + (K R - P1 H') K' with P1 = P - K H P. Matrices of gains and
// projections are stored transposed, so all inner loops run along the states.
template <int N, int M>
void correct(const Measurement& m, const Innovation& y, Belief& b) {
  double HP[4][N], gain[4][N];  // K' = inv(L') inv(L) H P
  project<N>(b.P, m, HP);
  for (int j = 0; j < M; ++j) {
    std::copy_n(HP[j], N, gain[j]);
    for (int k = 0; k < j; ++k)
      for (int i = 0; i < N; ++i) gain[j][i] -= y.L[j][k] * gain[k][i];
    for (int i = 0; i < N; ++i) gain[j][i] /= y.L[j][j];
    for (int i = 0; i < N; ++i) b.x[i] += gain[j][i] * y.whitened[j];
  }
  for (int j = M - 1; j >= 0; --j) {
    for (int k = j + 1; k < M; ++k)
      for (int i = 0; i < N; ++i) gain[j][i] -= y.L[k][j] * gain[k][i];
    for (int i = 0; i < N; ++i) gain[j][i] /= y.L[j][j];
  }
  double rest[4][N];
  for (int j = 0; j < M; ++j)
    for (int i = 0; i < N; ++i) rest[j][i] = -gain[j][i];
  add_product<M>(rest, HP, b.P);
  project<N>(b.P, m, HP);
  for (int j = 0; j < M; ++j) {
    for (int i = 0; i < N; ++i) rest[j][i] = -HP[j][i];
    for (int k = 0; k < M; ++k)
      for (int i = 0; i < N; ++i) rest[j][i] += m.R[k][j] * gain[k][i];
  }
  add_product<M>(rest, gain, b.P);
  symmetrize<N>(b.P);
  keep_positive<N>(b.P);
}

template <int N>
void correct(const Measurement& m, const Innovation& y, Belief& b) {
  m.size == 4 ? correct<N, 4>(m, y, b) : correct<N, 3>(m, y, b);
}

bool is_covariance(const geometry::Mat3& r) {
  const double scale = r[0][0] + r[1][1] + r[2][2];
  if (!(scale <= kFarthest * kFarthest)) return false;
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    if (!(r[i][i] >= 0) || !(std::abs(r[i][j] - r[j][i]) <= 1e-9 * scale)) return false;
    if (!(r[i][i] * r[j][j] - r[i][j] * r[j][i] >= -1e-12 * scale * scale)) return false;
  }
  return geometry::dot(r.row(0), geometry::cross(r.row(1), r.row(2))) >= -1e-12 * scale * scale * scale;
}

}  // namespace

void predict(MotionModel model, const MotionNoise& noise, double dt, Belief& belief) {
  if (dt == 0) return;
  switch (model) {
    case MotionModel::velocity:
      return predict_velocity(noise.acceleration, dt, belief);
    case MotionModel::acceleration:
      return predict_acceleration(noise.jerk, dt, belief);
    case MotionModel::turn:
      return predict_turn(noise, dt, belief);
  }
}

geometry::Vec3 acceleration(MotionModel model, const Belief& b) {
  switch (model) {
    case MotionModel::velocity:
      break;
    case MotionModel::acceleration:
      return {b.x[6], b.x[7], b.x[8]};
    case MotionModel::turn:
      return {-b.x[6] * b.x[4], b.x[6] * b.x[3], 0};
  }
  return {};
}

bool measure(const Detection& d, Measurement& m) {
  if (!(geometry::norm(d.position) <= kFarthest) || !is_covariance(d.covariance)) return false;
  m = {};
  for (int i = 0; i < 3; ++i) {
    m.z[i] = d.position[i];
    for (int j = 0; j < 3; ++j) m.R[i][j] = 0.5 * (d.covariance[i][j] + d.covariance[j][i]);
    m.R[i][i] += kFloor;
  }
  if (!d.has_doppler) return true;
  const double length = geometry::norm(d.los);
  if (!(length > 0) || !std::isfinite(length) || !(std::abs(d.range_rate) <= kFarthest)) return false;
  if (!(d.range_rate_sigma >= 0 && d.range_rate_sigma <= kFarthest)) return false;
  m.size = 4;
  for (int i = 0; i < 3; ++i) m.los[i] = d.los[i] / length;
  m.z[3] = d.range_rate;
  m.R[3][3] = d.range_rate_sigma * d.range_rate_sigma + kFloor;
  return true;
}

Innovation innovate(const Belief& b, const Measurement& m) {
  Innovation result;
  double HP[4][6], S[4][4];
  project<6>(b.P, m, HP);
  double y[4] = {m.z[0] - b.x[0], m.z[1] - b.x[1], m.z[2] - b.x[2], 0};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j <= i; ++j) S[i][j] = b.P[i][j] + m.R[i][j];
  if (m.size == 4) {
    y[3] = m.z[3];
    S[3][3] = m.R[3][3];
    for (int i = 0; i < 3; ++i) {
      y[3] -= m.los[i] * b.x[i + 3];
      S[3][i] = HP[3][i];
      S[3][3] += m.los[i] * HP[3][i + 3];
    }
  }
  double determinant = 1;
  for (int i = 0; i < m.size; ++i) {
    double sum = y[i];
    for (int j = 0; j <= i; ++j) {
      double s = S[i][j];
      for (int k = 0; k < j; ++k) s -= result.L[i][k] * result.L[j][k];
      if (j < i) {
        result.L[i][j] = s / result.L[j][j];
        sum -= result.L[i][j] * result.whitened[j];
      } else {
        if (!(s > 0) || !std::isfinite(s)) return result;
        determinant *= s;
        result.L[i][i] = std::sqrt(s);
      }
    }
    result.whitened[i] = sum / result.L[i][i];
    result.distance += result.whitened[i] * result.whitened[i];
  }
  result.log_determinant = std::log(determinant);
  result.is_valid = std::isfinite(result.distance) && std::isfinite(result.log_determinant);
  return result;
}

void correct(MotionModel model, const Measurement& measurement, const Innovation& innovation, Belief& belief) {
  if (!innovation.is_valid) return;
  switch (model) {
    case MotionModel::velocity:
      return correct<6>(measurement, innovation, belief);
    case MotionModel::acceleration:
      return correct<9>(measurement, innovation, belief);
    case MotionModel::turn:
      return correct<7>(measurement, innovation, belief);
  }
}

}  // namespace alula::flight
