#include "alula/quadrotor.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::e3;
using geometry::multiply;

// Gauss-Jordan with partial pivoting; throws when a pivot vanishes beside its column.
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
      throw std::invalid_argument("the place of a rotor must be finite");
    allocation_[0][i] = 1;
    allocation_[1][i] = rotors.y[i];
    allocation_[2][i] = -rotors.x[i];
    allocation_[3][i] = rotors.spin[i] * rotors.torque_ratio;
  }
  if (!(rotors.torque_ratio > 0 && std::isfinite(rotors.torque_ratio)))
    throw std::invalid_argument("the ratio of torque to thrust must be positive");
  inverse_allocation_ = inverse(allocation_);
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

Wrench Quadrotor::limited(const Wrench& u) const {
  if (admissible(u)) return u;
  double low = rotors_.f_min[0], high = rotors_.f_max[0];  // for all rotors, with room for the torques between
  for (std::size_t i = 1; i < 4; ++i) low = std::max(low, rotors_.f_min[i]), high = std::min(high, rotors_.f_max[i]);
  if (!(low < high)) throw std::logic_error("the rotors have no thrust in common");
  const double room = high - low;
  Vec4 difference{};  // of each rotor from the mean
  const auto add = [&](Vec3 torque) {
    const Vec4 part = rotor_thrust({0, torque});
    const auto spread_at = [&](double share) {
      double least = 0, most = 0;
      for (std::size_t i = 0; i < 4; ++i) {
        const double f = difference[i] + share * part[i];
        least = std::min(least, f), most = std::max(most, f);
      }
      return most - least;
    };
    double share = 1;
    if (spread_at(1) > room) {  // convex in the share and within at 0
      double inside = 0;
      for (int step = 0; step < 52; ++step) {
        const double middle = 0.5 * (inside + share);
        (spread_at(middle) > room ? share : inside) = middle;
      }
      share = inside;
    }
    for (std::size_t i = 0; i < 4; ++i) difference[i] += share * part[i];
  };
  add({u.torque.x, u.torque.y, 0});
  add({0, 0, u.torque.z});
  const auto [least, most] = std::minmax_element(difference.begin(), difference.end());
  const double mean = std::clamp(u.thrust * inverse_allocation_[0][0], low - *least, high - *most);
  Vec4 f{};
  for (std::size_t i = 0; i < 4; ++i) f[i] = std::clamp(mean + difference[i], rotors_.f_min[i], rotors_.f_max[i]);
  return wrench(f);
}

State Quadrotor::derivative(const State& x, const Wrench& u, Vec3 external_acceleration) const {
  const Vec3 thrust_axis = geometry::transposed_times(body_from_inertial(x.sigma), e3);
  const Vec3 momentum = multiply(inertia_, x.omega);
  return {x.v, rate_matrix(x.sigma) * x.omega,
          -gravity_ * e3 + (u.thrust / mass_) * thrust_axis + external_acceleration,
          divide(u.torque - cross(x.omega, momentum), inertia_)};
}

State Quadrotor::step(const State& x, const Wrench& u, double dt) const {
  const State k1 = derivative(x, u);
  const State k2 = derivative(x + dt / 2 * k1, u);
  const State k3 = derivative(x + dt / 2 * k2, u);
  const State k4 = derivative(x + dt * k3, u);
  return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
}

}  // namespace alula::flight
