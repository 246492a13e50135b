// Estimate of the acceleration that the model of a quadrotor leaves out: wind, a hover throttle or a mass that is
// wrong, a weak rotor.
//
// A Luenberger observer of v' = a + d with the modelled acceleration a and a constant disturbance d, both poles at
// -1 / T:
//
//   v^' = a + d^ + 2 / T (v - v^),   d^' = 1 / T^2 (v - v^).
//
// After d jumps by D, |v - v^| rises to D T / e at the time T and decays. So e |v - v^| / T, held at its peak and
// decaying with 2 T, is a bound on what d^ does not know yet for a disturbance that changes in jumps; noise of the
// velocity adds to it.
//
// `Level` makes a constant disturbance vanish for controllers and filters. With G = g e3 - d the body moves by
// p'' = T/m z - G about its thrust axis z. S turns G upwards, k = |G| / g. For the thrust T / k and the attitude S R
// the model without disturbance gives a, and the body's acceleration is exactly k S^T a; turning about the body's own
// axes does not change. So hovering is exact, and another acceleration is turned by the angle between G and e3 and
// scaled by k.
#pragma once

#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

struct DisturbanceOptions {
  double time_s = 0;            // T; 0: no disturbance is estimated
  double max_m_s2 = 4;          // the estimate is at most this long
  double max_interval_s = 0.3;  // after a longer one without a measurement the velocity begins anew
};

// Throws std::invalid_argument for a number out of range; the estimate must be below gravity [m/s^2].
void check(const DisturbanceOptions& options, double gravity);

// What the margin of a filter grows by, one law for all filters: the way [m] that a disturbance of `bound` [m/s^2],
// which the estimate does not contain, moves the vehicle in the time until it is estimated and countered. A free body
// moves by bound t^2 / 2. Of a vehicle that follows velocities with a lag, the point where it would come to rest
// moves with lag x bound (chord_filter.hpp), so by lag bound t.
inline constexpr double kReactionTime = 0.5;  // [s]
inline double way_before_reaction(double bound) { return kReactionTime * kReactionTime / 2 * bound; }
inline double way_before_reaction(double bound, double lag_s) { return kReactionTime * lag_s * bound; }

// The bound that noise of the velocity makes in calm air [m/s^2]: margins grow by what is beyond it.
inline constexpr double kNoiseBound = 0.3;

class DisturbanceObserver {
 public:
  explicit DisturbanceObserver(const DisturbanceOptions& options) : options_(options) {}

  bool is_on() const { return options_.time_s > 0; }
  void reset() { *this = DisturbanceObserver(options_); }

  // Forgets all but that the vehicle hovers in the disturbance: it rests on its thrust, whose axis is given.
  void begin(Vec3 thrust_axis, double gravity);

  // A measured velocity at a time [s], and the acceleration by the model at its attitude. Times that do not advance
  // are ignored.
  void update(double time_s, Vec3 v, Vec3 modelled);

  Vec3 acceleration() const { return d_; }  // d^ [m/s^2]
  double bound() const { return bound_; }   // [m/s^2]

 private:
  DisturbanceOptions options_;
  Vec3 v_, d_;
  double time_ = 0, bound_ = 0;
  bool has_state_ = false;
};

// The turn S and the scale k of a disturbance.
class Level {
 public:
  Level() = default;
  Level(Vec3 disturbance, double gravity);

  double scale() const { return scale_; }  // k: true thrust over that without a disturbance
  State operator()(const State& x) const;  // the state with the attitude S R
  Vec3 acceleration(Vec3 modelled) const;  // k S^T a, the true one
  bool is_still() const { return scale_ == 1 && !(sine_ != 0); }

 private:
  Vec3 turn_;  // rotation vector of S [rad, inertial axes]
  Vec3 axis_;  // of S, a unit vector, with sine and cosine of the angle
  double sine_ = 0, cosine_ = 1, scale_ = 1;
};

}  // namespace alula::flight
