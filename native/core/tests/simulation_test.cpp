// Simulated encounters fly the command within the limits of the vehicle, and their metrics are those of the true
// motion, also between steps. Flights among hulls and along references on several threads, and filters that
// misbehave.
#include "alula/flight/simulation.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <stdexcept>

#include "alula/filters/adapters.hpp"
#include "alula/filters/cone_di.hpp"
#include "check.hpp"

namespace alula::flight {
namespace {

using geometry::Vec3;

using Answer = std::function<MovingReport(int tick, std::span<const alula_track>, std::span<const alula_wall>, Vec3)>;

MovingReport flown(Vec3 a, std::uint8_t mode = ALULA_NOMINAL) {
  MovingReport report;
  report.status = MovingStatus::ok;
  report.acceleration = a;
  report.mode = mode;
  return report;
}

// A filter that returns the test's report in each tick.
class Scripted final : public MovingFilter {
 public:
  explicit Scripted(Answer answer, std::vector<Vec3>* flown = nullptr) : answer_(std::move(answer)), flown_(flown) {}
  MovingReport filter(const alula_vehicle_state&, std::span<const alula_track> tracks,
                      std::span<const alula_wall> walls, Vec3 nominal) override {
    return answer_(tick_++, tracks, walls, nominal);
  }
  void flown(Vec3 a) override {
    if (flown_ != nullptr) flown_->push_back(a);
  }
  void reset() override { tick_ = 0; }
  std::unique_ptr<MovingFilter> clone() const override { return std::make_unique<Scripted>(answer_, flown_); }

 private:
  Answer answer_;
  int tick_ = 0;
  std::vector<Vec3>* flown_;  // the commands flown instead
};

Scripted nominal() {
  return Scripted([](int, auto, auto, Vec3 a) { return flown(a); });
}

// A point that flies from 10 m above the origin at 4 m/s along x, among moving obstacles and walls.
struct Scene {
  SimulationSpec spec{.vehicle = {.body = small_quadrotor().body}};
  Task task;
  std::shared_ptr<const ObstacleMap> walls;

