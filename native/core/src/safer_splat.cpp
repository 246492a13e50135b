#include "alula/safer_splat.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::is_finite;
using geometry::norm;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// v^T H v with H along the ellipsoid's axes, for v in the world's frame.
double curvature(const geometry::Ellipsoid& e, const geometry::Projection& at, Vec3 v) {
  double sum = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += dot(e.axis[i], v) * at.hessian[i][j] * dot(e.axis[j], v);
  return sum;
}

// The same with v's world components taken for those along the axes by descending length, each axis turned
// so that the point is on its positive side.
double published_curvature(const geometry::Ellipsoid& e, const geometry::Projection& at, Vec3 v) {
  int order[3] = {0, 1, 2};
  std::sort(order, order + 3, [&](int i, int j) { return e.semi[i] != e.semi[j] ? e.semi[i] > e.semi[j] : i < j; });
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const bool flips = (at.local[order[i]] < 0) != (at.local[order[j]] < 0);
      sum += v[i] * v[j] * (flips ? -1 : 1) * at.hessian[order[i]][order[j]];
    }
  }
  return sum;
}

Pruning of_distance(Pruning pruning) {
  pruning.approach = pruning.sweep = false;
  return pruning;
}

}  // namespace

SaferSplat::SaferSplat(std::shared_ptr<const EllipsoidIndex> index, const SaferSplatOptions& options)
    : options_(options), pruner_(std::move(index), of_distance(options.pruning)), program_(pruner_.most()) {
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  if (!positive(options.alpha) || !positive(options.beta))
    throw std::invalid_argument("alpha and beta must be positive");
  if (!(options.max_acceleration > 0) || !positive(options.max_braking))
    throw std::invalid_argument("limits of the acceleration must be positive");
}

SaferSplat::Barrier SaferSplat::barrier(std::uint32_t item, Vec3 p, Vec3 v) const {
  const geometry::Ellipsoid e = pruner_.index().ellipsoid(item);
  const geometry::Projection at = geometry::project(e, p);
  const double phi = at.distance < 0 ? -1 : 1, radius = pruner_.index().radius() + pruner_.index().ball(item);
  const double a = options_.alpha, b = options_.beta;
  Barrier result;
  result.h = at.distance * std::abs(at.distance) - radius * radius;
  result.row.row = 2 * phi * at.offset;
  const double bend = options_.hessian == SaferHessian::correct ? curvature(e, at, v) : published_curvature(e, at, v);
  result.row.bound = -(phi * bend + (a + b) * dot(result.row.row, v) + a * b * result.h);
  return result;
}

FilterReport SaferSplat::filter(const FlightState& state, const Nominal& nominal) {
  FilterReport report;
  const Vec3 p = state.x.p, v = state.x.v;
  if (!is_finite(p) || !is_finite(v) || !is_finite(nominal.acceleration) || !std::isfinite(dot(v, v))) return report;
  report.margin = kInfinity;
  program_.start(nominal.acceleration);
  program_.limit(options_.max_acceleration);
  const auto candidates = options_.brute ? pruner_.near_by_scan(p, v, report) : pruner_.near(p, v, false, report);
  for (const Found& found : candidates) {
    const Barrier barrier = this->barrier(found.item, p, v);
    report.margin = std::min(report.margin, barrier.h);
    program_.add(barrier.row, found.item);
  }
  report.rows = static_cast<std::uint32_t>(program_.rows());

  const bool unsafe = report.margin < 0;
  if (!program_.accept(report, unsafe) && !program_.solve(report, unsafe))
    program_.brake(report, v, options_.alpha / 2, options_.max_braking);
  return report;
}

}  // namespace alula::flight
