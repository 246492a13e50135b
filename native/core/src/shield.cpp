#include "alula/shield.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::dot;
using geometry::e3;
using geometry::multiply;
using geometry::norm;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kStep = 0.01;      // of RK4 at most [s],
constexpr double kTurn = 0.1;       // and [rad]
constexpr int kSweeps = 8;          // chords tried before the path is looked at tick by tick
constexpr double kTurnPerTick = 1;  // more than that and holding an input for a tick means nothing

}  // namespace

Shield::Shield(const BackupPolicy& policy, std::shared_ptr<const EllipsoidIndex> index, const ShieldOptions& options)
    : policy_(policy), index_(std::move(index)), options_(options), rest_drift_(options.rest_drift_m) {
  const ShieldOptions& o = options_;
  const auto require = [](bool holds, const char* what) {
    if (!holds) throw std::invalid_argument(what);
  };
  require(index_ != nullptr, "a shield needs a map");
  require(o.tick_s > 0 && o.tick_s <= 1 && o.max_time_s >= o.tick_s && o.max_time_s / o.tick_s <= 1e5,
          "the tick of a shield must be positive, and at most 100 000 of them make its longest time");
  require(
      policy.settles(o.tick_s),
      "the gains of the backup policy are too high for this vehicle at this tick: held for one, they do not settle");
  require(o.substeps >= 1 && o.line_search >= 0 && o.escape_tries >= 0, "counts of a shield must not be negative");
  require(2 * o.rest_drift_m < o.margin_m && std::isfinite(o.margin_m),
          "the margin of a shield must be more than twice the drift at rest");
  require(o.escape_time_s >= 0 && o.escape_time_s <= o.max_time_s,
          "an escape must fit into the shield's longest time");
  require(o.rest_speed_m_s > 0 && o.rest_rate_rad_s > 0 && o.rest_tilt_rad > 0 && o.rest_drift_m > 0,
          "the tolerances of rest must be positive");
  path_.reserve(static_cast<std::size_t>(o.max_time_s / o.tick_s) + 3);
  found_.reserve(4);
}

int Shield::hold_ticks() const { return static_cast<int>(std::lround(options_.escape_time_s / options_.tick_s)); }

State Shield::after(const State& x, const Wrench& u) const {
  State y = x;
  const double needed = std::max(options_.tick_s / kStep * (1 - 1e-9), norm(x.omega) * options_.tick_s / kTurn);
  const int steps = std::max(options_.substeps, static_cast<int>(std::ceil(std::min(needed, 100.0))));
  const double h = options_.tick_s / steps;
  for (int i = 0; i < steps; ++i) y = policy_.vehicle().step(y, u, h);
  y.sigma = shadowed(y.sigma);
  return y;
}

bool Shield::resting(const State& x) const {
  const ShieldOptions& o = options_;
  if (dot(x.v, x.v) > o.rest_speed_m_s * o.rest_speed_m_s) return false;
  if (dot(x.omega, x.omega) > o.rest_rate_rad_s * o.rest_rate_rad_s) return false;
  const Vec3 b = thrust_axis(x.sigma);
  if (!(b.z > 0) || b.x * b.x + b.y * b.y > o.rest_tilt_rad * o.rest_tilt_rad) return false;
  // With a spring on the heading only the one that it pulls to is a rest.
  if (policy_.kind() == BackupKind::hover && !(4 * std::abs(x.sigma.z) <= o.rest_tilt_rad)) return false;
  return policy_.sways_at_most(x, rest_drift_);
}

// Fills the path; false when it does not come to rest in time.
bool Shield::roll(const State& x, const Manoeuvre& manoeuvre, const Wrench* first, double& time) {
  const Quadrotor& vehicle = policy_.vehicle();
  const double h = options_.tick_s;
  // What is accepted rests a little early, so that small differences of plan and flight do not take it back.
  const int before = first != nullptr ? 1 : 0, most = static_cast<int>(options_.max_time_s / h),
            ticks = first != nullptr ? most - most / 8 : most;
  path_.clear();
  path_.push_back({x.p, 0, 0});
  State now = x;
  double speed = norm(now.v), spin = norm(now.omega);
  for (int tick = 0; tick < ticks; ++tick) {
    if (tick >= before + manoeuvre.ticks && resting(now)) {
      time = tick * h;
      return true;
    }
    const bool is_first = tick < before;
    const Wrench u = is_first ? *first : policy_(now, manoeuvre.at(tick - before));
    const State next = after(now, u);
    // |v'| within the tick: its value at the start, and the thrust axis turning by at most |omega| h.
    const double next_spin = norm(next.omega);
    if (!(spin * h <= kTurnPerTick)) return false;
    const double thrust = std::abs(u.thrust) / vehicle.mass();
    const Vec3 start = thrust * thrust_axis(now.sigma) - vehicle.gravity() * e3;
    const Vec3 spin_up =
        divide(u.torque - cross(now.omega, multiply(vehicle.inertia(), now.omega)), vehicle.inertia());
    const double rate = std::max(spin, next_spin) + h * norm(spin_up);
    const double change = norm(start) + thrust * rate * h;
    const double next_speed = norm(next.v);
    const double length = h * (speed + next_speed) / 2 + change * h * h / 4;
    path_.push_back({next.p, path_.back().arc + length, change * h * h / 8});
    now = next, speed = next_speed, spin = next_spin;
    if (!std::isfinite(path_.back().arc)) return false;
  }
  time = ticks * h;
  return resting(now);
}

