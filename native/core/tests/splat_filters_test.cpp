// Filters among ellipsoids allocate nothing once warm, and equal ticks give equal bits.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>
#include <vector>

#include "allocations.hpp"
#include "alula/filters/cone_di.hpp"
#include "alula/filters/safer_splat.hpp"
#include "check.hpp"

namespace {

using namespace alula;
using namespace alula::flight;

struct Cloud {
  std::vector<float> mean, scale, quat;

  explicit Cloud(std::size_t count) {
    std::mt19937_64 random(7);
    const auto uniform = [&] { return static_cast<float>(random() >> 11) * 0x1p-53F; };
    for (std::size_t i = 0; i < 3 * count; ++i) mean.push_back(4 * uniform() - 2);
    for (std::size_t i = 0; i < 3 * count; ++i) scale.push_back(0.005F + 0.05F * uniform());
    for (std::size_t i = 0; i < 4 * count; ++i) quat.push_back(2 * uniform() - 1);
  }
  std::shared_ptr<const EllipsoidIndex> index() const {
    return std::make_shared<const EllipsoidIndex>(Splats{mean, scale, quat, {}}, 1.0, 0.1);
  }
};

FlightState state(int i) {
  FlightState s;
  s.x.p = {std::sin(0.37 * i), std::cos(0.53 * i), std::sin(0.71 * i)};
  s.x.v = {2 * std::cos(0.29 * i), std::sin(0.41 * i), 0.3 * std::cos(0.13 * i)};
  return s;
}

void test_no_tick_allocates(SafetyFilter& filter) {
  Nominal nominal;
  nominal.acceleration = {3, 1, -1};
  nominal.position_error = {0.1, 0, 0};
  for (int i = 0; i < 3; ++i) filter.filter(state(i), nominal);
  const std::size_t before = allocations;
  unsigned rows = 0, changed = 0;
  for (int i = 0; i < 300; ++i) {
    const FilterReport report = filter.filter(state(i), nominal);
    rows += report.rows, changed += report.status != SafetyStatus::ok;
  }
  CHECK(allocations == before);
  CHECK(rows > 1000 && changed > 100);
}

void test_a_clone_gives_the_same_bits(SafetyFilter& filter) {
  const auto other = filter.clone();
  for (int i = 0; i < 50; ++i) {
    const FilterReport a = filter.filter(state(i), {}), b = other->filter(state(i), {});
    CHECK(std::memcmp(&a.acceleration, &b.acceleration, sizeof a.acceleration) == 0 && a.status == b.status);
  }
}

void test_queries_allocate_only_what_is_found(const EllipsoidIndex& index) {
  std::vector<Found> found;
  found.reserve(64);
  std::uint32_t hint = 0;
  const std::size_t before = allocations;
  for (int i = 0; i < 200; ++i) {
    const FlightState s = state(i);
    index.nearest(s.x.p, s.x.p + 0.3 * s.x.v, 1.0, 64, found);
    CHECK(index.clearance(s.x.p, 5, hint) <= 5);
  }
  CHECK(allocations == before);
}

using Point = geometry::Vec3;

bool is_same(const std::vector<Found>& a, const std::vector<Found>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const Found& x, const Found& y) {
    return x.item == y.item && std::memcmp(&x.distance, &y.distance, sizeof x.distance) == 0;
  });
}

