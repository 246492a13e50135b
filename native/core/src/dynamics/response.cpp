#include "alula/dynamics/response.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace alula::flight {

using geometry::norm;

void check(const ResponseOptions& o, double gravity) {
  if (!(o.time_s == 0 || (o.time_s >= 0.05 && o.time_s <= 10)))
    throw std::invalid_argument("the time of a response observer must be 0 or in 0.05..10 s");
  if (!(o.max_m_s2 > 0 && o.max_m_s2 < gravity))
    throw std::invalid_argument("a disturbance must be positive and below gravity");
  if (!(o.room_m_s2 >= 0 && std::isfinite(o.room_m_s2) && o.delay_s >= 0 && o.delay_s <= 10))
    throw std::invalid_argument("the room of a response must not be negative, and its delay at most 10 s");
  for (const double value : {o.shortest_lag_s, o.jerk_m_s3, o.release_s, o.max_interval_s})
    if (!(value > 0 && std::isfinite(value)))
      throw std::invalid_argument("the lag, jerk, release and interval of a response must be positive");
}

namespace {

std::size_t ticks_of(double seconds, double dt) { return static_cast<std::size_t>(std::ceil(seconds / dt - 1e-9)); }

}  // namespace

ResponseObserver::ResponseObserver(const ResponseOptions& options, const std::optional<geometry::PerAxis>& lag,
                                   double dt_s, double oldest_s)
    : options_(options), lag_(lag), dt_(dt_s) {
  if (is_on()) past_.resize(ticks_of(options.delay_s, dt_s) + ticks_of(oldest_s, dt_s) + 2);
}

void ResponseObserver::reset() {
  std::fill(past_.begin(), past_.end(), std::nullopt);
  ticks_ = 0, slow_.reset();
  v_ = low_ = high_ = d_ = {};
  time_ = bound_ = 0, has_state_ = false;
}

void ResponseObserver::sent(const std::optional<Vec3>& command) {
  if (!is_on()) return;
  std::optional<Range>& entry = past_[static_cast<std::size_t>(ticks_++) % past_.size()];
  entry.reset();
  if (!command) {
    slow_.reset();
    return;
  }
  entry = Range{*command, *command};
  if (lag_) return;
  if (!slow_) slow_ = *command;
  const double most = options_.jerk_m_s3 * dt_;
  for (int i = 0; i < 3; ++i) {
    (*slow_)[i] += std::clamp((*command)[i] - (*slow_)[i], -most, most);
    entry->low[i] = std::min((*command)[i], (*slow_)[i]), entry->high[i] = std::max((*command)[i], (*slow_)[i]);
  }
}

// The hull of the commands that the vehicle may have followed at this age; nothing if one of them is not known.
// Before the first command it got none.
std::optional<ResponseObserver::Range> ResponseObserver::commanded(double age_s) const {
  const auto to = ticks_ - 1 - static_cast<std::int64_t>(std::floor(std::max(0.0, age_s) / dt_));
  const auto from = to - static_cast<std::int64_t>(ticks_of(options_.delay_s, dt_));
  const auto size = static_cast<std::int64_t>(past_.size());
  if (from < 0 || from < ticks_ - size) return std::nullopt;
  std::optional<Range> all;
  for (std::int64_t k = from; k <= to; ++k) {
    const std::optional<Range>& each = past_[static_cast<std::size_t>(k % size)];
    if (!each) return std::nullopt;
    if (!all) all = each;
    for (int i = 0; i < 3; ++i)
      all->low[i] = std::min(all->low[i], each->low[i]), all->high[i] = std::max(all->high[i], each->high[i]);
  }
  return all;
}

ResponseObserver::Range ResponseObserver::modelled(const Range& commands, Vec3 v) const {
  Range a = commands;
  if (lag_) {
    for (int i = 0; i < 3; ++i) {
      const double low = commands.low[i] - v[i], high = commands.high[i] - v[i];
      const double slowest = std::max((*lag_)[i], options_.shortest_lag_s);
      a.low[i] = low / (low < 0 ? options_.shortest_lag_s : slowest);
      a.high[i] = high / (high > 0 ? options_.shortest_lag_s : slowest);
    }
  }
  for (int i = 0; i < 3; ++i) a.low[i] -= options_.room_m_s2, a.high[i] += options_.room_m_s2;
  return a;
}

void ResponseObserver::update(double age_s, Vec3 v) {
  if (!is_on() || !geometry::is_finite(v)) return;
  const double time = static_cast<double>(ticks_) * dt_ - age_s, interval = time - time_;
  if (has_state_ && !(interval > 1e-9)) return;
  const std::optional<Range> commands = commanded(age_s);
  time_ = time;
  const bool begins = !has_state_ || interval > options_.max_interval_s;
  has_state_ = commands.has_value();
  if (!has_state_) {
    d_ = {}, bound_ = 0;
    return;
  }
  const Range a = modelled(*commands, v);
  if (begins) {  // as if what it does now were in the middle of what is expected
    v_ = v - 0.5 * options_.time_s * (a.low + a.high);
    low_ = a.low, high_ = a.high;
    return;
  }
  const double kept = std::exp(-interval / options_.time_s), share = 1 - kept;
  v_ = v_ + share * (v - v_);
  low_ = low_ + share * (a.low - low_), high_ = high_ + share * (a.high - high_);
  const Vec3 measured = share / (kept * interval) * (v - v_);  // exact for a constant acceleration
  Vec3 residual;
  for (int i = 0; i < 3; ++i)
    residual[i] = std::max(0.0, measured[i] - high_[i]) + std::min(0.0, measured[i] - low_[i]);
  d_ = limited(d_ + share * (residual - d_), options_.max_m_s2);
  bound_ = std::max(bound_ * std::exp(-interval / options_.release_s), std::numbers::e * norm(residual - d_));
}

}  // namespace alula::flight
