#include "alula/flight/moving_world.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/base/constants.hpp"
#include "alula/flight/encounter_watch.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::norm;
using geometry::Vec3;

constexpr double kNear = 5;  // a track this near an obstacle may belong to it [m]

}  // namespace

void check(const MovingSpec& spec) {
  if (spec.obstacles.size() > ALULA_OBSTACLES) throw std::invalid_argument("there are too many obstacles");
  if (!(spec.yaw_rate_rad_s >= 0 && spec.yaw_rate_rad_s <= 100))
    throw std::invalid_argument("the rate of yaw must be in 0..100 rad/s");
  for (const ObstacleSpec& obstacle : spec.obstacles) check(obstacle);
  check(spec.radar);
}

MovingWorld::MovingWorld(const MovingSpec& spec, double dt_s, int plant_steps)
    : spec_(spec), dt_s_(dt_s), plant_steps_(plant_steps), tracker_(spec.tracker) {
  for (const ObstacleSpec& o : spec.obstacles) track_radius_ = std::max(track_radius_, o.radius_m);
}

void MovingWorld::begin(const RandomStream& random, const Kinematics& start, Vec3 course) {
  random_ = random;
  course_ = course;
  tracker_.reset();
  obstacle_.clear(), truth_.clear(), tracks_.clear();
  for (std::size_t i = 0; i < spec_.obstacles.size(); ++i) {
    obstacle_.push_back(draw(spec_.obstacles[i], start, random_, static_cast<std::uint32_t>(i)));
    truth_.push_back(obstacle_.back()->state());
  }
  before_ = truth_;
  scans_ = 0, scanned_ = 0;
  yaw_ = std::atan2(course_.y, course_.x);
}

Kinematics MovingWorld::own_state(const Kinematics& vehicle, std::int64_t step) const {
  return flight::own_state(spec_.radar, vehicle, random_, static_cast<std::uint64_t>(step));
}

void MovingWorld::sense(std::int64_t step, const Kinematics& vehicle) {
  const RadarOptions& radar = spec_.radar;
  const double now = static_cast<double>(step) * dt_s_ / plant_steps_;
  if (now < static_cast<double>(scanned_) / radar.rate_hz - kSameTime) return;
  ++scanned_;
  if (scans_ == scan_.size()) scan_.emplace_back();
  Scan& made = scan_[scans_++];
  made.time = now;
  made.detections.clear();
  made.field = field_of_view(radar, own_state(vehicle, step), yaw_);
  scan(radar, vehicle, yaw_, truth_, random_, static_cast<std::uint64_t>(step), made.detections);
}

std::span<const alula_track> MovingWorld::tracks(double now, const alula_vehicle_state& own) {
  const RadarOptions& radar = spec_.radar;
  std::size_t arrived = 0;
  for (; arrived < scans_ && scan_[arrived].time + radar.delay_s <= now + kSameTime; ++arrived)
    tracker_.update(scan_[arrived].time, scan_[arrived].detections, &scan_[arrived].field);
  std::rotate(scan_.begin(), scan_.begin() + static_cast<std::ptrdiff_t>(arrived), scan_.end());
  scans_ -= arrived;

  tracks_.clear();
  for (const Track& track : tracker_.tracks(now)) {
    if (!track.is_confirmed || tracks_.size() == ALULA_OBSTACLES) continue;
    alula_track& t = tracks_.emplace_back();
    t.id = track.id;
    t.radius_m = static_cast<float>(track_radius_);
    for (int i = 0; i < 3; ++i) {
      t.position[i] = static_cast<float>(track.p[i]);
      t.velocity[i] = static_cast<float>(track.v[i]);
      t.acceleration[i] = static_cast<float>(track.a[i]);
    }
    for (std::size_t i = 0; i < track.covariance.size(); ++i)
      t.covariance[i] = static_cast<float>(track.covariance[i]);
  }
  if (spec_.yaw_rate_rad_s > 0) {
    const double limit = spec_.yaw_rate_rad_s * dt_s_;
    yaw_ += std::clamp(turn_to(tracks_, own, yaw_, radar.half_azimuth_rad, course_), -limit, limit);
  }
  return tracks_;
}

void MovingWorld::advance(double dt_s, const Kinematics& vehicle) {
  before_ = truth_;
  for (std::size_t i = 0; i < truth_.size(); ++i) {
    obstacle_[i]->step(dt_s, vehicle);
    truth_[i] = obstacle_[i]->state();
  }
}

std::int64_t MovingWorld::obstacle_near(const float* position) const {
  const Vec3 p{position[0], position[1], position[2]};
  std::int64_t found = -1;
  double best = kNear;
  for (std::size_t i = 0; i < truth_.size(); ++i) {
    const double distance = norm(truth_[i].p - p);
    if (distance < best) best = distance, found = static_cast<std::int64_t>(i);
  }
  return found;
}

std::int64_t MovingWorld::track_near(Vec3 position) const {
  std::int64_t found = -1;
  double best = kNear;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    const Vec3 p{tracks_[i].position[0], tracks_[i].position[1], tracks_[i].position[2]};
    const double distance = norm(p - position);
    if (distance < best) best = distance, found = static_cast<std::int64_t>(i);
  }
  return found;
}

double closest_approach(Vec3 r0, Vec3 r1, Vec3 a, double h) {
  const Vec3 chord = 1 / h * (r1 - r0), c = chord - h / 2 * a;
  const double ends = std::min(dot(r0, r0), dot(r1, r1)), square = dot(chord, chord);
  double t = square > 0 ? std::clamp(-dot(r0, chord) / square, 0.0, h) : 0;
  double best = ends;
  for (int step = 0; step < 4; ++step) {  // Newton steps on r . r', from the chord's closest point
    const Vec3 r = r0 + t * c + t * t / 2 * a, v = c + t * a;
    best = std::min(best, dot(r, r));
    const double slope = dot(v, v) + dot(r, a);
    if (!(slope > 0)) break;
    t = std::clamp(t - dot(r, v) / slope, 0.0, h);
  }
  return std::sqrt(best);
}

}  // namespace alula::flight
