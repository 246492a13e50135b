// Safety shield: accepts only inputs after which a safe manoeuvre to rest has been found.
//
// A manoeuvre is the backup policy sampled and held tick by tick, as in flight: about a velocity for some ticks, then
// to rest. It is safe when, until it rests, the ball of the vehicle's radius and a margin about the position meets no
// obstacle of the map (all of them, not only the nearest; not grown). Nothing but the distance of the map and swept
// clearance is used, so any static map will do. Its signed distance is 1-Lipschitz, so a distance at one tick clears
// all ticks within that arc length; arc lengths and the sag of the path between ticks are bounded, not sampled. The
// rollout ends early where the vehicle has almost stopped and a ball of twice its excursion is free. Long stretches
// are first tested with chords: the distance of a point to a chord is convex, so no part of the path leaves a chord
// by more than its ticks and their sag do. An input is returned when the state after one tick of it has a safe
// manoeuvre. Then the next tick has at least that manoeuvre. By induction, a flight that starts with one never comes
// closer than the radius in the model, for any nominal input. What is certified in every tick is the radius and half
// the margin, until the manoeuvre rests: a new manoeuvre keeps the whole margin, but one being flown stays accepted
// down to half of it, which covers rounding and small differences between plan and flight. The other half covers the
// drift at rest. Two steps of this are tested and not proven. From a state that counts as rest, only the linear loop
// about hover is known to drift by at most rest_drift_m, less than half the margin. And where a rollout ends early,
// only the linear loop is known to stay within the ball; `keeps_to_excursion` flies the nonlinear one from 96 corners
// of the admitted states. Without `early_end` every manoeuvre is rolled out to rest, and the second step does not
// occur.
//
// With a motor time constant the rotors' thrusts are part of the state: `see` sets their present values, and rollouts
// propagate them. An input is then the wrench that the rotors reach by the end of a tick (`leading`), as far as their
// limits allow; the caller must command that. The induction is the same, for exact thrusts.
//
// With a rate loop an input is the thrust and the body rates that a wrench leads to, held for a tick, which the loop
// follows within the limits of the rotors, with their lag. Thrust and torque within a tick are then bounded by those
// limits alone.
//
// What moves cannot be excluded for ever, so the tubes of tracks (tubes.hpp) only choose among inputs that are safe
// without them. A manoeuvre is clear when it keeps the radius from all tubes up to their horizon, in continuous time,
// also at rest. `decide` flies, as the first that is possible,
//   (a) the candidate, if a safe and clear manoeuvre remains after it;
//   (b) a safe and clear manoeuvre, or an input between it and the candidate after which one remains;
//   (c) the candidate, if a safe manoeuvre remains: a filter that evades may stand before the shield, and braking
//       would not be clear either;
//   (d) what it flies without tracks.
// (a) and (b) are `certified_moving`. They alternate only where both are clear, and a manoeuvre that is being flown
// comes first in the choice of (b). Safety by half the margin alone is never taken up for the tubes.
//
// A constant disturbance that the state accounts for (`FlightState::level`: wind, as estimated) is part of the model:
// the body's acceleration is k S^T a where the model without it has a, and rollouts fly that. So with a disturbance d
// a certified manoeuvre holds for the assumption |d - d^| <= bound. Rest is judged as without it.
//
// The margin grows by what a disturbance that the state does not account for can move the vehicle before it is
// estimated (`FlightState::disturbance_bound`, disturbance.hpp), and by `FlightState::slip_m`, for new inputs only:
// the manoeuvre that is being flown stays accepted.
//
// When no manoeuvre is safe, the policy with the rotors' full range is tried. When that is not safe either, the best
// remaining manoeuvre is flown: of those without contact the one with the largest clearance, else the one that is
// slowest at its first contact.
//
// Source: the backup set of Chen, Jankovic, Santillo, Ames 2021, checked by rollout instead of by rows.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "alula/dynamics/actuators.hpp"
#include "alula/dynamics/disturbance.hpp"
#include "alula/filters/backup_policy.hpp"
#include "alula/filters/cone_escape.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/safety_filter.hpp"
#include "alula/filters/tubes.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula::flight {

