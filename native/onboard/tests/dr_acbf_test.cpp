// The onboard filter among moving obstacles as firmware calls it: refused inputs, and for inputs of all kinds a
// result that is finite, in the box and consistent with its rows. Inputs are pseudo-random and the same in every run.
#include <algorithm>
#include <array>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <limits>

#include "alula_dr_acbf.h"
#include "check.hpp"

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

class Random {
 public:
  std::uint32_t next() {  // xorshift64*
    x_ ^= x_ >> 12, x_ ^= x_ << 25, x_ ^= x_ >> 27;
    return static_cast<std::uint32_t>((x_ * 0x2545F4914F6CDD1DULL) >> 32);
  }
  std::uint32_t below(std::uint32_t n) { return next() % n; }
  float uniform(float low, float high) { return low + (high - low) * static_cast<float>(next() >> 8) * 0x1p-24F; }
  float one_of(std::initializer_list<float> values) {
    return values.begin()[below(static_cast<std::uint32_t>(values.size()))];
  }
  void direction(float n[3]) {
    float length = 0;
    while (!(length > 0.01F && length < 1)) {
      for (int k = 0; k < 3; ++k) n[k] = uniform(-1, 1);
      length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    for (int k = 0; k < 3; ++k) n[k] /= length;
  }

 private:
  std::uint64_t x_ = 0x9E3779B97F4A7C15ULL;
};

double along(const float n[3], const float a[3]) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) sum += static_cast<double>(n[k]) * static_cast<double>(a[k]);
  return sum;
}

bool is_in_box(const float a[3], float limit) {
  return std::abs(a[0]) <= limit && std::abs(a[1]) <= limit && std::abs(a[2]) <= limit;  // not for NaN
}

double worst_of(const alula_half_space* row, std::uint32_t count, const float a[3]) {
  double most = -static_cast<double>(FLT_MAX);
  for (std::uint32_t i = 0; i < count; ++i)
    most = std::max(most, along(row[i].normal, a) - static_cast<double>(row[i].bound));
  return most;
}

// Rows that are random, doubled, opposite, parallel but for rounding, or along an axis; bounds of any size.
void draw_rows(Random& random, float limit, alula_half_space* row, std::uint32_t count) {
  for (std::uint32_t i = 0; i < count; ++i) {
    alula_half_space& r = row[i];
    random.direction(r.normal);
    const std::uint32_t kind = random.below(6);
    if (kind == 0) {
      for (int k = 0; k < 3; ++k) r.normal[k] = 0;
      r.normal[random.below(3)] = random.one_of({-1, 1});
    } else if (kind < 4 && i > 0) {
      const float* other = row[random.below(i)].normal;
      const float sign = kind == 1 ? -1.0F : 1.0F, apart = kind == 3 ? random.one_of({1e-7F, 1e-5F, 1e-3F}) : 0.0F;
      float length = 0;
      for (int k = 0; k < 3; ++k) {
        r.normal[k] = sign * other[k] + apart * r.normal[k];
        length += r.normal[k] * r.normal[k];
      }
      for (int k = 0; k < 3; ++k) r.normal[k] /= std::sqrt(length);
    }
    r.bound = limit * random.one_of({0, 1e-6F, 0.1F, 1, 3, 1e6F}) * random.uniform(-1, 1);
  }
}

