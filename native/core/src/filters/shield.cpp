#include "alula/filters/shield.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <tuple>
#include <utility>

#include "alula/base/constants.hpp"
#include "alula/base/require.hpp"
#include "alula/dynamics/actuators.hpp"

namespace alula::flight {
namespace {

using geometry::norm;

constexpr double kSameSpeed = 0.05;  // contact speeds closer than this count as equal [m/s]
constexpr double kNearer = 1e-9;     // smaller decreases in a tick do not count as an approach [m]

// True if a beats b when neither is safe.
bool is_less_bad(const Certificate& a, const Certificate& b) {
  const bool a_clears = a.clearance > 0, b_clears = b.clearance > 0;
  if (a_clears != b_clears) return a_clears;
  if (!a_clears && std::abs(a.contact_speed - b.contact_speed) > kSameSpeed) return a.contact_speed < b.contact_speed;
  return a.clearance > b.clearance;
}

// The remaining manoeuvre after a tick of it.
Manoeuvre rest_of(const Manoeuvre& m) { return {m.hold, std::max(0, m.ticks - 1), m.is_urgent}; }

}  // namespace

Shield::Shield(const BackupPolicy& policy, Surroundings surroundings, const ShieldOptions& options,
               std::shared_ptr<const EllipsoidIndex> cones)
    : policy_(policy),
      map_(std::move(surroundings.map)),
      radius_(surroundings.radius_m),
      cones_(std::move(cones)),
      options_(options),
      rest_drift_(options.rest_drift_m),
      tubes_(options.tube_horizon_s, options.tube_risk, options.tube_acceleration_m_s2) {
  const ShieldOptions& o = options_;
  require(map_ != nullptr, "a shield needs a map");
  require(is_size(radius_), "the radius that a shield keeps must not be negative");
  require(cones_ != nullptr || !policy.escapes(), "the policy cone-escape needs ellipsoids to turn away from");
  require(o.tick_s > 0 && o.tick_s <= 1 && o.max_time_s >= o.tick_s && o.max_time_s / o.tick_s <= 1e5,
          "the tick of a shield must be positive, and at most 100 000 of them make its longest time");
  check(ActuatorModel{o.motor_time_constant_s, 0, o.rate_time_constant_s});
  require(o.max_rate_rad_s.x > 0 && o.max_rate_rad_s.y > 0 && o.max_rate_rad_s.z > 0,
          "the limits of body rates must be positive");
  bound_motion();
  hovering_ = policy.vehicle().rotor_thrust(policy.vehicle().limited({policy.vehicle().hover_thrust(), {}}));
  reset();
  require(
      acts_at_once() ? policy.settles(o.tick_s) : settles(),
      "the gains of the backup policy are too high for this vehicle at this tick: held for one, they do not settle");
  require(o.substeps >= 1 && o.line_search >= 0 && o.escape_tries >= 0, "counts of a shield must not be negative");
  require(2 * o.rest_drift_m < o.margin_m && std::isfinite(o.margin_m),
          "the margin of a shield must be more than twice the drift at rest");
  require(o.escape_time_s >= 0 && o.escape_time_s <= o.max_time_s,
          "an escape must fit into the shield's longest time");
  require(o.rest_speed_m_s > 0 && o.rest_rate_rad_s > 0 && o.rest_tilt_rad > 0 && o.rest_drift_m > 0,
          "the tolerances of rest must be positive");
  ends_early_ = o.early_end && keeps_to_excursion();
  path_.reserve(static_cast<std::size_t>(o.max_time_s / o.tick_s) + 3);
  memory_ = map_->memory();
}

// Sets the limits of thrust and bounds on the angular acceleration for any thrusts of the rotors.
void Shield::bound_motion() {
  const Quadrotor& body = policy_.vehicle();
  const RotorLayout& rotors = body.rotors();
  const Vec3 j = body.inertia();
  const auto range = [&](std::size_t row) {
    double least = 0, most = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      const double at_least = body.allocation()[row][i] * rotors.f_min[i],
                   at_most = body.allocation()[row][i] * rotors.f_max[i];
      least += std::min(at_least, at_most), most += std::max(at_least, at_most);
    }
    return std::pair{least, most};
  };
  std::tie(least_thrust_, most_thrust_) = range(0);
  Vec3 fastest;
  for (int i = 0; i < 3; ++i) {
    const auto [least, most] = range(static_cast<std::size_t>(i) + 1);
    fastest[i] = std::max(-least, most) / j[i];
  }
  spin_up_ = norm(fastest);
  swing_ = norm(Vec3{(j.y - j.z) / j.x, (j.z - j.x) / j.y, (j.x - j.y) / j.z});
}

