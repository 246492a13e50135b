// Rollouts do not depend on the number of threads, and the rounding helpers round in the direction of their names.
#include "alula/flight/rollout.hpp"

#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>

#include "alula/filters/adapters.hpp"
#include "check.hpp"

using namespace alula;

namespace {

PolytopeCbf block() {
  static const std::vector<double> normal{1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1};
  static const std::vector<double> offset{1, 0, 1, 0, 1, 0};
  static const std::vector<std::int64_t> start{0, 6};
  auto map = std::make_shared<const PolytopeMap>(make_polytope_map({normal, offset, start}, 20));
  return PolytopeCbf(map, {.radius_m = 0.1});
}

void test_threads_change_nothing() {
  std::vector<Vec3> start, goal;
  for (int i = 0; i < 12; ++i) {
    start.push_back({-2.0, 0.1 * i, 0.5});
    goal.push_back({3.0, 1.3 - 0.1 * i, 0.4});
  }
  const flight::VelocityFilter filter(block());
  const TrialRules rules{.max_steps = 2000};
  Control control;
  const auto one = rollout(filter, start, goal, rules, {}, 1, control);
  const auto many = rollout(filter, start, goal, rules, {}, 7, control);
  int reached = 0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    CHECK(one[i].position == many[i].position && one[i].u == many[i].u && one[i].status == many[i].status);
    CHECK(one[i].margin == many[i].margin && one[i].outcome == many[i].outcome);
    CHECK(one[i].position.size() == 3 * (one[i].status.size() + 1));
    reached += one[i].outcome == Outcome::reached;
  }
  CHECK(reached > 0);
}

void test_rules_without_meaning_throw() {
  for (const TrialRules& rules :
       {TrialRules{}, TrialRules{.dt_s = 0, .max_steps = 1}, TrialRules{.gain = std::nan(""), .max_steps = 1},
        TrialRules{.gain = 300, .max_steps = 1}}) {
    bool thrown = false;
    try {
      const Trial trial({0, 0, 0}, {1, 0, 0}, rules);
    } catch (const std::invalid_argument&) {
      thrown = true;
    }
    CHECK(thrown);
  }
}

void test_rounding_is_directed() {
  for (const double value : {0.1, -0.1, 1e-300, -1e-300, 1.0, 16777217.0, 3.14159e20, 0.0}) {
    CHECK(static_cast<double>(round_up(value)) >= value && static_cast<double>(round_down(value)) <= value);
    CHECK(round_up(value) == round_down(value) ||
          std::nextafterf(round_down(value), std::numeric_limits<float>::infinity()) == round_up(value));
  }
  CHECK(round_up(0.5) == 0.5F && round_down(0.5) == 0.5F);
}

}  // namespace

int main() {
  test_threads_change_nothing();
  test_rules_without_meaning_throw();
  test_rounding_is_directed();
  return alula_failures == 0 ? 0 : 1;
}
