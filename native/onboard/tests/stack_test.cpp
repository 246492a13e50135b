// The stack of onboard filters as firmware calls it: combinations that are refused, parts alone, walls, and inputs
// that are not finite. Inputs are pseudo-random and the same in every run.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "stack_world.hpp"

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

bool same(const void* a, const void* b, std::size_t size) { return std::memcmp(a, b, size) == 0; }

void test_bad_combinations_are_refused() {
  using Change = std::function<void(alula_stack_config&)>;
  const auto status_of = [](const Change& change, const alula_map* hulls, const alula_fence* fence) {
    alula_stack_config config = indoors();
    change(config);
    auto stack = std::make_unique<alula_stack>();
    const alula_status status = alula_stack_init(stack.get(), hulls, fence, &config);
    const alula_stack_input in = hovering();
    alula_stack_result result;
    if (status != ALULA_READY) {
      CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED);
      CHECK(result.sticks.throttle == 0.0F && result.velocity[0] == 0.0F && result.acceleration[0] == 0.0F);
    }
    return status;
  };
  const auto keep = [](alula_stack_config&) {};
  CHECK(status_of(keep, &field(), &box()) == ALULA_READY);
  CHECK(status_of(keep, nullptr, &box()) == ALULA_BAD_POINTER);
  CHECK(status_of(keep, &field(), nullptr) == ALULA_BAD_POINTER);
  CHECK(alula_stack_init(nullptr, &field(), &box(), nullptr) == ALULA_BAD_POINTER);
  const auto only = [](std::uint32_t parts, alula_stack_command takes, alula_stack_command gives) {
    return [=](alula_stack_config& c) { c.parts = parts, c.takes = takes, c.gives = gives; };
  };
  constexpr auto kVelocity = ALULA_STACK_VELOCITY, kAcceleration = ALULA_STACK_ACCELERATION,
                 kSticks = ALULA_STACK_STICKS;
  struct Row {
    std::uint32_t parts;
    alula_stack_command takes, gives;
    bool is_good;
  };
  const Row rows[] = {{0, kVelocity, kSticks, false},
                      {8, kVelocity, kSticks, false},
                      {kPolytope, kVelocity, kVelocity, true},
                      {kPolytope, kAcceleration, kAcceleration, false},
                      {kPolytope, kVelocity, kAcceleration, false}, /* nothing keeps hulls behind a velocity loop */
                      {kPolytope, kVelocity, kSticks, false},
                      {kPolytope | kGeofence, kVelocity, kSticks, false}, /* the fence has no map */
                      {kPolytope | kMoving, kVelocity, kAcceleration, true},
                      {kPolytope | kMoving, kVelocity, kSticks, true},
                      {kPolytope | kMoving, kAcceleration, kSticks, false},
                      {kMoving, kVelocity, kVelocity, false},
                      {kMoving, kVelocity, kAcceleration, true},
                      {kMoving, kAcceleration, kAcceleration, true},
                      {kMoving, kAcceleration, kSticks, true},
                      {kMoving, kSticks, kSticks, false},
                      {kMoving | kGeofence, kAcceleration, kSticks, true},
                      {kMoving | kGeofence, kSticks, kSticks, false},
                      {kGeofence, kSticks, kSticks, true},
                      {kGeofence, kVelocity, kSticks, true},
                      {kGeofence, kVelocity, kAcceleration, false},
                      {kGeofence, kSticks, kVelocity, false}};
  for (const Row& row : rows) {
    const alula_status want = row.is_good ? ALULA_READY : ALULA_BAD_PARAMETER;
    CHECK(status_of(only(row.parts, row.takes, row.gives), &field(), &box()) == want);
  }
  alula_fence with_map = box();
  with_map.keep_out = &field();
  CHECK(status_of(only(kPolytope | kGeofence, kVelocity, kSticks), &field(), &with_map) == ALULA_READY);
  const Change bad[] = {[](alula_stack_config& c) { c.polytope_cbf.dt_s = 0.02F; },
                        [](alula_stack_config& c) { c.geofence.tick_s = 0.005F; },
                        [](alula_stack_config& c) { c.dr_acbf.avoidance.dt_s = kNan; },
                        [](alula_stack_config& c) { c.velocity_gain = 2.3F; }, /* below 4 beta */
                        [](alula_stack_config& c) { c.velocity_gain = 101.0F; },
                        [](alula_stack_config& c) { c.velocity_gain = kNan; },
                        [](alula_stack_config& c) { c.most_walls = ALULA_WALLS + 1U; },
                        [](alula_stack_config& c) { c.dr_acbf.avoidance.a_max = 9.5F; }, /* almost free fall */
                        [](alula_stack_config& c) { c.geofence.model.thrust[2] = 9.0F; },
                        [](alula_stack_config& c) { c.polytope_cbf.kappa = kNan; },
                        [](alula_stack_config& c) { c.dr_acbf.risk = 0.0F; },
                        [](alula_stack_config& c) { c.extent_m = -1.0F; }};
  for (const Change& change : bad) CHECK(status_of(change, &field(), &box()) == ALULA_BAD_PARAMETER);
  CHECK(status_of([](alula_stack_config& c) { c.geofence.beta = 30.0F; }, &field(), &box()) == ALULA_TOO_LATE);
  CHECK(status_of([](alula_stack_config& c) { c.geofence.steps = 20U; }, &field(), &box()) == ALULA_NO_REST);
}