void test_projections_are_finite_in_the_box_and_honest() {
  Random random;
  static std::array<alula_half_space, ALULA_OBSTACLES + ALULA_WALLS> row;
  int feasible = 0, missed = 0;
  for (int n = 0; n < 60000; ++n) {
    const bool is_full = n % 2000 == 0;
    const auto count = is_full ? static_cast<std::uint32_t>(row.size()) : random.below(9);
    const float limit = random.one_of({1e-2F, 0.8F, 6, 1e3F});
    draw_rows(random, limit, row.data(), count);
    float a0[3], largest = limit;
    for (float& a : a0) a = limit * random.one_of({0, 1e-30F, 0.5F, 2, 100, 1e6F}) * random.uniform(-1, 1);
    for (std::uint32_t i = 0; i < count; ++i) largest = std::max(largest, std::abs(row[i].bound));
    const double rounding = 4e-7 * static_cast<double>(largest), margin = 2e-5 * static_cast<double>(limit);
    std::array<alula_projection, 3> found;
    const std::uint32_t soft = random.below(count + 1);
    alula_project_exact(row.data(), count, limit, a0, &found[0]);
    alula_project_gauss_southwell(row.data(), count, limit, 1, 15, a0, &found[1]);
    alula_project_least_violation(row.data(), count, soft, limit, a0, &found[2]);
    for (const alula_projection& f : found) {
      CHECK(is_in_box(f.a, limit));
      CHECK(f.basis_count <= 4);
      for (std::uint32_t i = 0; i < f.basis_count; ++i) CHECK(f.basis[i] < count + 6);
      CHECK(count > 0 ? std::abs(static_cast<double>(f.violation) - worst_of(row.data(), count, f.a)) <= rounding
                      : f.violation == -FLT_MAX && f.feasible != 0);
    }
    CHECK(found[0].iterations <= ALULA_PROJECTION_STEPS && found[1].iterations <= 15);
    CHECK(found[0].feasible == 0 || found[0].violation <= 0);
    CHECK(found[1].feasible == 0 || static_cast<double>(found[1].violation) <= margin);
    // A point with room proves that the set is not empty; the nearest point is then no farther.
    feasible += found[0].feasible;
    if (found[0].feasible != 0 && is_in_box(a0, 16 * limit)) {
      double near = 0, other = 0;
      for (int k = 0; k < 3; ++k) {
        near += std::pow(static_cast<double>(found[0].a[k]) - static_cast<double>(a0[k]), 2);
        other += std::pow(static_cast<double>(found[1].a[k]) - static_cast<double>(a0[k]), 2);
      }
      if (found[1].feasible != 0 && static_cast<double>(found[1].violation) < -2 * margin)
        CHECK(std::sqrt(near) <= std::sqrt(other) + 0.05 * static_cast<double>(limit));
    }
    if (found[1].feasible != 0 && static_cast<double>(found[1].violation) < -4 * margin)
      CHECK(found[0].feasible != 0);
    if (found[0].feasible == 0) {
      ++missed;
      alula_projection all;
      alula_project_least_violation(row.data(), count, count, limit, a0, &all);
      CHECK(static_cast<double>(all.violation) <= static_cast<double>(found[1].violation) + 2 * margin + rounding);
    }
  }
  CHECK(feasible > 10000 && missed > 10000);
}

struct Scene {
  alula_vehicle_state vehicle{};
  std::array<alula_track, ALULA_OBSTACLES + 1> track{};
  std::array<alula_wall, ALULA_WALLS + 1> wall{};
  std::uint32_t tracks = 0, walls = 0;
  float nominal[3]{};
};

void draw_scene(Random& random, Scene& s, bool is_full) {
  const float scale = random.one_of({1, 1, 1, 20, 1e5F});
  for (int k = 0; k < 3; ++k) {
    s.vehicle.position[k] = scale * random.uniform(-1, 1);
    s.vehicle.velocity[k] = random.one_of({0, 1, 12, 1e5F}) * random.uniform(-1, 1);
    s.nominal[k] = random.one_of({0, 3, 9, 1e6F}) * random.uniform(-1, 1);
  }
  const float own = random.one_of({0, 0.01F, 1e6F});
  for (const int k : {0, 3, 5}) s.vehicle.covariance[k] = own;
  s.tracks = is_full ? ALULA_OBSTACLES : random.below(4);
  s.walls = is_full ? ALULA_WALLS : random.below(3);
  for (std::uint32_t i = 0; i < s.tracks; ++i) {
    alula_track& t = s.track[i];
    t = {};
    t.id = i + 10 * random.below(2);
    t.radius_m = random.one_of({0, 0.15F, 1e3F});
    float way[3];
    random.direction(way);
    const float far = random.one_of({0, 1e-4F, 0.2F, 2, 10, 60, 1e5F}), fast = random.one_of({0, 3, 10, 1e4F});
    for (int k = 0; k < 3; ++k) {
      t.position[k] = s.vehicle.position[k] + far * way[k];
      t.velocity[k] = -fast * way[k] + random.uniform(-1, 1);
      t.acceleration[k] = random.one_of({0, 1, 1e3F}) * random.uniform(-1, 1);
    }
    float factor[6][6];
    const float size = random.one_of({0, 0.1F, 1, 1e4F});
    for (auto& r : factor)
      for (float& f : r) f = size * random.uniform(-1, 1);
    for (int a = 0, at = 0; a < 6; ++a) {
      for (int b = 0; b <= a; ++b, ++at) {
        for (int k = 0; k < 6; ++k) t.covariance[at] += factor[a][k] * factor[b][k];
      }
    }
  }
  for (std::uint32_t i = 1; i < s.tracks && !is_full; ++i)
    if (s.track[i].id == s.track[0].id) s.track[i].id += 100;
  for (std::uint32_t i = 0; i < s.tracks; ++i)
    if (is_full || s.tracks > 2) s.track[i].id = i;
  for (std::uint32_t i = 0; i < s.walls; ++i) {
    random.direction(s.wall[i].normal);
    s.wall[i].distance_m = random.one_of({0, 0.2F, 3, 1e5F}) * random.uniform(-0.1F, 1);
  }
}

