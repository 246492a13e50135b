#include "alula/flight/obstacle_motion.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "alula/flight/meeting.hpp"
#include "alula/flight/motions.hpp"

namespace alula::flight {
namespace {

using geometry::e3;

constexpr double kShortestLeg = 1e-3;                        // [m]
constexpr double kLongestWait = 1e4;                         // maximum time until a meeting [s]
constexpr double kShortestThrow = 1e-3, kLongestThrow = 60;  // [s]

void require(bool good, const char* message) {
  if (!good) throw std::invalid_argument(message);
}

// Streams of the random values, one for each quantity.
enum Item : std::uint64_t { kUniforms, kMoreUniforms, kOffset, kMeeting };

double in(const Range& range, double u) { return range.from + (range.to - range.from) * u; }

// Frame (course, left, up).
struct Course {
  explicit Course(Vec3 v) {
    const double speed = std::hypot(v.x, v.y);
    if (speed > 0) forward = {v.x / speed, v.y / speed, 0};
    left = cross(e3, forward);
  }
  Vec3 forward{1, 0, 0}, left;

  Vec3 world(Vec3 of) const { return of.x * forward + of.y * left + of.z * e3; }
  Vec3 direction(double azimuth, double elevation) const {
    const double c = std::cos(elevation);
    return world({c * std::cos(azimuth), c * std::sin(azimuth), std::sin(elevation)});
  }
};

Vec3 about_vertical(Vec3 v, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * v.x - s * v.y, s * v.x + c * v.y, v.z};
}

// One draw: start, speed and direction.
struct Draw {
  Draw(const ObstacleSpec& s, const Kinematics& vehicle, const RandomStream& random, std::uint32_t obstacle)
      : spec(s), course(vehicle.v) {
    const std::uint32_t from = channel::kObstacle + obstacle;
    const auto u = random.uniforms(kUniforms, from), more = random.uniforms(kMoreUniforms, from);
    pace = {in(s.speed_m_s, u[0]), 0, s.max_speed_m_s};
    const double acceleration = in(s.acceleration_m_s2, u[1]);
    if (s.kind == MotionKind::accelerating || s.kind == MotionKind::curving) pace.acceleration = acceleration;
    leg = {pace.speed, acceleration > 0 ? acceleration : kFallGravity / 2};
    const double side = s.either_side && more[1] < 0.5 ? -1 : 1;
    const Vec3 bearing = course.direction(side * in(s.azimuth, u[2]), in(s.elevation, u[3]));
    target_v = s.aims_at_vehicle ? Vec3{} : vehicle.v;
    target_p = vehicle.p + s.start_s * target_v;
    p = !s.is_relative ? s.position : s.crosses ? crossing(vehicle.p, bearing) : vehicle.p + s.distance_m * bearing;
    p += course.world(multiply(s.offset_sigma, random.normals(kOffset, from)));
    meeting_error = course.world(multiply(s.meeting_sigma, random.normals(kMeeting, from)));
    turn = in(s.heading, more[0]);
  }

  double way(double t) const { return spec.kind == MotionKind::quadrotor ? leg.half_way(t) : pace.way(t); }

  Vec3 crossing(Vec3 start, Vec3 bearing) const {
    const Vec3 ahead = target_p - start;
    require(norm(ahead) < spec.distance_m, "an obstacle that crosses starts too near for how late it starts");
    const double t =
        with_mean_speed([&](double s) { return leaving_time(ahead, target_v + s * bearing, spec.distance_m); },
                        [&](double after) { return way(after); }, 1);
    require(t < kLongestWait, "an obstacle with this speed crosses the vehicle's path nowhere");
    return target_p + t * target_v + way(t) * bearing;
  }

  double meeting_after(bool is_level) const {
    const Vec3 keep{1, 1, is_level ? 0.0 : 1.0}, r = multiply(keep, target_p - p), v = multiply(keep, target_v);
    return with_mean_speed([&](double s) { return meeting_time(r, v, s); }, [&](double after) { return way(after); },
                           1);
  }

  Vec3 target_at(double t) const { return target_p + t * target_v + meeting_error; }

  // Vector turned outwards.
  Vec3 outwards(Vec3 heading) const {
    const Vec3 out = dot(p - target_p, course.left) >= 0 ? course.left : -course.left;
    return about_vertical(heading, cross(heading, out).z >= 0 ? turn : -turn);
  }

  Vec3 heading() const {
    const Vec3 to = target_at(meeting_after(false)) - p;
    const double distance = norm(to);
    return outwards(distance > kSamePlace ? 1 / distance * to : -course.forward);
  }

  const ObstacleSpec& spec;
  Course course;
  Pace pace;
  Leg leg;
  Vec3 p, target_p, target_v, meeting_error;  // vehicle's position and velocity when the obstacle starts
  double turn = 0;
};

bool is_range(const Range& r) { return std::isfinite(r.from) && std::isfinite(r.to) && r.from <= r.to; }
bool has_velocity(const ObstacleSpec& s) { return norm(s.velocity) > 0; }

}  // namespace

FlownBody small_quadrotor() {
  const double arm = 0.0325, most = 0.1125, least = 0.02;
  const Vec3 inertia{16.6e-6, 16.6e-6, 29.3e-6};
  TrackingGains gains;
  gains.k_r = multiply(inertia, {500, 500, 110}), gains.k_omega = multiply(inertia, {36, 36, 11});
  gains.max_tilt_rad = 0.7, gains.max_thrust_share = 0.95;
  return {{0.029,
           inertia,
           {{arm, -arm, -arm, arm},
            {-arm, -arm, arm, arm},
            {-1, 1, -1, 1},
            0.005964552,
            {least, least, least, least},
            {most, most, most, most}}},
          gains};
}

