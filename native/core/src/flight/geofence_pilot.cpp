#include "alula/flight/geofence_pilot.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace alula::flight {

namespace {

constexpr std::uint32_t kPilot = 0x5000'0000;
constexpr double kPi = std::numbers::pi;
constexpr double kAttitudeGain = 15;  // [1/s]

double to_float(double x) { return static_cast<float>(x); }

}  // namespace

void check(const Pilot& pilot) {
  if (!std::isfinite(pilot.heading_rad) || !std::isfinite(pilot.climb_m_s2) || !(pilot.tilt_rad >= 0) ||
      !(pilot.tilt_rad < kPi / 2) || !(pilot.silent_after_s >= 0) || !std::isfinite(pilot.silent_after_s)) {
    throw std::invalid_argument("a pilot's angles and times must be finite, the tilt below 90 degrees");
  }
}

PilotHand::PilotHand(const Pilot& pilot, const RacerModel& model, RandomStream random, double start_height)
    : pilot_(pilot), model_(model), random_(random), start_height_(start_height) {
  check(pilot);
  if (pilot.kind == PilotKind::silent) {
    silent_at_ = pilot.silent_after_s * (1 + random_.uniforms(0, kPilot + 1)[0]);
  }
}

// Vertical acceleration that holds the height of the start.
double PilotHand::hold(const RacerState& x) const {
  return std::clamp(2 * (start_height_ - x.p.z) - 2 * x.v.z, -8.0, 8.0);
}

// Turns the thrust axis to a tilt towards a heading; the throttle gives the commanded vertical acceleration.
RacerCommand PilotHand::attitude_command(const RacerState& x, double heading, double tilt, double climb) const {
  const Vec3 target{std::sin(tilt) * std::cos(heading), std::sin(tilt) * std::sin(heading), std::cos(tilt)};
  const Vec3 axis = racer_axis(x.q), turn = geometry::cross(axis, target);
  // into the body: q* turn q
  const Vec3 u{-x.q[1], -x.q[2], -x.q[3]}, t = 2.0 * geometry::cross(u, turn);
  const Vec3 body = turn + x.q[0] * t + geometry::cross(u, t);
  RacerCommand command{model_.throttle_for((model_.gravity + climb) / std::max(axis.z, 0.2)), kAttitudeGain * body};
  for (int i = 0; i < 3; ++i) {
    command.rates[i] = std::clamp(command.rates[i], -model_.max_rate[i], model_.max_rate[i]);
  }
  return command;
}

RacerCommand PilotHand::random_command(double time, const RacerState& x, bool only_sticks) {
  if (time >= segment_end_) {
    const auto a = random_.uniforms(segment_, kPilot + 2), b = random_.uniforms(segment_, kPilot + 3);
    ++segment_;
    has_sticks_ = only_sticks || a[0] < 0.3;
    segment_end_ = time + (has_sticks_ ? 0.1 + 0.9 * a[1] : 0.3 + 2.7 * a[1]);
    stick_.throttle = b[0];
    for (int i = 0; i < 3; ++i) {
      stick_.rates[i] = (2 * b[static_cast<std::size_t>(i) + 1] - 1) * model_.max_rate[i];
    }
    heading_ = 2 * kPi * a[2];
    tilt_ = a[3] * 85 * kPi / 180;
    climb_ = -9.5 + 25 * b[0];
  }
  return has_sticks_ ? stick_ : attitude_command(x, heading_, tilt_, climb_);
}

std::optional<RacerCommand> PilotHand::operator()(double time, const RacerState& x) {
  RacerCommand u;
  switch (pilot_.kind) {
    case PilotKind::straight:
      u = attitude_command(x, pilot_.heading_rad, pilot_.tilt_rad, hold(x));
      break;
    case PilotKind::diagonal:
      u = attitude_command(x, pilot_.heading_rad + kPi / 4, pilot_.tilt_rad,
                           pilot_.climb_m_s2 == 0 ? hold(x) : pilot_.climb_m_s2);
      break;
    case PilotKind::fall:
      break;
    case PilotKind::sticks:
      u = random_command(time, x, true);
      break;
    case PilotKind::silent:
      if (time >= silent_at_) return std::nullopt;
      [[fallthrough]];
    case PilotKind::aggressive:
      u = random_command(time, x, false);
      break;
    case PilotKind::repeated: {
      const double phase = std::fmod(time, 12.0);
      if (phase < 4) {
        u = attitude_command(x, pilot_.heading_rad, pilot_.tilt_rad, hold(x));
      } else if (phase < 8) {
        u = attitude_command(x, pilot_.heading_rad + kPi, pilot_.tilt_rad, hold(x));
      } else if (phase < 10.5) {
        u = attitude_command(x, 0, 0, -model_.gravity);
      } else {
        u = attitude_command(x, 0, 0, hold(x));
      }
      break;
    }
  }
  u.throttle = to_float(u.throttle);
  for (int i = 0; i < 3; ++i) u.rates[i] = to_float(u.rates[i]);
  return u;
}

}  // namespace alula::flight
