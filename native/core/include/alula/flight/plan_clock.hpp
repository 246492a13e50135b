// Time along a plan: it runs with the clock, and slows down for a vehicle that falls behind.
//
// The rate falls linearly from 1 at an error of `near_m` to 0 at `far_m`, and changes by at most `slew_per_s`.
// Derivatives of the reference are those of the slowed time, with its rate taken as constant. The time stops at a
// via point until the vehicle is within 0.9 of its tolerance, for 4 s at most.
#pragma once

#include <cstddef>
#include <limits>
#include <memory>
#include <vector>

#include "alula/planning/reference_curve.hpp"

namespace alula::flight {

struct PlanClockOptions {
  double near_m = 0.3, far_m = 1;  // errors from which on the time slows down, and stands still
  double slew_per_s = 2;           // maximum change of the rate
  std::vector<double> via_s;       // times of the via points along the plan, ascending
  double via_m = std::numeric_limits<double>::infinity();  // distance within which a via point counts as passed
  std::vector<double> own_via_m;                           // the same of each via point; empty: via_m
};

// Throws std::invalid_argument for distances that do not ascend or times that are not in order.
void check(const PlanClockOptions& options);

class PlanClock {
 public:
  PlanClock(std::shared_ptr<const ReferenceCurve> curve, const PlanClockOptions& options = {});

  void reset();
  // Stop; the flight continues from here, and turns from this heading to the plan's.
  void pause(double heading);
  // Begin at a time [s] with a rate of the time; via points at or before it are left out. The flight turns from this
  // heading to the plan's.
  void enter(double time, double rate, double heading);
  void advance(double dt_s, double error_m);

  ReferencePoint target() const;
  double time() const { return time_; }  // [s], from the start of the curve
  double rate() const { return rate_; }  // from 0 to 1
  bool is_over() const { return time_ >= curve_->duration(); }
  const ReferenceCurve& curve() const { return *curve_; }

 private:
  std::shared_ptr<const ReferenceCurve> curve_;
  PlanClockOptions options_;
  double time_ = 0, rate_ = 0, turn_ = 0, waited_s_ = 0;
  std::size_t next_ = 0;  // via point
};

}  // namespace alula::flight