alula_filter_status run(alula_dr_acbf& filter, const Scene& s, alula_dr_acbf_result& result) {
  return alula_dr_acbf_filter(&filter, &s.vehicle, s.track.data(), s.tracks, s.wall.data(), s.walls, s.nominal,
                              &result);
}

bool is_unset(const alula_dr_acbf_result& result) {
  return result.a[0] == 0 && result.a[1] == 0 && result.a[2] == 0 && result.rows == 0 && result.violation == -FLT_MAX;
}

bool is_finite(const alula_dr_acbf& f) {
  bool good = is_in_box(f.executed, FLT_MAX);
  for (const float* v : {f.avoidance.bypass, f.avoidance.direction, f.avoidance.command})
    good = good && is_in_box(v, FLT_MAX);
  for (std::uint32_t i = 0; i < f.row_count; ++i) good = good && std::isfinite(f.row[i].bound);
  for (std::uint32_t i = 0; i < f.avoidance.envelope_count; ++i) {
    const alula_envelope& e = f.avoidance.envelope[i];
    good = good && std::isfinite(e.bound) && is_in_box(e.z0, FLT_MAX) && is_in_box(e.z1, FLT_MAX);
  }
  return good;
}

void test_every_tick_is_finite_in_the_box_and_honest_about_its_rows() {
  Random random;
  static Scene s;
  static alula_dr_acbf filter, before;
  int counted[5] = {}, reached[3] = {};
  for (int n = 0; n < 30000; ++n) {
    if (n % 40 == 0) {
      alula_dr_acbf_config config = alula_dr_acbf_defaults();
      config.solver = random.below(2) != 0 ? ALULA_SOLVER_EXACT : ALULA_SOLVER_GAUSS_SOUTHWELL;
      config.rows_before_warning = random.below(4) != 0;
      config.avoidance.distributional = random.below(8) == 0;  // samples take long
      config.avoidance.accelerated = random.below(2) != 0;
      config.j_max = random.one_of({0, 1e-3F, 60, 1e5F});
      config.horizons = 1 + random.below(ALULA_HORIZONS);
      config.avoidance.a_max = random.one_of({0.8F, 6, 6, 40});
      config.wall_deceleration = 0.5F * config.avoidance.a_max;
      CHECK(alula_dr_acbf_init(&filter, &config) == ALULA_READY);
    }
    draw_scene(random, s, n % 3000 == 0);
    const float limit = filter.config.avoidance.a_max;
    alula_dr_acbf_result result;
    if (n % 16 == 0) {  // one number is corrupted
      static Scene broken;
      broken = s;
      const float bad = random.one_of({kNan, kInfinity, -kInfinity, 1e30F});
      std::uint32_t where = random.below(s.tracks > 0 ? 6 : 3);
      if (where == 0) broken.vehicle.position[random.below(3)] = bad;
      if (where == 1) broken.vehicle.velocity[random.below(3)] = bad;
      if (where == 2) broken.nominal[random.below(3)] = bad;
      if (where == 3) broken.track[random.below(s.tracks)].position[random.below(3)] = bad;
      if (where == 4) broken.track[random.below(s.tracks)].covariance[random.below(21)] = bad;
      if (where == 5) broken.track[random.below(s.tracks)].radius_m = bad;
      std::memcpy(&before, &filter, sizeof filter);
      CHECK(run(filter, broken, result) == ALULA_FILTER_REFUSED && is_unset(result));
      CHECK(std::memcmp(&before, &filter, sizeof filter) == 0);
      const float braked[3] = {limit, -limit, 0};
      if (random.below(2) != 0) alula_dr_acbf_flown(&filter, braked);
    }
    const alula_filter_status status = run(filter, s, result);
    ++counted[status];
    CHECK(status != ALULA_FILTER_REFUSED);
    CHECK(is_in_box(result.a, limit) && is_finite(filter));
    CHECK(result.rows == filter.row_count && result.rows <= s.tracks + s.walls);
    CHECK(result.horizon_s >= filter.config.h_min_s && result.horizon_s <= filter.config.avoidance.h_max_s);
    ++reached[result.guidance.mode];
    const double worst = worst_of(filter.row, filter.row_count, result.a);
    double largest = static_cast<double>(limit);
    for (std::uint32_t i = 0; i < filter.row_count; ++i)
      largest = std::max(largest, std::abs(static_cast<double>(filter.row[i].bound)));
    if (result.rows > 0) CHECK(std::abs(worst - static_cast<double>(result.violation)) <= 4e-7 * largest);
    const double most = static_cast<double>(filter.config.tolerance) + 4e-6 * static_cast<double>(limit);
    if (status == ALULA_FILTER_OK || status == ALULA_FILTER_FILTERED) CHECK(worst <= most);
    if (status == ALULA_FILTER_OK) CHECK(std::equal(s.nominal, s.nominal + 3, result.a));
    if (status == ALULA_FILTER_RECOVERING) CHECK(result.violation > filter.config.tolerance && result.failing > 0);
  }
  CHECK(counted[ALULA_FILTER_OK] > 200 && counted[ALULA_FILTER_FILTERED] > 2000);
  CHECK(counted[ALULA_FILTER_RECOVERING] > 2000);
  CHECK(reached[ALULA_NOMINAL] > 200 && reached[ALULA_AVOID] > 2000 && reached[ALULA_HOVER] > 10);
}

