// Rollouts of a shield: the commands of a manoeuvre from a state, and the check that its path is clear.
#include <algorithm>
#include <array>
#include <cmath>

#include "alula/base/constants.hpp"
#include "alula/dynamics/actuators.hpp"
#include "alula/filters/shield.hpp"

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::dot;
using geometry::e3;
using geometry::multiply;
using geometry::norm;

constexpr int kChords = 8;           // chords tried before the path is checked tick by tick
constexpr double kTurnPerTick = 1;   // [rad]; beyond this, the model of an input held for a tick is invalid
constexpr double kAlmost = 4;        // multiple of the rest thresholds of speed, rate and tilt
constexpr double kRoom = 2;          // multiple of the excursion that must be free
constexpr double kMostPassed = 1.5;  // maximum ratio of the flown distance to the excursion
constexpr double kQuarter = 1.5707963267948966;  // quarter of a turn [rad]
constexpr double kMostExcursion = 0.25;          // maximum excursion that is considered [m]

// The matrix k S^T of a level: the true acceleration by that of the model.
Mat3 true_acceleration(const Level& level) {
  const Vec3 x = level.acceleration({1, 0, 0}), y = level.acceleration({0, 1, 0}), z = level.acceleration({0, 0, 1});
  return {{{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}};
}

}  // namespace

// True if the flight from where `settles_clear` may end a path stays well within the distance that it requires. For
// the loop about hover the excursion is a bound; low caps of tilt, thrust or torque, or a slow attitude, may violate
// it. Tested from the corners of the admitted states, scaled to the maximum excursion considered.
bool Shield::keeps_to_excursion() const {
  if (!acts_at_once()) return false;
  const ShieldOptions& o = options_;
  const double speed = kAlmost * o.rest_speed_m_s, tilt = kAlmost * o.rest_tilt_rad / 4,
               rate = kAlmost * o.rest_rate_rad_s;
  const int ticks = static_cast<int>(std::min(o.max_time_s, 5.0) / o.tick_s);
  for (int corner = 0; corner < 96; ++corner) {
    const double turn = corner % 4 * kQuarter, side = corner / 4 % 4 * kQuarter, climb = corner / 16 % 2 ? 0.4 : -0.4;
    const double spin = corner / 32 - 1;  // -1, 0, 1
    State x;
    x.v = speed * Vec3{0.9 * std::cos(turn), 0.9 * std::sin(turn), climb};
    x.sigma = tilt * Vec3{std::cos(side), std::sin(side), 0};
    x.omega = spin * rate * Vec3{std::cos(side), std::sin(side), 0};
    x = std::min(1.0, kMostExcursion / policy_.excursion(x)) * x;
    const double most = kMostPassed * policy_.excursion(x);
    for (int tick = 0; tick < ticks && !resting(x); ++tick) {
      x = after(x, flown(x, {}, 0));
      if (!(norm(x.p) <= most)) return false;
    }
  }
  return true;
}

// True if x is so near to rest, and so far from all obstacles, that it keeps `distance` on its way to rest. Along a
// path, the map is queried only when the excursion has halved since the last query.
bool Shield::settles_clear(const State& x, double distance, double& looked) {
  const ShieldOptions& o = options_;
  const double speed = kAlmost * o.rest_speed_m_s, rate = kAlmost * o.rest_rate_rad_s;
  if (dot(x.v, x.v) > speed * speed || dot(x.omega, x.omega) > rate * rate) return false;
  const Vec3 b = thrust_axis(x.sigma);
  const double tilt = kAlmost * o.rest_tilt_rad;
  if (!(b.z > 0) || b.x * b.x + b.y * b.y > tilt * tilt) return false;
  if (policy_.kind() == BackupKind::hover && !(4 * std::abs(x.sigma.z) <= tilt)) return false;
  const double excursion = policy_.excursion(x);
  if (!(excursion <= looked / 2)) return false;
  looked = excursion;
  const double needed = distance + kRoom * excursion;
  if (!(this->distance(x.p, needed) >= needed)) return false;
  tail_ = std::max(options_.margin_m / 2, kRoom * excursion), ended_early_ = true;
  return true;
}