int Shield::hold_ticks() const { return static_cast<int>(std::lround(options_.escape_time_s / options_.tick_s)); }

void Shield::reset() {
  committed_ = {}, is_committed_ = is_planned_ = false, rotors_ = hovering_, margin_ = options_.margin_m;
  level_ = {}, tubes_.clear();
}

void Shield::find_escapes(const State& x, std::span<const Found> near) {
  if (has_escapes_) return;
  has_escapes_ = true;
  escapes_ = escape_velocities(*cones_, near, x.p, x.v);
  escapes_.count = std::min(escapes_.count, static_cast<std::size_t>(options_.escape_tries));
}

// True if a manoeuvre is safe after a tick of u. At rest the vehicle may have drifted into the margin, where no path
// that begins there keeps it. Then a manoeuvre is accepted that keeps about the present distance and has almost no
// drift at rest.
bool Shield::is_safe_after(const State& x, const Wrench& u, const Manoeuvre& manoeuvre, double kept,
                           bool until_rest) {
  const double least = options_.rest_drift_m / 40;
  const double here = is_finite(x) ? distance(x.p, radius_ + margin_) - radius_ : kInfinity;
  if (here >= margin_) return is_safe(x, manoeuvre, margin_, &u, until_rest);
  rest_drift_ = least;
  const bool safe = is_safe(x, manoeuvre, std::max(kept, here - 4 * least) + 2 * least, &u, until_rest);
  rest_drift_ = options_.rest_drift_m;
  return safe;
}

// True if no tick of u and of the following rest is nearer than now; the tolerance of `is_safe_after` would
// accumulate.
bool Shield::comes_no_nearer(const State& x, const Wrench& u) {
  if (!is_safe_after(x, u, stop(), -margin_, true)) return false;
  const double here = distance(x.p, radius_ + margin_);
  return std::all_of(path_.begin(), path_.end(),
                     [&](const Tick& tick) { return distance(tick.p, here) >= here - kNearer; });
}

// Tries `next` after a tick of u; true if it is safe and clear of the tubes. `best` and `next_` become those of the
// first manoeuvre tried with the best verdict.
bool Shield::takes(const State& x, const Wrench& u, const Manoeuvre& next, double kept, Verdict& best) {
  if (!is_safe_after(x, u, next, kept)) return false;
  const Verdict found = clears_tubes(x, next, &u) ? Verdict::clear : Verdict::safe;
  if (found > best) best = found, next_ = next;
  return found == Verdict::clear;
}

// The verdict on u with the manoeuvre to rest, or else the committed one, after a tick of it: `next_`.
Shield::Verdict Shield::accept(const State& x, const Wrench& u) {
  Verdict best = Verdict::unsafe;
  const double kept = options_.margin_m / 2;
  if (takes(x, u, stop(), kept, best) || !policy_.escapes() || committed_.ticks == 0) return best;
  takes(x, u, committed_, kept, best);
  return best;
}

// The same, then with new escapes.
Shield::Verdict Shield::accept_escaping(const State& x, const Wrench& u, std::span<const Found> near) {
  Verdict best = accept(x, u);
  if (best == Verdict::clear || !policy_.escapes()) return best;
  find_escapes(x, near);
  for (std::size_t i = 0; i < escapes_.count; ++i)
    if (takes(x, u, {escapes_.velocity[i], hold_ticks()}, options_.margin_m / 2, best)) break;
  return best;
}

