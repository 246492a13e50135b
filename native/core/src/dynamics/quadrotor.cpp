#include "alula/dynamics/quadrotor.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::e3;
using geometry::multiply;

constexpr double kTogether = 1e-10;

// Gauss-Jordan with partial pivoting; throws when a pivot is negligible relative to its column.
Mat4 inverse(Mat4 a) {
  Mat4 b{};
  for (std::size_t i = 0; i < 4; ++i) b[i][i] = 1;
  for (std::size_t column = 0; column < 4; ++column) {
    std::size_t pivot = column;
    double largest = 0;
    for (std::size_t i = 0; i < 4; ++i) largest = std::max(largest, std::abs(a[i][column]));
    for (std::size_t i = column + 1; i < 4; ++i)
      if (std::abs(a[i][column]) > std::abs(a[pivot][column])) pivot = i;
    if (!(std::abs(a[pivot][column]) > 1e-12 * largest))
      throw std::invalid_argument("the rotors cannot make every thrust and torque");
    std::swap(a[pivot], a[column]), std::swap(b[pivot], b[column]);
    const double scale = 1 / a[column][column];
    for (std::size_t j = 0; j < 4; ++j) a[column][j] *= scale, b[column][j] *= scale;
    for (std::size_t i = 0; i < 4; ++i) {
      if (i == column) continue;
      const double factor = a[i][column];
      for (std::size_t j = 0; j < 4; ++j) a[i][j] -= factor * a[column][j], b[i][j] -= factor * b[column][j];
    }
  }
  return b;
}

Vec4 times(const Mat4& m, const Vec4& v) {
  Vec4 result{};
  for (std::size_t i = 0; i < 4; ++i) result[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2] + m[i][3] * v[3];
  return result;
}

bool all_finite(const Vec4& v) {
  return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]) && std::isfinite(v[3]);
}

Vec4 to_array(const Wrench& u) { return {u.thrust, u.torque.x, u.torque.y, u.torque.z}; }

}  // namespace

Quadrotor::Quadrotor(double mass, Vec3 inertia, const RotorLayout& rotors, double gravity)
    : mass_(mass), gravity_(gravity), inertia_(inertia), rotors_(rotors) {
  if (!(mass > 0 && std::isfinite(mass) && gravity > 0 && std::isfinite(gravity)))
    throw std::invalid_argument("mass and gravity must be positive");
  for (int i = 0; i < 3; ++i)
    if (!(inertia[i] > 0 && std::isfinite(inertia[i]))) throw std::invalid_argument("the inertia must be positive");
  for (std::size_t i = 0; i < 4; ++i) {
    if (!(rotors.f_min[i] >= 0 && rotors.f_min[i] < rotors.f_max[i] && std::isfinite(rotors.f_max[i])))
      throw std::invalid_argument("limits of a rotor's thrust need 0 <= f_min < f_max");
    if (rotors.spin[i] != 1 && rotors.spin[i] != -1) throw std::invalid_argument("a rotor's spin is -1 or 1");
    if (!std::isfinite(rotors.x[i]) || !std::isfinite(rotors.y[i]))
      throw std::invalid_argument("the position of a rotor must be finite");
    allocation_[0][i] = 1;
    allocation_[1][i] = rotors.y[i];
    allocation_[2][i] = -rotors.x[i];
    allocation_[3][i] = rotors.spin[i] * rotors.torque_ratio;
  }
  if (!(rotors.torque_ratio > 0 && std::isfinite(rotors.torque_ratio)))
    throw std::invalid_argument("the ratio of torque to thrust must be positive");
  inverse_allocation_ = inverse(allocation_);
  double low = 0, high = std::numeric_limits<double>::infinity();  // thrusts without torque
  for (std::size_t i = 0; i < 4; ++i) {
    pure_thrust_[i] = inverse_allocation_[i][0];
    if (!(pure_thrust_[i] > 0)) throw std::invalid_argument("the center of mass must be between the rotors");
    low = std::max(low, rotors.f_min[i] / pure_thrust_[i]), high = std::min(high, rotors.f_max[i] / pure_thrust_[i]);
  }
  if (!(low < high)) throw std::invalid_argument("the rotors have no thrust without torque in common");
}

double Quadrotor::max_thrust() const {
  return rotors_.f_max[0] + rotors_.f_max[1] + rotors_.f_max[2] + rotors_.f_max[3];
}

Wrench Quadrotor::wrench(const Vec4& rotor_thrust) const {
  const Vec4 u = times(allocation_, rotor_thrust);
  return {u[0], {u[1], u[2], u[3]}};
}

Vec4 Quadrotor::rotor_thrust(const Wrench& u) const { return times(inverse_allocation_, to_array(u)); }

bool Quadrotor::admissible(const Wrench& u, double tolerance_n) const {
  const Vec4 f = rotor_thrust(u);
  for (std::size_t i = 0; i < 4; ++i)
    if (!(f[i] >= rotors_.f_min[i] - tolerance_n && f[i] <= rotors_.f_max[i] + tolerance_n)) return false;
  return true;
}

