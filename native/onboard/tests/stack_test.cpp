// The stack as firmware calls it: configurations that are refused, the bits of the chord filter, rows that hold, and
// inputs that are not finite. Inputs are pseudo-random and the same in every run.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <vector>

#include "stack_world.hpp"

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

bool same(const void* a, const void* b, std::size_t size) { return std::memcmp(a, b, size) == 0; }

float along(const alula_half_space& row, const float* u) {
  return row.normal[0] * u[0] + row.normal[1] * u[1] + row.normal[2] * u[2];
}

bool is_flyable(const alula_stack_result& r, const alula_stack_config& c) {
  double square = 0;
  for (const float u : r.velocity) square += static_cast<double>(u) * static_cast<double>(u);
  return square <= 1.0003 * static_cast<double>(c.polytope_cbf.v_max * c.polytope_cbf.v_max); /* not for NaN */
}

bool is_zero(const alula_stack_result& r) {
  return r.velocity[0] == 0.0F && r.velocity[1] == 0.0F && r.velocity[2] == 0.0F;
}

void test_bad_configurations_are_refused() {
  using Change = std::function<void(alula_stack_config&)>;
  const auto status_of = [](const Change& change, const alula_map* hulls, const alula_fence* fence) {
    alula_stack_config config = indoors();
    change(config);
    auto stack = std::make_unique<alula_stack>();
    const alula_status status = alula_stack_init(stack.get(), hulls, fence, &config);
    if (status != ALULA_READY) {
      const alula_stack_input in = hovering();
      alula_stack_result result;
      CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_zero(result));
    }
    return status;
  };
  const auto keep = [](alula_stack_config&) {};
  CHECK(status_of(keep, &field(), &box()) == ALULA_READY);
  CHECK(status_of(keep, &field(), nullptr) == ALULA_READY);
  CHECK(status_of(keep, nullptr, &box()) == ALULA_BAD_POINTER);
  CHECK(alula_stack_init(nullptr, &field(), &box(), nullptr) == ALULA_BAD_POINTER);
  alula_fence with_map = box(), empty{};
  with_map.keep_out = &field();
  CHECK(status_of(keep, &field(), &with_map) == ALULA_BAD_PARAMETER);
  CHECK(status_of(keep, &field(), &empty) == ALULA_BAD_PARAMETER);
  const Change bad[] = {[](alula_stack_config& c) { c.polytope_cbf.dt_s = 0.02F; },
                        [](alula_stack_config& c) { c.dr_acbf.avoidance.dt_s = kNan; },
                        [](alula_stack_config& c) { c.polytope_cbf.radius_m = kNan; },
                        [](alula_stack_config& c) { c.polytope_cbf.beta = 101.0F; },
                        [](alula_stack_config& c) { c.lag_s = 0.005F; },
                        [](alula_stack_config& c) { c.lag_s = kNan; },
                        [](alula_stack_config& c) { c.lag_s = 0.3F; }, /* 2 m/s / 0.3 s > a_max */
                        [](alula_stack_config& c) { c.dr_acbf.avoidance.a_max = 5.6F; },
                        [](alula_stack_config& c) { c.dr_acbf.risk = 0.0F; },
                        [](alula_stack_config& c) { c.extent_m = -1.0F; }};
  for (const Change& change : bad) CHECK(status_of(change, &field(), &box()) == ALULA_BAD_PARAMETER);
}

void draw_state(Random& random, alula_stack_input& in) {
  for (int i = 0; i < 3; ++i) {
    in.position[i] = static_cast<float>(i < 2 ? random(-5, 5) : random(0.3, 3.2));
    in.velocity[i] = static_cast<float>(random(-1, 1));
    in.nominal[i] = static_cast<float>(random(-1.5, 1.5));
  }
}

void test_without_fence_and_obstacles_it_is_the_chord_filter() {
  const alula_stack_config c = indoors();
  const auto stack = std::make_unique<alula_stack>();
  const auto chord = std::make_unique<alula_chord>();
  CHECK(alula_stack_init(stack.get(), &field(), nullptr, &c) == ALULA_READY);
  CHECK(alula_chord_open(chord.get(), &field(), c.extent_m, &c.polytope_cbf, c.lag_s) == ALULA_READY);
  Random random{std::mt19937(1)};
  int seen[5] = {0, 0, 0, 0, 0};
  for (int n = 0; n < 2000; ++n) {
    alula_stack_input in{};
    draw_state(random, in);
    if (n % 100 == 50) in.position[n / 100 % 3] = 1e6F;
    if (n % 2 == 0)
      for (float& u : in.nominal) u *= 0.3F;
    in.is_taking_off = n % 5 == 0;
    alula_stack_result result;
    alula_polytope_result want;
    const alula_filter_status status =
        alula_chord_filter(chord.get(), in.position, in.velocity, in.nominal, in.is_taking_off, &want);
    CHECK(alula_stack_filter(stack.get(), &in, &result) == status && same(&result.chord, &want, sizeof want));
    CHECK(same(result.velocity, want.u, sizeof want.u));
    ++seen[status];
  }
  for (const int status : {0, 1, 3, 4}) CHECK(seen[status] > 0);
}

