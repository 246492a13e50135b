#include "alula/filters/safer_splat.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::is_finite;

constexpr double kViolated = 4e-15;  // of a row, relative to 1 + |a|: rounding error of its slack
constexpr std::size_t kBatch = 16;   // rows added at once
constexpr int kRounds = 256;         // far more than a tick needs

Pruning of_distance(Pruning pruning) {
  pruning.approach = pruning.sweep = false;
  return pruning;
}

double largest(Vec3 u) { return std::max({std::abs(u.x), std::abs(u.y), std::abs(u.z)}); }

// True if the program gets rows on demand, of all ellipsoids or of those within the gate.
bool is_on_demand(const SaferSplatOptions& options) {
  const Pruning& p = options.pruning;
  return options.rows == SaferRows::all || (p.count == 0 && p.gate && p.hold == 1 && !options.brute);
}

std::size_t rows_of(const SaferSplatOptions& options, std::size_t nearest) {
  return is_on_demand(options) ? kBatch * kRounds : nearest;
}

}  // namespace

SaferSplat::SaferSplat(std::shared_ptr<const EllipsoidIndex> index, const SaferSplatOptions& options,
                       Surroundings others)
    : options_(options),
      pruner_(std::move(index), of_distance(options.pruning), others),
      rows_(pruner_.shared_index(), {options.alpha, options.beta, options.hessian}, std::move(others)),
      program_(rows_of(options, pruner_.most())) {
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  if (!positive(options.alpha) || !positive(options.beta))
    throw std::invalid_argument("alpha and beta must be positive");
  if (!(options.max_acceleration > 0) || !positive(options.max_braking))
    throw std::invalid_argument("limits of the acceleration must be positive");
}

FilterReport SaferSplat::filter(const FlightState& state, const Nominal& nominal) {
  FilterReport report;
  const Vec3 p = state.x.p, v = state.x.v;
  if (!is_finite(p) || !is_finite(v) || !is_finite(nominal.acceleration) || !std::isfinite(dot(v, v))) return report;
  program_.start(nominal.acceleration);
  program_.limit(options_.max_acceleration);
  const bool on_demand = is_on_demand(options_);
  const double more = added_margin(state);
  if (on_demand) {
    const bool has_all = options_.rows == SaferRows::all;
    report.gate_m = has_all ? kInfinity : gate_distance(options_.pruning, geometry::norm(v), index().radius());
    rows_.start(p, v, options_.brute, report.gate_m, more);
    report.margin = rows_.least();
  } else {
    add_nearest(p, v, more, report);
  }
  const bool unsafe = report.margin < 0;
  if (!(on_demand ? solve_on_demand(report, unsafe)
                  : program_.accept(report, unsafe) || program_.solve(report, unsafe))) {
    report.infeasible = true;
    program_.brake(report, v, options_.alpha / 2, options_.max_braking);
    const double tolerance = AccelerationProgram::kTolerance * (1 + largest(report.acceleration));
    if (on_demand && !rows_.hold(report.acceleration, tolerance)) report.status = SafetyStatus::recovering;
  }
  report.rows = static_cast<std::uint32_t>(program_.rows());
  if (on_demand) report.candidates = rows_.measured();
  return report;
}

void SaferSplat::add_nearest(Vec3 p, Vec3 v, double more, FilterReport& report) {
  report.margin = kInfinity;
  DistanceLaw law = rows_.law();
  law.more_m = more;
  for (const Found& found : options_.brute ? pruner_.near_by_scan(p, v, report) : pruner_.near(p, v, false, report)) {
    const DistanceBarrier barrier = pruner_.is_local(found.item) ? contact_barrier(pruner_.contact(found.item), law,
                                                                                   pruner_.radius_of_others(), p, v)
                                                                 : distance_barrier(index(), law, found.item, p, v);
    report.margin = std::min(report.margin, barrier.h);
    program_.add(barrier.row, pruner_.number(found.item));
  }
}

bool SaferSplat::solve_on_demand(FilterReport& report, bool unsafe) {
  std::uint32_t iterations = 0;
  for (int round = 0; round < kRounds; ++round) {
    // The nominal input is tested exactly; the program's solution satisfies a row up to rounding.
    const bool is_nominal = program_.accept(report, unsafe);
    if (!is_nominal) {
      const bool is_solved = program_.solve(report, unsafe);
      report.iterations = iterations += report.iterations;
      if (!is_solved) return false;
    }
    const Vec3 u = report.acceleration;
    const double tolerance = is_nominal ? 0 : kViolated * (1 + largest(u));
    auto worst = rows_.worst(u, tolerance, kBatch);
    if (worst.empty() && rows_.search(u, tolerance, kBatch)) worst = rows_.worst(u, tolerance, kBatch);
    if (worst.empty()) return true;
    for (const std::uint32_t i : worst) program_.add(rows_[i].unit, rows_[i].item);
  }
  return false;
}

}  // namespace alula::flight