void test_there_is_room_for_so_many_and_no_more() {
  static alula_dr_acbf filter;
  static Scene s;
  const alula_dr_acbf_config config = alula_dr_acbf_defaults();
  CHECK(alula_dr_acbf_init(&filter, &config) == ALULA_READY);
  Random random;
  draw_scene(random, s, true);
  alula_dr_acbf_result result;
  CHECK(run(filter, s, result) != ALULA_FILTER_REFUSED);
  s.track[ALULA_OBSTACLES] = s.track[0];
  s.track[ALULA_OBSTACLES].id = 1000;
  s.tracks = ALULA_OBSTACLES + 1;
  CHECK(run(filter, s, result) == ALULA_FILTER_REFUSED && is_unset(result));
  s.tracks = ALULA_OBSTACLES, s.walls = ALULA_WALLS + 1;
  s.wall[ALULA_WALLS] = s.wall[0];
  CHECK(run(filter, s, result) == ALULA_FILTER_REFUSED);
  s.walls = ALULA_WALLS, s.track[1].id = s.track[0].id;
  CHECK(run(filter, s, result) == ALULA_FILTER_REFUSED);
  CHECK(alula_dr_acbf_filter(nullptr, &s.vehicle, nullptr, 0, nullptr, 0, s.nominal, &result) ==
        ALULA_FILTER_REFUSED);
  CHECK(alula_dr_acbf_filter(&filter, nullptr, nullptr, 0, nullptr, 0, s.nominal, &result) == ALULA_FILTER_REFUSED);
  CHECK(alula_dr_acbf_filter(&filter, &s.vehicle, nullptr, 1, nullptr, 0, s.nominal, &result) ==
        ALULA_FILTER_REFUSED);
  CHECK(alula_dr_acbf_filter(&filter, &s.vehicle, nullptr, 0, nullptr, 1, s.nominal, &result) ==
        ALULA_FILTER_REFUSED);
  CHECK(alula_dr_acbf_filter(&filter, &s.vehicle, nullptr, 0, nullptr, 0, nullptr, &result) == ALULA_FILTER_REFUSED);
  CHECK(alula_dr_acbf_filter(&filter, &s.vehicle, nullptr, 0, nullptr, 0, s.nominal, nullptr) ==
        ALULA_FILTER_REFUSED);
}

