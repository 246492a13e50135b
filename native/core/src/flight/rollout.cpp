#include "alula/flight/rollout.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <stdexcept>

#include "alula/base/parallel.hpp"

namespace alula {

namespace {

double norm(const Vec3& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

double distance(const Vec3& a, const Vec3& b) { return norm({a[0] - b[0], a[1] - b[1], a[2] - b[2]}); }

Vec3 row(std::span<const double> rows, std::size_t index) {
  return {rows[3 * index], rows[3 * index + 1], rows[3 * index + 2]};
}

void append(std::vector<double>& rows, const Vec3& v) { rows.insert(rows.end(), v.begin(), v.end()); }

}  // namespace

Trial::Trial(const Vec3& start, const Vec3& goal, const TrialRules& rules, Reference reference)
    : x_(start),
      goal_(goal),
      rules_(rules),
      reference_(reference),
      stop_distance_(std::max(rules.stop_fraction * distance(start, goal), 1e-3)) {
  const bool good = rules.dt_s > 0 && rules.gain > 0 && rules.v_max > 0 && rules.stop_fraction >= 0 &&
                    rules.stuck_speed >= 0 && rules.stuck_steps > 0 && rules.max_steps > 0 &&
                    rules.gain / 2 * rules.dt_s <= 1 && reference.position.size() == reference.velocity.size();
  if (!good || !std::isfinite(norm(start)) || !std::isfinite(norm(goal)))
    throw std::invalid_argument("rules of a trial must be positive, with gain / 2 * dt <= 1, and points finite");
}

Vec3 Trial::nominal() const {
  Vec3 target = goal_, u{};
  if (const std::size_t rows = reference_.size(); rows > 0) {
    const auto index = static_cast<std::size_t>(step_);
    target = row(reference_.position, std::min(index, rows - 1));
    if (index < rows) u = row(reference_.velocity, index);
  }
  for (std::size_t i = 0; i < 3; ++i) u[i] += rules_.gain / 2 * (target[i] - x_[i]);
  const double speed = norm(u);
  if (speed > rules_.v_max)
    for (double& component : u) component *= rules_.v_max / speed;
  return u;
}

Outcome Trial::advance(const Vec3& u, bool refused) {
  if (outcome_ != Outcome::flying) throw std::logic_error("the flight is over");
  for (std::size_t i = 0; i < 3; ++i) x_[i] += u[i] * rules_.dt_s;
  ++step_;
  const auto rows = static_cast<std::int64_t>(reference_.size());
  // A vehicle may rest where the reference rests; it is stuck only if it is away from the reference.
  const bool behind =
      rows == 0 ||
      distance(x_, row(reference_.position, static_cast<std::size_t>(std::min(step_, rows - 1)))) > stop_distance_;
  still_ = norm(u) < rules_.stuck_speed && behind ? still_ + 1 : 0;
  if (refused) {
    outcome_ = Outcome::refused;
  } else if (step_ >= rows - 1 && distance(x_, goal_) <= stop_distance_) {
    outcome_ = Outcome::reached;
  } else if (still_ >= rules_.stuck_steps) {
    outcome_ = Outcome::stuck;
  } else if (step_ >= rules_.max_steps) {
    outcome_ = Outcome::timeout;
  }
  return outcome_;
}

namespace {

TrialLog fly(flight::SafetyFilter& filter, Trial trial) {
  using Clock = std::chrono::steady_clock;
  TrialLog log;
  append(log.position, trial.position());
  flight::FlightState state;
  flight::Nominal wanted;
  filter.reset();
  while (trial.outcome() == Outcome::flying) {
    const Vec3 x = trial.position(), u_nom = trial.nominal();
    state.x.p = {x[0], x[1], x[2]}, wanted.velocity = {u_nom[0], u_nom[1], u_nom[2]};
    const auto before = Clock::now();
    const flight::FilterReport report = filter.filter(state, wanted);
    const double seconds = std::chrono::duration<double>(Clock::now() - before).count();
    const Vec3 u{report.velocity.x, report.velocity.y, report.velocity.z};
    trial.advance(u, report.status == flight::SafetyStatus::refused);
    append(log.position, trial.position());
    append(log.u_nom, u_nom);
    append(log.u, u);
    log.margin.push_back(static_cast<float>(report.margin));
    log.status.push_back(static_cast<std::uint8_t>(report.status));
    log.filter_s.push_back(static_cast<float>(report.solve_time_s.value_or(seconds)));
  }
  log.outcome = trial.outcome();
  return log;
}

}  // namespace

std::vector<TrialLog> rollout(const flight::SafetyFilter& filter, std::span<const Vec3> start,
                              std::span<const Vec3> goal, const TrialRules& rules, Reference reference, unsigned jobs,
                              Control& control) {
  if (start.size() != goal.size()) throw std::invalid_argument("start and goal differ in length");
  if (filter.kind() != flight::CommandKind::velocity) throw std::invalid_argument("a point is moved by velocities");
  std::vector<TrialLog> logs(start.size());
  parallel_chunks(start.size(), 1, jobs, control, [&](std::size_t begin, std::size_t end) {
    const std::unique_ptr<flight::SafetyFilter> own = filter.clone();
    for (std::size_t i = begin; i < end; ++i) logs[i] = fly(*own, Trial(start[i], goal[i], rules, reference));
  });
  return logs;
}

}  // namespace alula