void draw_state(Random& random, alula_racer_state& x) {
  double square = 0, q[4];
  for (double& component : q) component = random(-1, 1), square += component * component;
  for (int i = 0; i < 4; ++i) x.attitude[i] = static_cast<float>(q[i] / std::sqrt(square));
  for (int i = 0; i < 3; ++i) {
    x.position[i] = static_cast<float>(i < 2 ? random(-5, 5) : random(0.3, 3.2));
    x.velocity[i] = static_cast<float>(random(-2, 2));
    x.rates[i] = static_cast<float>(random(-2, 2));
  }
}

void test_a_part_alone_gives_its_own_bits() {
  alula_stack_config c = indoors();
  c.parts = kPolytope, c.takes = c.gives = ALULA_STACK_VELOCITY;
  const Stack velocities = make(c);
  c.parts = kMoving, c.takes = c.gives = ALULA_STACK_ACCELERATION;
  const Stack accelerations = make(c);
  c.parts = kGeofence, c.takes = c.gives = ALULA_STACK_STICKS;
  const Stack sticks = make(c);
  const auto polytope = std::make_unique<alula_polytope_cbf>();
  const auto moving = std::make_unique<alula_dr_acbf>();
  const auto geofence = std::make_unique<alula_geofence>();
  CHECK(alula_polytope_cbf_open(polytope.get(), &field(), c.extent_m, &c.polytope_cbf) == ALULA_READY);
  CHECK(alula_dr_acbf_init(moving.get(), &c.dr_acbf) == ALULA_READY);
  CHECK(alula_geofence_init(geofence.get(), &box(), &c.geofence) == ALULA_READY);
  Random random{std::mt19937(1)};
  std::array<int, 5> seen{};
  for (int n = 0; n < 400; ++n) {
    alula_stack_input in{};
    draw_state(random, in.state);
    for (float& component : in.nominal) component = static_cast<float>(random(-4, 4));
    in.sticks.throttle = static_cast<float>(random(0, 1));
    for (float& rate : in.sticks.rates) rate = static_cast<float>(random(-3, 3));
    const alula_track track =
        ball_at({random(-4, 4), random(-4, 4), random(0, 3)}, {random(-4, 4), random(-4, 4), random(-1, 1)}, 7);
    const alula_wall wall{{0.0F, 0.0F, 1.0F}, in.state.position[2]};
    in.track = &track, in.track_count = 1, in.wall = &wall, in.wall_count = 1;
    alula_stack_result result;

    in.kind = ALULA_STACK_VELOCITY;
    alula_polytope_result slow;
    alula_filter_status want = alula_polytope_cbf_filter(polytope.get(), in.state.position, in.nominal, &slow);
    CHECK(alula_stack_filter(velocities.get(), &in, &result) == want && same(result.velocity, slow.u, 12));
    CHECK(same(&result.polytope_cbf, &slow, sizeof slow));
    ++seen[want];

    in.kind = ALULA_STACK_ACCELERATION;
    alula_vehicle_state vehicle{};
    std::memcpy(vehicle.position, in.state.position, 12);
    std::memcpy(vehicle.velocity, in.state.velocity, 12);
    alula_dr_acbf_result dodged;
    want = alula_dr_acbf_filter(moving.get(), &vehicle, &track, 1, &wall, 1, in.nominal, &dodged);
    CHECK(alula_stack_filter(accelerations.get(), &in, &result) == want && same(result.acceleration, dodged.a, 12));
    CHECK(result.walls == 1 && result.dr_acbf.rows == dodged.rows);
    ++seen[want];

    in.kind = ALULA_STACK_STICKS;
    alula_geofence_result held;
    const alula_geofence_status outcome = alula_geofence_filter(geofence.get(), &in.state, &in.sticks, &held);
    (void)!alula_stack_filter(sticks.get(), &in, &result);
    CHECK(result.outcome == outcome && same(&result.sticks, &held.command, sizeof held.command));
    CHECK(result.geofence.h_i == held.h_i && result.geofence.lambda == held.lambda);
  }
  for (const int status : {0, 1, 3}) CHECK(seen[static_cast<std::size_t>(status)] > 0);
}