// A walk with jumps: results of earlier queries must not affect later ones.
void test_guesses_change_nothing(const EllipsoidIndex& index) {
  std::mt19937_64 random(11);
  const auto uniform = [&] { return 2 * static_cast<double>(random() >> 11) * 0x1p-53 - 1; };
  std::vector<Found> kept, empty;
  Point p, v{1, 0, 0};
  std::size_t seen = 0;
  for (int i = 0; i < 2000; ++i) {
    v = v + 0.3 * Point{uniform(), uniform(), uniform()};
    p = i % 100 == 0 ? 2 * Point{uniform(), uniform(), uniform()} : p + 0.01 * v;
    if (geometry::norm(p) > 3) p = {}, v = -v;
    const Point end = i % 7 == 0 ? p : p + 0.4 * v;
    const double reach = i % 11 == 0 ? 0.1 : 1.5;
    const std::size_t count = i % 13 == 0 ? 200 : 65;
    if (i % 17 == 0) kept.push_back({4'000'000'000U, 0}), kept.push_back({3, 0}), kept.push_back({3, 0});
    empty.clear();
    if (i % 3 == 0) {
      index.nearest(p, end, reach, count, kept), index.nearest(p, end, reach, count, empty);
    } else {
      index.nearest_ahead(p, end, v, reach, count, kept), index.nearest_ahead(p, end, v, reach, count, empty);
    }
    CHECK(is_same(kept, empty));
    seen += empty.size();
  }
  CHECK(seen > 50'000);
}

// At coordinates where single precision resolves 1 mm, as in national grids.
void test_far_from_the_origin_nothing_is_missed() {
  Cloud cloud(3000);
  for (std::size_t i = 0; i < cloud.mean.size(); i += 3) cloud.mean[i] += 9000, cloud.mean[i + 1] -= 7000;
  const auto index = cloud.index();
  std::vector<Found> found;
  for (int i = 0; i < 40; ++i) {
    const Point p = state(i).x.p + Point{9000, -7000, 0}, v = state(i).x.v;
    std::vector<Found> expected;
    for (std::uint32_t item = 0; item < index->size(); ++item) {
      const GrownEllipsoid& e = index->grown(item);
      const Point r = e.centre - p, ar = e.a * r;
      const double distance = signed_distance(index->ellipsoid(item), p).value;
      if (distance < 1 && (geometry::dot(ar, v) >= 0 || geometry::dot(ar, r) < 1))
        expected.push_back({item, distance});
    }
    index->nearest_ahead(p, p, v, 1, expected.size() + 1, found);
    CHECK(found.size() == expected.size() && found.size() > 20);
    std::sort(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.item < b.item; });
    double smallest = 1;
    for (std::size_t k = 0; k < std::min(found.size(), expected.size()); ++k) {
      CHECK(found[k].item == expected[k].item && std::abs(found[k].distance - expected[k].distance) < 1e-12);
      smallest = std::min(smallest, expected[k].distance);
    }
    std::uint32_t hint = 0;
    CHECK(index->clearance(p, 5, hint) <= smallest + 1e-12);
  }
}

void test_four_at_once_are_four_alone() {
  std::mt19937_64 random(5);
  const auto uniform = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  const auto place = [&](double size) {
    return size * Point{2 * uniform() - 1, 2 * uniform() - 1, 2 * uniform() - 1};
  };
  for (int i = 0; i < 5000; ++i) {
    std::vector<geometry::Sighted> each;
    for (int k = 0; k < 1 + i % 9; ++k) {
      const Point semi{0.001 + 0.2 * uniform(), 0.001 + 0.1 * uniform(), 0.001 + 0.01 * uniform()};
      const Point along = i % 2 == 0 || k == 5 ? Point{} : place(1);
      each.push_back({semi, place(k % 3 == 0 ? 0.1 : 1), along, k % 4 == 3 ? uniform() - 0.1 : 5});
    }
    std::vector<double> distance(each.size());
    geometry::distances_below(each, distance);
    for (std::size_t k = 0; k < each.size(); ++k) {
      const double alone = geometry::distance_below(each[k].semi, each[k].start, each[k].along, each[k].enough);
      CHECK(std::memcmp(&distance[k], &alone, sizeof alone) == 0);
    }
  }
}

// Ellipsoids behind are rejected in single precision first, and queries of segments work without a nearest one.
void test_shortcuts_change_nothing(const EllipsoidIndex& index) {
  std::vector<Found> every, ahead, nearest;
  for (int i = 0; i < 100; ++i) {
    const FlightState s = state(i);
    const Point a = s.x.p, v = s.x.v, b = a + 0.5 * v;
    index.nearest(a, b, 0.8, index.size(), every);
    index.nearest_ahead(a, b, v, 0.8, index.size(), ahead);
    std::erase_if(every, [&](const Found& found) {
      const GrownEllipsoid& e = index.grown(found.item);
      const Point r = e.centre - a, ar = e.a * r;
      return !(dot(ar, v) >= 0 || dot(ar, r) < 1);
    });
    CHECK(!ahead.empty() && is_same(every, ahead));
    const Point far = a + Point{5.0 + 0.01 * i, 0, 0};  // outside of the cloud, so not met
    index.nearest(far, far + 0.2 * v, 10, 1, nearest);
    const double distance = nearest[0].distance;
    CHECK(distance > 0.1 && index.is_near(far, far + 0.2 * v, distance * (1 + 1e-6)) &&
          !index.is_near(far, far + 0.2 * v, distance * (1 - 1e-6)));
  }
}

}  // namespace

int main() {
  const auto index = Cloud(5000).index();
  ConeDiOptions options;
  options.tracking.weight = 10, options.max_acceleration = 8;
  ConeDi cone(index, options);
  SaferSplatOptions few;
  few.rows = SaferRows::nearest;
  SaferSplat distance(index, {}), nearest(index, few);
  for (SafetyFilter* filter : {static_cast<SafetyFilter*>(&cone), static_cast<SafetyFilter*>(&distance),
                               static_cast<SafetyFilter*>(&nearest)}) {
    test_no_tick_allocates(*filter);
    test_a_clone_gives_the_same_bits(*filter);
  }
  test_queries_allocate_only_what_is_found(*index);
  test_guesses_change_nothing(*index);
  test_shortcuts_change_nothing(*index);
  test_far_from_the_origin_nothing_is_missed();
  test_four_at_once_are_four_alone();
  return alula_failures == 0 ? 0 : 1;
}
