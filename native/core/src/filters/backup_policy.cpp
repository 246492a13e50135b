#include "alula/filters/backup_policy.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <stdexcept>

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::dot;
using geometry::e3;
using geometry::hat;
using geometry::multiply;
using geometry::norm;
using geometry::outer;

constexpr double kLiftFloor = 0.02;  // eps of l: off by 1 % at 35 degrees, at most 3.6 at any tilt

void require(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

bool positive(std::initializer_list<double> values) {
  return std::all_of(values.begin(), values.end(), [](double x) { return x > 0 && std::isfinite(x); });
}

// e3 x y and the rows of e3 x M.
Vec3 turned(Vec3 y) { return {-y.y, y.x, 0}; }
Mat3 turned(const Mat3& m) { return {{{-m[1][0], -m[1][1], -m[1][2]}, {m[0][0], m[0][1], m[0][2]}, {0, 0, 0}}}; }
Mat3 scaled_rows(Vec3 d, const Mat3& m) {
  Mat3 result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result[i][j] = d[i] * m[i][j];
  return result;
}

// c tanh(y / c) and its slope; 0 for NaN, which occurs if the squares of a huge state overflow.
struct Saturated {
  double value, slope;
};
Saturated saturate(double y, double cap) {
  const double t = std::isnan(y) ? 0 : std::tanh(y / cap);
  return {cap * t, 1 - t * t};
}

}  // namespace

BackupPolicy::BackupPolicy(const Quadrotor& vehicle, BackupKind kind, const BackupGains& gains)
    : vehicle_(vehicle), kind_(kind), gains_(gains) {
  const BackupGains& k = gains_;
  const RotorLayout& rotors = vehicle.rotors();
  const Mat4& inverse = vehicle.inverse_allocation();
  require(k.eta_frac > 0 && k.eta_frac < 1, "eta_frac must lie between 0 and 1");
  const Vec3 inertia = vehicle.inertia();
  if (brakes()) {
    require(positive({k.tilt_rad, k.full_tilt_speed_m_s, k.climb_rate_1_s, k.attitude_rad_s, k.attitude_damping,
                      k.yaw_damping_1_s, k.torque_weight.x, k.torque_weight.y, k.torque_weight.z}),
            "gains of the brake must be positive");
    require(k.tilt_rad <= 1.2, "the tilt of the brake must be at most 1.2 rad");
    require(k.torque_fraction > 0 && k.torque_fraction < 1, "torque_share must lie between 0 and 1");
    const double w = k.attitude_rad_s;
    k_tilt_ = w * w * Vec3{inertia.x, inertia.y, 0};
    k_omega_ = multiply({2 * k.attitude_damping * w, 2 * k.attitude_damping * w, k.yaw_damping_1_s}, inertia);
    lean_ = std::tan(k.tilt_rad) / k.full_tilt_speed_m_s;
    k_z_ = k.climb_rate_1_s;
  } else {
    require(
        positive({k.k_vz, k.k_sigma, k.k_omega, k.k_vh, k.kappa, k.weight[0], k.weight[1], k.weight[2], k.weight[3]}),
        "gains of the backup policy must be positive");
    k_tilt_ = k.k_sigma / 4 * Vec3{1, 1, 0};
    k_omega_ = k.k_omega * Vec3{1, 1, 1};
    lean_ = 4 * k.k_vh / k.k_sigma;
    k_z_ = k.k_vz;
    kappa_ = k.kappa;
  }
  for (int i = 0; i < 2; ++i)
    require(kappa_ * k_omega_[i] > inertia[i] * vehicle.gravity() * lean_,
            "the braking loop is not stable: it needs kappa K_omega K_sigma > 4 J g k_vh");

  Vec4 above{}, below{}, margin{};
  for (std::size_t i = 0; i < 4; ++i) {
    const double hover = inverse[i][0] * vehicle.hover_thrust();
    above[i] = k.eta_frac * (rotors.f_max[i] - hover), below[i] = k.eta_frac * (hover - rotors.f_min[i]);
    margin[i] = std::min(above[i], below[i]);
    require(inverse[i][0] > 0 && margin[i] > 0, "the rotors cannot hover within their limits");
  }
  constexpr double inf = std::numeric_limits<double>::infinity();
  const auto torque_of = [&](std::size_t i, Vec3 d) {
    return std::abs(inverse[i][1]) * d.x + std::abs(inverse[i][2]) * d.y + std::abs(inverse[i][3]) * d.z;
  };
  double scale = inf;
  if (!brakes()) {
    const Vec3 d{k.weight[1], k.weight[2], k.weight[3]};
    for (std::size_t i = 0; i < 4; ++i)
      scale = std::min(scale, margin[i] / (std::abs(inverse[i][0]) * k.weight[0] + torque_of(i, d)));
    up_ = down_ = scale * k.weight[0];
    torque_cap_ = scale * d;
    return;
  }
  for (std::size_t i = 0; i < 4; ++i)
    scale = std::min(scale, k.torque_fraction * margin[i] / torque_of(i, k.torque_weight));
  torque_cap_ = scale * k.torque_weight;
  up_ = down_ = inf;
  for (std::size_t i = 0; i < 4; ++i) {
    const double taken = torque_of(i, torque_cap_);
    up_ = std::min(up_, (above[i] - taken) / inverse[i][0]);
    down_ = std::min(down_, (below[i] - taken) / inverse[i][0]);
  }
}