struct Certificate {
  bool safe = false;
  bool rests = false;                                           // within max_time_s
  double clearance = -std::numeric_limits<double>::infinity();  // minimum distance minus the radius [m]: exact where
                                                                // searched, at most the distance searched for
  double time_s = 0;                                            // until rest
  double contact_speed = std::numeric_limits<double>::infinity();  // bound on the speed at the first contact [m/s];
                                                                   // infinite without contact, or if not searched for
  bool clears_tubes = false;  // keeps the radius from the tubes of all tracks; independent of `safe`
};

// What manoeuvres must be clear of, and the radius of the ball that they keep clear [m].
struct Surroundings {
  std::shared_ptr<const ObstacleMap> map;
  double radius_m = 0;

  // The ellipsoids of an index, for its radius.
  static Surroundings of(std::shared_ptr<const EllipsoidIndex> index) {
    const double radius = index ? index->radius() : 0;
    return {std::make_shared<const EllipsoidMap>(std::move(index)), radius};
  }
};

// One per thread; allocates in the constructor only.
class Shield {
 public:
  // `cones`: the ellipsoids that the policy `cone_escape` turns away from, which need not be in the map. Throws
  // std::invalid_argument for invalid options, a policy that is not stable when held for a tick, or `cone_escape`
  // without ellipsoids.
  Shield(const BackupPolicy& policy, Surroundings surroundings, const ShieldOptions& options = {},
         std::shared_ptr<const EllipsoidIndex> cones = nullptr);

  const BackupPolicy& policy() const { return policy_; }
  const ShieldOptions& options() const { return options_; }
  const ObstacleMap& map() const { return *map_; }
  double radius() const { return radius_; }

  // Distance of p to the map, exact where it is below `upto` [m].
  double distance(Vec3 p, double upto) { return map_->distance(p, upto, memory_); }

  // Checks whether flying `manoeuvre` from x, after one tick of `first` if given, is safe with `margin_m`. `thorough`
  // continues after the verdict, for the minimum clearance.
  Certificate certify(const State& x, const Manoeuvre& manoeuvre, double margin_m, const Wrench* first = nullptr,
                      bool thorough = false);

  // The state after a tick of u, |sigma| <= 1.
  State after(const State& x, const Wrench& u) const;

  // Sets the thrust of each rotor [N] for all later states. Initially, after `reset` and without a value, the rotors
  // hover. It matters only with a motor time constant.
  void see(const std::optional<Vec4>& rotors) { rotors_ = rotors.value_or(hovering_); }

  // The same, and the tracks from now on; initially and after `reset` there are none.
  void see(const FlightState& state) {
    see(state.rotors);
    level_ = state.level;
    margin_ = options_.margin_m + added_margin(state);
    tubes_.set(state.tracks, state.position_variance);
  }

  // Action of the backup if nothing else is accepted: the manoeuvre committed last, or the best found.
  // Sets report's wrench, status, `certified` and `certified_moving`: `candidate` with `accepted` when it is safe, an
  // input between it and the backup's, or the backup's (status backup), or the best remaining one (recovering). In
  // the last case
  // `candidate` is used only where it comes no nearer than now. `cone_escape` turns away from the cones of the
  // ellipsoids `near`. Returns true if the candidate itself was accepted.
  bool decide(const State& x, const Wrench& candidate, SafetyStatus accepted, std::span<const Found> near,
              FilterReport& report);

  // The same without a candidate.
  void fall_back(const State& x, std::span<const Found> near, FilterReport& report);

  // The wrench that `fall_back` would fly from x. A following call of `fall_back` or `decide` for the same x and
  // `near` reuses the result.
  Manoeuvre plan(const State& x, std::span<const Found> near);

  int hold_ticks() const;  // ticks of an escape

  // True if rollouts may end before rest. False with lag, and where the policy's caps let the vehicle go farther than
  // its excursion, which is tested at the start.
  bool ends_early() const { return ends_early_; }
  void reset();

