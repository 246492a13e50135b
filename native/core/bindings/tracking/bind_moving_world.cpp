// Bindings of alula/flight/{obstacle_motion,moving_world,encounter_watch}.hpp and alula/tracking/radar.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <string>

#include "alula/flight/encounter_watch.hpp"
#include "alula/flight/meeting.hpp"
#include "alula/flight/moving_world.hpp"
#include "alula/tracking/radar.hpp"
#include "fields.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

namespace flight {
namespace {

// A specification with an optional quadrotor.
struct ObstacleArguments : ObstacleSpec {
  std::optional<Quadrotor> body;
  std::optional<TrackingGains> gains;
};

struct FieldOfViewArguments : FieldOfView {
  FieldOfViewArguments() {
    const RadarOptions radar;
    half_azimuth_rad = radar.half_azimuth_rad, half_elevation_rad = radar.half_elevation_rad;
    max_range_m = radar.max_range_m;
  }
};

}  // namespace
}  // namespace flight

template <>
struct Choices<flight::MotionKind> {
  static constexpr std::array names{"constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"};
};

template <>
struct Choices<flight::SensorKind> {
  static constexpr std::array names{"radar", "ideal", "mocap"};
};

template <>
struct fields::Python<flight::Range> {
  using Pair = std::array<double, 2>;
  static std::string type() { return Python<Pair>::type(); }
  static flight::Range from(nb::handle value) {
    const auto pair = nb::cast<Pair>(value);
    return {pair[0], pair[1]};
  }
  static Pair out(const flight::Range& range) { return {range.from, range.to}; }
};

template <>
struct Fields<flight::ObstacleArguments> {
  using Spec = flight::ObstacleArguments;
  static constexpr std::tuple all{
      Field{"kind", &Spec::kind, "motion: constant-velocity, accelerating, curving, ballistic or quadrotor"},
      Field{"radius_m", &Spec::radius_m, "radius [m]"},
      Field{"is_relative", &Spec::is_relative, "placed by distance and azimuth; false: at a position"},
      Field{"position", &Spec::position, "start [m]"},
      Field{"distance_m", &Spec::distance_m, "distance from the vehicle's start [m]"},
      Field{"azimuth_rad", &Spec::azimuth, "from the course [rad]"},
      Field{"elevation_rad", &Spec::elevation, "above the horizon [rad]"},
      Field{"either_side", &Spec::either_side, "draw the sign of the azimuth"},
      Field{"crosses", &Spec::crosses, "azimuth and elevation are seen from the meeting point"},
      Field{"offset_sigma_m", &Spec::offset_sigma, "standard deviation of the start, frame (course, left, up) [m]"},
      Field{"speed_m_s", &Spec::speed_m_s, "speed [m/s]"},
      Field{"heading_rad", &Spec::heading, "from the direction to the meeting point, outwards [rad]"},
      Field{"acceleration_m_s2", &Spec::acceleration_m_s2, "acceleration, or limit of a leg [m/s^2]"},
      Field{"velocity_m_s", &Spec::velocity, "initial velocity; 0: from speed and heading [m/s]"},
      Field{"aims_at_vehicle", &Spec::aims_at_vehicle, "aim at the vehicle's start"},
      Field{"meeting_sigma_m", &Spec::meeting_sigma, "standard deviation of the meeting point [m]"},
      Field{"max_speed_m_s", &Spec::max_speed_m_s, "maximum speed [m/s]"},
      Field{"turn_rate_rad_s", &Spec::turn_rate_rad_s, "maximum turn rate [rad/s]"},
      Field{"release_m", &Spec::release_m, "distance below which it stops turning [m]"},
      Field{"drag_per_m", &Spec::drag_per_m, "quadratic drag of a ballistic obstacle [1/m]"},
      Field{"start_s", &Spec::start_s, "time at which it starts to move [s]"},
      Field{"way_points", &Spec::way_points, "way-points of a quadrotor [m]"},
      Field{"body", &Spec::body, "body of a quadrotor, with its gains; default: a small one"},
      Field{"gains", &Spec::gains, "gains of its controller"}};
};

