#include "alula/filters/cone_di.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

using geometry::dot;
using geometry::is_finite;
using geometry::norm;

constexpr double kLead = 0.1;                              // h reaches 0 this long before contact [s]
constexpr double kLeastContact = 0.05;                     // below this, alpha overshoots within a tick of 10 ms [s]
constexpr double kSmallestPart = 0.125, kLeastNotice = 1;  // of a grown radius, and until it is met [s]
constexpr double kHeadOn = 0.02;                           // sideways component of a unit row

}  // namespace

ConeDi::ConeDi(std::shared_ptr<const EllipsoidIndex> index, const ConeDiOptions& options, QpSolver solver)
    : options_(options), pruner_(std::move(index), options.pruning), program_(pruner_.most(), std::move(solver)) {
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  const auto at_least_zero = [](double value) { return value >= 0 && std::isfinite(value); };
  if (!positive(options.alpha) || !positive(options.escape_rate))
    throw std::invalid_argument("alpha and escape_rate must be positive");
  if (!at_least_zero(options.recovery) || !at_least_zero(options.swell))
    throw std::invalid_argument("recovery and swell must be at least 0");
  if (!positive(options.min_speed)) throw std::invalid_argument("min_speed must be positive");
  if (!(options.max_acceleration > 0) || !positive(options.max_braking))
    throw std::invalid_argument("limits of the acceleration must be positive");
  if (!at_least_zero(options.lateral_bias)) throw std::invalid_argument("lateral_bias must be at least 0");
  if (!at_least_zero(options.tracking.weight)) throw std::invalid_argument("clf_weight must be at least 0");
  cones_.reserve(pruner_.most());
  if (!positive(options.tracking.rate) || !positive(options.tracking.kp) || !positive(options.tracking.kv))
    throw std::invalid_argument("rate and gains of the tracking row must be positive");
}

Cone ConeDi::cone(std::uint32_t item, Vec3 p, Vec3 v, double more) const {
  for (double part = 1; more > 0 && part >= kSmallestPart; part /= 2) {
    const Cone grown = cone_of(pruner_.index().grown(item, part * more), p, v);
    if (!grown.is_inside() && grown.contact_time() >= kLeastNotice) return grown;
  }
  return cone_of(pruner_.index().grown(item), p, v);
}

Cone ConeDi::cone_of(const GrownEllipsoid& e, Vec3 p, Vec3 v) const {
  const double larger = 1 + options_.swell;
  return collision_cone({e.centre, 1 / (larger * larger) * e.a}, p, v);
}

void ConeDi::add_tracking_row(const Nominal& nominal) {
  const double kp = options_.tracking.kp, kv = options_.tracking.kv;
  const double p12 = 1 / (2 * kp), p22 = (1 + 2 * p12) / (2 * kv), p11 = kv * p12 + kp * p22;
  const Vec3 e_p = nominal.position_error, e_v = nominal.velocity_error;
  const Vec3 x = p11 * e_p + p12 * e_v, y = p12 * e_p + p22 * e_v;
  const double value = 0.5 * (dot(e_p, x) + dot(e_v, y));
  if (dot(y, y) == 0) return;
  program_.add_soft({-1 * y, dot(e_v, x) - dot(y, nominal.reference_acceleration) + options_.tracking.rate * value},
                    options_.tracking.weight);
}

Vec3 ConeDi::bias(Vec3 v) const {
  const Vec3 a = program_.nominal();
  std::size_t worst = 0;
  double least = kInfinity;
  for (std::size_t i = 0; i < program_.rows(); ++i) {
    const double slack = program_.slack(i, a);
    if (slack < least) least = slack, worst = i;
  }
  if (!(least < 0)) return {};
  const Vec3 along = 1 / norm(v) * v, row = program_.row(worst);
  const Vec3 sideways = row - dot(row, along) * along;
  if (dot(row, along) >= 0 || norm(sideways) > kHeadOn) return {};
  Vec3 side = geometry::cross(along, geometry::e3);
  if (norm(side) < 1e-3) side = geometry::cross(along, Vec3{0, 1, 0});
  side = (dot(sideways, side) < 0 ? -1 : 1) / norm(side) * side;
  return options_.lateral_bias * side;
}

FilterReport ConeDi::filter(const FlightState& state, const Nominal& nominal) {
  FilterReport report;
  const Vec3 p = state.x.p, v = state.x.v;
  const bool tracks = options_.tracking.weight > 0;
  if (!is_finite(p) || !is_finite(v) || !is_finite(nominal.acceleration) || !std::isfinite(dot(v, v)) ||
      (tracks && !(is_finite(nominal.position_error) && is_finite(nominal.velocity_error) &&
                   is_finite(nominal.reference_acceleration)))) {
    return report;
  }
  const bool moves = norm(v) >= options_.min_speed;
  bool inside = false;
  report.margin = kInfinity;
  program_.start(nominal.acceleration);
  program_.limit(options_.max_acceleration);
  const auto candidates = pruner_.near(p, v, moves, report);
  cones_.clear();
  const double more = added_margin(state);
  for (const Found& found : candidates) cones_.push_back(cone(found.item, p, v, more));
  double contact = kInfinity;
  if (moves && options_.recovery > 0)
    for (const Cone& cone : cones_) contact = std::min(contact, cone.contact_time());
  const double alpha = std::max(options_.alpha, options_.recovery / std::max(contact - kLead, kLeastContact));
  const double edge = 1 / ((1 + options_.swell) * (1 + options_.swell)) - 1;  // gamma on the ellipsoid of the index
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    const Cone& cone = cones_[i];
    const bool on_cone = moves && !cone.is_inside();
    inside = inside || cone.gamma < edge;
    report.margin = std::min(report.margin, on_cone ? cone.h : cone.gamma);
    program_.add(on_cone ? cone_row(cone, alpha) : escape_row(cone, options_.escape_rate), candidates[i].item);
  }
  report.rows = static_cast<std::uint32_t>(program_.rows());
  if (tracks) add_tracking_row(nominal);

  if (program_.accept(report, inside)) return report;
  if (moves && options_.lateral_bias > 0) program_.set_nominal(nominal.acceleration + bias(v));
  if (!program_.solve(report, inside)) program_.brake(report, v, alpha / 2, options_.max_braking);
  return report;
}

}  // namespace alula::flight
