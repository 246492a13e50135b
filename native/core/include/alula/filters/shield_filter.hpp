// The shield as a filter of its own: passes the nominal wrench where a certified manoeuvre remains after it.
//
// Otherwise it returns what `Shield::decide` does: an input between the backup and the nominal one, the backup's, or
// the best effort. It needs no model of the obstacles but their distance, so it takes every static map. It does not
// steer around obstacles: it lets the nominal input run up to the last moment, then brakes.
#pragma once

#include "alula/filters/options.hpp"
#include "alula/filters/shielded.hpp"

namespace alula::flight {

class ShieldFilter final : public SafetyFilter {
 public:
  // Throws std::invalid_argument for invalid options, and for `cone_escape`, which needs ellipsoids.
  ShieldFilter(const BackupPolicy& policy, Surroundings surroundings, const ShieldFilterOptions& options = {});

  CommandKind kind() const override { return CommandKind::wrench; }

  // `margin` is the clearance now: the distance to the map less the radius, infinite beyond 1 m.
  FilterReport filter(const FlightState& state, const Nominal& nominal) override;
  void reset() override { shield_.reset(); }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<ShieldFilter>(*this); }
  const ShieldFilterOptions& options() const { return options_; }

 private:
  ShieldFilterOptions options_;
  Shield shield_;
};

}  // namespace alula::flight
