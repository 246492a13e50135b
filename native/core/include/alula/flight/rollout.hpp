// Closed loop of a single integrator, x' = u with a zero-order hold of u, behind a filter of velocities.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/filters/polytope_cbf.hpp"
#include "alula/filters/safety_filter.hpp"

namespace alula {

enum class Outcome : std::uint8_t { flying, reached, stuck, timeout, refused };

struct TrialRules {
  double dt_s = 0.01;
  double gain = 2;              // c of the control Lyapunov function [1/s]
  double v_max = 1;             // the nominal input is scaled down to this [m/s]
  double stop_fraction = 0.01;  // goal reached within this fraction of the start-goal distance, or a millimetre
  double stuck_speed = 1e-3;    // [m/s]
  std::int64_t stuck_steps = 100;
  std::int64_t max_steps = 0;
};

// A reference to track, sampled every dt from the start; after the end it rests in its last row.
struct Reference {
  std::span<const double> position;  // (K, 3) [m]
  std::span<const double> velocity;  // (K, 3) [m/s]
  std::size_t size() const { return position.size() / 3; }
};

// One flight, a step at a time: take nominal(), filter it, advance() with the result.
//
// To a goal, u_nom is the u of minimum norm with (x - x_goal) . u <= -c/2 |x - x_goal|^2, which is
// -(c/2)(x - x_goal); along a reference it is v_ref + (c/2)(x_ref - x). Both are scaled to v_max.
// Source: PolyMerge (arXiv 2606.16232), eq. 16.
class Trial {
 public:
  Trial(const Vec3& start, const Vec3& goal, const TrialRules& rules, Reference reference = {});

  Vec3 nominal() const;
  Outcome advance(const Vec3& u, bool refused);

  const Vec3& position() const { return x_; }
  Outcome outcome() const { return outcome_; }
  std::int64_t steps() const { return step_; }

 private:
  Vec3 x_, goal_;
  TrialRules rules_;
  Reference reference_;
  double stop_distance_;
  std::int64_t step_ = 0, still_ = 0;
  Outcome outcome_ = Outcome::flying;
};

// Rows per step: the position before the step, the inputs and the filter's results.
struct TrialLog {
  std::vector<double> position;      // (steps + 1, 3): the last row is where the flight ended
  std::vector<double> u_nom;         // (steps, 3)
  std::vector<double> u;             // (steps, 3)
  std::vector<float> margin;         // (steps): of polytope-cbf smooth psi - r
  std::vector<std::uint8_t> status;  // (steps): alula_filter_status
  std::vector<float> filter_s;       // (steps): measured time, the only field that differs from run to run
  Outcome outcome = Outcome::flying;
};

// Flies trial i from start[i] to goal[i] (along the reference when it has rows), on `jobs` threads.
// All but filter_s is independent of `jobs`. Throws std::invalid_argument for a filter of other commands.
std::vector<TrialLog> rollout(const flight::SafetyFilter& filter, std::span<const Vec3> start,
                              std::span<const Vec3> goal, const TrialRules& rules, Reference reference, unsigned jobs,
                              Control& control);

}  // namespace alula
