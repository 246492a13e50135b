// Bindings of alula/flight/obstacle_motion.hpp and alula/tracking/radar.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <string>

#include "alula/flight/meeting.hpp"
#include "alula/tracking/radar.hpp"
#include "flight_arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

using Pair = std::array<double, 2>;
using InKinematics = In<double, nb::shape<-1, 9>>;  // p, v, a
using Scans = nb::typed<nb::dict, nb::str, nb::any>;

Range range_of(const Pair& pair) { return {pair[0], pair[1]}; }
Pair pair_of(const Range& range) { return {range.from, range.to}; }

template <class Kind, std::size_t N>
Kind kind_of(const std::array<const char*, N>& names, const std::string& name) {
  for (std::size_t i = 0; i < N; ++i)
    if (name == names[i]) return static_cast<Kind>(i);
  std::string all;
  for (const char* known : names) all += std::string(all.empty() ? "" : ", ") + known;
  throw std::invalid_argument("a kind is one of " + all);
}

constexpr std::array kMotions{"constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"};
constexpr std::array kSensors{"radar", "ideal", "mocap"};

Kinematics kinematics_at(const double* row) {
  using geometry::from_rows;
  return {from_rows(row), from_rows(row + 3), from_rows(row + 6)};
}

void bind_spec(nb::module_& m) {
  const ObstacleSpec d;
  nb::class_<ObstacleSpec>(m, "ObstacleSpec",
                           "A moving obstacle, to be drawn for each trial: alula/flight/obstacle_motion.hpp.\n\n"
                           "Kinds: constant-velocity, accelerating, curving, ballistic, quadrotor. Pairs are ranges; "
                           "angles in radian.")
      .def(
          "__init__",
          [](ObstacleSpec* self, const std::string& kind, double radius, bool is_relative, const Triple& position,
             double distance, const Pair& azimuth, const Pair& elevation, bool either_side, bool crosses,
             const Triple& offset_sigma, const Pair& speed, const Pair& heading, const Pair& acceleration,
             const Triple& velocity, bool aims_at_vehicle, const Triple& meeting_sigma, double max_speed,
             double turn_rate, double release, double drag, double start, const std::vector<Triple>& way_points,
             const std::optional<Quadrotor>& body, const std::optional<TrackingGains>& gains) {
            ObstacleSpec spec;
            spec.kind = kind_of<MotionKind>(kMotions, kind);
            spec.radius_m = radius;
            spec.is_relative = is_relative;
            spec.position = vector_of(position);
            spec.distance_m = distance;
            spec.azimuth = range_of(azimuth), spec.elevation = range_of(elevation);
            spec.either_side = either_side, spec.crosses = crosses;
            spec.offset_sigma = vector_of(offset_sigma);
            spec.speed_m_s = range_of(speed), spec.heading = range_of(heading);
            spec.acceleration_m_s2 = range_of(acceleration);
            spec.velocity = vector_of(velocity);
            spec.aims_at_vehicle = aims_at_vehicle;
            spec.meeting_sigma = vector_of(meeting_sigma);
            spec.max_speed_m_s = max_speed, spec.turn_rate_rad_s = turn_rate, spec.release_m = release;
            spec.drag_per_m = drag, spec.start_s = start;
            for (const Triple& point : way_points) spec.way_points.push_back(vector_of(point));
            if (body.has_value() != gains.has_value())
              throw std::invalid_argument("a body needs its gains, and gains a body");
            if (body) spec.pilot = {*body, *gains};
            check(spec);
            new (self) ObstacleSpec(std::move(spec));
          },
          nb::kw_only(), "kind"_a = kMotions[0], "radius_m"_a = d.radius_m, "is_relative"_a = d.is_relative,
          "position"_a = triple_of(d.position), "distance_m"_a = d.distance_m, "azimuth_rad"_a = pair_of(d.azimuth),
          "elevation_rad"_a = pair_of(d.elevation), "either_side"_a = d.either_side, "crosses"_a = d.crosses,
          "offset_sigma_m"_a = triple_of(d.offset_sigma), "speed_m_s"_a = pair_of(d.speed_m_s),
          "heading_rad"_a = pair_of(d.heading), "acceleration_m_s2"_a = pair_of(d.acceleration_m_s2),
          "velocity_m_s"_a = triple_of(d.velocity), "aims_at_vehicle"_a = d.aims_at_vehicle,
          "meeting_sigma_m"_a = triple_of(d.meeting_sigma), "max_speed_m_s"_a = d.max_speed_m_s,
          "turn_rate_rad_s"_a = d.turn_rate_rad_s, "release_m"_a = d.release_m, "drag_per_m"_a = d.drag_per_m,
          "start_s"_a = d.start_s, "way_points"_a = std::vector<Triple>{}, "body"_a = nb::none(),
          "gains"_a = nb::none())
      .def_prop_ro(
          "kind", [](const ObstacleSpec& self) { return std::string(kMotions[static_cast<std::size_t>(self.kind)]); })
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
      "What an obstacle does beside a vehicle whose states at k dt are rows (p, v, a) (N, 9), of each trial, shape "
      "(trials, N, 9).");
  m.def(
      "meeting_time",
      [](const Triple& r, const Triple& v, double s) { return meeting_time(vector_of(r), vector_of(v), s); }, "r"_a,
      "v"_a, "s"_a, "The least t with |r + v t| = s t; where there is none, that of the nearest approach.");
}

