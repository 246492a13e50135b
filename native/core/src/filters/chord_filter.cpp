#include "alula/filters/chord_filter.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

using geometry::by_axis;
using geometry::dot;
using geometry::norm;

constexpr double kSpeedTolerance = 1.01;  // times the speed limit, for filters in single precision
constexpr double kPoints = 12;            // the minimum step along the chord is its length divided by this
constexpr double kLeastStep = 0.02, kMostStep = 0.2;  // limits of that step: a thin hull must not fit between points
constexpr int kSweeps = 3;                            // passes over the points until none changes the velocity
constexpr double kFractions[] = {1, 0.5};             // of the velocity, if the points do not agree; after them 0
constexpr double kTolerance = 1e-3;                   // times the speed limit: a smaller change is rounding
constexpr int kHalvings = 4;                          // of the bisection for where the chord enters a hull
constexpr double kReturnGain = 2;                     // times 1 / lag: gain that drives q out of a hull
constexpr Vec3 kWhole{1, 1, 1};
constexpr double kLongest = 1e3;  // of a lag [s]

bool is_inside(const FilterReport& report) { return report.status == SafetyStatus::recovering; }

FilterReport with(FilterReport report, Vec3 u, SafetyStatus status) {
  report.velocity = u;
  report.status = status;
  return report;
}

}  // namespace

ChordFilter::ChordFilter(const SafetyFilter& filter, geometry::PerAxis lag_s, double max_speed)
    : filter_(filter.clone()), lag_(lag_s), max_speed_(max_speed) {
  if (filter.kind() != CommandKind::velocity)
    throw std::invalid_argument("the chord of a vehicle is for a filter of velocities");
  for (int i = 0; i < 3; ++i)
    if (!(lag_s[i] >= 0 && lag_s[i] <= kLongest && max_speed > 0))
      throw std::invalid_argument("the lag of a vehicle must be from 0 to 1000 s, and its speed limit positive");
  if (lag_s.most() > 0 && !(lag_s.least() > 0))
    throw std::invalid_argument("either all axes of a vehicle lag or none does");
  points_.reserve(static_cast<std::size_t>(2 * kPoints + std::min(1e3, lag_.most() * max_speed_ / kMostStep)));
}

// The filter at a point, validated; for the velocity M u, and its answer divided by M.
FilterReport ChordFilter::evaluate(Vec3 x, Vec3 share, Vec3 u) {
  const bool is_whole = lag_.is_even();
  at_.x.p = x, wanted_.velocity = is_whole ? u : by_axis(share, u);
  FilterReport report = filter_->filter(at_, wanted_);
  if (!geometry::is_finite(report.velocity))
    throw std::invalid_argument("the filter returned a velocity that is not finite");
  if (norm(report.velocity) > kSpeedTolerance * max_speed_)
    throw std::invalid_argument("the filter returned a velocity above the speed limit");
  if (std::isnan(report.margin) && report.status != SafetyStatus::refused)  // the margin determines the next point
    throw std::invalid_argument("the filter returned a margin that is not a number");
  if (is_whole || report.status == SafetyStatus::refused) return report;
  if (report.status == SafetyStatus::ok) {
    report.velocity = u;
    return report;
  }
  for (int i = 0; i < 3; ++i) report.velocity[i] /= share[i];
  const double speed = norm(report.velocity);
  if (speed > max_speed_) report.velocity = max_speed_ / speed * report.velocity;
  return report;
}

// The point of the chord at a fraction of it; with lags that differ, of the curve, at the time at which the axis with
// the longest lag has covered that fraction.
ChordFilter::Evaluated ChordFilter::point_at(double theta, Vec3 p, Vec3 chord, Vec3 u) {
  Vec3 x = p + theta * chord, share = kWhole;
  if (!lag_.is_even()) {
    const double most = lag_.most(), least = lag_.least();
    for (int i = 0; i < 3; ++i) {  // 1 - E_i, and at theta = 0 its derivative
      share[i] = theta > 0 ? 1 - std::pow(1 - theta, most / lag_[i]) : most / lag_[i];
      x[i] = p[i] + (theta > 0 ? share[i] : 0) * chord[i];
    }
    const double whole = theta > 0 ? 1 - std::pow(1 - theta, most / least) : most / least;
    share = 1 / whole * share;
  }
  return {x, share, evaluate(x, share, u)};
}

// Points of the chord from p to q, or to the first inside a hull after a clear one.
void ChordFilter::go_along(Vec3 p, Vec3 chord, Vec3 u) {
  points_.clear();
  // With lags that differ, a bound of the curve's speed by theta: |d c_i / d theta| <= most |v_i|.
  const double length = lag_.is_even() ? norm(chord) : lag_.most() * norm(at_.x.v);
  if (!(length > kLeastStep)) {
    points_.push_back({p + chord, kWhole, evaluate(p + chord, kWhole, u)});
    return;
  }
  const double least = std::max(std::min(length / kPoints, kMostStep), kLeastStep);
  bool was_clear = false;
  for (double theta = 0;;) {
    points_.push_back(point_at(theta, p, chord, u));
    const FilterReport& report = points_.back().report;
    const bool inside = is_inside(report);
    if (theta >= 1 || (inside && was_clear) || report.status == SafetyStatus::refused) return;
    was_clear = was_clear || !inside;
    theta = std::min(1.0, theta + std::max(0.5 * report.margin, least) / length);
  }
}