double BackupPolicy::fastest_rate() const {
  const Vec3 rate = divide(kappa_ * k_omega_, vehicle_.inertia());
  return std::max({rate.x, rate.y, rate.z});
}

// n for `brake`; e3 - (k_vh / K_R) v for the other policies.
Vec3 BackupPolicy::tilt_target(Vec3 v, Vec3 hold) const {
  if (!brakes()) return e3 - lean_ * v;
  const double ux = v.x - hold.x, uy = v.y - hold.y, v0 = gains_.full_tilt_speed_m_s;
  const double k = lean_ * v0 / std::sqrt(v0 * v0 + ux * ux + uy * uy);
  return {-k * ux, -k * uy, 1};
}

double BackupPolicy::lift(double cosine) const { return (1 + kLiftFloor) * cosine / (cosine * cosine + kLiftFloor); }

Wrench BackupPolicy::raw(const State& x, Vec3 hold) const {
  const double weight = vehicle_.hover_thrust(), mass = vehicle_.mass();
  if (kind_ == BackupKind::hover) {
    const Vec3 braking = turned(to_body(x.sigma, x.v));
    return {weight - mass * k_z_ * x.v.z,
            -gains_.k_sigma * x.sigma - multiply(k_omega_, x.omega) - gains_.k_vh * braking};
  }
  const Vec3 lean = turned(to_body(x.sigma, tilt_target(x.v, hold)));
  const Vec3 torque = multiply(k_tilt_, lean) - multiply(k_omega_, x.omega);
  if (kind_ == BackupKind::heading_invariant) return {weight - mass * k_z_ * x.v.z, torque};
  return {(weight - mass * k_z_ * (x.v.z - hold.z)) * lift(thrust_axis(x.sigma).z), torque};
}

Wrench BackupPolicy::saturated(const Wrench& raw) const {
  const double weight = vehicle_.hover_thrust(), y = kappa_ * (raw.thrust - weight);
  Wrench u{weight + saturate(y, y > 0 ? up_ : down_).value, {}};
  for (int i = 0; i < 3; ++i) u.torque[i] = saturate(kappa_ * raw.torque[i], torque_cap_[i]).value;
  return u;
}

Wrench BackupPolicy::operator()(const State& x, Vec3 hold) const { return saturated(raw(x, hold)); }

Wrench BackupPolicy::urgent(const State& x, Vec3 hold) const {
  Wrench u = raw(x, hold);
  u.torque = kappa_ * u.torque;
  if (brakes()) {
    const Vec3 b = thrust_axis(x.sigma), n = tilt_target(x.v, hold);
    const double lift = vehicle_.hover_thrust() - vehicle_.mass() * k_z_ * (x.v.z - hold.z);
    u.thrust = std::max(0.0, lift) * std::max(0.0, dot(b, n));
  }
  return vehicle_.limited(u);
}

