// A racing drone with its rate loop, in double precision: the plant for tests of the geofence.
//
//   p' = v,  q' = q (0, omega) / 2,  v' = s a(throttle) z(q) - g e3 + drag / m,  omega' = C (omega_des - omega)
//   a(throttle) = a_0 + a_1 throttle + a_2 throttle^2
//
// World z up, body x forward, y left, z up; SI units. Rates are integrated exactly, the other states by RK4.
// Source: Singletary et al. 2022 (arXiv 2201.04331), eq. 15.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "alula/base/random.hpp"
#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

struct RacerState {
  Vec3 p, v;
  Vec4 q{1, 0, 0, 0};  // w, x, y, z; body to world
  Vec3 omega;          // body
};

struct RacerCommand {
  double throttle = 0;  // 0 to 1
  Vec3 rates;           // omega_des [rad/s]
};

inline bool is_finite(const RacerCommand& u) { return std::isfinite(u.throttle) && geometry::is_finite(u.rates); }

// The model that filters use.
struct RacerModel {
  double gravity = 9.81;
  std::array<double, 3> thrust{0, 7.75474, 73.895455};  // a_0, a_1, a_2 [m/s^2]
  double rate_gain = 50;                                // C [1/s]
  Vec3 max_rate{12, 12, 6};                             // limit of a command

  double acceleration(double throttle) const { return thrust[0] + throttle * (thrust[1] + throttle * thrust[2]); }
  double throttle_for(double acceleration) const;  // in [0, 1], nearest
};

// Throws std::invalid_argument for numbers out of range.
void check(const RacerModel& model);

// Effects of the plant that the model lacks; all off by default.
struct RacerOptions {
  double mass = 1;  // [kg]; matters for drag alone
  double mass_scale = 1, thrust_scale = 1, rate_gain_scale = 1;
  double delay_s = 0;                // until a command acts, in whole steps
  Vec3 linear_drag, quadratic_drag;  // along the body's axes, of the air speed [N s/m, N s^2/m^2]
  Vec3 wind_m_s, gust_m_s;           // gusts: first-order Gauss-Markov, standard deviation per axis
  double gust_time_s = 1;
  // Battery sag: thrust is (1 - sag_share x) of the map's, where x follows throttle^2 with this time constant.
  double sag_share = 0, sag_time_s = 0.5;
};

void check(const RacerOptions& options);

Vec3 racer_axis(const Vec4& q);  // z(q)

// One flight; a function of the commands, the seed and the trial. The throttle is clipped to [0, 1] and rates to the
// model's limits. A command that is not finite is replaced by the last one, initially hovering.
class Racer {
 public:
  Racer(const RacerModel& model, const RacerOptions& options = {}, RandomStream random = {});

  void reset(const RacerState& x);
  void step(double dt, const RacerCommand& command);  // the same dt in a flight

  const RacerState& state() const { return x_; }
  double time() const { return time_; }

 private:
  Vec3 acceleration(const Vec3& v, const Vec4& q, double thrust) const;

  RacerModel model_;
  RacerOptions options_;
  RandomStream random_;
  RacerState x_;
  RacerCommand hover_;
  std::vector<RacerCommand> pending_;  // ring buffer of delayed commands
  std::size_t next_ = 0;
  bool has_air_;
  double sag_ = 0, time_ = 0, dt_ = 0, decay_ = 0, half_decay_ = 0;
  Vec3 gust_;
  std::uint64_t steps_ = 0;
};

}  // namespace alula::flight