template <>
struct Fields<flight::RadarOptions> {
  using Radar = flight::RadarOptions;
  static constexpr std::tuple all{
      Field{"kind", &Radar::kind, "radar, ideal or mocap"},
      Field{"rate_hz", &Radar::rate_hz, "scans per second"},
      Field{"half_azimuth_rad", &Radar::half_azimuth_rad, "half width of the field of view [rad]"},
      Field{"half_elevation_rad", &Radar::half_elevation_rad, "half height of the field of view [rad]"},
      Field{"max_range_m", &Radar::max_range_m, "range [m]"},
      Field{"detection_probability", &Radar::detection_probability, "probability of a detection"},
      Field{"sigma_range_m", &Radar::sigma_range_m, "noise of the range [m]"},
      Field{"sigma_azimuth_rad", &Radar::sigma_azimuth_rad, "noise of the azimuth [rad]"},
      Field{"sigma_elevation_rad", &Radar::sigma_elevation_rad, "noise of the elevation [rad]"},
      Field{"sigma_range_rate_m_s", &Radar::sigma_range_rate_m_s, "noise of the range rate [m/s]"},
      Field{"clutter_per_scan", &Radar::clutter_per_scan, "mean number of false detections in a scan"},
      Field{"clutter_range_rate_m_s", &Radar::clutter_range_rate_m_s,
            "their range rates are uniform within +- this [m/s]"},
      Field{"noise_scale", &Radar::noise_scale, "factor of all sigmas"},
      Field{"position_sigma_m", &Radar::position_sigma_m, "noise of ideal and mocap per axis [m]"},
      Field{"delay_s", &Radar::delay_s, "time until the tracker receives a detection [s]"},
      Field{"own_position_sigma_m", &Radar::own_position_sigma_m, "noise of the vehicle's own position per axis [m]"},
      Field{"own_velocity_sigma_m_s", &Radar::own_velocity_sigma_m_s,
            "noise of the vehicle's own velocity per axis [m/s]"}};
};

template <>
struct Fields<flight::FieldOfViewArguments> {
  using View = flight::FieldOfViewArguments;
  static constexpr std::tuple all{Field{"position", &View::position, "position of the sensor [m]", Limits{}, true},
                                  Field{"yaw", &View::yaw, "heading, levelled [rad]"},
                                  Field{"half_azimuth_rad", &View::half_azimuth_rad, "half width [rad]"},
                                  Field{"half_elevation_rad", &View::half_elevation_rad, "half height [rad]"},
                                  Field{"max_range_m", &View::max_range_m, "range [m]"}};
};

