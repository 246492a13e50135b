#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/flight/encounter.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::norm;
using geometry::Vec3;

void require(bool good, const char* message) {
  if (!good) throw std::invalid_argument(message);
}

bool is_within(double value, double low, double high) { return value >= low && value <= high; }

}  // namespace

void check(const EncounterSpec& spec) {
  const EncounterVehicle& v = spec.vehicle;
  const EncounterRules& r = spec.rules;
  require(std::isfinite(dot(v.start, v.start)) && std::isfinite(dot(v.goal, v.goal)),
          "start and goal must be finite");
  require(v.hovers || norm(v.goal - v.start) > 0, "start and goal are one point: the vehicle hovers, or has a way");
  require(is_within(r.dt_s, 1e-4, 1) && is_within(r.plant_steps, 1, 1000),
          "dt_s must be in 1e-4..1 s, with 1..1000 "
          "steps of the plant");
  require(is_within(r.max_time_s, r.dt_s, 1e5), "max_time_s must be in dt_s..1e5 s");
  require(is_within(r.receded_s, 0, 1e5), "receded_s must be >= 0");
  require(is_within(r.risk_window_s, 1e-6, 1e5), "risk_window_s must be positive");
  require(is_within(v.max_speed_m_s, 1e-3, 1e3), "the largest speed must be in 0.001..1000 m/s");
  require(is_within(v.start_speed_m_s, 0, v.max_speed_m_s), "the speed at the start must be in 0..the largest speed");
  require(is_within(v.cruise_m_s, 1e-3, v.max_speed_m_s), "the cruise speed must be in 0.001..the largest speed");
  require(is_within(v.gain, 1e-3, 1 / r.dt_s), "the gain must be in 0.001..1 / dt_s");
  require(is_within(v.radius_m, 0, 1e3), "the radius must be in 0..1000 m");
  require(is_within(v.max_acceleration_m_s2, 1e-3, 1e4), "the largest acceleration must be in 0.001..10000 m/s^2");
  require(is_within(v.max_jerk_m_s3, 1e-3, 1e9), "the largest jerk must be in 0.001..1e9 m/s^3");
  require(is_within(v.actuation_delay_s, 0, 10), "the delay of the actuation must be in 0..10 s");
  check(spec.moving);
}

}  // namespace alula::flight
