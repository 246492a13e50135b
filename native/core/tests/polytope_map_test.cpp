// The rounding of a map's numbers to single precision is in the direction of its name.
#include "alula/filters/polytope_map.hpp"

#include <cmath>
#include <limits>

#include "check.hpp"

using namespace alula;

namespace {

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
  test_rounding_is_directed();
  return alula_failures == 0 ? 0 : 1;
}
