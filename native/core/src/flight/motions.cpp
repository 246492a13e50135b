#include "alula/flight/motions.hpp"

#include <stdexcept>

#include "alula/base/constants.hpp"
#include "alula/dynamics/plant.hpp"
#include "alula/flight/meeting.hpp"

namespace alula::flight {
namespace {

using geometry::e3;

constexpr double kLongestStep = 0.001;       // maximum step of the second quadrotor's controller [s]
constexpr double kLongestBallistic = 0.005;  // maximum step of a ballistic obstacle [s]
constexpr double kMostDrag = 20;             // maximum c of a throw: it then loses 95 % of its speed

// Common part: time, and rest before the start.
class Starting : public ObstacleMotion {
 public:
  Starting(double start_s, Vec3 p) : start_(start_s) { state_.p = p; }

  void step(double dt, const Kinematics& vehicle) final {
    time_ += dt;
    const double moving = std::min(dt, time_ - start_);
    if (moving > kSameTime) move(moving, vehicle);
  }
  const Kinematics& state() const final { return state_; }

 protected:
  virtual void move(double dt, const Kinematics& vehicle) = 0;
  Kinematics state_;

 private:
  double start_, time_ = 0;
};

// Motion along a straight line, exact at any time.
class Straight final : public Starting {
 public:
  Straight(double start_s, Vec3 p, Vec3 heading, const Pace& pace)
      : Starting(start_s, p), from_(p), heading_(heading), pace_(pace) {
    if (start_s == 0) place();
  }

 private:
  void move(double dt, const Kinematics&) override {
    moved_ += dt;
    place();
  }
  void place() {
    state_ = {from_ + pace_.way(moved_) * heading_, pace_.speed_at(moved_) * heading_,
              pace_.acceleration_at(moved_) * heading_};
  }

  Vec3 from_, heading_;
  Pace pace_;
  double moved_ = 0;
};

// The unit vector at `angle` from a towards b, at most b itself.
Vec3 turned_towards(Vec3 a, Vec3 b, double angle) {
  const double sine = norm(cross(a, b)), between = std::atan2(sine, dot(a, b));
  if (between <= angle) return b;
  Vec3 side = b - dot(a, b) * a;
  if (sine < kSamePlace) side = cross(std::abs(a.z) < 0.9 ? e3 : Vec3{1, 0, 0}, a);  // opposite: any side
  return std::cos(angle) * a + std::sin(angle) / norm(side) * side;
}

class Curving final : public Starting {
 public:
  Curving(const ObstacleSpec& spec, Vec3 p, Vec3 heading, const Pace& pace, Vec3 meeting_error)
      : Starting(spec.start_s, p),
        heading_(heading),
        meeting_error_(meeting_error),
        pace_(pace),
        rate_(spec.turn_rate_rad_s),
        release_(spec.release_m),
        pursues_(spec.aims_at_vehicle) {
    if (spec.start_s == 0) state_.v = pace.speed * heading, state_.a = pace.acceleration_at(0) * heading;
  }

 private:
  void move(double dt, const Kinematics& vehicle) override {
    const Vec3 before = heading_;
    turns_ = turns_ && norm(vehicle.p - state_.p) > release_;
    if (turns_) {
      const Vec3 to = aim(vehicle) - state_.p;
      const double distance = norm(to);
      if (distance > kSamePlace && std::isfinite(distance))
        heading_ = turned_towards(heading_, 1 / distance * to, rate_ * dt);
    }
    const double way = pace_.way(moved_ + dt) - pace_.way(moved_);
    moved_ += dt;
    const double speed = pace_.speed_at(moved_);
    state_.p += way / 2 * (before + heading_);
    state_.v = speed * heading_;
    state_.a = pace_.acceleration_at(moved_) * heading_ + speed / dt * (heading_ - before);
  }

  Vec3 aim(const Kinematics& vehicle) const {
    if (pursues_) return vehicle.p + meeting_error_;
    const Pace now{pace_.speed_at(moved_), pace_.acceleration_at(moved_), pace_.most};
    const Vec3 r = vehicle.p - state_.p;
    const double t = with_mean_speed([&](double s) { return meeting_time(r, vehicle.v, s); },
                                     [&](double after) { return now.way(after); }, 1);
    return vehicle.p + t * vehicle.v + meeting_error_;
  }

