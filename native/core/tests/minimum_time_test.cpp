// Curves of minimum time through a chain of boxes: in their cells, within limits, through a via point, from motion.
#include "alula/planning/minimum_time.hpp"

#include <cmath>
#include <stdexcept>

#include "check.hpp"

using namespace alula;
using geometry::Vec3;

namespace {

// Two boxes about the segments (0, 0, 0) .. (3, 0, 0) .. (3, 3, 0), three pieces each.
struct Bend {
  std::vector<double> normals, offsets;
  std::vector<std::int64_t> row_start{0};
  std::vector<std::uint32_t> cell{0, 0, 0, 1, 1, 1};
  std::vector<Vec3> joint{5, Vec3{3, 0, 0}};
  std::vector<std::uint8_t> is_via{0, 0, 0, 0, 0};

  Bend() {
    add({-0.3, -0.3, -0.3}, {3.3, 0.3, 0.3});
    add({2.7, -0.3, -0.3}, {3.3, 3.3, 0.3});
  }

  void add(Vec3 lower, Vec3 upper) {
    for (int i = 0; i < 3; ++i) {
      for (const double sign : {-1.0, 1.0}) {
        Vec3 n;
        n[i] = sign;
        normals.insert(normals.end(), {n.x, n.y, n.z});
        offsets.push_back(sign > 0 ? upper[i] : -lower[i]);
      }
    }
    row_start.push_back(static_cast<std::int64_t>(offsets.size()));
  }

