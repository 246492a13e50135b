// Shared end of a tick of the quadrotor filters, with or without a shield.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "alula/filters/pruning.hpp"
#include "alula/filters/shield.hpp"

namespace alula::flight {

// An ellipsoid that contains the sum of `e` and a ball of radius `room` [m], as `EllipsoidIndex` grows them; `e` if
// `room` is 0.
inline GrownEllipsoid with_room(const GrownEllipsoid& e, double room) {
  using geometry::cross, geometry::dot;
  const auto inverse = [](const Mat3& m) {  // inverse of a symmetric matrix
    const Vec3 x = cross(m.row(1), m.row(2)), y = cross(m.row(2), m.row(0)), z = cross(m.row(0), m.row(1));
    const double scale = 1 / dot(m.row(0), x);
    return scale * Mat3{{{x.x, x.y, x.z}, {x.y, y.y, y.z}, {x.z, y.z, z.z}}};
  };
  if (!(room > 0)) return e;
  Mat3 covariance = inverse(e.a);
  const Sum sum = outer_sum(covariance[0][0] + covariance[1][1] + covariance[2][2], room);
  covariance = sum.scale * covariance + sum.add * geometry::identity();
  return {e.centre, inverse(covariance)};
}

// The second map of a pruner, with rows at `room` beyond its radius.
inline Surroundings with_room(Surroundings others, double room) {
  others.radius_m += room;
  return others;
}

// Ellipsoids of an index grown by `room`; caches recent ones. One per thread.
class RoomyEllipsoids {
 public:
  RoomyEllipsoids(std::shared_ptr<const EllipsoidIndex> index, double room)
      : index_(std::move(index)), room_(room), last_(room > 0 ? kSize : 0) {}

  const GrownEllipsoid& operator[](std::uint32_t item) {
    if (last_.empty()) return index_->grown(item);
    Entry& entry = last_[item % kSize];
    if (entry.item != item) entry = {item, with_room(index_->grown(item), room_)};
    return entry.grown;
  }

  // The ellipsoid of a candidate, or its local ball.
  const GrownEllipsoid& of(const Pruner& pruner, std::uint32_t item) {
    return pruner.is_local(item) ? pruner.ball(item) : (*this)[item];
  }

 private:
  static constexpr std::size_t kSize = 1024;
  struct Entry {
    std::uint32_t item = ~std::uint32_t{0};
    GrownEllipsoid grown;
  };

  std::shared_ptr<const EllipsoidIndex> index_;
  double room_;
  std::vector<Entry> last_;  // indexed by number
};

inline bool is_usable(const FlightState& state, const Nominal& nominal) {
  return is_finite(state.x) && std::isfinite(state.thrust) && std::isfinite(state.thrust_rate) &&
         is_finite(nominal.wrench) && std::isfinite(nominal.thrust_rate) &&
         std::isfinite(nominal.thrust_acceleration) && geometry::is_finite(nominal.position_error) &&
         geometry::is_finite(nominal.velocity_error) && geometry::is_finite(nominal.reference_acceleration);
}

// Returns hover, for inputs that are not finite.
inline FilterReport refused(const Quadrotor& vehicle) {
  FilterReport report;
  report.status = SafetyStatus::refused;
  report.wrench = {vehicle.hover_thrust(), {}};
  return report;
}

// `wrench` satisfies all rows: it is returned as `certified_status` when the shield accepts it, or as `bare_status`
// unchecked without a shield. report.thrust_rate is that of `wrench`, and 0 when another wrench is flown.
inline void finish(Shield* shield, const State& x, const Wrench& wrench, SafetyStatus bare_status,
                   SafetyStatus certified_status, std::span<const Found> near, FilterReport& report) {
  if (shield == nullptr) {
    report.wrench = wrench, report.status = bare_status;
  } else if (!shield->decide(x, wrench, certified_status, near, report)) {
    report.thrust_rate = 0;
  }
}

// No input satisfies all rows: returns the backup policy, or with `nominal` what the shield accepts between both.
inline void fly_backup(Shield* shield, const BackupPolicy& policy, const State& x, const Wrench* nominal,
                       std::span<const Found> near, FilterReport& report) {
  report.thrust_rate = 0;
  if (shield == nullptr) {
    report.wrench = policy(x), report.status = SafetyStatus::backup;
  } else if (nominal != nullptr) {
    shield->decide(x, policy.vehicle().limited(*nominal), SafetyStatus::backup, near, report);
  } else {
    shield->fall_back(x, near, report);
  }
}

}  // namespace alula::flight