void bind_radar(nb::module_& m) {
  const RadarOptions d;
  nb::class_<RadarOptions>(
      m, "RadarOptions", "A sensor of obstacles: alula/tracking/radar.hpp. Kinds: radar, ideal (all, always), mocap.")
      .def(
          "__init__",
          [](RadarOptions* self, const std::string& kind, double rate, double half_azimuth, double half_elevation,
             double max_range, double probability, double sigma_range, double sigma_azimuth, double sigma_elevation,
             double sigma_range_rate, double clutter, double clutter_range_rate, double noise_scale,
             double position_sigma, double delay, double own_position, double own_velocity) {
            const RadarOptions options{kind_of<SensorKind>(kSensors, kind),
                                       rate,
                                       half_azimuth,
                                       half_elevation,
                                       max_range,
                                       probability,
                                       sigma_range,
                                       sigma_azimuth,
                                       sigma_elevation,
                                       sigma_range_rate,
                                       clutter,
                                       clutter_range_rate,
                                       noise_scale,
                                       position_sigma,
                                       delay,
                                       own_position,
                                       own_velocity};
            check(options);
            new (self) RadarOptions(options);
          },
          nb::kw_only(), "kind"_a = kSensors[0], "rate_hz"_a = d.rate_hz, "half_azimuth_rad"_a = d.half_azimuth_rad,
          "half_elevation_rad"_a = d.half_elevation_rad, "max_range_m"_a = d.max_range_m,
          "detection_probability"_a = d.detection_probability, "sigma_range_m"_a = d.sigma_range_m,
          "sigma_azimuth_rad"_a = d.sigma_azimuth_rad, "sigma_elevation_rad"_a = d.sigma_elevation_rad,
          "sigma_range_rate_m_s"_a = d.sigma_range_rate_m_s, "clutter_per_scan"_a = d.clutter_per_scan,
          "clutter_range_rate_m_s"_a = d.clutter_range_rate_m_s, "noise_scale"_a = d.noise_scale,
          "position_sigma_m"_a = d.position_sigma_m, "delay_s"_a = d.delay_s,
          "own_position_sigma_m"_a = d.own_position_sigma_m, "own_velocity_sigma_m_s"_a = d.own_velocity_sigma_m_s)
      .def_ro("rate_hz", &RadarOptions::rate_hz)
      .def_ro("delay_s", &RadarOptions::delay_s);
  nb::class_<FieldOfView>(m, "FieldOfView", "Where a scan could find something.")
      .def(
          "__init__",
          [](FieldOfView* self, const Triple& position, double yaw, double half_azimuth, double half_elevation,
             double max_range) {
            new (self) FieldOfView{vector_of(position), yaw, half_azimuth, half_elevation, max_range};
          },
          nb::kw_only(), "position"_a, "yaw"_a = 0.0, "half_azimuth_rad"_a = d.half_azimuth_rad,
          "half_elevation_rad"_a = d.half_elevation_rad, "max_range_m"_a = d.max_range_m,
          "Of a sensor at a position [m], levelled, looking along yaw [rad].")
      .def(
          "holds",
          [](const FieldOfView& self, const Triple& mean, const std::array<Triple, 3>& covariance, double margin) {
            geometry::Mat3 m;
            for (std::size_t k = 0; k < 3; ++k)
              for (std::size_t l = 0; l < 3; ++l) m[static_cast<int>(k)][static_cast<int>(l)] = covariance[k][l];
            return self.holds(vector_of(mean), m, margin);
          },
          "mean"_a, "covariance"_a, "margin"_a,
          "Whether it has all within `margin` standard deviations of the range and of both angles.");

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
      "Detections of scans at states (N, 9), headings (N,) and truths (N, obstacles, 9); `scan` says of which one.");
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
      "What a vehicle at states (N, 9) believes of itself.");
}

}  // namespace
}  // namespace alula::flight

void bind_moving_world(nb::module_& m) {
  alula::flight::bind_spec(m);
  alula::flight::bind_radar(m);
}
