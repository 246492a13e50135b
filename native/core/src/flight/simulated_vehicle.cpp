#include "alula/flight/simulated_vehicle.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

#include "alula/filters/adapters.hpp"

namespace alula::flight {
namespace {

using geometry::norm;

PlantOptions without_sensor(PlantOptions options) {
  options.sensor = {};
  return options;
}

Quadrotor scaled(const Quadrotor& body, double scale) {
  if (scale == 1) return body;
  return {scale * body.mass(), scale * body.inertia(), body.rotors(), body.gravity()};
}

}  // namespace

bool is_finite(const Command& c) {
  switch (c.interface) {
    case Interface::velocity:
      return geometry::is_finite(c.velocity);
    case Interface::acceleration:
      return geometry::is_finite(c.acceleration);
    case Interface::wrench:
      return is_finite(c.wrench);
    case Interface::body_rates:
      return std::isfinite(c.wrench.thrust) && geometry::is_finite(c.rates);
    case Interface::sticks:
      return is_finite(c.sticks);
  }
  return false;
}

void check(const VehicleSpec& spec) {
  const auto require = [](bool good, const char* what) {
    if (!good) throw std::invalid_argument(what);
  };
  const auto is = [&](Interface interface) { return spec.interface == interface; };
  switch (spec.model) {
    case VehicleModel::single_integrator:
      require(is(Interface::velocity), "a single integrator is commanded by velocity");
      break;
    case VehicleModel::double_integrator:
      require(is(Interface::velocity) || is(Interface::acceleration),
              "a double integrator is commanded by acceleration or velocity");
      break;
    case VehicleModel::quadrotor:
      require(!is(Interface::sticks), "a quadrotor by sticks is a racer");
      break;
    case VehicleModel::racer:
      require(is(Interface::sticks), "a racer is commanded by sticks");
      break;
  }
  check(spec.gains), check(spec.plant), check(spec.assumed), check(spec.racer), check(spec.following);
  require(
      has_rate_loop(spec.rate_time_constant_s) && spec.max_rate.x > 0 && spec.max_rate.y > 0 && spec.max_rate.z > 0,
      "the rate loop needs a time constant and limits above 0");
  require(spec.velocity_gain > 0 && spec.max_speed > 0 && spec.max_acceleration > 0 && spec.max_jerk > 0 &&
              spec.actuation_delay_s >= 0 && spec.actuation_delay_s <= 10 && spec.radius_m >= 0 &&
              spec.mass_scale >= 0.01 && spec.mass_scale <= 100 && spec.rate_gain_scale >= 0.01 &&
              spec.rate_gain_scale <= 100,
          "gains, limits and scales of a vehicle must be positive");
}

Vec3 velocity_loop(const VehicleSpec& spec, Vec3 commanded, Vec3 v) {
  const Vec3 a = spec.velocity_gain * (commanded - v);
  const double length = norm(a);
  return length > spec.max_acceleration ? spec.max_acceleration / length * a : a;
}

SimulatedVehicle::SimulatedVehicle(const VehicleSpec& spec, double dt_s, int plant_steps, const RandomStream& random)
    : spec_(spec),
      h_(dt_s / plant_steps),
      body_(scaled(spec.body, spec.mass_scale), without_sensor(spec.plant), random),
      point_(spec.max_acceleration),
      limited_({spec.max_speed, spec.max_jerk, spec.actuation_delay_s}, h_),
      racer_(spec.racer, spec.racer_options, random),
      sensor_(spec.plant.sensor, random),
      autopilot_(spec.following),
      is_limited_(has_inner_limits(spec)) {}

void SimulatedVehicle::reset(const State& x, const std::optional<Vec4>& attitude) {
  x_ = x;
  time_ = 0, steps_ = 0;
  point_acceleration_ = {};
  switch (spec_.model) {
    case VehicleModel::single_integrator:
      break;
    case VehicleModel::double_integrator:
      is_limited_ ? limited_.reset({x.p, x.v, {}}) : point_.reset(x);
      break;
    case VehicleModel::quadrotor:
      body_.reset(x), autopilot_.reset(x);
      break;
    case VehicleModel::racer:
      racer_.reset(to_racer(x, attitude));
      break;
  }
  sensor_.reset(x_);
}

// The attitude and rate loops of the vehicle for an acceleration, from its true state.
Wrench SimulatedVehicle::wrench_of_acceleration(Vec3 a) const {
  ReferencePoint here = reference_for(x_.p, x_.v, command_.yaw);
  here.a = a;
  return track(spec_.body, spec_.gains, x_, here).wrench;
}

Wrench SimulatedVehicle::wrench_of_rates() const {
  Wrench u = held_;
  Vec3 time_constant = spec_.rate_time_constant_s;
  for (int i = 0; i < 3; ++i) time_constant[i] = time_constant[i] / spec_.rate_gain_scale;
  u.torque = rate_loop_torque(spec_.body, x_.omega, command_.rates, time_constant);
  return spec_.body.limited(u);
}

void SimulatedVehicle::command(const Command& command) {
  if (!is_finite(command)) throw std::logic_error("a command is not finite");
  command_ = command;
  if (spec_.model == VehicleModel::double_integrator) {
    const Vec3 a = command.interface == Interface::velocity ? velocity_loop(spec_, command.velocity, x_.v)
                                                            : command.acceleration;
    point_acceleration_ = a;
    if (is_limited_) limited_.command(a);
  } else if (spec_.model == VehicleModel::quadrotor && !is_shaped()) {
    if (command.interface == Interface::velocity)
      held_ = track(spec_.body, holding(spec_), x_, reference_for(x_.p, command.velocity, command.yaw)).wrench;
    else if (command.interface == Interface::acceleration)
      held_ = wrench_of_acceleration(command.acceleration);
    else
      held_ = command.wrench;
    if (command.interface < Interface::wrench) held_ = spec_.body.limited(held_);
  }
}

void SimulatedVehicle::step() {
  switch (spec_.model) {
    case VehicleModel::single_integrator: {
      const double speed = norm(command_.velocity);
      x_.v = command_.velocity;
      if (speed > spec_.max_speed * (1 + 1e-12)) x_.v = spec_.max_speed / speed * command_.velocity;
      for (int i = 0; i < 3; ++i) x_.p[i] += x_.v[i] * h_;
      break;
    }
    case VehicleModel::double_integrator:
      if (is_limited_) {
        limited_.step();
        x_.p = limited_.state().p, x_.v = limited_.state().v;
      } else {
        point_.step(h_, point_acceleration_);
        x_ = point_.state();
      }
      break;
    case VehicleModel::quadrotor:
      if (is_shaped()) {
        const bool is_velocity = command_.interface == Interface::velocity;
        held_ = spec_.body.limited(
            wrench_of_acceleration(is_velocity ? autopilot_.follow_velocity(h_, command_.velocity, x_)
                                               : autopilot_.follow_acceleration(h_, command_.acceleration, x_)));
      }
      body_.step(h_, command_.interface == Interface::body_rates ? wrench_of_rates() : held_);
      x_ = body_.state();
      break;
    case VehicleModel::racer:
      racer_.step(h_, command_.sticks);
      x_ = from_racer(racer_.state());
      break;
  }
  time_ += h_, ++steps_;
  sensor_.record(time_, x_);
}

void SimulatedVehicle::end_tick() {
  if (spec_.model != VehicleModel::quadrotor) return;
  body_.switch_shadow();
  x_ = body_.state();
}

Vec3 SimulatedVehicle::acceleration() const {
  switch (spec_.model) {
    case VehicleModel::single_integrator:
      return {};
    case VehicleModel::double_integrator:
      return is_limited_ ? limited_.state().a : point_.acceleration();
    case VehicleModel::quadrotor:
      return body_.acceleration();
    case VehicleModel::racer:
      break;
  }
  // Of the thrust alone, without drag; only obstacles that aim and the log's curvature use it.
  return spec_.racer.acceleration(command_.sticks.throttle) * racer_axis(racer_.state().q) -
         spec_.racer.gravity * geometry::e3;
}

State SimulatedVehicle::measured() const {
  State x = sensor_.measured(steps_);
  if (spec_.model == VehicleModel::quadrotor || spec_.model == VehicleModel::racer) x.sigma = shadowed(x.sigma);
  return x;
}

std::optional<Vec4> SimulatedVehicle::attitude_of(const State& measured) const {
  const Vec3 sigma = shadowed(x_.sigma);
  if (spec_.model != VehicleModel::racer || std::memcmp(&sigma, &measured.sigma, sizeof sigma) != 0) return {};
  return racer_.state().q;
}

}  // namespace alula::flight