// What moves q beside u counts as part of u, as far as the speed limit of the filter leaves room for it.
FilterReport ChordFilter::filter(const FlightState& state, const Nominal& nominal) {
  at_ = state, wanted_ = nominal;
  const Vec3 u = nominal.velocity, moved = by_axis(lag_, state.disturbance);
  at_.more_margin_m = added_margin(state, lag_.most());
  const double size = norm(moved);
  if (!(size > 0)) return filter_moved(u);
  const double along = dot(u, moved) / size, spare = max_speed_ * max_speed_ - dot(u, u) + along * along;
  const double part = std::clamp((std::sqrt(std::max(0.0, spare)) - along) / size, 0.0, 1.0);
  FilterReport report = filter_moved(u + part * moved);
  if (report.status == SafetyStatus::refused) return report;
  report.velocity = report.status == SafetyStatus::ok ? u : report.velocity - part * moved;
  return report;
}

// Where the chord enters the margin of a hull, q is driven out on the side of p. The filter at q would not do so: q
// may be nearer to the far side of a thin wall. Where only points near p are in a margin and the margin increases
// towards q, they are left out, because no u moves p out faster.
FilterReport ChordFilter::filter_moved(Vec3 u) {
  const bool lags = lag_.most() > 0;
  const Vec3 p = at_.x.p, chord = by_axis(lag_, at_.x.v);
  if (lags && !(geometry::is_finite(chord) && geometry::is_finite(p))) return {};
  go_along(p, lags ? chord : Vec3{}, u);
  if (points_.back().report.status == SafetyStatus::refused) return points_.back().report;
  const auto is_blocked = [](const Evaluated& point) { return is_inside(point.report); };
  const auto first_clear = std::find_if_not(points_.begin(), points_.end(), is_blocked);
  const auto considered = first_clear == points_.end() ? first_clear : first_clear + 1;
  const bool moves_out = std::is_sorted(points_.begin(), considered, [](const Evaluated& a, const Evaluated& b) {
    return a.report.margin < b.report.margin;
  });
  if (moves_out) {
    if (first_clear == points_.end()) return points_.back().report;
    points_.erase(points_.begin(), first_clear);
  }
  const auto blocked = std::find_if(points_.begin(), points_.end(), is_blocked);
  if (blocked != points_.end()) {
    const Vec3 clear = blocked == points_.begin() ? blocked->x : (blocked - 1)->x;
    return driven_out(clear, *blocked, p, chord, u);
  }
  const auto nearer = [](const Evaluated& a, const Evaluated& b) { return a.report.margin < b.report.margin; };
  const FilterReport worst = std::min_element(points_.begin(), points_.end(), nearer)->report;
  const bool all_pass = std::all_of(points_.begin(), points_.end(),
                                    [](const Evaluated& point) { return point.report.status == SafetyStatus::ok; });
  return points_.size() == 1 || all_pass ? worst : agreed(worst, u);
}

// A velocity that the filter leaves unchanged at each point; the point nearest to a hull is last. If the points do
// not agree after some passes, it is shortened: with u = 0 the chord shrinks towards p and remains within the former
// one.
FilterReport ChordFilter::agreed(const FilterReport& worst, Vec3 u) {
  for (std::size_t i = 1; i < points_.size(); ++i)  // stable, without memory: farthest first
    for (std::size_t k = i; k > 0 && points_[k].report.margin > points_[k - 1].report.margin; --k)
      std::swap(points_[k], points_[k - 1]);
  SafetyStatus status = SafetyStatus::ok;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    bool is_settled = true;
    for (const Evaluated& point : points_) {
      const FilterReport report = evaluate(point.x, point.share, u);
      if (report.status == SafetyStatus::refused) return report;
      if (report.status == SafetyStatus::ok) continue;
      is_settled = false;
      u = report.velocity;
      status = std::max(status, report.status);
    }
    if (is_settled) return with(worst, u, status);
  }
  for (const double fraction : kFractions) {
    double change = 0;
    for (const Evaluated& point : points_) {
      const FilterReport report = evaluate(point.x, point.share, fraction * u);
      if (report.status == SafetyStatus::refused) return report;
      for (int i = 0; i < 3; ++i) change = std::max(change, std::abs(report.velocity[i] - fraction * u[i]));
    }
    if (change <= kTolerance * max_speed_) return with(worst, fraction * u, status);
  }
  return with(worst, {}, status);
}

// A velocity out of the hull that the chord enters after `clear`, along the normal there. The speed is that of the
// filter, or kReturnGain / lag times the depth of q behind the point of entry if that is more.
FilterReport ChordFilter::driven_out(Vec3 clear, Evaluated blocked, Vec3 p, Vec3 chord, Vec3 u) {
  for (int i = 0; i < kHalvings; ++i) {
    const Vec3 middle = 0.5 * (clear + blocked.x);
    const FilterReport found = evaluate(middle, kWhole, u);
    if (found.status == SafetyStatus::refused) return found;
    if (is_inside(found))
      blocked = {middle, kWhole, found};
    else
      clear = middle;
  }
  const Vec3 back = -1 / norm(chord) * chord;
  const double speed = norm(blocked.report.velocity);
  Vec3 normal = speed > 0 ? 1 / speed * blocked.report.velocity : back;
  if (dot(normal, back) < 0) normal = back;
  const double depth = dot(normal, blocked.x - p - chord);
  const double size = std::min(std::max(speed, kReturnGain / lag_.most() * depth), max_speed_);
  return with(blocked.report, size * normal, SafetyStatus::recovering);
}

}  // namespace alula::flight