  Scene() {
    VehicleSpec& v = spec.vehicle;
    v.model = VehicleModel::double_integrator, v.interface = Interface::acceleration;
    v.max_speed = 12, v.max_acceleration = 6, v.max_jerk = 60, v.radius_m = 0.15;
    spec.rules.receded_s = 1, spec.rules.ends_when_refused = false, spec.rules.ends_at_goal = false;
    spec.moving.radar.kind = SensorKind::ideal;
    task.start.p = {0, 0, 10}, task.start.v = {4, 0, 0};
    task.mission.kind = MissionKind::goal, task.mission.goal = {200, 0, 10}, task.mission.speed = 4;
    task.max_time_s = 14;
  }
};

std::vector<SimulatedFlight> fly(const Scene& scene, const MovingFilter& filter, std::uint32_t first = 0,
                                 std::uint32_t count = 1, unsigned jobs = 1) {
  Control control;
  const VehicleSpec& v = scene.spec.vehicle;
  const MovingSafety safety(filter.clone(), {scene.walls, v.max_speed, v.max_acceleration, v.radius_m});
  const SafetyFilter* const filters[] = {&safety};
  const std::vector<Task> tasks(count, scene.task);
  return simulate(scene.spec, tasks, filters, 7, first, jobs, control);
}

ObstacleSpec ahead(Vec3 position, Vec3 velocity) {
  ObstacleSpec o;
  o.is_relative = false;
  o.position = position;
  o.velocity = velocity;
  return o;
}

void test_the_closest_approach_is_that_of_the_parabola() {
  const RandomStream random{1, 0};
  for (std::uint64_t i = 0; i < 2000; ++i) {
    const Vec3 r0 = random.normals(i, 1), v = 3 * random.normals(i, 2), a = 5 * random.normals(i, 3);
    const double h = i % 2 ? 0.05 : 0.001;
    const auto at = [&](double t) { return r0 + t * v + t * t / 2 * a; };
    double smallest = INFINITY;
    for (int k = 0; k <= 2000; ++k) smallest = std::min(smallest, norm(at(h * k / 2000)));
    const double found = closest_approach(r0, at(h), a, h);
    CHECK(found <= smallest + 1e-12 + norm(a) * h * h / 8);
    CHECK(found >= smallest - 1e-4 * h * norm(v) - 1e-9);
    CHECK(found <= std::min(norm(r0), norm(at(h))) + 1e-12);
  }
  CHECK(closest_approach({1, 0, 0}, {1, 0, 0}, {}, 0.01) == 1);
  CHECK(std::abs(closest_approach({-1, 0.5, 0}, {1, 0.5, 0}, {}, 0.01) - 0.5) < 1e-15);
}

void test_the_plant_is_late_and_keeps_its_limits() {
  EncounterPlant plant({.max_speed_m_s = 2, .max_jerk_m_s3 = 60, .actuation_delay_s = 0.025}, 0.001);
  plant.reset({{1, 2, 3}, {}, {}});
  plant.command({6, -3, 0});
  int begun = -1, speed_reached = -1;
  Kinematics last = plant.state();
  for (int k = 0; k < 1000; ++k) {
    if (k == 10) plant.command({6, -3, 0});
    plant.step();
    const Kinematics& x = plant.state();
    if (begun < 0 && norm(x.a) > 0) begun = k;
    if (speed_reached < 0 && norm(x.v) > 2 - 1e-9) speed_reached = k;
    for (int i = 0; i < 3 && speed_reached < 0; ++i) CHECK(std::abs(x.a[i] - last.a[i]) <= 0.06 + 1e-12);
    CHECK(norm(x.v) <= 2 + 1e-12);
    const Vec3 moved = last.p + 0.001 * last.v + 5e-7 * x.a;
    CHECK(norm(moved - x.p) < 1e-12);
    last = x;
  }
  CHECK(begun == 25 && speed_reached > 0);
  plant.reset({});
  for (int k = 0; k < 30; ++k) plant.step();
  CHECK(norm(plant.state().v) == 0);  // earlier commands have no effect after the reset
}

void test_an_obstacle_that_is_not_avoided_comes_as_near_as_geometry_says() {
  Scene scene;
  scene.spec.moving.obstacles = {ahead({50, 1, 10}, {-6, 0, 0}), ahead({50, 0.2, 10}, {-6, 0, 0})};
  const SimulatedFlight log = fly(scene, nominal())[0];
  const EncounterLog& met = log.encounters;
  CHECK(std::abs(met.obstacle[0].closest_m - 1) < 1e-9 && std::abs(met.obstacle[1].closest_m - 0.2) < 1e-9);
  CHECK(log.end == End::passed && met.active_ticks == 0 && met.filtered_ticks == 0);
  CHECK(std::abs(static_cast<double>(log.ticks) * 0.01 - (5 + 1)) < 0.025);  // met after 5 s, receding for one
  CHECK(std::isnan(met.obstacle[0].warned_s) && std::isnan(met.obstacle[0].separation_m));
  CHECK(std::abs(log.path_length_m - 4 * 0.01 * static_cast<double>(log.ticks)) < 1e-6);
  CHECK(std::abs(log.max_speed_m_s - 4) < 1e-9 && log.max_jerk_m_s3 < 1e-6);
  CHECK(met.obstacle[0].detected_s < 0.5);
}

void test_a_flight_that_is_not_logged_has_the_same_metrics() {
  Scene scene;
  scene.spec.moving.obstacles = {ahead({50, 0.2, 10}, {-6, 0, 0})};
  const SimulatedFlight log = fly(scene, nominal())[0];
  scene.spec.rules.keeps_path = scene.spec.rules.keeps_ticks = false;
  const SimulatedFlight bare = fly(scene, nominal())[0];
  CHECK(bare.path.empty() && bare.state.empty() && bare.tracks.empty() && bare.estimate.empty() && bare.rows.empty());
  CHECK(bare.mark == log.mark && bare.margin == log.margin && bare.status == log.status && bare.flags == log.flags);
  CHECK(bare.ticks == log.ticks && bare.end == log.end && bare.path_length_m == log.path_length_m);
  CHECK(bare.encounters.obstacle[0].closest_m == log.encounters.obstacle[0].closest_m);
  CHECK(bare.encounters.mission_risk == log.encounters.mission_risk && bare.encounters.mission_risk > 0);
}

void test_warnings_and_manoeuvres_are_timed() {
  Scene scene;
  scene.spec.moving.obstacles = {ahead({50, 1, 10}, {-6, 0, 0})};
  const Scripted filter([](int tick, std::span<const alula_track> tracks, auto, Vec3 a) {
    const std::uint8_t mode = tick < 400 ? ALULA_NOMINAL : tick < 450 ? ALULA_AVOID : ALULA_HOVER;
    MovingReport report = flown(a, tick < 480 ? mode : std::uint8_t{ALULA_NOMINAL});
    report.warned = tick >= 400 && tick < 410;
    report.urgent = report.warned && !tracks.empty() ? 0 : -1;
    if (tick >= 403 && tick < 480) report.acceleration.z += 0.06;
    return report;
  });
  const EncounterLog log = fly(scene, filter)[0].encounters;
  const EncounterMetrics& m = log.obstacle[0];
  CHECK(std::abs(m.warned_s - 4) < 1e-9 && std::abs(m.reaction_s - 0.03) < 1e-9);
  CHECK(std::abs(m.avoid_s - 0.77) < 1e-9);
  const double gap = std::hypot(50 - 10 * 4.8, 1);  // at the end of HOVER, before the closest approach
  CHECK(std::abs(m.separation_m - gap) < 0.05 && m.closest_m < 1.1);
  CHECK(std::abs(m.closing_m_s - 10 * 10 / std::hypot(10, 1)) < 1e-6);
  CHECK(log.active_ticks == 80 && log.active_tick_s.size() == 80 && m.command_s >= 0);
}

void test_what_a_filter_refuses_is_braked_within_the_box() {
  Scene scene;
  scene.task.max_time_s = 4;
  const SimulatedFlight log = fly(scene, Scripted([](int, auto, auto, Vec3) { return MovingReport{}; }))[0];
  CHECK(log.encounters.refused_ticks == 400 && log.ticks == 400 && log.end == End::timeout);
  for (const double a : log.command) CHECK(std::abs(a) <= scene.spec.vehicle.max_acceleration);
  const double* last = log.state.data() + log.state.size() - 12;
  CHECK(std::abs(last[6]) < 1e-3 && last[0] < 4.0 * 4 / 2);
}

void test_a_filter_is_notified_of_the_command_flown_where_it_refused() {
  Scene scene;
  scene.task.max_time_s = 0.1;
  std::vector<Vec3> replaced;
  const Scripted filter(
      [](int tick, auto, auto, Vec3) { return tick == 3 || tick == 4 ? MovingReport{} : flown({0, 1, 0}); },
      &replaced);
  const SimulatedFlight log = fly(scene, filter)[0];
  CHECK(replaced.size() == 2 && log.encounters.refused_ticks == 2);
  for (std::size_t i = 0; i < replaced.size(); ++i) {
    for (int k = 0; k < 3; ++k) CHECK(replaced[i][k] == log.command[11 * (3 + i) + static_cast<std::size_t>(k)]);
  }
  CHECK(replaced[0].x < -5.9);  // it brakes
}

void test_trials_do_not_depend_on_their_order() {
  Scene scene;
  scene.spec.moving.radar.kind = SensorKind::radar;
  scene.spec.moving.obstacles.resize(2);
  scene.spec.moving.obstacles[0].azimuth = {0.2, 0.5}, scene.spec.moving.obstacles[0].either_side = true;
  scene.task.max_time_s = 3;
  const std::vector<SimulatedFlight> all = fly(scene, nominal(), 0, 9, 1), many = fly(scene, nominal(), 0, 9, 3);
  const SimulatedFlight alone = fly(scene, nominal(), 5)[0];
  for (std::size_t i = 0; i < all.size(); ++i) {
    CHECK(all[i].state == many[i].state && all[i].obstacle == many[i].obstacle && all[i].ticks == many[i].ticks);
    CHECK(all[i].encounters.obstacle[1].closest_m == many[i].encounters.obstacle[1].closest_m);
  }
  CHECK(alone.obstacle == all[5].obstacle && alone.obstacle != all[4].obstacle);
  // Tracks may be missing (NaN), so not all numbers compare equal.
  CHECK(alone.track.size() == all[5].track.size() &&
        std::memcmp(alone.track.data(), all[5].track.data(), alone.track.size() * sizeof(double)) == 0);
}

void test_obstacles_are_drawn_to_meet_the_expected_velocity() {
  Scene scene;
  scene.spec.moving.obstacles.resize(1);
  const auto start = [](const SimulatedFlight& log) { return log.obstacle[0]; };
  const double cruising = start(fly(scene, nominal())[0]);
  scene.task.expected_velocity = Vec3{4, 0, 0};
  CHECK(start(fly(scene, nominal())[0]) == cruising);  // as the mission's
  const SimulatedFlight met = fly(scene, nominal())[0];
  CHECK(met.encounters.obstacle[0].closest_m < 0.1);
}

PolytopeSet boxes(const std::vector<std::array<double, 6>>& bounds) {
  std::vector<double> normals, offsets, vertices;
  std::vector<std::int64_t> planes{0}, corners{0};
  for (const auto& b : bounds) {
    for (std::size_t i = 0; i < 3; ++i)
      for (const double sign : {-1.0, 1.0}) {
        for (std::size_t j = 0; j < 3; ++j) normals.push_back(i == j ? sign : 0);
        offsets.push_back(sign * b[sign < 0 ? i : i + 3]);
      }
    for (std::size_t k = 0; k < 8; ++k)
      for (std::size_t i = 0; i < 3; ++i) vertices.push_back(b[(k >> i & 1U) ? i + 3 : i]);
    planes.push_back(planes.back() + 6), corners.push_back(corners.back() + 8);
  }
  return {normals, offsets, planes, vertices, corners};
}

void test_walls_are_shown_nearest_first() {
  std::vector<std::array<double, 6>> bounds{{3, 2, 9, 4, 5, 11}};  // 2 m to the left of the path
  for (int i = 0; i < 40; ++i) bounds.push_back({3, 4.0 + i, 5, 4, 4.5 + i, 15});
  Scene scene;
  scene.walls = std::make_shared<HullMap>(std::make_shared<PolytopeSet>(boxes(bounds)));
  scene.task.max_time_s = 2;
  int ticks = 0;
  const Scripted filter([&](int tick, auto, std::span<const alula_wall> seen, Vec3 a) {
    CHECK(seen.size() == ALULA_WALLS);
    for (std::size_t i = 1; i < seen.size(); ++i) CHECK(seen[i - 1].distance_m <= seen[i].distance_m);
    if (tick == 0)  // 3 m before the front of the first, whose edge is 2 m to the left
      CHECK(std::abs(seen[0].distance_m - std::hypot(3.0F, 2.0F)) < 1e-5 && seen[0].normal[0] < 0);
    if (tick == 85) CHECK(std::abs(seen[0].distance_m - 2) < 1e-6 && seen[0].normal[1] == -1);  // beside the first
    ++ticks;
    return flown(a);
  });
  fly(scene, filter);
  CHECK(ticks == 200);
}

void test_threads_change_no_flight_among_hulls() {
  static const std::vector<double> normal{1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1};
  static const std::vector<double> offset{1, 0, 1, 0, 1, 0};
  static const std::vector<std::int64_t> start{0, 6};
  auto map = std::make_shared<const PolytopeMap>(make_polytope_map({normal, offset, start}, 20));
  const VelocityFilter filter(PolytopeCbf(map, {.radius_m = 0.1}));
  SimulationSpec spec{.vehicle = {.body = small_quadrotor().body}};
  spec.vehicle.model = VehicleModel::single_integrator, spec.vehicle.interface = Interface::velocity;
  spec.vehicle.max_speed = 1, spec.rules.plant_steps = 1;
  std::vector<Task> tasks(12);
  for (std::size_t i = 0; i < tasks.size(); ++i) {
    const double y = 0.1 * static_cast<double>(i);
    tasks[i].start.p = {-2, y, 0.5}, tasks[i].max_time_s = 20;
    tasks[i].mission.kind = MissionKind::goal, tasks[i].mission.goal = {3, 1.3 - y, 0.4};
  }
  Control control;
  const SafetyFilter* const filters[] = {&filter};
  const auto one = simulate(spec, tasks, filters, 0, 0, 1, control),
             many = simulate(spec, tasks, filters, 0, 0, 7, control);
  int reached = 0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    CHECK(one[i].path == many[i].path && one[i].command == many[i].command && one[i].status == many[i].status);
    CHECK(one[i].margin == many[i].margin && one[i].end == many[i].end);
    CHECK(one[i].path.size() == 3 * (one[i].status.size() + 1));
    reached += one[i].end == End::reached;
  }
  CHECK(reached > 0);
}

const Quadrotor kBody(0.461, {6.5e-4, 6.9e-4, 1.1e-3},
                      {.x = {0.078, -0.078, 0.078, -0.078},
                       .y = {0.078, -0.078, -0.078, 0.078},
                       .spin = {-1, -1, 1, 1},
                       .torque_ratio = 0.0116,
                       .f_min = {0, 0, 0, 0},
                       .f_max = {4.25, 4.25, 4.25, 4.25}});

// Rest to rest along x by two metres in two seconds, at y: 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7.
Task along(double y) {
  std::vector<double> coefficient(32, 0.0);
  const double term[] = {35, -84, 70, -20};
  for (std::size_t j = 0; j < 4; ++j) coefficient[4 + j] = 2 * term[j] / std::pow(2.0, 4.0 + static_cast<double>(j));
  coefficient[8] = y, coefficient[16] = 1;
  Task task;
  task.start.p = {0, y, 1};
  task.mission.curve = std::make_shared<const ReferenceCurve>(std::vector<double>{0, 2}, coefficient);
  task.max_time_s = 6;
  return task;
}

// Returns one wrench, whatever it is.
class Wrong final : public SafetyFilter {
 public:
  explicit Wrong(double thrust) : thrust_(thrust) {}
  CommandKind kind() const override { return CommandKind::wrench; }
  FilterReport filter(const FlightState&, const Nominal& nominal) override {
    FilterReport report;
    report.status = SafetyStatus::filtered;
    report.wrench = {thrust_, nominal.wrench.torque};
    return report;
  }
  std::unique_ptr<SafetyFilter> clone() const override { return std::make_unique<Wrong>(*this); }

