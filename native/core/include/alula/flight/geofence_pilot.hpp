// Simulated pilots of a racing drone in a geofence.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>

#include "alula/dynamics/racer.hpp"

namespace alula::flight {

enum class PilotKind : std::uint8_t {
  straight,    // tilted towards a heading, height held, permanently
  diagonal,    // the same half way between two axes, and climbing or sinking: into an edge or a corner
  fall,        // no throttle, no rates
  sticks,      // random rates and throttle, held for 0.1 to 1 s
  aggressive,  // random attitudes, tilted up to 85 degrees, and sometimes random sticks
  silent,      // aggressive, then no radio
  repeated     // to a wall, to the opposite one, to the floor, up again, and so on
};

struct Pilot {
  PilotKind kind = PilotKind::straight;
  double heading_rad = 0;       // of straight and repeated; diagonal is 45 degrees to the left of it
  double tilt_rad = 1.2566;     // 72 degrees
  double climb_m_s2 = 0;        // of diagonal: commanded vertical acceleration
  double silent_after_s = 1.5;  // of silent: minimum time, at most twice as long
};

// Throws std::invalid_argument for an angle or a time out of range.
void check(const Pilot& pilot);

class PilotHand {
 public:
  PilotHand(const Pilot& pilot, const RacerModel& model, RandomStream random, double start_height);

  // The command, rounded to float like a receiver's; nothing when the radio is silent.
  std::optional<RacerCommand> operator()(double time, const RacerState& x);

 private:
  RacerCommand attitude_command(const RacerState& x, double heading, double tilt, double climb) const;
  RacerCommand random_command(double time, const RacerState& x, bool only_sticks);
  double hold(const RacerState& x) const;

  Pilot pilot_;
  RacerModel model_;
  RandomStream random_;
  double start_height_, silent_at_ = std::numeric_limits<double>::infinity();
  double segment_end_ = 0;
  std::uint64_t segment_ = 0;
  bool has_sticks_ = false;
  RacerCommand stick_;
  double heading_ = 0, tilt_ = 0, climb_ = 0;
};

}  // namespace alula::flight
