// A double integrator whose acceleration follows the command late and at a bounded rate.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "alula/tracking/radar.hpp"

namespace alula::flight {

struct PointLimits {
  double max_speed_m_s = 12;     // limit of the executed |v|
  double max_jerk_m_s3 = 60;     // limit of the executed |da/dt|_inf, except where the speed limit acts
  double actuation_delay_s = 0;  // time from a command until it begins to act
};

// Within a step of h the acceleration is constant, so the motion is exact. The acceleration moves
// towards the command that is in effect by at most j_max h per axis; a speed beyond the limit is scaled down to it.
class EncounterPlant {
 public:
  EncounterPlant(const PointLimits& limits, double h);

  void reset(const Kinematics& start);
  void command(geometry::Vec3 acceleration);  // takes effect after the delay
  void step();

  const Kinematics& state() const { return x_; }

 private:
  struct Queued {
    std::int64_t begins;  // step
    geometry::Vec3 a;
  };
  double h_, max_speed_, most_;  // most_: maximum change of the acceleration in a step
  std::int64_t delay_, now_ = 0;
  std::vector<Queued> queue_;  // a ring that grows until it holds the delay
  std::size_t oldest_ = 0, count_ = 0;
  geometry::Vec3 acting_;
  Kinematics x_;
};

}  // namespace alula::flight