// Whether all ellipsoids keep `distance` from the chord of the path between two ticks by as much more as the path
// leaves that chord. Then `march` finds nothing there either: what it looks at is no farther from the chord.
bool Shield::is_clear(std::size_t from, std::size_t to, double distance) const {
  const Vec3 a = path_[from].p, d = path_[to].p - a;
  const double length2 = dot(d, d), per_length2 = length2 > 0 ? 1 / length2 : 0;
  double off2 = 0, sag = 0;
  for (std::size_t i = from + 1; i <= to; ++i) {
    const Vec3 r = path_[i].p - a;
    const Vec3 off = r - std::clamp(dot(r, d) * per_length2, 0.0, 1.0) * d;
    off2 = std::max(off2, dot(off, off)), sag = std::max(sag, path_[i].sag);
  }
  return !index_->is_near(a, path_[to].p, (1 + 1e-8) * (std::max(distance, 0.0) + std::sqrt(off2) + sag) + 1e-9);
}

// The tick up to which a few long chords show that the path keeps `distance`.
std::size_t Shield::sweep(double distance) const {
  const std::size_t last = path_.size() - 1;
  std::size_t from = 0, to = last;
  for (int looks = 0; looks < kSweeps && from < last; ++looks) {
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

// Whether the path keeps `distance` from all ellipsoids from a tick on. `least` becomes the least distance that was
// seen.
bool Shield::march(std::size_t from, double distance, bool thorough, double& least) {
  const std::size_t last = path_.size() - 1;
  const double end = path_[last].arc;
  bool clear = true;
  std::size_t k = from;
  least = kInfinity;
  while (true) {
    const double enough = distance + (end - path_[k].arc);
    const double here = index_->clearance(path_[k].p, enough, hint_);
    least = std::min(least, here);
    clear = clear && here >= distance;
    if (!clear && !thorough) return false;
    if (k == last || here >= enough) return clear;
    const double reach = path_[k].arc + std::max(here - distance, thorough && !clear ? 0.02 : 0.0);
    std::size_t j = k;
    while (j < last && path_[j + 1].arc <= reach) ++j;
    if (j == k) {  // the next tick is beyond what this one clears: look at the chord between them
      ++j;
      const Tick& next = path_[j];
      const double needed = distance + next.sag;  // of the chord; what is that near is so near to its start, or less
      const double reach_of_start = needed + norm(next.p - path_[k].p);
      index_->nearest(path_[k].p, next.p, reach_of_start, 1, found_);
      if (!found_.empty() && found_[0].distance < needed) {
        clear = false, least = std::min(least, found_[0].distance - next.sag);
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
  if (!std::isfinite(path_.back().arc) || (!result.rests && !thorough)) return result;
  double least = 0;
  const bool clear = march(0, index_->radius() + margin_m, thorough, least);
  result.clearance = least - index_->radius();
  result.safe = clear && result.rests;
  return result;
}

// `certify` for its verdict alone.
bool Shield::is_safe(const State& x, const Manoeuvre& manoeuvre, double margin_m, const Wrench* first) {
  double unused = 0;
  if (!is_finite(x) || !roll(x, manoeuvre, first, unused)) return false;
  const double distance = index_->radius() + margin_m;
  const std::size_t swept = sweep(distance);
  return swept + 1 == path_.size() || march(swept, distance, false, unused);
}

void Shield::find_escapes(const State& x, std::span<const Found> near) {
  if (has_escapes_) return;
  has_escapes_ = true;
  escapes_ = escape_velocities(*index_, near, x.p, x.v);
  escapes_.count = std::min(escapes_.count, static_cast<std::size_t>(options_.escape_tries));
}

// Whether a manoeuvre is safe after a tick of u. A rest may have drifted into the margin, where no path that begins
// there keeps it: then one that stays about as far away as now, and drifts hardly at all when it rests, will do.
bool Shield::is_safe_after(const State& x, const Wrench& u, const Manoeuvre& manoeuvre) {
  const double kept = options_.margin_m / 2, least = options_.rest_drift_m / 40, radius = index_->radius();
  const double here = is_finite(x) ? index_->clearance(x.p, radius + options_.margin_m, hint_) - radius : kInfinity;
  if (here >= options_.margin_m) return is_safe(x, manoeuvre, options_.margin_m, &u);
  rest_drift_ = least;
  const bool safe = is_safe(x, manoeuvre, std::max(kept, here - 4 * least) + 2 * least, &u);
  rest_drift_ = options_.rest_drift_m;
  return safe;
}

// Whether resting, or else the committed manoeuvre, is safe after a tick of u; it becomes `next_`.
bool Shield::accept(const State& x, const Wrench& u) {
  next_ = {};
  if (is_safe_after(x, u, next_)) return true;
  if (!policy_.escapes() || committed_.ticks == 0) return false;
  next_ = committed_;
  return is_safe_after(x, u, next_);
}

// The same, or else a new escape.
bool Shield::accept_escaping(const State& x, const Wrench& u, std::span<const Found> near) {
  if (accept(x, u)) return true;
  if (!policy_.escapes()) return false;
  find_escapes(x, near);
  for (std::size_t i = 0; i < escapes_.count; ++i) {
    next_ = {escapes_.velocity[i], hold_ticks()};
    if (is_safe_after(x, u, next_)) return true;
  }
  return false;
}

// The manoeuvre to fly from x; true when it is safe.
bool Shield::choose(const State& x, std::span<const Found> near) {
  const double kept = options_.margin_m / 2;
  if (policy_.escapes()) {
    if (committed_.ticks > 0 && is_safe(x, committed_, kept)) return chosen_ = committed_, true;
    find_escapes(x, near);
    for (std::size_t i = 0; i < escapes_.count; ++i) {
      const Manoeuvre escape{escapes_.velocity[i], hold_ticks()};
      if (is_safe(x, escape, options_.margin_m)) return chosen_ = escape, true;
    }
  }
  if (is_safe(x, {}, kept)) return chosen_ = {}, true;
  double best = -kInfinity;
  chosen_ = {};
  const auto try_one = [&](const Manoeuvre& manoeuvre) {
    const double clearance = certify(x, manoeuvre, 0, nullptr, true).clearance;
    if (clearance > best) best = clearance, chosen_ = manoeuvre;
  };
  try_one({});
  if (policy_.escapes()) {
    if (committed_.ticks > 0) try_one(committed_);
    for (std::size_t i = 0; i < escapes_.count; ++i) try_one({escapes_.velocity[i], hold_ticks()});
  }
  return false;
}

Manoeuvre Shield::plan(const State& x, std::span<const Found> near) {
  has_escapes_ = false;
  is_chosen_safe_ = choose(x, near);
  is_planned_ = true;
  return chosen_;
}

// Sets the report to the manoeuvre to fly from x.
void Shield::settle(const State& x, std::span<const Found> near, FilterReport& report) {
  report.certified = is_planned_ ? is_chosen_safe_ : choose(x, near);
  report.status = report.certified ? SplatFilterStatus::backup : SplatFilterStatus::recovering;
  report.wrench = policy_(x, chosen_.at(0));
}

void Shield::fall_back(const State& x, std::span<const Found> near, FilterReport& report) {
  has_escapes_ = has_escapes_ && is_planned_;
  settle(x, near, report);
  committed_ = {chosen_.hold, std::max(0, chosen_.ticks - 1)};
  is_planned_ = false;
}

bool Shield::decide(const State& x, const Wrench& candidate, SplatFilterStatus accepted, std::span<const Found> near,
                    FilterReport& report) {
  has_escapes_ = has_escapes_ && is_planned_;
  if (accept_escaping(x, candidate, near)) {
    report.wrench = candidate, report.status = accepted, report.certified = true;
    committed_ = next_;
    is_planned_ = false;
    return true;
  }
  settle(x, near, report);
  is_planned_ = false;
  const Wrench base = report.wrench;
  Manoeuvre next{chosen_.hold, std::max(0, chosen_.ticks - 1)};
  if (report.certified) {
    double inside = 0, outside = 1;
    for (int i = 0; i < options_.line_search; ++i) {
      const double share = (inside + outside) / 2;
      const Wrench u{base.thrust + share * (candidate.thrust - base.thrust),
                     base.torque + share * (candidate.torque - base.torque)};
      if (accept(x, u)) {
        report.wrench = u, next = next_, inside = share;
      } else {
        outside = share;
      }
    }
  }
  committed_ = next;
  return false;
}

}  // namespace alula::flight
