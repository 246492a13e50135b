// Vehicle of an encounter: a double integrator whose acceleration follows the command late and at a bounded rate.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "alula/flight/encounter.hpp"

namespace alula::flight {

// Within a step of h = dt / plant_steps the acceleration is constant, so the motion is exact. The acceleration moves
// towards the command that is in effect by at most j_max h per axis; a speed beyond the limit is scaled down to it.
class EncounterPlant {
 public:
  EncounterPlant(const EncounterVehicle& vehicle, const EncounterRules& rules);

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
