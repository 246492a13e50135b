// Wrench filters among ellipsoids allocate nothing once warm, return admissible inputs, and repeat themselves.
#include <cmath>
#include <cstring>
#include <random>
#include <vector>

#include "allocations.hpp"
#include "alula/filters/cone_backup.hpp"
#include "alula/filters/cone_ecbf.hpp"
#include "alula/filters/shield_filter.hpp"
#include "check.hpp"

namespace {

using namespace alula;
using namespace alula::flight;

Quadrotor vehicle() {
  const double l = 0.078;
  return {0.461,
          {6.5e-4, 6.9e-4, 1.1e-3},
          {{l, -l, l, -l}, {l, -l, -l, l}, {-1, -1, 1, 1}, 0.0116, {}, {4.25, 4.25, 4.25, 4.25}}};
}

std::shared_ptr<const EllipsoidIndex> cloud(std::size_t count) {
  std::vector<float> mean, scale, quat;
  std::mt19937_64 random(7);
  const auto uniform = [&] { return static_cast<float>(random() >> 11) * 0x1p-53F; };
  for (std::size_t i = 0; i < 3 * count; ++i) mean.push_back(6 * uniform() - 3);
  for (std::size_t i = 0; i < 3 * count; ++i) scale.push_back(0.005F + 0.05F * uniform());
  for (std::size_t i = 0; i < 4 * count; ++i) quat.push_back(2 * uniform() - 1);
  return std::make_shared<const EllipsoidIndex>(Splats{mean, scale, quat, {}}, 1.0, 0.1);
}

FlightState state(int i) {
  FlightState s;
  s.x.p = {std::sin(0.37 * i), std::cos(0.53 * i), std::sin(0.71 * i)};
  s.x.sigma = {0.05 * std::sin(0.2 * i), 0.05 * std::cos(0.3 * i), 0.5 * std::sin(0.05 * i)};
  s.x.v = {2 * std::cos(0.29 * i), std::sin(0.41 * i), 0.3 * std::cos(0.13 * i)};
  s.thrust = 4.5;
  return s;
}

Nominal nominal() {
  Nominal n;
  n.wrench = {5.5, {0.02, -0.03, 0.001}};
  n.position_error = {0.1, 0, 0.2};
  return n;
}

// States in an order that cannot occur in a flight: the filter's commitments do not apply and must not do harm.
void test_ticks(SafetyFilter& filter, bool has_rows = true) {
  const Quadrotor body = vehicle();
  const auto other = filter.clone();
  for (SafetyFilter* each : {&filter, other.get()}) {
    for (int i = 0; i < 100; ++i) each->filter(state(i), nominal());
    each->reset();
  }
  const std::size_t before = allocations;
  unsigned rows = 0, changed = 0, certified = 0, different = 0, inadmissible = 0;
  for (int i = 0; i < 100; ++i) {
    const FilterReport report = filter.filter(state(i), nominal()), again = other->filter(state(i), nominal());
    rows += report.rows, changed += report.status != SafetyStatus::ok, certified += report.certified;
    different += std::memcmp(&report.wrench, &again.wrench, sizeof report.wrench) != 0;
    inadmissible += !body.admissible(report.wrench, 1e-9);
  }
  CHECK((rows > 100) == has_rows && changed > 10 && certified > 10);
  CHECK(different == 0);
  CHECK(inadmissible == 0);
  CHECK(allocations == before);
}

// Boxes on a lattice, beside ellipsoids and in a fence.
std::shared_ptr<const ObstacleMap> rooms(std::shared_ptr<const EllipsoidIndex> index) {
  std::vector<double> normals, offsets, vertices;
  std::vector<std::int64_t> planes{0}, corners{0};
  std::vector<geometry::HalfSpace> fence;
  for (int i = 0; i < 3; ++i)
    for (const double side : {1.0, -1.0}) {
      geometry::Vec3 n;
      n[i] = side;
      fence.push_back({n, 2.5});
    }
  for (int k = 0; k < 8; ++k) {
    const geometry::Vec3 low{k & 1 ? 0.8 : -1.2, k & 2 ? 0.8 : -1.2, k & 4 ? 0.8 : -1.2};
    for (const geometry::HalfSpace& plane : fence) {
      normals.insert(normals.end(), {plane.normal.x, plane.normal.y, plane.normal.z});
      const double along = dot(plane.normal, low);
      offsets.push_back(dot(plane.normal, {1, 1, 1}) > 0 ? along + 0.3 : along);
    }
    for (int corner = 0; corner < 8; ++corner)
      for (int i = 0; i < 3; ++i) vertices.push_back(low[i] + (corner >> i & 1 ? 0.3 : 0));
    planes.push_back(static_cast<std::int64_t>(offsets.size()));
    corners.push_back(static_cast<std::int64_t>(vertices.size() / 3));
  }
  const auto hulls = std::make_shared<const PolytopeSet>(normals, offsets, planes, vertices, corners);
  return std::make_shared<const MapUnion>(std::vector<std::shared_ptr<const ObstacleMap>>{
      std::make_shared<const EllipsoidMap>(index), std::make_shared<const HullMap>(hulls),
      std::make_shared<const FenceMap>(fence)});
}

// A row that is not finite is never left out: no input satisfies it, for any bound.
void test_rows_that_are_no_numbers() {
  WrenchProgram program(vehicle(), 4);
  Vec4 u{};
  const double nan = std::nan("");
  const auto solves = [&](const Vec4& row, double bound) {
    FilterReport report;
    program.start({4.5, 0, 0, 0});
    program.add({row, bound}, 0);
    return program.solve({4.5, 0, 0, 0}, u, report);
  };
  CHECK(solves({0, 0, 0, 0}, -1));
  CHECK(!solves({0, 0, 0, 0}, 1));
  for (const double bound : {-1.0, 0.0, 1.0, nan}) {
    CHECK(!solves({nan, 0, 0, 0}, bound));
    CHECK(!solves({0, 0, 0, nan}, bound));
    CHECK(!solves({1, 0, nan, 0}, bound));
  }
  CHECK(!solves({1, 0, 0, 0}, nan));
}

void test_shortcuts_give_the_same_bits() {
  std::mt19937_64 random(11);
  const auto some = [&](double size) {
    const auto one = [&] { return size * (static_cast<double>(random() >> 11) * 0x1p-52 - 1); };
    return geometry::Vec3{one(), one(), one()};
  };
  const Quadrotor body = vehicle();
  const BackupPolicy brake(body, BackupKind::brake), hover(body, BackupKind::hover);
  int rests = 0;
  for (int i = 0; i < 2000; ++i) {
    const double size = i % 2 == 0 ? 1 : 0.03;
    const State x{some(5), some(0.5 * size), some(2 * size), some(4 * size)};
    const Wrench u{4.5 + size * some(2).x, some(0.1)};
    const State fused = body.step(x, u, 0.01),
                plain = rk4_step(x, 0.01, [&](double, const State& at) { return body.derivative(at, u); });
    CHECK(std::memcmp(&fused, &plain, sizeof fused) == 0);
    for (const BackupPolicy* policy : {&brake, &hover}) {
      const double sway = policy->sway(x);
      rests += sway <= 0.008;
      for (const double limit : {0.008, sway, std::nextafter(sway, 0.0), 0.5 * sway, 2 * sway})
        CHECK(policy->sways_at_most(x, limit) == (sway <= limit));
    }
  }
  CHECK(rests > 20);
}

}  // namespace

int main() {
  test_rows_that_are_no_numbers();
  test_shortcuts_give_the_same_bits();
  const auto index = cloud(400);
  for (const BackupKind kind :
       {BackupKind::hover, BackupKind::heading_invariant, BackupKind::brake, BackupKind::cone_escape}) {
    const BackupPolicy policy(vehicle(), kind);
    for (const double weight : {0.0, 10.0}) {
      ConeEcbfOptions ecbf;
      ConeBackupOptions backup;
      ecbf.tracking.weight = backup.tracking.weight = weight;
      // With lag too; without rotor thrusts the filter assumes hovering.
      ecbf.shield_options.motor_time_constant_s = backup.shield_options.motor_time_constant_s = weight > 0 ? 0.03 : 0;
      ConeEcbf first(policy, index, ecbf);
      ConeBackup second(policy, index, backup);
      test_ticks(first), test_ticks(second);
    }
    if (policy.escapes()) continue;
    const Surroundings kept{rooms(index), 0.1};
    ShieldFilter alone(policy, kept);
    ConeBackup among_all(policy, index, {}, {}, kept);
    test_ticks(alone, false), test_ticks(among_all);
  }
  return alula_failures;
}