 private:
  double thrust_;
};

std::vector<SimulatedFlight> among_ellipsoids(const SimulationSpec& spec, const SafetyFilter* filter, unsigned jobs,
                                              double most_s = 6) {
  Control control;
  std::vector<Task> tasks;
  for (int i = 0; i < 6; ++i) tasks.push_back(along(0.2 * i)), tasks.back().max_time_s = most_s;
  std::vector<const SafetyFilter*> filters;
  if (filter != nullptr) filters.push_back(filter);
  return simulate(spec, tasks, filters, 0, 0, jobs, control);
}

void test_flights_along_references_do_not_depend_on_threads() {
  const std::vector<float> mean{1, 0.05F, 1, 1, 1, 1.1F}, scale{0.2F, 0.2F, 0.2F, 0.1F, 0.3F, 0.2F},
      quat{1, 0, 0, 0, 1, 0, 0, 0};
  const auto index = std::make_shared<const EllipsoidIndex>(Splats{mean, scale, quat, {}}, 1.0, 0.1);
  const ConeDi cone(index, ConeDiOptions{});
  const SimulationSpec spec{.vehicle = {.body = kBody}};
  const auto one = among_ellipsoids(spec, &cone, 1), many = among_ellipsoids(spec, &cone, 4);
  for (std::size_t i = 0; i < one.size(); ++i) {
    CHECK(one[i].state == many[i].state && one[i].path == many[i].path && one[i].command == many[i].command);
    CHECK(one[i].status == many[i].status && one[i].margin == many[i].margin && one[i].end == many[i].end);
    CHECK(one[i].a_error == many[i].a_error && one[i].a_command == many[i].a_command);
    CHECK(one[i].path.size() == 3 * (10 * static_cast<std::size_t>(one[i].ticks) + 1));
  }
  CHECK(one[5].end == End::reached);
  const auto plain = among_ellipsoids(spec, nullptr, 2);
  CHECK(plain[0].end == End::reached && plain[0].state != one[0].state);
  CHECK(least_gamma(*index, plain[0].path) < 0);  // straight through the first ellipsoid

  SimulationSpec point = spec;
  point.vehicle.model = VehicleModel::double_integrator, point.vehicle.interface = Interface::acceleration;
  const auto exact = among_ellipsoids(point, &cone, 2);
  for (const double error : exact[0].a_error) CHECK(error == 0);
  bool refused = false;  // it has no wrench; the error reaches the caller from a thread
  try {
    among_ellipsoids(point, std::make_unique<Wrong>(1.0).get(), 2);
  } catch (const std::invalid_argument&) {
    refused = true;
  }
  CHECK(refused);
}

// One that is not finite hovers; one far beyond the rotors' limits is clipped, and finally leaves the box.
void test_wrenches_that_no_rotor_makes() {
  SimulationSpec spec{.vehicle = {.body = kBody}};
  const Wrong nan(std::nan("")), full(1e6);
  const SimulatedFlight odd = among_ellipsoids(spec, &nan, 2, 0.5)[0];
  CHECK(odd.end == End::timeout && std::isfinite(odd.state.back()));
  spec.rules.upper = {9, 9, 1.2};
  const SimulatedFlight up = among_ellipsoids(spec, &full, 2, 2)[0];
  CHECK(up.end == End::refused && up.state[up.state.size() - 10] > 1.2);
  CHECK((up.mark[0] & 4) != 0);
}

void test_invalid_specifications_are_rejected() {
  const auto refused = [](const std::function<void(SimulationSpec&)>& change) {
    Scene scene;
    change(scene.spec);
    try {
      check(scene.spec);
    } catch (const std::invalid_argument&) {
      return true;
    }
    return false;
  };
  CHECK(!refused([](SimulationSpec&) {}));
  CHECK(refused([](SimulationSpec& s) { s.vehicle.max_jerk = NAN; }));
  CHECK(refused([](SimulationSpec& s) { s.vehicle.actuation_delay_s = 11; }));
  CHECK(refused([](SimulationSpec& s) { s.options.dt_s = 0; }));
  CHECK(refused([](SimulationSpec& s) { s.rules.plant_steps = 0; }));
  CHECK(refused([](SimulationSpec& s) { s.rules.risk_window_s = 0; }));
  CHECK(refused([](SimulationSpec& s) { s.moving.obstacles.resize(ALULA_OBSTACLES + 1); }));
  CHECK(refused([](SimulationSpec& s) { s.moving.radar.rate_hz = 0; }));
}

void test_all() {
  test_the_closest_approach_is_that_of_the_parabola();
  test_the_plant_is_late_and_keeps_its_limits();
  test_an_obstacle_that_is_not_avoided_comes_as_near_as_geometry_says();
  test_a_flight_that_is_not_logged_has_the_same_metrics();
  test_warnings_and_manoeuvres_are_timed();
  test_what_a_filter_refuses_is_braked_within_the_box();
  test_a_filter_is_notified_of_the_command_flown_where_it_refused();
  test_trials_do_not_depend_on_their_order();
  test_obstacles_are_drawn_to_meet_the_expected_velocity();
  test_walls_are_shown_nearest_first();
  test_threads_change_no_flight_among_hulls();
  test_flights_along_references_do_not_depend_on_threads();
  test_wrenches_that_no_rotor_makes();
  test_invalid_specifications_are_rejected();
}

}  // namespace
}  // namespace alula::flight

int main() {
  alula::flight::test_all();
  return alula_failures == 0 ? 0 : 1;
}
