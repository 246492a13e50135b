// Estimate of the acceleration that the model leaves out of a vehicle that follows velocities or accelerations
// itself.
//
// How such a vehicle follows is known as an interval only: it may be faster than assumed, and its own controller
// counters wind. So the acceleration of the model is an interval of each axis, [low, high], at every measurement of
// the velocity v:
//
//   velocities      hull of (u - v) / tau over the commands u of the last `delay_s` and lags tau from
//   `shortest_lag_s`
//                   to the assumed one
//   accelerations   hull of the commands of the last `delay_s`, and of what follows them with at most `jerk_m_s3`,
//
// wider by `room_m_s2` on both sides, for noise and for what the identified model leaves out. With the low-pass
// L = 1 / (1 + T s), the washed-out velocity s L v is the measured acceleration through L. Its distance from the
// interval [L low, L high] is the residual; through L again it is the estimate d^. Inside the interval both are 0
// exactly. After a disturbance jumps by D beyond the interval, residual - d^ is D (t / T) exp(-t / T) and its peak
// D / e at the time T. So e |residual - d^|, held at its peak and decaying with `release_s`, bounds what d^ does not
// know yet for a disturbance that changes in jumps. (With low = high this is the observer of disturbance.hpp.)
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "alula/dynamics/quadrotor.hpp"

namespace alula::flight {

struct ResponseOptions {
  double time_s = 0;            // T; 0: nothing is estimated
  double room_m_s2 = 0.3;       // by which the interval is wider on both sides
  double delay_s = 0.3;         // a command of this age may be the one that is followed
  double shortest_lag_s = 0.1;  // of a vehicle that follows velocities
  double jerk_m_s3 = 4;         // with which accelerations are followed at least
  double release_s = 1;         // time constant with which the bound decays
  double max_m_s2 = 4;          // the estimate is at most this long
  double max_interval_s = 0.3;  // after a longer one without a measurement the estimate begins anew
};

// Throws std::invalid_argument for a number out of range; the estimate must be below gravity [m/s^2].
void check(const ResponseOptions& options, double gravity);

class ResponseObserver {
 public:
  // `lag`: longest time constants of a vehicle that follows velocities; without a value it follows accelerations.
  // `dt_s`: duration of a command. `oldest_s`: maximum age of a measurement. Allocates here only.
  ResponseObserver(const ResponseOptions& options, const std::optional<geometry::PerAxis>& lag, double dt_s,
                   double oldest_s);

  bool is_on() const { return options_.time_s > 0; }
  void reset();

  // The command of the next tick; nothing where the vehicle got one of another kind. Then the estimate begins anew
  // once all commands that it may follow are known again.
  void sent(const std::optional<Vec3>& command);

  // A measured velocity of this age [s], seen from the end of the last command. Times that do not advance are
  // ignored.
  void update(double age_s, Vec3 v);

  Vec3 acceleration() const { return d_; }  // d^ [m/s^2]
  double bound() const { return bound_; }   // beyond the interval's room [m/s^2]

 private:
  struct Range {
    Vec3 low, high;
  };
  std::optional<Range> commanded(double age_s) const;
  Range modelled(const Range& commands, Vec3 v) const;

  ResponseOptions options_;
  std::optional<geometry::PerAxis> lag_;
  double dt_;
  std::vector<std::optional<Range>> past_;  // commands, and what follows them late; a ring
  std::int64_t ticks_ = 0;                  // commands since the reset
  std::optional<Vec3> slow_;
  Vec3 v_, low_, high_, d_;
  double time_ = 0, bound_ = 0;
  bool has_state_ = false;
};

}  // namespace alula::flight