// Chooses the manoeuvre to fly from x; true when it is safe. Of safe ones that would do, the first that is clear of
// the tubes.
bool Shield::choose(const State& x, std::span<const Found> near) {
  const double kept = options_.margin_m / 2;
  std::optional<Manoeuvre> safe;
  is_chosen_clear_ = false;
  const auto suits = [&](const Manoeuvre& manoeuvre, double margin) {
    if (!is_safe(x, manoeuvre, margin)) return false;
    chosen_ = manoeuvre, is_chosen_clear_ = clears_tubes(x, manoeuvre);
    if (!safe) safe = manoeuvre;
    return is_chosen_clear_;
  };
  if (policy_.escapes()) {
    if (committed_.ticks > 0 && suits(committed_, kept)) return true;
    find_escapes(x, near);
    for (std::size_t i = 0; i < escapes_.count; ++i)
      if (suits({escapes_.velocity[i], hold_ticks()}, options_.margin_m)) return true;
  }
  const Manoeuvre gentle, urgent{.hold = {}, .ticks = 0, .is_urgent = true};
  // Half the margin is only for the committed manoeuvre: a new one that rests so near would drift out of it.
  const Manoeuvre& same = committed_.is_urgent ? urgent : gentle;
  if (is_committed_ && suits(same, kept)) return true;
  for (const double margin : {options_.margin_m, kept}) {
    if (safe && margin < options_.margin_m) break;  // not for the tubes either
    for (const Manoeuvre& manoeuvre : {stop(), acts_at_once() ? urgent : gentle})
      if (suits(manoeuvre, margin)) return true;
  }
  if (safe) return chosen_ = *safe, true;
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
  report.certified_moving = report.certified && is_chosen_clear_;
  report.status = report.certified ? SafetyStatus::backup : SafetyStatus::recovering;
  report.wrench = flown(x, chosen_, 0);
}

void Shield::fall_back(const State& x, std::span<const Found> near, FilterReport& report) {
  has_escapes_ = has_escapes_ && is_planned_;
  settle(x, near, report);
  committed_ = rest_of(chosen_);
  is_committed_ = report.certified, is_planned_ = false;
}

bool Shield::decide(const State& x, const Wrench& candidate, SafetyStatus accepted, std::span<const Found> near,
                    FilterReport& report) {
  has_escapes_ = has_escapes_ && is_planned_;
  const Verdict verdict = accept_escaping(x, candidate, near);
  const Manoeuvre after = next_;
  const auto fly_candidate = [&] {
    report.wrench = candidate, report.status = accepted;
    report.certified = true, report.certified_moving = verdict == Verdict::clear;
    committed_ = after;
    is_committed_ = true, is_planned_ = false;
    return true;
  };
  if (verdict == Verdict::clear) return fly_candidate();
  settle(x, near, report);
  if (verdict == Verdict::safe && !report.certified_moving) return fly_candidate();
  is_committed_ = report.certified, is_planned_ = false;
  // Inside the kept margin no manoeuvre is safe, not even to rest. An input that comes no nearer than now lets the
  // vehicle leave.
  if (!report.certified && comes_no_nearer(x, candidate)) {
    report.wrench = candidate, committed_ = stop();
    return true;
  }
  const Wrench base = report.wrench;
  Manoeuvre next = rest_of(chosen_);
  if (report.certified) {
    double inside = 0, outside = 1;
    for (int i = 0; i < options_.line_search; ++i) {
      const double fraction = (inside + outside) / 2;
      const Wrench u{base.thrust + fraction * (candidate.thrust - base.thrust),
                     base.torque + fraction * (candidate.torque - base.torque)};
      if (accept(x, u) >= (is_chosen_clear_ ? Verdict::clear : Verdict::safe)) {
        report.wrench = u, next = next_, inside = fraction;
      } else {
        outside = fraction;
      }
    }
  }
  committed_ = next;
  return false;
}

}  // namespace alula::flight
