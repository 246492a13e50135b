#include "alula/flight/plan_clock.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <utility>

namespace alula::flight {
namespace {

constexpr double kTurn = 0.7;  // from the heading at the start of a flight to the plan's [rad/s]
constexpr double kSlow =
    0.5;  // time before a via point in which it slows down for a vehicle that is too far away [s]
constexpr double kCreep = 0.1;   // minimum rate there, so that the time arrives
constexpr double kPassed = 0.9;  // a via point is passed at this fraction of its tolerance
constexpr double kWait = 4;      // maximum time at a via point; a filter may keep the vehicle away [s]

}  // namespace

void check(const PlanClockOptions& o) {
  if (!(o.near_m >= 0 && o.far_m > o.near_m && o.slew_per_s > 0 && o.via_m > 0))
    throw std::invalid_argument("the distances and the slew of a plan's clock must be positive, far_m above near_m");
  if (!o.own_via_m.empty() && o.own_via_m.size() != o.via_s.size())
    throw std::invalid_argument("each via point of a plan's clock needs a distance");
  for (const double via_m : o.own_via_m)
    if (!(via_m > 0)) throw std::invalid_argument("the distances of a plan's clock must be positive");
  for (std::size_t i = 0; i < o.via_s.size(); ++i)
    if (!std::isfinite(o.via_s[i]) || (i > 0 && o.via_s[i] < o.via_s[i - 1]))
      throw std::invalid_argument("the times of via points must ascend");
}

PlanClock::PlanClock(std::shared_ptr<const ReferenceCurve> curve, const PlanClockOptions& options)
    : curve_(std::move(curve)), options_(options) {
  check(options_);
}

void PlanClock::reset() {
  time_ = rate_ = turn_ = waited_s_ = 0;
  next_ = 0;
}

void PlanClock::pause(double heading) {
  rate_ = 0;
  turn_ = std::remainder(heading - curve_->at(curve_->start() + time_).yaw, 2 * std::numbers::pi);
}

void PlanClock::enter(double time, double rate, double heading) {
  if (!(time >= 0 && rate >= 0 && rate <= 1 && std::isfinite(heading)))
    throw std::invalid_argument("a plan is entered at a time from 0 on, at a rate from 0 to 1");
  reset();
  time_ = std::min(time, curve_->duration());
  while (next_ < options_.via_s.size() && options_.via_s[next_] <= time_) ++next_;
  pause(heading);
  rate_ = rate;
}

void PlanClock::advance(double dt_s, double error_m) {
  const PlanClockOptions& o = options_;
  double passed_m = kPassed * (next_ < o.own_via_m.size() ? o.own_via_m[next_] : o.via_m);
  double target = std::clamp((o.far_m - error_m) / (o.far_m - o.near_m), 0.0, 1.0);
  double end = curve_->duration();
  if (next_ < o.via_s.size() && error_m > passed_m) {
    end = o.via_s[next_];
    target = std::min(target, std::max(kCreep, (end - time_) / kSlow));
  }
  const double change = o.slew_per_s * dt_s;
  rate_ += std::clamp(target - rate_, -change, change);
  time_ = std::min(time_ + rate_ * dt_s, end);
  while (next_ < o.via_s.size() && time_ >= o.via_s[next_]) {
    waited_s_ += dt_s;
    if (error_m > passed_m && waited_s_ < kWait) {
      rate_ = 0;  // the reference stands still: its velocity would lead the vehicle past the point
      break;
    }
    ++next_, waited_s_ = 0;
    if (next_ < o.own_via_m.size()) passed_m = kPassed * o.own_via_m[next_];
  }
  turn_ -= std::clamp(turn_, -kTurn * dt_s, kTurn * dt_s);
}

ReferencePoint PlanClock::target() const {
  ReferencePoint r = curve_->at(curve_->start() + time_);
  const double s = rate_;
  r.v = s * r.v, r.a = s * s * r.a, r.j = s * s * s * r.j, r.s = s * s * s * s * r.s;
  r.yaw += turn_;
  r.yaw_rate = s * r.yaw_rate - (turn_ == 0 ? 0 : std::copysign(kTurn, turn_));
  r.yaw_acceleration *= s * s;
  return r;
}

}  // namespace alula::flight