namespace flight {
namespace {

using InKinematics = In<double, nb::shape<-1, 9>>;  // p, v, a
using Scans = nb::typed<nb::dict, nb::str, nb::any>;

Kinematics kinematics_at(const double* row) {
  using geometry::from_rows;
  return {from_rows(row), from_rows(row + 3), from_rows(row + 6)};
}

void bind_spec(nb::module_& m) {
  fields::bind_from<ObstacleSpec, ObstacleArguments>(
      m, "ObstacleSpec", "Moving obstacle, drawn for each trial: alula/flight/obstacle_motion.hpp. Pairs are ranges.",
      [](ObstacleArguments given) {
        if (given.body.has_value() != given.gains.has_value())
          throw std::invalid_argument("a body needs its gains, and gains a body");
        if (given.body) given.pilot = {*given.body, *given.gains};
        return ObstacleSpec(std::move(given));
      })
      .def_prop_ro("kind", [](const ObstacleSpec& self) { return fields::Python<MotionKind>::out(self.kind); })
      .def_ro("radius_m", &ObstacleSpec::radius_m)
      .def_ro("start_s", &ObstacleSpec::start_s);

  m.def(
      "obstacle_paths",
      [](const ObstacleSpec& spec, const InKinematics& vehicle, double dt, std::uint64_t seed, std::uint32_t first,
         std::uint32_t count, std::uint32_t obstacle) {
        if (vehicle.shape(0) == 0) throw std::invalid_argument("a vehicle has a path of one state at least");
        if (!(dt > 0) || !std::isfinite(dt)) throw std::invalid_argument("a step must be positive");
        Rows rows(count * vehicle.shape(0));
        {
          const nb::gil_scoped_release release;
          for (std::uint32_t trial = first; trial != first + count; ++trial) {
            const auto motion = draw(spec, kinematics_at(vehicle.data()), {seed, trial}, obstacle);
            for (std::size_t k = 0; k < vehicle.shape(0); ++k) {
              if (k > 0) motion->step(dt, kinematics_at(vehicle.data() + 9 * (k - 1)));
              const Kinematics& x = motion->state();
              rows.add(x.p).add(x.v).add(x.a);
            }
          }
        }
        return rows.array({count, vehicle.shape(0), 9});
      },
      "spec"_a, "vehicle"_a, nb::kw_only(), "dt_s"_a, "seed"_a = 0, "first_trial"_a = 0, "trials"_a = 1,
      "obstacle"_a = 0,
      "States of an obstacle beside a vehicle with states (p, v, a) (N, 9) at k dt, for each trial, shape "
      "(trials, N, 9).");
  m.def(
      "meeting_time",
      [](const Triple& r, const Triple& v, double s) { return meeting_time(vector_of(r), vector_of(v), s); }, "r"_a,
      "v"_a, "s"_a, "The smallest t with |r + v t| = s t; without one, the time of the nearest approach.");
}

void bind_radar(nb::module_& m) {
  fields::bind<RadarOptions>(m, "RadarOptions", "Obstacle sensor: alula/tracking/radar.hpp.");
  fields::bind_from<FieldOfView, FieldOfViewArguments>(
      m, "FieldOfView", "Field of view of a scan.",
      [](const FieldOfViewArguments& given) { return FieldOfView(given); })
      .def(
          "holds",
          [](const FieldOfView& self, const Triple& mean, const std::array<Triple, 3>& covariance, double margin) {
            geometry::Mat3 m;
            for (std::size_t k = 0; k < 3; ++k)
              for (std::size_t l = 0; l < 3; ++l) m[static_cast<int>(k)][static_cast<int>(l)] = covariance[k][l];
            return self.holds(vector_of(mean), m, margin);
          },
          "mean"_a, "covariance"_a, "margin"_a,
          "True if it contains all points within `margin` standard deviations of the range and of both angles.");

  m.def(
      "radar_scans",
      [](const RadarOptions& options, const InKinematics& vehicle, const InVector<double>& yaw,
         const In<double, nb::shape<-1, -1, 9>>& truth, std::uint64_t seed, std::uint32_t trial,
         std::uint64_t first_step) {
        const std::size_t scans = vehicle.shape(0), obstacles = truth.shape(1);
        require_rows(yaw.size(), scans), require_rows(truth.shape(0), scans);
        std::vector<Detection> all;
        std::vector<std::int64_t> of;
        {
          const nb::gil_scoped_release release;
          std::vector<Kinematics> there(obstacles);
          for (std::size_t k = 0; k < scans; ++k) {
            for (std::size_t i = 0; i < obstacles; ++i)
              there[i] = kinematics_at(truth.data() + 9 * (k * obstacles + i));
            scan(options, kinematics_at(vehicle.data() + 9 * k), yaw.data()[k], there, {seed, trial}, first_step + k,
                 all);
            of.resize(all.size(), static_cast<std::int64_t>(k));
          }
        }
        const std::size_t n = all.size();
        Rows position(n), covariance(n), los(n), rate(n), sigma(n);
        std::vector<std::uint8_t> has_doppler;
        for (const Detection& d : all) {
          position.add(d.position), covariance.add(d.covariance), los.add(d.los);
          rate.add(d.range_rate), sigma.add(d.range_rate_sigma);
          has_doppler.push_back(d.has_doppler ? 1 : 0);
        }
        Scans result;
        result["scan"] = to_numpy(std::move(of), {n});
        result["position"] = position.array({n, 3});
        result["covariance"] = covariance.array({n, 3, 3});
        result["has_doppler"] = to_numpy(std::move(has_doppler), {n});
        result["los"] = los.array({n, 3});
        result["range_rate"] = rate.array({n});
        result["range_rate_sigma"] = sigma.array({n});
        return result;
      },
      "options"_a, "vehicle"_a, "yaw"_a, "truth"_a, nb::kw_only(), "seed"_a = 0, "trial"_a = 0, "first_step"_a = 0,
      "Detections of scans at states (N, 9), headings (N,) and truths (N, obstacles, 9); `scan` is the number of the "
      "scan.");
  m.def(
      "own_states",
      [](const RadarOptions& options, const InKinematics& vehicle, std::uint64_t seed, std::uint32_t trial,
         std::uint64_t first_step) {
        Rows rows(vehicle.shape(0));
        for (std::size_t k = 0; k < vehicle.shape(0); ++k) {
          const Kinematics own =
              own_state(options, kinematics_at(vehicle.data() + 9 * k), {seed, trial}, first_step + k);
          rows.add(own.p).add(own.v).add(own.a);
        }
        return rows.array({vehicle.shape(0), 9});
      },
      "options"_a, "vehicle"_a, nb::kw_only(), "seed"_a = 0, "trial"_a = 0, "first_step"_a = 0,
      "Measurements of its own state by a vehicle at states (N, 9).");
}

void bind_moving(nb::module_& m) {
  nb::class_<MovingSpec>(m, "MovingSpec", "What moves around a vehicle, and how it senses that.")
      .def(
          "__init__",
          [](MovingSpec* self, std::vector<ObstacleSpec> obstacles, const RadarOptions& radar,
             const TrackerOptions& tracker, double yaw_rate_rad_s) {
            MovingSpec spec{std::move(obstacles), radar, tracker, yaw_rate_rad_s};
            check(spec);
            new (self) MovingSpec(std::move(spec));
          },
          nb::kw_only(), "obstacles"_a = std::vector<ObstacleSpec>{}, "radar"_a = RadarOptions{},
          "tracker"_a = TrackerOptions{}, "yaw_rate_rad_s"_a = MovingSpec{}.yaw_rate_rad_s,
          "yaw_rate_rad_s: maximum rate at which the sensor turns; 0: it looks along the course.");
  m.def(
      "collision_risk",
      [](const Triple& position, const Triple& velocity, const std::array<double, 21>& covariance,
         const Triple& command, double radius, double window) {
        const alula_vehicle_state vehicle{};
        alula_track track{};
        for (std::size_t k = 0; k < 3; ++k) {
          track.position[k] = static_cast<float>(position[k]);
          track.velocity[k] = static_cast<float>(velocity[k]);
        }
        for (std::size_t k = 0; k < 21; ++k) track.covariance[k] = static_cast<float>(covariance[k]);
        return risk_of(track, vehicle, vector_of(command), radius, window);
      },
      "position"_a, "velocity"_a, "covariance"_a, "command"_a, "radius"_a, "window_s"_a,
      "Collision risk of an obstacle relative to the vehicle, covariance of (p, v) as a lower triangle row by row: "
      "bound on the probability that it is within the radius when it comes closest in the window.");
  m.def(
      "closest_approach",
      [](const Triple& r0, const Triple& r1, const Triple& a, double h) {
        return closest_approach(vector_of(r0), vector_of(r1), vector_of(a), h);
      },
      "r0"_a, "r1"_a, "a"_a, "h"_a,
      "Minimum |r(t)|, 0 <= t <= h, of the parabola from r0 to r1 with acceleration a.");
}

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_moving_world(nb::module_& m) {
  alula::flight::bind_spec(m);
  alula::flight::bind_radar(m);
  alula::flight::bind_moving(m);
}