// Fills the path; false when it does not come to rest in time. With a `distance` it ends also where the remaining
// path is proven to keep that distance.
bool Shield::roll(const State& x, const Manoeuvre& manoeuvre, const Wrench* first, double& time, double distance) {
  const Quadrotor& vehicle = policy_.vehicle();
  const double h = options_.tick_s;
  // Accepted manoeuvres rest a little early, so that small differences of plan and flight do not revoke them.
  const int before = first != nullptr ? 1 : 0, most = static_cast<int>(options_.max_time_s / h),
            ticks = first != nullptr ? most - most / 8 : most;
  path_.clear();
  path_.push_back({x.p, 0, 0});
  State now = x;
  Vec4 rotors = rotors_;
  double speed = norm(now.v), spin = norm(now.omega), looked = 2 * kMostExcursion;
  tail_ = options_.margin_m / 2, ended_early_ = false;
  const bool is_still = level_.is_still();
  const Mat3 turned = true_acceleration(level_);
  const bool may_settle = ends_early_ && distance < kInfinity && !manoeuvre.is_urgent;
  for (int tick = 0; tick < ticks; ++tick) {
    if (tick >= before + manoeuvre.ticks &&
        (resting(now, rotors) || (may_settle && settles_clear(now, distance, looked)))) {
      time = tick * h;
      return true;
    }
    const bool is_first = tick < before;
    const Wrench command = is_first ? *first : flown(now, manoeuvre, tick - before);
    const Wrench u = lags() ? vehicle.wrench(rotors) : command;  // at the start
    State next = acts_at_once() ? after(now, command) : following(now, rotors, command);
    if (!is_still) {  // attitude and rates are the same: nothing depends on the velocity within a tick
      const Vec3 by_speed = h * now.v;
      next.p = now.p + by_speed + turned * (next.p - now.p - by_speed);
      next.v = now.v + turned * (next.v - now.v);
    }
    // |v'| within the tick: its value at the start, and the thrust axis turning by at most |omega| h. With lag,
    // thrust and torques go on a straight line from u to those at the end, so the maximum is at one of the ends. A
    // rate loop can have any torque and thrust of the rotors in between.
    const double next_spin = norm(next.omega);
    if (!(spin * h <= kTurnPerTick)) return false;
    double thrust = std::abs(u.thrust) / vehicle.mass(), growth = 0;
    const Vec3 start = thrust * thrust_axis(now.sigma) - vehicle.gravity() * e3;
    const auto spin_up = [&](Vec3 torque) {
      return norm(divide(torque - cross(now.omega, multiply(vehicle.inertia(), now.omega)), vehicle.inertia()));
    };
    double turning = spin_up(u.torque);
    if (has_rate_loop()) {
      growth = std::max(most_thrust_ - u.thrust, u.thrust - least_thrust_) / vehicle.mass(), thrust += growth;
      const double fastest = std::max(spin, next_spin) + h * spin_up_;
      turning = spin_up_ + swing_ * fastest * fastest;
    } else if (lags()) {
      const Wrench end = vehicle.wrench(rotors);
      growth = std::abs(end.thrust - u.thrust) / vehicle.mass(), thrust += growth;
      turning = std::max(turning, spin_up(end.torque));
    }
    const double rate = std::max(spin, next_spin) + h * turning;
    const double change = level_.scale() * (norm(start) + growth + thrust * rate * h);
    const double next_speed = norm(next.v);
    const double length = h * (speed + next_speed) / 2 + change * h * h / 4;
    path_.push_back({next.p, path_.back().arc + length, change * h * h / 8});
    now = next, speed = next_speed, spin = next_spin;
    if (!std::isfinite(path_.back().arc)) return false;
  }
  time = ticks * h;
  return resting(now, rotors);
}

// True if all obstacles keep `distance` plus the path's deviation from the chord between two ticks to that chord.
// Then `march` finds no violation there either: every point that it tests is no farther from the chord.
bool Shield::is_clear(std::size_t from, std::size_t to, double distance) {
  const Vec3 a = path_[from].p, d = path_[to].p - a;
  const double length2 = dot(d, d), per_length2 = length2 > 0 ? 1 / length2 : 0;
  double off2 = 0, sag = 0;
  for (std::size_t i = from + 1; i <= to; ++i) {
    const Vec3 r = path_[i].p - a;
    const Vec3 off = r - std::clamp(dot(r, d) * per_length2, 0.0, 1.0) * d;
    off2 = std::max(off2, dot(off, off)), sag = std::max(sag, path_[i].sag);
  }
  return map_->is_clear(a, path_[to].p, std::max(distance, 0.0) + std::sqrt(off2) + sag, memory_);
}