void check(const ObstacleSpec& s) {
  using enum MotionKind;
  const bool speeds_up = s.kind == accelerating || s.kind == curving;
  require(s.radius_m > 0 && std::isfinite(s.radius_m), "the radius of an obstacle must be positive");
  require(geometry::is_finite(s.position) && geometry::is_finite(s.velocity),
          "place and velocity of an obstacle must be finite");
  require(s.distance_m > 0 && std::isfinite(s.distance_m), "the distance of an obstacle must be positive");
  require(is_range(s.azimuth) && is_range(s.elevation) && is_range(s.heading) && is_range(s.speed_m_s) &&
              is_range(s.acceleration_m_s2),
          "a range needs finite numbers, the first not above the second");
  require(std::max(-s.elevation.from, s.elevation.to) <= std::numbers::pi / 2, "an elevation is within +-pi / 2");
  require(s.speed_m_s.from >= 0 && s.acceleration_m_s2.from >= 0, "speeds and accelerations must be >= 0");
  require(is_size(s.offset_sigma) && is_size(s.meeting_sigma), "errors need standard deviations >= 0");
  require(s.max_speed_m_s > 0 && std::isfinite(s.max_speed_m_s), "the highest speed must be positive");
  require(!speeds_up || (has_velocity(s) ? norm(s.velocity) : s.speed_m_s.to) <= s.max_speed_m_s,
          "an obstacle that accelerates must start no faster than its highest speed");
  require(is_size(s.turn_rate_rad_s) && is_size(s.release_m) && is_size(s.drag_per_m) && is_size(s.start_s),
          "turn rate, release, drag and start must be >= 0");
  require(!(s.is_relative && has_velocity(s)), "an obstacle with a velocity needs a place, too");
  require(s.is_relative || !s.crosses, "an obstacle that crosses has a distance, not a place");
  require(!(s.crosses && s.aims_at_vehicle), "an obstacle crosses the vehicle's path or aims at its start");
  require(s.kind != ballistic || has_velocity(s) || s.speed_m_s.from > 0, "what is thrown needs a speed");
  if (s.kind != quadrotor) {
    require(s.way_points.empty(), "only a quadrotor flies to way-points");
    return;
  }
  require(s.speed_m_s.from > 0 && !has_velocity(s), "a quadrotor starts at rest and needs a speed to fly with");
  require(std::all_of(s.way_points.begin(), s.way_points.end(), [](Vec3 p) { return geometry::is_finite(p); }),
          "way-points must be finite");
  for (std::size_t k = 1; k < s.way_points.size(); ++k)
    require(norm(s.way_points[k] - s.way_points[k - 1]) >= kShortestLeg, "way-points must differ from the last one");
  check(s.pilot.gains);
}

std::unique_ptr<ObstacleMotion> draw(const ObstacleSpec& spec, const Kinematics& vehicle, const RandomStream& random,
                                     std::uint32_t obstacle) {
  check(spec);
  require(geometry::is_finite(vehicle.p) && geometry::is_finite(vehicle.v), "the vehicle's start must be finite");
  Draw drawn(spec, vehicle, random, obstacle);
  if (has_velocity(spec) && spec.kind != MotionKind::ballistic) drawn.pace.speed = norm(spec.velocity);
  const auto heading = [&] { return has_velocity(spec) ? 1 / norm(spec.velocity) * spec.velocity : drawn.heading(); };
  switch (spec.kind) {
    case MotionKind::constant_velocity:
    case MotionKind::accelerating:
      return move_straight(spec.start_s, drawn.p, heading(), drawn.pace);
    case MotionKind::curving:
      return move_curving(spec, drawn.p, heading(), drawn.pace, drawn.meeting_error);
    case MotionKind::ballistic: {
      if (has_velocity(spec)) return move_thrown(spec.start_s, drawn.p, spec.velocity, spec.drag_per_m);
      const double t = drawn.meeting_after(true);
      require(t > kShortestThrow, "what is thrown must not start above or below the meeting point");
      require(t <= kLongestThrow, "what is thrown must reach the meeting point within a minute");
      const Vec3 v = throw_velocity(drawn.p, drawn.target_at(t), t, spec.drag_per_m);
      return move_thrown(spec.start_s, drawn.p, drawn.outwards(v), spec.drag_per_m);
    }
    case MotionKind::quadrotor: {
      std::vector<Vec3> points{drawn.p};
      points.insert(points.end(), spec.way_points.begin(), spec.way_points.end());
      if (spec.way_points.empty()) {
        const Vec3 to = drawn.target_at(drawn.meeting_after(false)) - drawn.p;
        // An obstacle that starts at the meeting point flies a leg of 2 mm: it hovers there.
        const bool is_leg = norm(to) >= kShortestLeg;
        points.push_back(drawn.p + (is_leg ? 2 * drawn.outwards(to) : 2 * kShortestLeg * drawn.heading()));
      }
      if (norm(points[1] - points[0]) < kShortestLeg)
        points.erase(points.begin() + 1);  // it already is at that point
      require(points.size() > 1, "the way points of a quadrotor must lead away from its start");
      return move_flown(spec.start_s, spec.pilot, points, drawn.leg);
    }
  }
  throw std::invalid_argument("an obstacle of no kind");
}

}  // namespace alula::flight