  Vec3 heading_, meeting_error_;
  Pace pace_;
  double rate_, release_, moved_ = 0;
  bool pursues_, turns_ = true;
};

// State of a ballistic obstacle, or its derivative.
struct Throw {
  Vec3 p, v;
};
Throw operator+(const Throw& a, const Throw& b) { return {a.p + b.p, a.v + b.v}; }
Throw operator*(double s, const Throw& a) { return {s * a.p, s * a.v}; }

Vec3 fall(Vec3 v, double drag) { return -kFallGravity * e3 - drag * norm(v) * v; }

Throw flown(const Throw& from, double dt, double drag) {
  if (drag == 0) return {from.p + dt * from.v - kFallGravity * dt * dt / 2 * e3, from.v - kFallGravity * dt * e3};
  const double steps = std::ceil(dt / kLongestBallistic);
  Throw x = from;
  for (double i = 0; i < steps; ++i)
    x = rk4_step(x, dt / steps, [&](double, const Throw& at) { return Throw{at.v, fall(at.v, drag)}; });
  return x;
}

class Thrown final : public Starting {
 public:
  Thrown(double start_s, Vec3 p, Vec3 v, double drag) : Starting(start_s, p), now_{p, v}, drag_(drag) {
    if (start_s == 0) state_.v = v, state_.a = fall(v, drag);
  }

 private:
  void move(double dt, const Kinematics&) override {
    now_ = flown(now_, dt, drag_);
    state_ = {now_.p, now_.v, fall(now_.v, drag_)};
  }

  Throw now_;
  double drag_;
};

class Flown final : public Starting {
 public:
  Flown(double start_s, const FlownBody& pilot, Vec3 p, ReferenceCurve path)
      : Starting(start_s, p), pilot_(pilot), plant_(pilot.body), path_(std::move(path)) {
    State x;
    x.p = p;
    plant_.reset(x);
  }

 private:
  void move(double dt, const Kinematics&) override {
    const double steps = std::ceil(dt / kLongestStep - 1e-6);
    for (double i = 0; i < steps; ++i) {
      const Nominal desired = track(pilot_.body, pilot_.gains, plant_.state(), path_.at(plant_.time()));
      plant_.step(dt / steps, pilot_.body.limited(desired.wrench));
      plant_.switch_shadow();
    }
    state_ = {plant_.state().p, plant_.state().v, plant_.acceleration()};
  }

  FlownBody pilot_;
  Plant plant_;
  ReferenceCurve path_;
};

ReferenceCurve path_through(const std::vector<Vec3>& points, const Leg& leg) {
  std::vector<double> time{0}, coefficient((points.size() - 1) * 32, 0.0);
  for (std::size_t k = 0; k + 1 < points.size(); ++k) {
    const Vec3 way = points[k + 1] - points[k];
    const double T = leg.time(norm(way)), x4 = 1 / (T * T * T * T);
    for (int d = 0; d < 3; ++d) {
      double* c = coefficient.data() + 32 * k + 8 * static_cast<std::size_t>(d);
      c[0] = points[k][d];
      c[4] = 35 * way[d] * x4, c[5] = -84 * way[d] * x4 / T;
      c[6] = 70 * way[d] * x4 / (T * T), c[7] = -20 * way[d] * x4 / (T * T * T);
    }
    time.push_back(time.back() + T);
  }
  return {time, coefficient};
}

}  // namespace

std::unique_ptr<ObstacleMotion> move_straight(double start_s, Vec3 p, Vec3 heading, const Pace& pace) {
  return std::make_unique<Straight>(start_s, p, heading, pace);
}

std::unique_ptr<ObstacleMotion> move_curving(const ObstacleSpec& spec, Vec3 p, Vec3 heading, const Pace& pace,
                                             Vec3 meeting_error) {
  return std::make_unique<Curving>(spec, p, heading, pace, meeting_error);
}

std::unique_ptr<ObstacleMotion> move_thrown(double start_s, Vec3 p, Vec3 v, double drag) {
  return std::make_unique<Thrown>(start_s, p, v, drag);
}

// The velocity at which a throw from p is at `target` after t.
Vec3 throw_velocity(Vec3 p, Vec3 target, double t, double drag) {
  Vec3 v = 1 / t * (target - p) + kFallGravity * t / 2 * e3;
  for (int round = 0; drag > 0; ++round) {
    const Vec3 miss = target - flown({p, v}, t, drag).p;
    if (norm(miss) < kSamePlace) break;
    // Without gravity it flies log(1 + c) / (drag |v|) far, c = drag |v| t: this change of speed corrects a miss
    // across the path, and a part of one along it.
    const double c = drag * norm(v) * t;
    if (round == 500 || !(c < kMostDrag))
      throw std::invalid_argument("with this drag no throw reaches the meeting point");
    v += c / (std::log1p(c) * t) * miss;
  }
  return v;
}

std::unique_ptr<ObstacleMotion> move_flown(double start_s, const FlownBody& pilot, const std::vector<Vec3>& points,
                                           const Leg& leg) {
  return std::make_unique<Flown>(start_s, pilot, points.front(), path_through(points, leg));
}

}  // namespace alula::flight
