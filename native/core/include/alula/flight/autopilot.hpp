// How an autopilot follows set-points of velocity and acceleration: it shapes them into a motion with bounded
// acceleration and jerk, and follows that motion.
//
//   velocity u       a* = r(u - v), |a*| <= A, with r(e) = (J / A) e for |e| <= A^2 / J; beyond it is limited to A
//   acceleration u   a* = u
//   shaped motion    p' = v, v' = a, |a'| <= J towards a*; horizontally as a vector, vertically for itself
//   followed         a_c = a + k_v (v + k_p (p - p_true) - v_true), which acts through a lag: attitude, rotors
//
// The position error is bounded: a vehicle that cannot follow drags the motion along. Source: ArduPilot's
// AC_PosControl, whose gains are the defaults; acceleration and jerk follow from the measured times of stops.
#pragma once

#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

struct FollowingOptions {
  // A and J; 0: not shaped, the vehicle has another cascade.
  double horizontal_acceleration_m_s2 = 0, horizontal_jerk_m_s3 = 0;
  double vertical_acceleration_m_s2 = 0, vertical_jerk_m_s3 = 0;
  double lag_s = 0.1;              // of the acceleration within the attitude loop
  double position_gain_per_s = 1;  // k_p
  double velocity_gain_per_s = 2;  // k_v, horizontally
  double climb_gain_per_s = 5;     // k_v, vertically

  bool is_on() const { return horizontal_jerk_m_s3 > 0; }
};

// Throws std::invalid_argument for a number out of range.
void check(const FollowingOptions& options);

// The shaped motion, and the acceleration that follows it.
class Autopilot {
 public:
  explicit Autopilot(const FollowingOptions& options) : options_(options) {}

  void reset(const State& x);  // from this motion; a climb is being braked, as at the end of a take-off
  // One step of the motion, towards a velocity or an acceleration; the result is what the attitude loop gets.
  Vec3 follow_velocity(double h, Vec3 u, const State& x);
  Vec3 follow_acceleration(double h, Vec3 u, const State& x);

  Vec3 position() const { return p_; }
  Vec3 velocity() const { return v_; }
  Vec3 acceleration() const { return a_; }

 private:
  void advance(double h);
  void turn_towards(double h, Vec3 wanted);
  Vec3 followed(double h, const State& x);

  FollowingOptions options_;
  Vec3 p_, v_, a_, acting_;
};

}  // namespace alula::flight