// Rows of hulls and faces hold whatever flies around; those of obstacles hold unless the status says otherwise.
void test_rows_hold_and_obstacles_never_break_those_of_hulls() {
  const alula_stack_config c = indoors();
  const Stack stack = make(c);
  Random random{std::mt19937(2)};
  int held = 0, failed = 0, entered = 0, faces = 0;
  for (int n = 0; n < 3000; ++n) {
    alula_stack_input in{};
    draw_state(random, in);
    alula_track track[2];
    for (std::uint32_t k = 0; k < 2; ++k) {
      Triple at, way;
      for (std::size_t i = 0; i < 3; ++i) {
        at[i] = static_cast<double>(in.position[i]) + random(-2, 2);
        way[i] = (static_cast<double>(in.position[i]) - at[i]) * random(0, 2) + random(-0.5, 0.5);
      }
      track[k] = ball_at(at, way, k);
    }
    in.track = track, in.track_count = static_cast<std::uint32_t>(n % 3);
    alula_stack_result r;
    alula_stack_reset(stack.get());
    const alula_filter_status status = alula_stack_filter(stack.get(), &in, &r);
    CHECK(status != ALULA_FILTER_REFUSED && is_flyable(r, c));
    const alula_chord& chord = stack->chord;
    for (std::uint32_t i = chord.soft; i < chord.count; ++i) {
      CHECK(along(chord.row[i], r.velocity) <= chord.row[i].bound);
      faces += std::abs(chord.row[i].normal[2]) > 0.99F;
    }
    entered += chord.soft > 0;
    if (r.obstacle_rows == 0) continue;
    const bool holds = r.violation_m_s <= c.dr_acbf.tolerance * c.lag_s;
    if (status < ALULA_FILTER_RECOVERING) CHECK(holds);
    if (!holds) CHECK(status == ALULA_FILTER_RECOVERING && r.failing == 1);
    ++(holds ? held : failed);
  }
  CHECK(held > 500 && failed > 100 && entered > 100 && faces > 100);
}

void test_numbers_that_are_not_finite_are_refused() {
  const alula_stack_config c = indoors();
  const Stack stack = make(c);
  const alula_track track = ball_at({4, 1.6, 1.5}, {-4, 0, 0}, 3);
  for (const float bad : {kNan, kInfinity, -kInfinity, 3e38F}) {
    const auto check = [&](const std::function<void(alula_stack_input&, alula_track&)>& damage) {
      alula_stack_reset(stack.get());
      alula_stack_input in = hovering();
      alula_track seen = track;
      in.track = &seen, in.track_count = 1;
      in.velocity[0] = 0.5F;
      alula_stack_result result;
      CHECK(alula_stack_filter(stack.get(), &in, &result) < ALULA_FILTER_REFUSED);
      damage(in, seen);
      CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_flyable(result, c));
      const alula_stack_result first = result;
      in = hovering(), in.velocity[0] = 0.5F;
      CHECK(alula_stack_filter(stack.get(), &in, &result) < ALULA_FILTER_REFUSED && is_flyable(result, c));
      return first;
    };
    for (std::size_t i = 0; i < 6; ++i) {
      const alula_stack_result r = check(
          [&](alula_stack_input& in, alula_track&) { std::memcpy(reinterpret_cast<char*>(&in) + 4 * i, &bad, 4); });
      CHECK(is_zero(r));
    }
    for (std::size_t i = 0; i < 6; ++i) {
      const auto r = check([&](alula_stack_input& in, alula_track&) { in.covariance[i] = bad; });
      CHECK(is_zero(r)); /* the chord is clear: zero velocity */
    }
    for (int i = 0; i < 3 && bad != 3e38F; ++i) {
      alula_stack_result r = check([&](alula_stack_input& in, alula_track& seen) {
        in.nominal[i] = bad;
        seen.position[0] = 1000.0F; /* nothing to dodge */
      });
      CHECK(r.guidance.mode != ALULA_NOMINAL || is_zero(r));
    }
    for (std::size_t i = 1; i < sizeof(alula_track) / 4; ++i) {
      const alula_stack_result r = check([&](alula_stack_input&, alula_track& seen) {
        std::memcpy(reinterpret_cast<char*>(&seen) + 4 * i, &bad, 4);
      });
      CHECK(is_zero(r));
    }
  }
  alula_stack_result result;
  alula_stack_input in = hovering();
  in.track_count = 1;
  CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_zero(result));
  in.track = &track, in.track_count = ALULA_OBSTACLES + 1U;
  CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_zero(result));
  CHECK(alula_stack_filter(stack.get(), nullptr, &result) == ALULA_FILTER_REFUSED && is_zero(result));
  CHECK(alula_stack_filter(nullptr, &in, &result) == ALULA_FILTER_REFUSED && is_zero(result));
  CHECK(alula_stack_filter(stack.get(), &in, nullptr) == ALULA_FILTER_REFUSED);
}

void test_a_map_that_changes_is_refused() {
  std::vector<std::uint8_t> bytes = box_map(obstacles());
  alula_map map;
  CHECK(alula_map_open(&map, bytes.data(), static_cast<std::uint32_t>(bytes.size())) == ALULA_MAP_READY);
  const alula_stack_config c = indoors();
  const auto stack = std::make_unique<alula_stack>();
  CHECK(alula_stack_init(stack.get(), &map, &box(), &c) == ALULA_READY);
  for (std::size_t at = ALULA_MAP_HEADER_BYTES; at < bytes.size(); ++at) bytes[at] ^= 0xA5;
  const alula_stack_input in = hovering();
  alula_stack_result result;
  CHECK(alula_stack_filter(stack.get(), &in, &result) == ALULA_FILTER_REFUSED && is_zero(result));
}

}  // namespace

int main() {
  test_bad_configurations_are_refused();
  test_without_fence_and_obstacles_it_is_the_chord_filter();
  test_rows_hold_and_obstacles_never_break_those_of_hulls();
  test_numbers_that_are_not_finite_are_refused();
  test_a_map_that_changes_is_refused();
  return alula_failures == 0 ? 0 : 1;
}
