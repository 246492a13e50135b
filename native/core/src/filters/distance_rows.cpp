#include "alula/filters/distance_rows.hpp"

#include <algorithm>
#include <cmath>

#include "alula/base/constants.hpp"
#include "alula/filters/acceleration_program.hpp"

namespace alula::flight {
namespace {

constexpr std::size_t kRows = 8192;      // rows reserved in the constructor
constexpr std::size_t kContacts = 1024;  // the same for the second map
constexpr std::size_t kAll = std::numeric_limits<std::size_t>::max();

}  // namespace

DistanceRows::DistanceRows(std::shared_ptr<const EllipsoidIndex> index, const DistanceLaw& law, Surroundings others)
    : index_(std::move(index)), law_(law), others_(std::move(others)), seen_(index_->size(), 0) {
  std::size_t rows = std::min(kRows, index_->size());
  if (others_.map) {
    rows += kContacts;
    contact_.reserve(kContacts);
    memory_ = others_.map->memory();
  }
  row_.reserve(rows), order_.reserve(rows), worst_.reserve(rows), heap_.reserve(rows);
}

bool DistanceRows::is_beyond(const geometry::Box& box, double ball) const {
  const double far = reach_ + ball;
  return squared_distance(box, {p_, p_}) > (1 + 1e-12) * far * far;
}

void DistanceRows::start(Vec3 p, Vec3 v, bool all, double reach, double more_m) {
  law_.more_m = more_m;
  p_ = p, v_ = v, has_all_ = all, reach_ = reach;
  least_ = kInfinity, measured_ = 0;
  row_.clear();
  looked_ = -kInfinity;
  if (others_.map) {
    look(all ? kInfinity : contact_reach(law_, others_.radius_m, v, {}), {}, kInfinity);
    const double d = contact_.empty() ? others_.map->distance(p, reach, memory_) : kInfinity;
    if (d < reach) least_ = barrier_at(law_, d, others_.radius_m);
  }
  if (++tick_ == 0) std::fill(seen_.begin(), seen_.end(), 0), tick_ = 1;
  if (all) {
    for (std::uint32_t item = 0; item < index_->size(); ++item) measure(item);
    return;
  }
  index_->visit_least(
      heap_, least_,
      [&](const geometry::Box& box, double ball) {
        return is_beyond(box, ball) ? kInfinity : least_barrier(box, index_->radius() + law_.more_m + ball, p);
      },
      [&](std::uint32_t item) { measure(item); });
}

bool DistanceRows::measure(std::uint32_t item) {
  seen_[item] = tick_;
  ++measured_;
  return store(distance_barrier(*index_, law_, item, p_, v_), item);
}

bool DistanceRows::store(const DistanceBarrier& barrier, std::uint32_t item) {
  if (!(barrier.distance < reach_)) return false;
  least_ = std::min(least_, barrier.h);
  const AccelerationRow unit = normalised(barrier.row);
  if (unit.bound == -kInfinity) return false;
  row_.push_back({unit, geometry::norm(barrier.row.row), item, false});
  return true;
}

bool DistanceRows::look(double reach, Vec3 u, double tolerance) {
  reach = std::min(reach, reach_);
  if (!(reach > looked_)) return false;
  others_.map->near(p_, reach, kAll, contact_, memory_);
  const auto first = static_cast<std::uint32_t>(index_->size());
  bool is_violated = false;
  for (const Contact& contact : contact_) {
    if (contact.distance < looked_) continue;
    ++measured_;
    if (store(contact_barrier(contact, law_, others_.radius_m, p_, v_), first + contact.index))
      is_violated = is_violated || row_.back().slack(u) < -tolerance;
  }
  looked_ = reach;
  return is_violated;
}

bool DistanceRows::search(Vec3 u, double tolerance, std::size_t enough) {
  if (has_all_) return false;
  const bool is_violated = others_.map && look(contact_reach(law_, others_.radius_m, v_, u), u, tolerance);
  double limit = 0;
  value_.clear();
  const DistanceRowBound bound(law_, index_->radius(), p_, v_, u);
  const auto within = [&](const geometry::Box& box, double ball) {
    return is_beyond(box, ball) ? kInfinity : bound(box, ball);
  };
  index_->visit_least(heap_, limit, within, [&](std::uint32_t item) {
    if (seen_[item] == tick_ || !measure(item)) return;
    const double slack = row_.back().slack(u), value = slack * row_.back().length;
    if (slack >= -tolerance) return;
    value_.push_back(std::isnan(value) ? -kInfinity : value);
    std::push_heap(value_.begin(), value_.end());
    if (value_.size() < enough) return;
    if (value_.size() > enough) std::pop_heap(value_.begin(), value_.end()), value_.pop_back();
    limit = std::min(limit, value_.front());  // the remaining rows are violated less than `enough` others
  });
  return is_violated || !value_.empty();
}

bool DistanceRows::hold(Vec3 u, double tolerance) {
  const auto holds = [&](const Row& row) { return row.slack(u) >= -tolerance; };
  return std::all_of(row_.begin(), row_.end(), holds) && !search(u, tolerance, 1);
}

std::span<const std::uint32_t> DistanceRows::worst(Vec3 u, double tolerance, std::size_t count) {
  order_.clear(), worst_.clear();
  for (std::uint32_t i = 0; i < row_.size(); ++i) {
    if (row_[i].is_taken) continue;
    const double slack = row_[i].slack(u);
    if (slack >= -tolerance) continue;
    order_.push_back({std::isnan(slack) ? -kInfinity : slack, i});
  }
  const std::size_t taken = std::min(count, order_.size());
  std::partial_sort(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(taken), order_.end());
  for (std::size_t i = 0; i < taken; ++i) {
    worst_.push_back(order_[i].second);
    row_[order_[i].second].is_taken = true;
  }
  return worst_;
}

}  // namespace alula::flight
