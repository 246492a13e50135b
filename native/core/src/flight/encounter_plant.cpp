#include "alula/flight/encounter_plant.hpp"

#include <algorithm>
#include <cmath>

namespace alula::flight {

using geometry::Vec3;

EncounterPlant::EncounterPlant(const PointLimits& limits, double h)
    : h_(h),
      max_speed_(limits.max_speed_m_s),
      most_(limits.max_jerk_m_s3 * h_),
      delay_(static_cast<std::int64_t>(std::ceil(limits.actuation_delay_s / h_ - 1e-6))),
      queue_(4) {}

void EncounterPlant::reset(const Kinematics& start) {
  x_ = start;
  now_ = 0, oldest_ = 0, count_ = 0;
  acting_ = start.a;
}

void EncounterPlant::command(Vec3 acceleration) {
  if (count_ == queue_.size()) {
    std::rotate(queue_.begin(), queue_.begin() + static_cast<std::ptrdiff_t>(oldest_), queue_.end());
    oldest_ = 0;
    queue_.resize(2 * queue_.size());
  }
  queue_[(oldest_ + count_++) % queue_.size()] = {now_ + delay_, acceleration};
}

void EncounterPlant::step() {
  for (; count_ > 0 && queue_[oldest_].begins <= now_; --count_) {
    acting_ = queue_[oldest_].a;
    oldest_ = (oldest_ + 1) % queue_.size();
  }
  for (int i = 0; i < 3; ++i) x_.a[i] += std::clamp(acting_[i] - x_.a[i], -most_, most_);
  const Vec3 wanted = x_.v + h_ * x_.a;
  const double speed = geometry::norm(wanted);
  if (speed > max_speed_) x_.a = 1 / h_ * (max_speed_ / speed * wanted - x_.v);
  x_.p = x_.p + h_ * x_.v + h_ * h_ / 2 * x_.a;
  x_.v = x_.v + h_ * x_.a;
  ++now_;
}

}  // namespace alula::flight
