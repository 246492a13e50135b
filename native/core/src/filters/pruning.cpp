#include "alula/filters/pruning.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "alula/base/constants.hpp"

namespace alula::flight {
namespace {

constexpr double kBall = 0.3;              // radius of a local ball before it is grown [m]
constexpr std::size_t kMapContacts = 256;  // reserved where the number of rows has no limit

GrownEllipsoid ball_of(const Contact& contact, double radius) {
  const double grown = kBall + radius;
  return {contact.point - kBall * contact.normal, 1 / (grown * grown) * geometry::identity()};
}

}  // namespace

double gate_distance(const Pruning& pruning, double speed, double radius) {
  const double path = speed * (pruning.reaction_time_s + speed / (2 * pruning.max_deceleration));
  return std::max(pruning.floor_m, path + radius);
}

Pruner::Pruner(std::shared_ptr<const EllipsoidIndex> index, const Pruning& pruning, Surroundings others)
    : index_(std::move(index)), pruning_(pruning), others_(std::move(others)) {
  if (!index_) throw std::invalid_argument("there is no index");
  const auto at_least_zero = [](double value) { return value >= 0 && std::isfinite(value); };
  if (!at_least_zero(pruning.reaction_time_s) || !at_least_zero(pruning.floor_m))
    throw std::invalid_argument("reaction time and floor of the gate must be at least 0");
  if (!(pruning.max_deceleration > 0 && std::isfinite(pruning.max_deceleration)))
    throw std::invalid_argument("the deceleration of the gate must be positive");
  if (pruning_.hold < 1) throw std::invalid_argument("candidates are kept for at least one call");
  std::size_t reserved = most() + 1;
  if (others_.map) {
    if (!at_least_zero(others_.radius_m)) throw std::invalid_argument("the radius of rows must be at least 0");
    memory_ = others_.map->memory();
    const std::size_t contacts = pruning.count == 0 ? kMapContacts : std::size_t{pruning.count} + 1;
    contact_.reserve(contacts), ball_.reserve(contacts), reserved += contacts;
  }
  found_.reserve(reserved);
}

std::size_t Pruner::most() const {
  const bool all = !pruning_.gate || pruning_.count == 0;
  return all ? index_->size() : std::min<std::size_t>(index_->size(), pruning_.count);
}

bool Pruner::is_kept() {
  const bool kept = age_ > 0;
  age_ = (age_ + 1) % pruning_.hold;
  return kept;
}

std::span<const Found> Pruner::kept(FilterReport& report) const {
  report.gate_m = kept_gate_m_, report.capped = is_kept_capped_;
  report.candidates = static_cast<std::uint32_t>(found_.size());
  return found_;
}

std::span<const Found> Pruner::capped(FilterReport& report) {
  report.capped = pruning_.count > 0 && std::max(found_.size(), contact_.size()) > pruning_.count;
  if (report.capped) found_.resize(std::min<std::size_t>(found_.size(), pruning_.count));
  report.candidates = static_cast<std::uint32_t>(found_.size());
  kept_gate_m_ = report.gate_m, is_kept_capped_ = report.capped;
  return found_;
}

// Adds the obstacles of the second map within the gate, and keeps the order of the candidates.
void Pruner::add_others(Vec3 p, Vec3 v, bool approach, const FilterReport& report) {
  if (!others_.map) return;
  using geometry::dot;
  const bool is_limited = pruning_.gate && pruning_.count > 0;
  const std::size_t count = is_limited ? std::size_t{pruning_.count} + 1 : std::numeric_limits<std::size_t>::max();
  others_.map->near(p, report.gate_m, count, contact_, memory_);
  ball_.clear();
  const auto first = static_cast<std::uint32_t>(index_->size());
  for (std::uint32_t i = 0; i < contact_.size(); ++i) {
    ball_.push_back(ball_of(contact_[i], others_.radius_m));
    const bool is_inside = contact_[i].distance < others_.radius_m;
    if (!approach || !pruning_.approach || is_inside || dot(contact_[i].normal, v) <= 0)
      found_.push_back({first + i, contact_[i].distance});
  }
  if (pruning_.gate) std::sort(found_.begin(), found_.end(), nearer_found);
}

std::span<const Found> Pruner::near(Vec3 p, Vec3 v, bool approach, FilterReport& report) {
  using geometry::dot;
  if (is_kept()) return kept(report);
  if (!pruning_.gate) {
    const auto passes = [&](const GrownEllipsoid& e) {
      const Vec3 r = e.centre - p, ar = e.a * r;
      return !approach || !pruning_.approach || dot(ar, v) >= 0 || dot(ar, r) < 1;
    };
    report.gate_m = kInfinity;
    found_.clear();
    for (std::uint32_t item = 0; item < index_->size(); ++item)
      if (passes(index_->grown(item))) found_.push_back({item, 0});
    add_others(p, v, approach, report);
    kept_gate_m_ = kInfinity, is_kept_capped_ = false;
    return kept(report);
  }
  const double speed = geometry::norm(v);
  report.gate_m = gate_distance(pruning_, speed, index_->radius());
  const double time = pruning_.sweep ? pruning_.reaction_time_s + speed / (2 * pruning_.max_deceleration) : 0;
  const std::size_t count = pruning_.count == 0
                                ? index_->size()
                                : std::size_t{pruning_.count} + 1;  // one more shows whether the cap applies
  const Vec3 end = p + time * v;
  if (approach && pruning_.approach) {
    index_->nearest_ahead(p, end, v, report.gate_m, count, found_);
  } else {
    index_->nearest(p, end, report.gate_m, count, found_);
  }
  add_others(p, v, approach, report);
  return capped(report);
}

std::span<const Found> Pruner::near_by_scan(Vec3 p, Vec3 v, FilterReport& report) {
  if (is_kept()) return kept(report);
  report.gate_m = pruning_.gate ? gate_distance(pruning_, geometry::norm(v), index_->radius()) : kInfinity;
  found_.clear();
  for (std::uint32_t item = 0; item < index_->size(); ++item) {
    const double distance = geometry::signed_distance(index_->ellipsoid(item), p).value - index_->ball(item);
    if (distance < report.gate_m) found_.push_back({item, distance});
  }
  add_others(p, v, false, report);
  if (!pruning_.gate) {
    kept_gate_m_ = kInfinity, is_kept_capped_ = false;
    return kept(report);
  }
  std::sort(found_.begin(), found_.end(), nearer_found);
  return capped(report);
}

}  // namespace alula::flight
