// The filters of velocities, of moving obstacles and of sticks behind the protocol of all safety filters.
#pragma once

#include <memory>
#include <vector>

#include "alula/filters/backup_qp.hpp"
#include "alula/filters/geofence.hpp"
#include "alula/filters/moving_filter.hpp"
#include "alula/filters/polytope_cbf.hpp"
#include "alula/filters/safety_filter.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula::flight {

// Planes that separate a point from static obstacles, for filters that take walls.
//
// Behind each plane lies a whole convex obstacle, so a vehicle that stays in front of all planes touches none of the
// obstacles found. Of more than ALULA_WALLS obstacles those are kept before which the vehicle could not stop if it
// were a little faster: walls that it passes closely must not displace the one that it flies towards.
class WallPlanes {
 public:
  // Limits of the vehicle [m/s, m/s^2] and its radius [m]. Without a map there are no walls.
  WallPlanes(std::shared_ptr<const ObstacleMap> map, double max_speed, double max_acceleration, double radius);

  std::span<const alula_wall> at(Vec3 p, Vec3 v);

 private:
  std::shared_ptr<const ObstacleMap> map_;
  double farthest_ = 0, brake_ = 0, radius_ = 0;
  MapMemory memory_;
  struct Near {
    Contact contact;
    double spare;  // increase of the speed towards the obstacle from which the vehicle could still stop [m/s]
  };
  std::vector<Near> near_;
  std::vector<alula_wall> walls_;
};

// polytope-cbf. The velocity that it returns is safe for a vehicle that follows it at once; for others there is
// ChordFilter. It keeps `FlightState::more_margin_m` in addition. With `is_bare` it returns the nominal velocity, and
// only reports the margin, in no time.
class VelocityFilter final : public SafetyFilter {
 public:
  explicit VelocityFilter(const PolytopeCbf& filter, bool is_bare = false) : filter_(filter), is_bare_(is_bare) {}

  CommandKind kind() const override { return CommandKind::velocity; }
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { filter_.reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<VelocityFilter>(*this); }

 private:
  PolytopeCbf filter_;
  bool is_bare_;
};

// dr-acbf and the methods that it was compared with. Static obstacles are walls to them.
class MovingSafety final : public SafetyFilter {
 public:
  MovingSafety(std::unique_ptr<MovingFilter> filter, WallPlanes walls)
      : filter_(std::move(filter)), walls_(std::move(walls)) {}
  MovingSafety(const MovingSafety& other) : filter_(other.filter_->clone()), walls_(other.walls_) {}
  MovingSafety& operator=(const MovingSafety&) = delete;

  CommandKind kind() const override { return CommandKind::acceleration; }
  // `margin` is minus the violation of the rows [m/s^2], `active` the most urgent track while there is a warning.
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void flown(Vec3 acceleration) override { filter_->flown(acceleration); }
  void reset() override { filter_->reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<MovingSafety>(*this); }

 private:
  std::unique_ptr<MovingFilter> filter_;
  WallPlanes walls_;
};

// The onboard geofence, or with `alpha` the backup-set barrier backup-qp. A state that is not known counts as a loss
// of navigation, and a nominal command without sticks as a silent pilot: then the backup controller flies; backup-qp
// refuses without navigation. With `is_bare` it returns the pilot's command, and refuses where either is missing.
class FenceFilter final : public SafetyFilter {
 public:
  explicit FenceFilter(const Geofence& geofence, std::optional<double> alpha = {}, bool is_bare = false);
  FenceFilter(const FenceFilter& other) : FenceFilter(other.geofence_, other.alpha_, other.is_bare_) {}
  FenceFilter& operator=(const FenceFilter&) = delete;

  CommandKind kind() const override { return CommandKind::sticks; }
  // `margin` is h_I [m].
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override;
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<FenceFilter>(*this); }

 private:
  void by_program(const RacerState& x, const RacerCommand& pilot, FilterReport& report);

  Geofence geofence_;
  std::optional<double> alpha_;
  bool is_bare_;
  std::optional<BackupQp> program_;
};

// The state of the rigid body as that of the racing drone, and back; attitudes are the same up to rounding, and to
// the last bit where `attitude`, the quaternion of x.sigma, is given.
RacerState to_racer(const State& x, const std::optional<Vec4>& attitude = {});
State from_racer(const RacerState& x);

}  // namespace alula::flight