 private:
  struct Tick {
    Vec3 p;
    double arc;  // bound on the length of the path up to here
    double sag;  // bound on the path's deviation from the previous chord
  };
  // A change about hover, by velocity, attitude, rates and rotors.
  static constexpr std::size_t kSize = 13;
  using Row = std::array<double, kSize>;
  struct Linear {
    std::array<Row, kSize> next;  // the change after a tick
    std::array<Row, 3> moved;     // of the position, in the tick
  };
  // An input that leaves a safe manoeuvre, and one that is clear of the tubes too.
  enum class Verdict : std::uint8_t { unsafe, safe, clear };

  bool lags() const { return options_.motor_time_constant_s > 0; }
  bool has_rate_loop() const { return alula::flight::has_rate_loop(options_.rate_time_constant_s); }
  bool acts_at_once() const { return !lags() && !has_rate_loop(); }
  void bound_motion();
  Linear linearised() const;
  bool settles();
  State following(const State& x, Vec4& rotors, const Wrench& u) const;
  State following_rates(const State& x, Vec4& rotors, const Wrench& u) const;
  Wrench flown(const State& x, const Manoeuvre& manoeuvre, int tick) const;
  bool roll(const State& x, const Manoeuvre& manoeuvre, const Wrench* first, double& time,
            double distance = std::numeric_limits<double>::infinity());
  bool is_slow(const State& x) const;
  bool resting(const State& x) const;
  bool resting(const State& x, const Vec4& rotors) const;
  bool drifts_at_most(const State& x, const Vec4& rotors, double limit) const;
  bool keeps_to_excursion() const;
  bool settles_clear(const State& x, double distance, double& looked);
  bool march(std::size_t from, double distance, bool thorough, double& least, double& contact_speed);
  std::size_t sweep(double distance);
  bool is_clear(std::size_t from, std::size_t to, double distance);
  bool clears_tubes() const;
  bool clears_tubes(const State& x, const Manoeuvre& manoeuvre, const Wrench* first = nullptr);
  bool is_safe(const State& x, const Manoeuvre& manoeuvre, double margin_m, const Wrench* first = nullptr,
               bool until_rest = false);
  // Manoeuvre to a stop: the gentle policy, but with lag or a rate loop it overshoots its tilt and speeds up at
  // first.
  Manoeuvre stop() const { return {.hold = {}, .ticks = 0, .is_urgent = !acts_at_once()}; }
  bool is_safe_after(const State& x, const Wrench& u, const Manoeuvre& manoeuvre, double kept,
                     bool until_rest = false);
  bool comes_no_nearer(const State& x, const Wrench& u);
  bool takes(const State& x, const Wrench& u, const Manoeuvre& next, double kept, Verdict& best);
  Verdict accept(const State& x, const Wrench& u);
  Verdict accept_escaping(const State& x, const Wrench& u, std::span<const Found> near);
  void settle(const State& x, std::span<const Found> near, FilterReport& report);
  bool choose(const State& x, std::span<const Found> near);
  void find_escapes(const State& x, std::span<const Found> near);

  BackupPolicy policy_;
  std::shared_ptr<const ObstacleMap> map_;
  double radius_;
  std::shared_ptr<const EllipsoidIndex> cones_;
  ShieldOptions options_;
  double rest_drift_;
  double margin_ = 0;  // that new inputs keep now [m]
  bool ends_early_ = false;
  std::array<Row, 3> drift_{};  // of the linear loop about hover until rest, by velocity, attitude, rates and rotors
  // With a rate loop: the limits of the thrust [N], and bounds on |omega'| by torque [rad/s^2] and, without torque,
  // per |omega|^2.
  double least_thrust_ = 0, most_thrust_ = 0, spin_up_ = 0, swing_ = 0;
  Level level_;  // of a constant disturbance in all rollouts
  Tubes tubes_;
  double tail_ = 0;  // the vehicle stays within this distance of the end of the path [m]
  bool ended_early_ = false;
  Vec4 hovering_{}, rotors_{};
  std::vector<Tick> path_;
  MapMemory memory_;
  Manoeuvre committed_, chosen_, next_;  // accepted last; flown now; follows the input just accepted
  Escapes escapes_;
  bool has_escapes_ = false, is_planned_ = false, is_chosen_safe_ = false, is_chosen_clear_ = false;
  bool is_committed_ = false;  // true if it was safe
};

}  // namespace alula::flight
