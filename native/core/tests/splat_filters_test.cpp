// Filters among ellipsoids allocate nothing once warm, and equal ticks give equal bits.
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <new>
#include <random>
#include <vector>

#include "alula/cone_di.hpp"
#include "alula/safer_splat.hpp"
#include "check.hpp"

namespace {

std::atomic<std::size_t> allocations{0};

}  // namespace

void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size == 0 ? 1 : size)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

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

void test_no_tick_allocates(SplatFilter& filter) {
  Nominal nominal;
  nominal.acceleration = {3, 1, -1};
  nominal.position_error = {0.1, 0, 0};
  for (int i = 0; i < 3; ++i) filter.filter(state(i), nominal);
  const std::size_t before = allocations;
  unsigned rows = 0, changed = 0;
  for (int i = 0; i < 300; ++i) {
    const FilterReport report = filter.filter(state(i), nominal);
    rows += report.rows, changed += report.status != SplatFilterStatus::ok;
  }
  CHECK(allocations == before);
  CHECK(rows > 1000 && changed > 100);
}

void test_a_clone_gives_the_same_bits(SplatFilter& filter) {
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

}  // namespace

int main() {
  const auto index = Cloud(5000).index();
  ConeDiOptions options;
  options.clf_weight = 10, options.max_acceleration = 8;
  ConeDi cone(index, options);
  SaferSplatOptions few;
  few.rows = SaferRows::nearest;
  SaferSplat distance(index, {}), nearest(index, few);
  for (SplatFilter* filter : {static_cast<SplatFilter*>(&cone), static_cast<SplatFilter*>(&distance),
                              static_cast<SplatFilter*>(&nearest)}) {
    test_no_tick_allocates(*filter);
    test_a_clone_gives_the_same_bits(*filter);
  }
  test_queries_allocate_only_what_is_found(*index);
  return alula_failures == 0 ? 0 : 1;
}
