// Distances agree with closed forms and do not depend on the tree or the threads.
#include "alula/geometry/clearance.hpp"

#include <cmath>
#include <random>

#include "boxes.hpp"
#include "check.hpp"

using namespace alula;
using geometry::Vec3;

namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

double between(const PolytopeSet& set, Vec3 a, Vec3 b) {
  std::uint32_t nearest = 0xffffffffu;
  std::vector<double> scratch;
  return set.clearance(a, b, kNone, nearest, scratch);
}

void test_closed_forms() {
  Boxes boxes;
  boxes.add({0, 0, 0}, {2, 1, 1});
  const PolytopeSet set = boxes.set();
  CHECK(between(set, {-1, 0.5, 0.5}, {-3, 0.5, 0.5}) == 1.0);
  CHECK(std::abs(between(set, {3, 2, 2}, {4, 3, 3}) - std::sqrt(3.0)) < 1e-15);
  CHECK(between(set, {-5, 0.5, 3}, {5, 0.5, 3}) == 2.0);
  CHECK(between(set, {-1, 1, 0.5}, {3, 1, 0.5}) == 0.0);
  CHECK(between(set, {-1, 0.5, 0.5}, {3, 0.5, 0.5}) == -0.5);

  const geometry::Ellipsoid disc{{0, 0, 0}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {1e-9, 1, 1}};
  CHECK(geometry::signed_distance(disc, {0, 3, 0}).value == 2.0);
  CHECK(std::abs(geometry::signed_distance(disc, {0, 0, 0}).value + 1e-9) < 1e-15);
  CHECK(std::abs(geometry::signed_distance(disc, {-1, 0.5, 0}, {-0.5, 0.5, 0}, kNone) - 0.5) < 1e-8);
}

void test_tree_and_threads_change_nothing() {
  std::mt19937_64 random(1);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  Boxes boxes;
  std::vector<PolytopeSet> alone;
  for (int k = 0; k < 50; ++k) {
    const Vec3 low{8 * uniform(), 8 * uniform(), 8 * uniform()};
    const Vec3 high = low + Vec3{0.1 + uniform(), 0.1 + uniform(), 0.1 + uniform()};
    boxes.add(low, high);
    Boxes one;
    one.add(low, high);
    alone.push_back(one.set());
  }
  const PolytopeSet set = boxes.set();
  std::vector<double> start, end;
  for (int i = 0; i < 3000; ++i) start.push_back(9 * uniform()), end.push_back(9 * uniform());
  Control control;
  const std::vector<double> one = segment_clearance(set, start, end, kNone, 1, control);
  CHECK(one == segment_clearance(set, start, end, kNone, 3, control));
  for (std::size_t i = 0; i < one.size(); ++i) {
    double smallest = kNone;
    for (const PolytopeSet& box : alone) {
      smallest =
          std::min(smallest, between(box, geometry::from_rows(&start[3 * i]), geometry::from_rows(&end[3 * i])));
    }
    CHECK(std::abs(one[i] - smallest) < 1e-13);
  }
}

}  // namespace

int main() {
  test_closed_forms();
  test_tree_and_threads_change_nothing();
  return alula_failures == 0 ? 0 : 1;
}