// The tick up to which a few long chords prove that the path keeps `distance`.
std::size_t Shield::sweep(double distance) {
  const std::size_t last = path_.size() - 1;
  std::size_t from = 0, to = last;
  for (int looks = 0; looks < kChords && from < last; ++looks) {
    if (is_clear(from, to, distance)) {
      from = to, to = last;
      continue;
    }
    const double middle = (path_[from].arc + path_[to].arc) / 2;
    const std::size_t all = to;
    while (to > from && path_[to].arc > middle) --to;
    if (to <= from || to == all) break;
  }
  return from;
}

// True if the path keeps `distance` from all obstacles from a tick on. `least` becomes the minimum distance found,
// and `contact_speed` a bound on the speed in the first tick that is nearer.
bool Shield::march(std::size_t from, double distance, bool thorough, double& least, double& contact_speed) {
  const std::size_t last = path_.size() - 1;
  const double end = path_[last].arc;
  bool clear = true;
  std::size_t k = from;
  least = kInfinity;
  const auto touch = [&](std::size_t tick) {
    if (clear && last > 0) {
      tick = std::min(tick, last - 1);
      contact_speed = (path_[tick + 1].arc - path_[tick].arc) / options_.tick_s;
    }
    clear = false;
  };
  while (true) {
    const double enough = distance + (end - path_[k].arc);
    const double here = this->distance(path_[k].p, enough);
    least = std::min(least, here);
    if (!(here >= distance)) touch(k);
    if (!clear && !thorough) return false;
    if (k == last || here >= enough) return clear;
    const double reach = path_[k].arc + std::max(here - distance, thorough && !clear ? 0.02 : 0.0);
    std::size_t j = k;
    while (j < last && path_[j + 1].arc <= reach) ++j;
    if (j == k) {  // the next tick is outside the cleared ball: test the chord between them
      ++j;
      const Tick& next = path_[j];
      const double needed = distance + next.sag;
      const double of_chord = map_->segment_distance(path_[k].p, next.p, needed, memory_);
      if (of_chord < needed) {
        touch(k), least = std::min(least, of_chord - next.sag);
        if (!thorough) return false;
      }
    }
    k = j;
  }
}

Certificate Shield::certify(const State& x, const Manoeuvre& manoeuvre, double margin_m, const Wrench* first,
                            bool thorough) {
  Certificate result;
  if (!is_finite(x)) return result;
  result.rests = roll(x, manoeuvre, first, result.time_s);
  result.clears_tubes = result.rests && clears_tubes();
  if (!std::isfinite(path_.back().arc) || (!result.rests && !thorough)) return result;
  double least = 0;
  const bool clear = march(0, radius_ + margin_m, thorough, least, result.contact_speed);
  result.clearance = least - radius_;
  result.safe = clear && result.rests;
  return result;
}

// True if the path of the last rollout, and the rest at its end, keep the radius from all tubes up to their horizon.
bool Shield::clears_tubes() const {
  if (tubes_.empty()) return true;
  const double h = options_.tick_s;
  const std::size_t last = path_.size() - 1;
  const auto ticks = static_cast<std::size_t>(std::ceil(tubes_.horizon() / h * (1 - 1e-9)));
  const std::size_t flown = std::min(last, ticks);
  if (!std::isfinite(path_[flown].arc)) return false;
  const double reach = radius_ + path_[flown].arc + tail_;
  return tubes_.all_near(path_.front().p, reach, [&](const Tube& tube) {
    for (std::size_t k = 0; k < ticks; ++k) {
      const double from = static_cast<double>(k) * h;
      const Vec3 a = path_[std::min(k, last)].p, b = path_[std::min(k + 1, last)].p;
      if (!tubes_.is_clear_of(tube, a, b, from, from + h, radius_, k < last ? path_[k + 1].sag : tail_)) return false;
    }
    return true;
  });
}

// The same for the manoeuvre of the last rollout. One that ended early is rolled out to rest if that may matter.
bool Shield::clears_tubes(const State& x, const Manoeuvre& manoeuvre, const Wrench* first) {
  double unused = 0;
  return clears_tubes() || (ended_early_ && roll(x, manoeuvre, first, unused) && clears_tubes());
}

// `certify` for its verdict alone; the rollout ends early when the remaining path is clear.
bool Shield::is_safe(const State& x, const Manoeuvre& manoeuvre, double margin_m, const Wrench* first,
                     bool until_rest) {
  double unused = 0;
  const double distance = radius_ + margin_m;
  if (!is_finite(x) || !roll(x, manoeuvre, first, unused, until_rest ? kInfinity : distance)) return false;
  const std::size_t swept = sweep(distance);
  return (swept > 0 && swept + 1 == path_.size()) || march(swept, distance, false, unused, unused);
}

}  // namespace alula::flight