void test_parameters_without_meaning_are_refused() {
  const auto init = [](auto change) {
    static alula_dr_acbf filter;
    alula_dr_acbf_config config = alula_dr_acbf_defaults();
    change(config);
    return alula_dr_acbf_init(&filter, &config);
  };
  using Config = alula_dr_acbf_config;
  CHECK(init([](Config&) {}) == ALULA_READY);
  CHECK(alula_dr_acbf_init(nullptr, nullptr) == ALULA_BAD_POINTER);
  for (const float bad : {kNan, kInfinity, -1.0F}) {
    CHECK(init([=](Config& c) { c.v_max = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init([=](Config& c) { c.j_max = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init([=](Config& c) { c.risk = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init([=](Config& c) { c.tolerance = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init([=](Config& c) { c.wall_deceleration = bad; }) == ALULA_BAD_PARAMETER);
    CHECK(init([=](Config& c) { c.avoidance.h_max_s = bad; }) == ALULA_BAD_PARAMETER);
  }
  CHECK(init([](Config& c) { c.j_max = 1e-30F; }) == ALULA_BAD_PARAMETER);  // a lag without end
}

// In front of an obstacle with a velocity towards the vehicle but a constant position.
void test_each_manoeuvre_begins_with_less_risk_and_the_longest_horizon() {
  static alula_dr_acbf filter;
  static Scene s;
  const alula_dr_acbf_config config = alula_dr_acbf_defaults();
  CHECK(alula_dr_acbf_init(&filter, &config) == ALULA_READY);
  s = {};
  s.tracks = 1;
  s.track[0].position[0] = 3, s.track[0].velocity[0] = -8, s.track[0].radius_m = 0.15F;
  const float less = alula_cantelli(config.risk * config.warned_risk);
  int begun = 0;
  for (int tick = 0; tick < 300; ++tick) {
    alula_dr_acbf_result result;
    CHECK(run(filter, s, result) != ALULA_FILTER_REFUSED && result.guidance.mode == ALULA_AVOID);
    const bool begins = filter.avoidance.ticks_in_mode == 1;
    begun += begins;
    CHECK((filter.lambda[0] == less) == begins);
    if (begins) CHECK(result.horizon_s == config.avoidance.h_max_s);
  }
  CHECK(begun == 3);  // after 1.2 s the next begins
}

// Full speed at a wall was commanded when the input becomes invalid, and the caller brakes meanwhile.
void test_the_command_flown_while_input_is_refused_counts() {
  static alula_dr_acbf notified, unnotified;
  static Scene s;
  const alula_dr_acbf_config config = alula_dr_acbf_defaults();
  CHECK(alula_dr_acbf_init(&notified, &config) == ALULA_READY);
  s = {};
  s.walls = 1;
  s.wall[0] = {{-1, 0, 0}, 50};
  s.nominal[0] = -6;
  alula_dr_acbf_result result;
  for (int tick = 0; tick < 20; ++tick) CHECK(run(notified, s, result) != ALULA_FILTER_REFUSED);
  CHECK(notified.executed[0] == -6);
  std::memcpy(&unnotified, &notified, sizeof notified);
  Scene broken = s;
  broken.nominal[1] = kNan;
  const float towards[3] = {6, 0, 0}, none[3] = {kNan, 0, 0};
  for (int tick = 0; tick < 20; ++tick) {
    CHECK(run(notified, broken, result) == ALULA_FILTER_REFUSED &&
          run(unnotified, broken, result) == ALULA_FILTER_REFUSED);
    alula_dr_acbf_flown(&notified, towards);
    alula_dr_acbf_flown(&notified, none);
  }
  CHECK(notified.avoidance.command[0] == 6 && std::abs(notified.executed[0] - 6) < 1e-5F);
  s.wall[0].distance_m = 2;
  s.vehicle.velocity[0] = 3;
  s.nominal[0] = 6;
  CHECK(run(notified, s, result) != ALULA_FILTER_REFUSED);
  const float bound = notified.row[0].bound;
  CHECK(run(unnotified, s, result) != ALULA_FILTER_REFUSED);
  CHECK(bound < unnotified.row[0].bound - 1);  // the vehicle still accelerates towards the wall: brake harder
}

}  // namespace

int main() {
  test_projections_are_finite_in_the_box_and_honest();
  test_every_tick_is_finite_in_the_box_and_honest_about_its_rows();
  test_there_is_room_for_so_many_and_no_more();
  test_parameters_without_meaning_are_refused();
  test_each_manoeuvre_begins_with_less_risk_and_the_longest_horizon();
  test_the_command_flown_while_input_is_refused_counts();
  return alula_failures == 0 ? 0 : 1;
}
