// Random numbers depend only on their counters; obstacles and scans are functions of them, independent of the
// vehicle.
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "allocations.hpp"
#include "alula/tracking/radar.hpp"
#include "check.hpp"

using namespace alula::flight;
using alula::geometry::Vec3;

namespace {

bool near(Vec3 a, Vec3 b) { return norm(a - b) < 1e-15 * norm(b); }

// Equal up to differences in rounding between mathematical libraries.
void test_normals_stay_what_they_were() {
  const RandomStream random{0x0123456789abcdef, 42};
  CHECK(near(random.normals(7, 3), {0x1.4336fd0121958p+0, 0x1.c05711df11defp-1, 0x1.ed6a4a6da0bap-1}));
  CHECK(near(random.normals(std::uint64_t{1} << 40, 0x20000001),
             {0x1.98978fcf5bdbap-1, 0x1.22c0cabd13269p+0, -0x1.0feaea653b824p-1}));
  const Counter bits = philox({7, 0, 42, 3}, {0x89abcdef, 0x01234567});
  for (std::size_t i = 0; i < 4; ++i) CHECK(random.uniforms(7, 3)[i] == (bits[i] + 0.5) * 0x1p-32);
}

void test_poisson_numbers_are_the_inverse_of_the_distribution() {
  for (const double mean : {0.0, 0.1, 1.0, 7.5, 100.0, 500.0}) {
    double sum = 0;
    for (int k = 0; k < 2 * static_cast<int>(mean) + 10; ++k) {
      const double term = std::exp(k * std::log(mean > 0 ? mean : 1) - mean - std::lgamma(k + 1.0));
      const double p = mean > 0 ? term : k == 0 ? 1.0 : 0.0;
      if (p > 1e-6) CHECK(poisson(mean, sum + p / 2) == k);
      sum += p;
    }
    CHECK(poisson(mean, 1 - 0x1p-33) < mean + 20 * std::sqrt(mean) + 21);
    CHECK(poisson(mean, 0x1p-33) <= mean);
  }
}

void test_wild_vehicles_do_no_harm() {
  const double bad = std::numeric_limits<double>::quiet_NaN();
  ObstacleSpec spec;
  spec.kind = MotionKind::curving;
  spec.acceleration_m_s2 = {0.5, 0.5};
  const auto motion = draw(spec, {{0, 0, 10}, {4, 0, 0}, {}}, {1, 2}, 0);
  for (int i = 0; i < 200; ++i) {
    const double x = i % 3 == 0 ? bad : i % 3 == 1 ? 1e300 : 0;
    motion->step(0.01, {{x, 0, 10}, {x, 0, 0}, {}});
    CHECK(alula::geometry::is_finite(motion->state().p) && alula::geometry::is_finite(motion->state().v));
    CHECK(std::abs(norm(motion->state().v)) <= 12 + 1e-9);
  }
}

void test_steps_and_scans_allocate_nothing() {
  std::vector<std::unique_ptr<ObstacleMotion>> all;
  std::vector<Kinematics> truth;
  const Kinematics vehicle{{0, 0, 10}, {4, 0, 0}, {}};
  for (int kind = 0; kind < 5; ++kind) {
    ObstacleSpec spec;
    spec.kind = static_cast<MotionKind>(kind);
    spec.drag_per_m = 0.01;
    all.push_back(draw(spec, vehicle, {1, 2}, static_cast<std::uint32_t>(kind)));
    truth.push_back(all.back()->state());
  }
  std::vector<Detection> found;
  found.reserve(1000);
  const std::size_t before = allocations;
  for (std::uint64_t step = 0; step < 100; ++step) {
    for (std::size_t i = 0; i < all.size(); ++i) all[i]->step(0.01, vehicle), truth[i] = all[i]->state();
    scan({}, vehicle, 0, truth, {1, 2}, step, found);
  }
  CHECK(allocations == before);
  CHECK(found.size() > 400);
  for (const Kinematics& x : truth) CHECK(alula::geometry::is_finite(x.p) && norm(x.v) > 0);
}

}  // namespace

int main() {
  test_normals_stay_what_they_were();
  test_poisson_numbers_are_the_inverse_of_the_distribution();
  test_wild_vehicles_do_no_harm();
  test_steps_and_scans_allocate_nothing();
  return alula_failures == 0 ? 0 : 1;
}