// Planes of all boxes and of the fence by brute force, of equal normals the nearest; the most urgent first.
std::vector<std::pair<double, alula_wall>> all_walls(const alula_stack_config& c, const alula_racer_state& x) {
  std::vector<std::pair<double, alula_wall>> all;
  const auto add = [&](int face, double away) {
    const double sign = face < 3 ? -1 : 1;
    alula_wall wall{{0, 0, 0}, static_cast<float>(away)};
    wall.normal[face % 3] = static_cast<float>(sign);
    const double room = away - static_cast<double>(c.dr_acbf.avoidance.radius_m + c.dr_acbf.avoidance.wall_room_m);
    const double stop =
        std::copysign(std::sqrt(2.0 * static_cast<double>(c.dr_acbf.wall_deceleration) * std::abs(room)), room);
    const double spare = stop + sign * static_cast<double>(x.velocity[face % 3]);
    for (auto& [other_spare, other] : all) {
      if (!same(other.normal, wall.normal, 12)) continue;
      if (wall.distance_m < other.distance_m) other_spare = spare, other = wall;
      return;
    }
    all.emplace_back(spare, wall);
  };
  for (const LatticeBox& box : obstacles()) {
    double most = -1e9;
    int face = 0;
    for (int i = 0; i < 6; ++i) {
      const double at = static_cast<double>(x.position[i % 3]);
      const double edge = kBoxMapVoxel * box[static_cast<std::size_t>(i)];
      const double away = i < 3 ? edge - at : at - edge;
      if (away > most) most = away, face = i;
    }
    add(face, most);
  }
  for (int i = 0; i < 3; ++i) {
    add(3 + i, static_cast<double>(x.position[i] - box().lower[i]));
    add(i, static_cast<double>(box().upper[i] - x.position[i]));
  }
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  return all;
}

void test_walls_are_the_most_urgent_planes() {
  Random random{std::mt19937(2)};
  for (const std::uint32_t most : {0U, 1U, 3U, 6U, 20U}) {
    alula_stack_config c = indoors();
    c.most_walls = most;
    const Stack stack = make(c);
    for (int n = 0; n < 300; ++n) {
      alula_stack_input in{};
      draw_state(random, in.state);
      alula_stack_result result;
      (void)!alula_stack_filter(stack.get(), &in, &result);
      const auto want = all_walls(c, in.state);
      CHECK(result.walls <= std::min<std::size_t>(most, want.size()));
      CHECK(result.walls_are_full == (result.walls == most));
      for (std::uint32_t i = 0; i < result.walls; ++i) {
        const alula_wall &wall = stack->wall[i], &other = want[i].second;
        CHECK(std::abs(wall.distance_m - other.distance_m) < 1e-3F);
        CHECK(wall.distance_m <= other.distance_m + 1e-6F); /* rounded towards the vehicle */
        const bool is_tie = i + 1 < want.size() && want[i + 1].first - want[i].first < 1e-2;
        const bool follows_tie = i > 0 && want[i].first - want[i - 1].first < 1e-2;
        CHECK(is_tie || follows_tie || same(wall.normal, other.normal, 12));
      }
      /* what was left out of a list with room cannot bind: its row allows all accelerations of the box */
      if (result.walls == most) continue;
      for (std::size_t i = result.walls; i < want.size(); ++i) {
        const float none[3] = {0, 0, 0};
        const float* v = in.state.velocity;
        const alula_half_space row = alula_wall_row(&c.dr_acbf, &want[i].second, v, none, none);
        CHECK(row.bound >= std::sqrt(3.0F) * c.dr_acbf.avoidance.a_max);
      }
    }
  }
}

bool is_flyable(const alula_stack_result& r, const alula_stack_config& c) {
  bool good = r.sticks.throttle >= 0.0F && r.sticks.throttle <= 1.0F;
  for (int i = 0; i < 3; ++i) {
    good = good && std::abs(r.sticks.rates[i]) <= c.geofence.model.max_rate[i];
    good = good && std::abs(r.acceleration[i]) <= c.dr_acbf.avoidance.a_max;
    good = good && std::abs(r.velocity[i]) <= 1.001F * c.polytope_cbf.v_max;
  }
  return good;
}