Wrench Quadrotor::saturated(const Wrench& u) const {
  Vec4 f = rotor_thrust(u);
  bool cut = false;
  for (std::size_t i = 0; i < 4; ++i) {
    const double within = std::clamp(f[i], rotors_.f_min[i], rotors_.f_max[i]);
    cut = cut || within != f[i];
    f[i] = within;
  }
  return cut ? wrench(f) : u;
}

Wrench Quadrotor::limited(const Wrench& u) const {
  if (admissible(u)) return u;
  const Vec4 tilting = rotor_thrust({0, {u.torque.x, u.torque.y, 0}}),
             turning = rotor_thrust({0, {0, 0, u.torque.z}});
  if (!is_finite(u) || !all_finite(tilting) || !all_finite(turning)) return limited({hover_thrust(), {}});

  // Rotor i then has T pure_i + taken_i, within its limits for T between low_i and high_i.
  Vec4 taken{};
  const auto low = [&](std::size_t i) { return (rotors_.f_min[i] - taken[i]) / pure_thrust_[i]; };
  const auto high = [&](std::size_t i) { return (rotors_.f_max[i] - taken[i]) / pure_thrust_[i]; };
  for (const Vec4& part : {tilting, turning}) {
    double fraction = 1;  // the largest for which all low_i <= all high_j; 0 satisfies this
    for (std::size_t i = 0; i < 4; ++i)
      for (std::size_t j = 0; j < 4; ++j) {
        // Two rotors with equal rates up to rounding keep the gap between them.
        const double of_i = part[i] / pure_thrust_[i], of_j = part[j] / pure_thrust_[j];
        if (of_j - of_i > kTogether * (std::abs(of_i) + std::abs(of_j)))
          fraction = std::min(fraction, std::max(0.0, high(j) - low(i)) / (of_j - of_i));
      }
    for (std::size_t i = 0; i < 4; ++i) taken[i] += fraction * part[i];
  }
  const double lowest = std::max(std::max(low(0), low(1)), std::max(low(2), low(3)));
  const double highest = std::min(std::min(high(0), high(1)), std::min(high(2), high(3)));
  const double thrust = std::max(lowest, std::min(highest, u.thrust));
  Vec4 f{};
  for (std::size_t i = 0; i < 4; ++i)
    f[i] = std::clamp(thrust * pure_thrust_[i] + taken[i], rotors_.f_min[i], rotors_.f_max[i]);
  return wrench(f);
}

Vec3 Quadrotor::angular_acceleration(Vec3 omega, Vec3 torque) const {
  return divide(torque - cross(omega, multiply(inertia_, omega)), inertia_);
}

State Quadrotor::derivative(const State& x, const Wrench& u, Vec3 external_acceleration) const {
  return {x.v, attitude_rate(x.sigma, x.omega),
          -gravity_ * e3 + (u.thrust / mass_) * thrust_axis(x.sigma) + external_acceleration,
          angular_acceleration(x.omega, u.torque)};
}

// `rk4_step` of `derivative`, evaluated part by part: the same operations in the same order, so the same bits,
// without moving states through memory. Rates do not depend on the attitude, and the attitude not on the velocity.
State Quadrotor::step(const State& x, const Wrench& u, double dt) const {
  const double thrust = u.thrust / mass_, half = dt / 2;
  const auto spun_up = [&](Vec3 omega) {
    return divide(u.torque - cross(omega, multiply(inertia_, omega)), inertia_);
  };
  const auto pushed = [&](Vec3 sigma) {
    const Vec3 b = thrust_axis(sigma);
    return Vec3{thrust * b.x, thrust * b.y, thrust * b.z - gravity_};
  };
  const auto end = [&](Vec3 from, Vec3 k1, Vec3 k2, Vec3 k3, Vec3 k4) {
    return from + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
  };
  const Vec3 w1 = x.omega, spin1 = spun_up(w1);
  const Vec3 w2 = w1 + half * spin1, spin2 = spun_up(w2);
  const Vec3 w3 = w1 + half * spin2, spin3 = spun_up(w3);
  const Vec3 w4 = w1 + dt * spin3, spin4 = spun_up(w4);
  const Vec3 s1 = x.sigma, turn1 = attitude_rate(s1, w1);
  const Vec3 s2 = s1 + half * turn1, turn2 = attitude_rate(s2, w2);
  const Vec3 s3 = s1 + half * turn2, turn3 = attitude_rate(s3, w3);
  const Vec3 s4 = s1 + dt * turn3, turn4 = attitude_rate(s4, w4);
  const Vec3 a1 = pushed(s1), a2 = pushed(s2), a3 = pushed(s3), a4 = pushed(s4);
  const Vec3 v1 = x.v, v2 = v1 + half * a1, v3 = v1 + half * a2, v4 = v1 + dt * a3;
  return {end(x.p, v1, v2, v3, v4), end(s1, turn1, turn2, turn3, turn4), end(v1, a1, a2, a3, a4),
          end(w1, spin1, spin2, spin3, spin4)};
}

}  // namespace alula::flight
