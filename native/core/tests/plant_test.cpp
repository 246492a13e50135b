// Plants are repeatable, respect the rotors' limits and equal the bare body without options; the random generator
// gives its published test vectors.
#include "alula/dynamics/plant.hpp"

#include <cmath>
#include <cstring>
#include <limits>

#include "alula/dynamics/tracking_controller.hpp"
#include "check.hpp"

using namespace alula::flight;

namespace {

Quadrotor body() {
  return {0.461,
          {6.5e-4, 6.9e-4, 1.1e-3},
          {{0.078, -0.078, 0.078, -0.078},
           {0.078, -0.078, -0.078, 0.078},
           {-1, -1, 1, 1},
           0.0116,
           {},
           {4.25, 4.25, 4.25, 4.25}}};
}

const State kStart{{1, 2, 3}, {0.1, -0.2, 0.05}, {2, -1, 0.5}, {0.3, 1, -0.4}};

bool same(const State& a, const State& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

void test_the_generator_gives_its_published_answers() {
  CHECK((philox({}, {}) == Counter{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  CHECK((philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}) ==
         Counter{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

void test_off_is_the_bare_body() {
  const Quadrotor quadrotor = body();
  Plant plant(quadrotor);
  plant.reset(kStart);
  State x = kStart;
  for (int i = 0; i < 100; ++i) {
    const Wrench u{4 + 0.01 * i, {0.001 * i, -0.002, 0.003}};
    plant.step(0.001, u);
    x = quadrotor.step(x, u, 0.001);
    CHECK(same(plant.state(), x) && same(plant.measured(), x));
  }
}

void test_disturbed_flights_repeat_within_limits() {
  const Quadrotor quadrotor = body();
  PlantOptions options;
  options.motor_time_constant_s = 0.03;
  options.quadratic_drag = {0.02, 0.02, 0.05};
  options.gust_m_s = {1, 1, 1};
  options.sensor = {0.01, 0.1, 0.02, 0.1, 0.05};
  Plant one(quadrotor, options, {7, 3}), two(quadrotor, options, {7, 3});
  one.reset(kStart), two.reset(kStart);
  for (int i = 0; i < 500; ++i) {
    const double bad = i % 50 == 0 ? std::numeric_limits<double>::quiet_NaN() : 0;
    const Wrench u{30 * std::sin(0.1 * i) + bad, {1, -1, 0.5}};
    one.step(0.001, u), two.step(0.001, u);
    CHECK(quadrotor.admissible(one.wrench(), 1e-9));
    CHECK(same(one.state(), two.state()) && same(one.measured(), two.measured()));
    CHECK(is_finite(one.state()) && is_finite(one.measured()));
  }
}

void test_commands_and_states_without_meaning_do_no_harm() {
  const Quadrotor quadrotor = body();
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e308}) {
    for (int place = 0; place < 4; ++place) {
      Wrench u{4, {}};
      (place == 0 ? u.thrust : u.torque[place - 1]) = bad;
      CHECK(quadrotor.admissible(quadrotor.limited(u), 1e-9));
    }
    State x = kStart;
    x.sigma.x = bad;
    const Nominal nominal = track(quadrotor, {}, x, {});
    CHECK(quadrotor.admissible(quadrotor.limited(nominal.wrench), 1e-9));
    const Vec3 rates = body_rates(quadrotor, x, nominal.wrench, {0.01, 0.01, 0.01}, {1, 1, 1});
    CHECK(std::abs(rates.x) <= 1 && std::abs(rates.y) <= 1 && std::abs(rates.z) <= 1);
  }
}

}  // namespace

int main() {
  test_the_generator_gives_its_published_answers();
  test_off_is_the_bare_body();
  test_disturbed_flights_repeat_within_limits();
  test_commands_and_states_without_meaning_do_no_harm();
  return alula_failures == 0 ? 0 : 1;
}