Wrench BackupPolicy::linearised(const State& x, Vec3 hold, PolicyJacobian& jacobian) const {
  const Mat3 r = body_from_inertial(x.sigma), z_inverse = inverse_rate_matrix(x.sigma);
  const double weight = vehicle_.hover_thrust(), mass = vehicle_.mass();
  const Wrench u = raw(x, hold);
  const bool is_hover = kind_ == BackupKind::hover;

  // d(e3 x R n) = e3 x (hat(R n) Z^-1 dsigma + R dn), where n is that of `raw`.
  const Vec3 n = is_hover ? -lean_ * x.v : tilt_target(x.v, hold);
  Mat3 n_v = -lean_ * geometry::identity();
  if (brakes()) {
    const double ux = x.v.x - hold.x, uy = x.v.y - hold.y, v0 = gains_.full_tilt_speed_m_s;
    const double square = v0 * v0 + ux * ux + uy * uy, k = lean_ * v0 / std::sqrt(square);
    const double sx = ux / square, sy = uy / square;
    n_v = {{{-k * (1 - ux * sx), k * ux * sy, 0}, {k * uy * sx, -k * (1 - uy * sy), 0}, {0, 0, 0}}};
  }
  Mat3 torque_sigma = scaled_rows(k_tilt_, turned(hat(r * n) * z_inverse));
  if (is_hover) torque_sigma = torque_sigma - gains_.k_sigma * geometry::identity();
  const Mat3 torque_v = scaled_rows(k_tilt_, turned(r * n_v));

  Vec3 thrust_sigma, thrust_v{0, 0, -mass * k_z_};
  if (brakes()) {
    const double y = r[2][2], below = y * y + kLiftFloor;
    const double slope = (1 + kLiftFloor) * (kLiftFloor - y * y) / (below * below);
    const Vec3 c = r.column(2);
    const Vec3 y_sigma = geometry::transposed_times(z_inverse, {-c.y, c.x, 0});  // third row of hat(c) Z^-1
    thrust_sigma = (weight - mass * k_z_ * (x.v.z - hold.z)) * slope * y_sigma;
    thrust_v.z *= lift(y);
  }

  const double y = kappa_ * (u.thrust - weight);
  const Saturated thrust = saturate(y, y > 0 ? up_ : down_);
  jacobian.thrust_sigma = kappa_ * thrust.slope * thrust_sigma;
  jacobian.thrust_v = kappa_ * thrust.slope * thrust_v;
  Wrench result{weight + thrust.value, {}};
  Vec3 gain;
  for (int i = 0; i < 3; ++i) {
    const Saturated part = saturate(kappa_ * u.torque[i], torque_cap_[i]);
    result.torque[i] = part.value, gain[i] = kappa_ * part.slope;
  }
  jacobian.torque_sigma = scaled_rows(gain, torque_sigma);
  jacobian.torque_v = scaled_rows(gain, torque_v);
  jacobian.torque_omega = -multiply(gain, k_omega_);
  return result;
}

bool BackupPolicy::settles(double h) const {
  const auto inside = [](double a2, double a1, double a0) {  // all roots of z^3 + a2 z^2 + a1 z + a0 in the unit disc
    return 1 + a2 + a1 + a0 > 0 && 1 - a2 + a1 - a0 > 0 && std::abs(a0) < 1 && std::abs(a0 * a2 - a1) < 1 - a0 * a0;
  };
  const Vec3 inertia = vehicle_.inertia();
  for (int i = 0; i < 2; ++i) {
    // v' = g b, b' = w, w' = -k_w w - k_b b - k_v v, the last held for h: exact differences, and the characteristic
    // polynomial in z - 1, then in z.
    const double k_w = h * kappa_ * k_omega_[i] / inertia[i], k_b = h * h * kappa_ * k_tilt_[i] / inertia[i];
    const double k_v = h * lean_ * vehicle_.gravity() * k_b;
    const double d2 = k_w + k_b / 2 + k_v / 6, d1 = k_b + k_v, d0 = k_v;
    if (!inside(d2 - 3, 3 - 2 * d2 + d1, -1 + d2 - d1 + d0)) return false;
  }
  const double k_yaw = h * kappa_ * k_omega_.z / inertia.z;
  if (kind_ == BackupKind::hover) {  // a spring on sigma_z, sigma_z' = w / 4
    const double spring = h * h * kappa_ * gains_.k_sigma / (4 * inertia.z), d1 = k_yaw + spring / 2;
    if (!inside(d1 - 2, 1 - d1 + spring, 0)) return false;
  } else if (!(k_yaw < 2)) {
    return false;
  }
  return h * kappa_ * k_z_ < 2;
}

std::array<Vec3, 3> BackupPolicy::drifts(const State& x) const {
  // Near hover the horizontal part b of the thrust axis obeys J b'' = -K_omega b' - K_R (b + lean v) and v' = g b.
  // Integrated until rest, with int b = -v / g:  K_R lean int v = K_R v / g + K_omega b + J b'.
  const Vec3 b = thrust_axis(x.sigma), inertia = vehicle_.inertia();
  const Vec3 turn{inertia.x / (kappa_ * k_tilt_.x) * x.omega.x, inertia.y / (kappa_ * k_tilt_.y) * x.omega.y, 0};
  const Vec3 rate = geometry::transposed_times(body_from_inertial(x.sigma), turn);  // J b' / K_R, turned back
  const double per_rate = (k_omega_.x + k_omega_.y) / (k_tilt_.x + k_tilt_.y), per_speed = 1 / vehicle_.gravity();
  return {1 / lean_ * Vec3{per_speed * x.v.x, per_speed * x.v.y, 0},
          1 / lean_ * Vec3{per_rate * b.x, per_rate * b.y, 0}, 1 / lean_ * Vec3{rate.y, -rate.x, 0}};
}