void test_numbers_that_are_not_finite_are_refused() {
  for (const std::uint32_t parts : {kPolytope | kMoving | kGeofence, kPolytope | kMoving}) {
    alula_stack_config c = indoors();
    c.parts = parts;
    const Stack stack = make(c);
    const alula_track track = ball_at({4, 1.6, 1.5}, {-4, 0, 0}, 3);
    const alula_wall wall{{0.0F, 0.0F, 1.0F}, 1.5F};
    for (const float bad : {kNan, kInfinity, -kInfinity, 3e38F}) {
      const auto check = [&](const std::function<void(alula_stack_input&, alula_track&, alula_wall&)>& damage) {
        alula_stack_reset(stack.get());
        alula_stack_input in = hovering();
        alula_track seen = track;
        alula_wall given = wall;
        in.track = &seen, in.track_count = 1, in.wall = &given, in.wall_count = 1;
        in.state.velocity[0] = 0.5F;
        alula_stack_result result;
        CHECK(alula_stack_filter(stack.get(), &in, &result) < ALULA_FILTER_REFUSED);
        damage(in, seen, given);
        CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_flyable(result, c));
        const alula_stack_result first = result;
        in = hovering(), in.state.velocity[0] = 0.5F;
        CHECK(alula_stack_filter(stack.get(), &in, &result) < ALULA_FILTER_REFUSED && is_flyable(result, c));
        return first;
      };
      for (std::size_t i = 0; i < 13; ++i) {
        if (bad == 3e38F && i >= 6) continue;
        const alula_stack_result r = check([&](alula_stack_input& in, alula_track&, alula_wall&) {
          std::memcpy(reinterpret_cast<char*>(&in.state) + 4 * i, &bad, 4);
        });
        const bool is_held = parts == (kPolytope | kMoving);
        if (is_held) CHECK(r.sticks.throttle == stack->hover && r.sticks.rates[0] == 0.0F);
        if (i < 3) CHECK(r.velocity[0] == 0.0F);
        if (i >= 3 && i < 6) CHECK(r.acceleration[0] == 0.0F);
      }
      for (std::size_t i = 0; i < 6; ++i)
        check([&](alula_stack_input& in, alula_track&, alula_wall&) { in.covariance[i] = bad; });
      for (int i = 0; i < 3 && bad != 3e38F; ++i) {
        const alula_stack_result r =
            check([&](alula_stack_input& in, alula_track&, alula_wall&) { in.nominal[i] = bad; });
        CHECK(r.velocity[0] == 0.0F && r.acceleration[0] < 0.0F); /* brakes */
      }
      if (bad != 3e38F) check([&](alula_stack_input& in, alula_track&, alula_wall&) { in.yaw_rate_rad_s = bad; });
      for (std::size_t i = 1; i < sizeof(alula_track) / 4; ++i) {
        const alula_stack_result r = check([&](alula_stack_input&, alula_track& seen, alula_wall&) {
          std::memcpy(reinterpret_cast<char*>(&seen) + 4 * i, &bad, 4);
        });
        CHECK(r.part[ALULA_STACK_DR_ACBF] == ALULA_FILTER_REFUSED && r.acceleration[0] < 0.0F);
      }
      for (std::size_t i = 0; i < 4; ++i) {
        check([&](alula_stack_input&, alula_track&, alula_wall& given) {
          std::memcpy(reinterpret_cast<char*>(&given) + 4 * i, &bad, 4);
        });
      }
    }
    alula_stack_result result;
    alula_stack_input in = hovering();
    in.kind = ALULA_STACK_STICKS;
    CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && result.velocity[0] == 0.0F);
    in = hovering(), in.wall_count = ALULA_WALLS + 1U, in.wall = &wall;
    CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_flyable(result, c));
    in = hovering(), in.track_count = 1;
    CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_flyable(result, c));
    CHECK(alula_stack_filter(stack.get(), nullptr, &result) == ALULA_FILTER_REFUSED);
    CHECK(alula_stack_filter(nullptr, &in, &result) == ALULA_FILTER_REFUSED);
    CHECK(alula_stack_filter(stack.get(), &in, nullptr) == ALULA_FILTER_REFUSED);
  }
}

void test_a_map_that_changes_is_refused() {
  std::vector<std::uint8_t> bytes = box_map(obstacles());
  alula_map map;
  CHECK(alula_map_open(&map, bytes.data(), static_cast<std::uint32_t>(bytes.size())) == ALULA_MAP_READY);
  const alula_stack_config c = indoors();
  const auto stack = std::make_unique<alula_stack>();
  CHECK(alula_stack_init(stack.get(), &map, &box(), &c) == ALULA_READY);
  for (std::size_t at = ALULA_MAP_HEADER_BYTES; at < bytes.size(); ++at) bytes[at] ^= 0xA5;
  alula_stack_input in = hovering();
  alula_stack_result result;
  in.state.velocity[0] = 0.5F;
  CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_flyable(result, c));
  CHECK(result.part[ALULA_STACK_POLYTOPE_CBF] == ALULA_FILTER_REFUSED && result.velocity[0] == 0.0F);
  CHECK(result.acceleration[0] < 0.0F && result.walls <= 6);
}

}  // namespace

int main() {
  test_bad_combinations_are_refused();
  test_a_part_alone_gives_its_own_bits();
  test_walls_are_the_most_urgent_planes();
  test_numbers_that_are_not_finite_are_refused();
  test_a_map_that_changes_is_refused();
  return alula_failures == 0 ? 0 : 1;
}
