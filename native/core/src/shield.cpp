#include "alula/shield.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "alula/actuators.hpp"

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::divide;
using geometry::dot;
using geometry::e3;
using geometry::multiply;
using geometry::norm;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kStep = 0.01;       // of RK4 at most [s],
constexpr double kTurn = 0.1;        // and [rad]
constexpr int kSweeps = 8;           // chords tried before the path is looked at tick by tick
constexpr double kTurnPerTick = 1;   // more than that and holding an input for a tick means nothing
constexpr double kSameSpeed = 0.05;  // of two contacts [m/s]
constexpr double kNearer = 1e-9;     // in a tick: less is no approach [m]

// Whether a beats b when neither is safe.
bool is_less_bad(const Certificate& a, const Certificate& b) {
  const bool a_clears = a.clearance > 0, b_clears = b.clearance > 0;
  if (a_clears != b_clears) return a_clears;
  if (!a_clears && std::abs(a.contact_speed - b.contact_speed) > kSameSpeed) return a.contact_speed < b.contact_speed;
  return a.clearance > b.clearance;
}

// What is left of a manoeuvre after a tick of it.
Manoeuvre rest_of(const Manoeuvre& m) { return {m.hold, std::max(0, m.ticks - 1), m.is_urgent}; }

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
  check(ActuatorModel{o.motor_time_constant_s, 0});
  hovering_ = policy.vehicle().rotor_thrust(policy.vehicle().limited({policy.vehicle().hover_thrust(), {}}));
  reset();
  require(
      lags() ? settles() : policy.settles(o.tick_s),
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

void Shield::reset() { committed_ = {}, hint_ = 0, is_committed_ = is_planned_ = false, rotors_ = hovering_; }

// A tick of rotors that are led to u.
State Shield::following(const State& x, Vec4& rotors, const Wrench& u) const {
  const double tick = options_.tick_s, lag = options_.motor_time_constant_s;
  const double needed = std::max({tick / kStep * (1 - 1e-9), norm(x.omega) * tick / kTurn, 2 * tick / lag});
  const int steps = std::max(options_.substeps, static_cast<int>(std::ceil(std::min(needed, 100.0))));
  const auto derivative = [&](const State& at, const Wrench& made) { return policy_.vehicle().derivative(at, made); };
  const Wrench command = leading(policy_.vehicle(), lag, rotors, u, tick);
  State y = x;
  for (int i = 0; i < steps; ++i)
    y = following_step(policy_.vehicle(), lag, y, rotors, command, tick / steps, derivative);
  y.sigma = shadowed(y.sigma);
  return y;
}

// Whether hovering is asymptotically stable with lag, but for place and, without a spring, heading: powers of the
// Jacobian of a tick vanish.
bool Shield::settles() const {
  constexpr std::size_t kSize = 13;  // velocity, attitude, rates, rotors
  constexpr double kChange = 1e-5, kVanished = 1e-3;
  using Row = std::array<double, kSize>;
  const double unit = policy_.vehicle().hover_thrust() / 4;  // of rotors
  const auto after_a_tick = [&](std::size_t i, double change) {
    Row row{};
    row[i] = change;
    State x{{}, geometry::from_rows(&row[3]), geometry::from_rows(&row[0]), geometry::from_rows(&row[6])};
    Vec4 rotors = rotors_;
    for (std::size_t r = 0; r < 4; ++r) rotors[r] += row[9 + r] * unit;
    x = following(x, rotors, flown(x, {}, 0));
    if (policy_.kind() != BackupKind::hover) x.sigma.z = 0;
    return Row{x.v.x,           x.v.y,     x.v.z,     x.sigma.x,        x.sigma.y,        x.sigma.z,
               x.omega.x,       x.omega.y, x.omega.z, rotors[0] / unit, rotors[1] / unit, rotors[2] / unit,
               rotors[3] / unit};
  };
  std::array<Row, kSize> power{};
  for (std::size_t i = 0; i < kSize; ++i) {
    const Row above = after_a_tick(i, kChange), below = after_a_tick(i, -kChange);
    for (std::size_t j = 0; j < kSize; ++j) power[j][i] = (above[j] - below[j]) / (2 * kChange);
  }
  double largest = kInfinity;
  for (int doubled = 0; doubled < 14 && largest > kVanished; ++doubled) {
    std::array<Row, kSize> next{};
    largest = 0;
    for (std::size_t i = 0; i < kSize; ++i)
      for (std::size_t j = 0; j < kSize; ++j) {
        for (std::size_t k = 0; k < kSize; ++k) next[i][j] += power[i][k] * power[k][j];
        largest = std::max(largest, std::abs(next[i][j]));
      }
    if (!(largest < 1e100)) return false;
    power = next;
  }
  return largest <= kVanished;
}

// What a manoeuvre flies in a tick.
Wrench Shield::flown(const State& x, const Manoeuvre& manoeuvre, int tick) const {
  return manoeuvre.is_urgent ? policy_.urgent(x, manoeuvre.at(tick)) : policy_(x, manoeuvre.at(tick));
}

State Shield::after(const State& x, const Wrench& u) const {
  if (lags()) {
    Vec4 rotors = rotors_;
    return following(x, rotors, u);
  }
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

// The same with rotors on their way. Left alone they would still give the momentum that is added here, led ones a
// part of it; a linear loop ends where one without lag does from the state with that part, which lies between the
// two.
bool Shield::resting(const State& x, const Vec4& rotors) const {
  if (!resting(x)) return false;
  if (!lags()) return true;
  const Wrench u = policy_.vehicle().wrench(rotors);
  State y = x;
  y.v.z += options_.motor_time_constant_s * (u.thrust / policy_.vehicle().mass() - policy_.vehicle().gravity());
  y.omega += options_.motor_time_constant_s * divide(u.torque, policy_.vehicle().inertia());
  return resting(y);
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
  Vec4 rotors = rotors_;
  double speed = norm(now.v), spin = norm(now.omega);
  for (int tick = 0; tick < ticks; ++tick) {
    if (tick >= before + manoeuvre.ticks && resting(now, rotors)) {
      time = tick * h;
      return true;
    }
    const bool is_first = tick < before;
    const Wrench command = is_first ? *first : flown(now, manoeuvre, tick - before);
    const Wrench u = lags() ? vehicle.wrench(rotors) : command;  // at the start
    const State next = lags() ? following(now, rotors, command) : after(now, command);
    // |v'| within the tick: its value at the start, and the thrust axis turning by at most |omega| h. With lag thrust
    // and torques go on a straight line from u to those at the end, so one of the ends has the most.
    const double next_spin = norm(next.omega);
    if (!(spin * h <= kTurnPerTick)) return false;
    double thrust = std::abs(u.thrust) / vehicle.mass(), growth = 0;
    const Vec3 start = thrust * thrust_axis(now.sigma) - vehicle.gravity() * e3;
    const auto spin_up = [&](Vec3 torque) {
      return norm(divide(torque - cross(now.omega, multiply(vehicle.inertia(), now.omega)), vehicle.inertia()));
    };
    double turning = spin_up(u.torque);
    if (lags()) {
      const Wrench end = vehicle.wrench(rotors);
      growth = std::abs(end.thrust - u.thrust) / vehicle.mass(), thrust += growth;
      turning = std::max(turning, spin_up(end.torque));
    }
    const double rate = std::max(spin, next_spin) + h * turning;
    const double change = norm(start) + growth + thrust * rate * h;
    const double next_speed = norm(next.v);
    const double length = h * (speed + next_speed) / 2 + change * h * h / 4;
    path_.push_back({next.p, path_.back().arc + length, change * h * h / 8});
    now = next, speed = next_speed, spin = next_spin;
    if (!std::isfinite(path_.back().arc)) return false;
  }
  time = ticks * h;
  return resting(now, rotors);
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
// seen, and `contact_speed` a bound of the speed in the tick where it first is nearer.
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
    const double here = index_->clearance(path_[k].p, enough, hint_);
    least = std::min(least, here);
    if (!(here >= distance)) touch(k);
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
        touch(k), least = std::min(least, found_[0].distance - next.sag);
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
  const bool clear = march(0, index_->radius() + margin_m, thorough, least, result.contact_speed);
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
  return (swept > 0 && swept + 1 == path_.size()) || march(swept, distance, false, unused, unused);
}

void Shield::find_escapes(const State& x, std::span<const Found> near) {
  if (has_escapes_) return;
  has_escapes_ = true;
  escapes_ = escape_velocities(*index_, near, x.p, x.v);
  escapes_.count = std::min(escapes_.count, static_cast<std::size_t>(options_.escape_tries));
}

// Whether a manoeuvre is safe after a tick of u. A rest may have drifted into the margin, where no path that begins
// there keeps it: then one that stays about as far away as now, and drifts hardly at all when it rests, will do.
bool Shield::is_safe_after(const State& x, const Wrench& u, const Manoeuvre& manoeuvre, double kept) {
  const double least = options_.rest_drift_m / 40, radius = index_->radius();
  const double here = is_finite(x) ? index_->clearance(x.p, radius + options_.margin_m, hint_) - radius : kInfinity;
  if (here >= options_.margin_m) return is_safe(x, manoeuvre, options_.margin_m, &u);
  rest_drift_ = least;
  const bool safe = is_safe(x, manoeuvre, std::max(kept, here - 4 * least) + 2 * least, &u);
  rest_drift_ = options_.rest_drift_m;
  return safe;
}

// Whether no tick of u and of resting after it is nearer than now: what `is_safe_after` lets slip would add up.
bool Shield::comes_no_nearer(const State& x, const Wrench& u) {
  if (!is_safe_after(x, u, stop(), -options_.margin_m)) return false;
  const double here = index_->clearance(x.p, index_->radius() + options_.margin_m, hint_);
  return std::all_of(path_.begin(), path_.end(),
                     [&](const Tick& tick) { return index_->clearance(tick.p, here, hint_) >= here - kNearer; });
}

// Whether resting, or else the committed manoeuvre, is safe after a tick of u; it becomes `next_`.
bool Shield::accept(const State& x, const Wrench& u) {
  const double kept = options_.margin_m / 2;
  next_ = stop();
  if (is_safe_after(x, u, next_, kept)) return true;
  if (!policy_.escapes() || committed_.ticks == 0) return false;
  next_ = committed_;
  return is_safe_after(x, u, next_, kept);
}

// The same, or else a new escape.
bool Shield::accept_escaping(const State& x, const Wrench& u, std::span<const Found> near) {
  if (accept(x, u)) return true;
  if (!policy_.escapes()) return false;
  find_escapes(x, near);
  for (std::size_t i = 0; i < escapes_.count; ++i) {
    next_ = {escapes_.velocity[i], hold_ticks()};
    if (is_safe_after(x, u, next_, options_.margin_m / 2)) return true;
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
  const Manoeuvre gentle, urgent{.hold = {}, .ticks = 0, .is_urgent = true};
  // Half the margin is for what is flown already: another that rests so near would drift out of it.
  const Manoeuvre& same = committed_.is_urgent ? urgent : gentle;
  if (is_committed_ && is_safe(x, same, kept)) return chosen_ = same, true;
  for (const double margin : {options_.margin_m, kept})
    for (const Manoeuvre& manoeuvre : {stop(), lags() ? gentle : urgent})
      if (is_safe(x, manoeuvre, margin)) return chosen_ = manoeuvre, true;
  chosen_ = urgent;
  Certificate best = certify(x, chosen_, 0, nullptr, true);
  const auto try_one = [&](const Manoeuvre& manoeuvre) {
    const Certificate found = certify(x, manoeuvre, 0, nullptr, true);
    if (is_less_bad(found, best)) best = found, chosen_ = manoeuvre;
  };
  try_one(gentle);
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
  report.wrench = flown(x, chosen_, 0);
}

void Shield::fall_back(const State& x, std::span<const Found> near, FilterReport& report) {
  has_escapes_ = has_escapes_ && is_planned_;
  settle(x, near, report);
  committed_ = rest_of(chosen_);
  is_committed_ = report.certified, is_planned_ = false;
}

bool Shield::decide(const State& x, const Wrench& candidate, SplatFilterStatus accepted, std::span<const Found> near,
                    FilterReport& report) {
  has_escapes_ = has_escapes_ && is_planned_;
  if (accept_escaping(x, candidate, near)) {
    report.wrench = candidate, report.status = accepted, report.certified = true;
    committed_ = next_;
    is_committed_ = true, is_planned_ = false;
    return true;
  }
  settle(x, near, report);
  is_committed_ = report.certified, is_planned_ = false;
  // Inside the margin that is kept nothing is safe, resting neither; what comes no nearer than now lets it leave.
  if (!report.certified && comes_no_nearer(x, candidate)) {
    report.wrench = candidate, committed_ = stop();
    return true;
  }
  const Wrench base = report.wrench;
  Manoeuvre next = rest_of(chosen_);
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