Vec3 BackupPolicy::drift(const State& x) const {
  const auto [speed, tilt, swing] = drifts(x);
  Vec3 result = speed + tilt + swing;
  result.z = x.v.z / (kappa_ * k_z_);
  return result;
}

double BackupPolicy::excursion(const State& x) const {
  const auto [speed, tilt, swing] = drifts(x);
  return std::hypot(norm(speed) + norm(tilt) + norm(swing), x.v.z / (kappa_ * k_z_));
}

double BackupPolicy::sway(const State& x) const { return brakes() ? norm(drift(x)) : excursion(x); }

bool BackupPolicy::sways_at_most(const State& x, double limit) const {
  // The omitted terms reduce `flat` by at most |swing|, which has a cheap bound.
  const double g = vehicle_.gravity(), above = (1 + 1e-9) * limit, most = lean_ * above;
  if (std::abs(x.v.z) > kappa_ * k_z_ * above) return false;
  double fx = x.v.x / g, fy = x.v.y / g, swing = 0;
  if (brakes()) {
    const Vec3 b = thrust_axis(x.sigma), inertia = vehicle_.inertia();
    const double per_rate = (k_omega_.x + k_omega_.y) / (k_tilt_.x + k_tilt_.y);
    const double per_spin = std::max(inertia.x / (kappa_ * k_tilt_.x), inertia.y / (kappa_ * k_tilt_.y));
    fx += per_rate * b.x, fy += per_rate * b.y;
    swing = (1 + 1e-9) * per_spin * std::sqrt(x.omega.x * x.omega.x + x.omega.y * x.omega.y);
  }
  if (fx * fx + fy * fy > (most + swing) * (most + swing)) return false;
  return sway(x) <= limit;
}

State closed_loop(const BackupPolicy& policy, const State& x, Vec3 hold) {
  return policy.vehicle().derivative(x, policy(x, hold));
}

State closed_loop(const BackupPolicy& policy, const State& x, Vec3 hold, ClosedLoopJacobian& out) {
  const Quadrotor& vehicle = policy.vehicle();
  const Vec3 inertia = vehicle.inertia();
  PolicyJacobian d;
  const Wrench u = policy.linearised(x, hold, d);
  const Mat3 r = body_from_inertial(x.sigma), z = rate_matrix(x.sigma);
  const double n = dot(x.sigma, x.sigma);
  const Mat3 z_inverse = 16 / ((1 + n) * (1 + n)) * geometry::transpose(z);
  const Vec3 b = r.row(2), momentum = multiply(inertia, x.omega);
  const Vec3 per_inertia = divide({1, 1, 1}, inertia);
  const double per_mass = 1 / vehicle.mass();
  out.sigma_sigma = rate_jacobian(x.sigma, x.omega);
  out.sigma_omega = z;
  // -R^T hat(e3) Z^-1 without the zero row of hat(e3) = [[0,-1,0],[1,0,0],[0,0,0]]
  const Vec3 first = r.row(0), second = r.row(1);
  out.v_sigma = u.thrust * per_mass * (outer(first, z_inverse.row(1)) - outer(second, z_inverse.row(0))) +
                outer(per_mass * b, d.thrust_sigma);
  out.v_v = outer(per_mass * b, d.thrust_v);
  out.omega_sigma = scaled_rows(per_inertia, d.torque_sigma);
  out.omega_v = scaled_rows(per_inertia, d.torque_v);
  // hat(J omega) - hat(omega) J + d tau / d omega
  Mat3 rates = hat(momentum);
  const Mat3 turn = hat(x.omega);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) rates[i][j] -= turn[i][j] * inertia[j];
  for (int i = 0; i < 3; ++i) rates[i][i] += d.torque_omega[i];
  out.omega_omega = scaled_rows(per_inertia, rates);
  return {x.v, z * x.omega, -vehicle.gravity() * e3 + u.thrust * per_mass * b,
          divide(u.torque - cross(x.omega, momentum), inertia)};
}

}  // namespace alula::flight