  TimeProblem problem() const {
    TimeProblem p{normals, offsets, row_start, cell, {}, {}, {3, 3, 0}, joint, is_via};
    p.limits.speed = 1, p.limits.acceleration = 3, p.limits.jerk = 40, p.limits.snap = 600;
    p.limits.most_thrust = 15, p.limits.least_thrust = 4.9, p.limits.tilt = 0.6;
    return p;
  }
};

void check_curve(const Bend& bend, const TimeCurve& curve) {
  CHECK(curve.status != TimeStatus::infeasible);
  CHECK(curve.point.size() == 8 * bend.cell.size() && curve.duration.size() == bend.cell.size());
  for (std::size_t k = 0; k < bend.cell.size(); ++k) {
    for (std::size_t i = 0; i < 8; ++i) {
      const Vec3 p = curve.point[8 * k + i];
      for (auto r = bend.row_start[bend.cell[k]]; r < bend.row_start[bend.cell[k] + 1]; ++r) {
        const auto row = static_cast<std::size_t>(r);
        CHECK(dot(geometry::from_rows(&bend.normals[3 * row]), p) <= bend.offsets[row] + 1e-12);
      }
      if (i < 7) CHECK(7 / curve.duration[k] * norm(curve.point[8 * k + i + 1] - p) <= 1 + 1e-9);
    }
    if (k > 0) CHECK(norm(curve.point[8 * k] - curve.point[8 * k - 1]) < 1e-12);
  }
  CHECK(norm(curve.point.back() - Vec3{3, 3, 0}) < 1e-12);
}

double total(const TimeCurve& curve) {
  double sum = 0;
  for (const double t : curve.duration) sum += t;
  return sum;
}

void test_curves() {
  const TimeOptions options;
  Bend bend;
  const TimeCurve fastest = minimum_time(bend.problem(), options);
  check_curve(bend, fastest);
  CHECK(total(fastest) > 5.2 && total(fastest) < 6.6);  // 5.2 m at 1 m/s, and two ramps

  TimeProblem moving = bend.problem();
  moving.start = {{}, {0.6, 0.2, 0}, {0.5, 0, 0}, {}, true};
  const TimeCurve begun = minimum_time(moving, options);
  check_curve(bend, begun);
  CHECK(norm(7 / begun.duration[0] * (begun.point[1] - begun.point[0]) - moving.start.v) < 1e-9);
  moving.start.v = {-0.99, 0, 0};
  moving.limits.acceleration = 0.5;
  CHECK(minimum_time(moving, options).status == TimeStatus::infeasible);

  bend.is_via[2] = 1;
  const TimeCurve through = minimum_time(bend.problem(), options);
  check_curve(bend, through);
  CHECK(norm(through.point[24] - Vec3{3, 0, 0}) < 1e-12);
  CHECK(total(through) > total(fastest));
}

void test_a_via_may_be_passed_in_a_disc_along_its_normal_or_in_a_ball() {
  Bend bend;
  bend.is_via[2] = 1;
  const double through = total(minimum_time(bend.problem(), {}));
  const double h = std::sqrt(0.5);
  for (const Vec3 normal : {Vec3{h, h, 0}, Vec3{}}) {
    std::vector<Opening> opening(5);
    opening[2] = {{3, 0, 0}, normal, 0.2};
    for (const bool moves : {false, true}) {
      TimeProblem problem = bend.problem();
      problem.opening = opening;
      if (moves) problem.start = {{}, {0.6, 0.2, 0}, {0.5, 0, 0}, {}, true};
      const TimeCurve curve = minimum_time(problem, {});
      check_curve(bend, curve);
      const Vec3 at = curve.point[24] - Vec3{3, 0, 0};
      CHECK(norm(at) <= 0.2 + 1e-12 && norm(at) > 0.1);
      CHECK(total(curve) < through);
      CHECK(std::abs(dot(normal, at)) < 1e-12);
      if (dot(normal, normal) == 0) continue;
      for (std::size_t i = 0; i < 7; ++i) {
        CHECK(dot(normal, curve.point[16 + i] - Vec3{3, 0, 0}) < 0);
        CHECK(dot(normal, curve.point[25 + i] - Vec3{3, 0, 0}) > 0);
      }
    }
  }
}

void test_a_piece_has_its_own_limit_of_speed() {
  const Bend bend;
  const std::vector<double> speed{1, 1, 1, 0.3, 0.3, 2};
  TimeProblem problem = bend.problem();
  problem.speed = speed;
  const TimeCurve curve = minimum_time(problem, {});
  check_curve(bend, curve);
  for (std::size_t k = 3; k < 5; ++k) {
    for (std::size_t i = 0; i < 7; ++i) {
      CHECK(7 / curve.duration[k] * norm(curve.point[8 * k + i + 1] - curve.point[8 * k + i]) <= 0.3 + 1e-9);
    }
  }
  CHECK(total(curve) > total(minimum_time(bend.problem(), {})) + 0.5);
}

void test_longer_curves_have_less_snap_and_the_same_ratios() {
  const Bend bend;
  const TimeCurve fastest = minimum_time(bend.problem(), {});
  const TimeCurve slower = minimum_time(bend.problem(), {.stretch = 1.5});
  check_curve(bend, slower);
  for (std::size_t k = 0; k < bend.cell.size(); ++k) {
    CHECK(std::abs(slower.duration[k] / fastest.duration[k] - 1.5) < 1e-12);
  }
}

void test_few_steps_give_a_slower_curve_and_bad_sizes_are_refused() {
  Bend bend;
  const TimeCurve early = minimum_time(bend.problem(), {.most_steps = 5});
  CHECK(early.status == TimeStatus::stopped_early);
  check_curve(bend, early);
  CHECK(total(early) > total(minimum_time(bend.problem(), {})));
  bend.cell = {0, 0, 0, 0, 0, 1};  // a piece alone cannot come to rest
  bool refused = false;
  try {
    minimum_time(bend.problem(), {});
  } catch (const std::invalid_argument&) {
    refused = true;
  }
  CHECK(refused);
  for (const int bad : {0, 1, 2}) {
    const Bend good;
    TimeProblem problem = good.problem();
    std::vector<Opening> opening(bad == 0 ? 4 : 5);
    if (bad == 1) opening[2] = {{3, 0, 0}, {0.5, 0, 0}, 0.2};  // its normal is not of unit length
    const std::vector<double> speed(6, bad == 2 ? 0.0 : 1.0);
    problem.opening = opening, problem.speed = speed;
    refused = false;
    try {
      minimum_time(problem, {});
    } catch (const std::invalid_argument&) {
      refused = true;
    }
    CHECK(refused);
  }
}

}  // namespace

int main() {
  test_curves();
  test_a_via_may_be_passed_in_a_disc_along_its_normal_or_in_a_ball();
  test_a_piece_has_its_own_limit_of_speed();
  test_longer_curves_have_less_snap_and_the_same_ratios();
  test_few_steps_give_a_slower_curve_and_bad_sizes_are_refused();
  return alula_failures == 0 ? 0 : 1;
}
