// Model predictive control to the bypass point: a double integrator over 20 steps with 3 moves, condensed.
//
//   min sum_k |p_k - p_b|^2 + w_v |v_k|^2 + w_u |u_k|^2 + w_xi xi^2
//   n_i . (p_k - p_e) <= d_i + n_i . v_i k T - R_eff(H_max) + xi,  xi >= 0,  |u|_inf <= a_max
//
// in the 9 + 1 variables (u_0, u_1, u_2, xi). The violation reported is the acceleration that compensates xi over
// the whole horizon, 2 xi / (20 T)^2, as rows of DR-ACBF with H = 20 T count it. The penalty leaves some slack
// wherever a distance binds: distances count as kept up to kMissed.
#include <algorithm>
#include <array>
#include <stdexcept>
#include <vector>

#include "alula/filters/moving_guide.hpp"

namespace alula::flight {

using geometry::Vec3;

namespace {

constexpr std::size_t kSteps = 20, kMoves = 3, kVariables = 3 * kMoves + 1, kSlack = kVariables - 1;
constexpr double kMissed = 1e-3;  // [m]

class Mpc final : public MovingFilter {
 public:
  explicit Mpc(const MovingFilterOptions& options) : options_(options.mpc), guide_(options.config) {
    if (!(options_.step_s > 0 && options_.step_s < 10 && options_.velocity_weight >= 0 && options_.input_weight > 0 &&
          options_.slack_weight > 0 && options_.velocity_weight < 1e9 && options_.input_weight < 1e9 &&
          options_.slack_weight < 1e12)) {
      throw std::invalid_argument("mpc: the step and the weights must be above 0");
    }
    if (options.backend) solver_ = QpSolver::with_backend(options.backend);
    predict();
    const std::size_t most = kSteps * ALULA_OBSTACLES + 6 * kMoves + 1;
    solver_.reserve(most);
    rows_.reserve(most * kVariables);
    bounds_.reserve(most);
  }

  MovingReport filter(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                      std::span<const alula_wall> walls, Vec3 nominal) override {
    alula_guidance guidance;
    if (!guide_.step(vehicle, tracks, walls, nominal, guidance)) return {};
    Vec3 a = to_vec3(guidance.desired);
    QpResult result;
    result.status = QpStatus::optimal;
    rows_.clear(), bounds_.clear();
    if (guidance.mode == ALULA_AVOID) {
      condense(vehicle, tracks);
      // The last tick's active rows are a good initial guess while the number of rows is unchanged.
      const std::span<const std::uint32_t> warm(warm_.data(), warm_of_ == bounds_.size() ? warm_count_ : 0);
      result = solver_.solve({kVariables, hessian_, gradient_, rows_, bounds_}, warm);
      if (result.status == QpStatus::optimal) {
        a = {result.x[0], result.x[1], result.x[2]};
        warm_of_ = bounds_.size();
        warm_count_ = result.active_count;
        std::copy_n(result.active.begin(), warm_count_, warm_.begin());
      }
    }
    const double slack = result.status == QpStatus::optimal && !bounds_.empty() ? std::max(0.0, result.x[kSlack]) : 0;
    const bool holds = result.status == QpStatus::optimal && slack <= kMissed;
    MovingReport report = guide_.finish(guidance, vehicle, walls, nominal, a, holds);
    report.feasible = holds;
    report.rows = static_cast<std::uint32_t>(bounds_.size());
    report.iterations = static_cast<std::uint32_t>(result.iterations);
    const double horizon = static_cast<double>(kSteps) * options_.step_s;
    if (bounds_.size() > 6 * kMoves + 1) {
      report.violation = std::max(report.violation, slack > kMissed ? 2 * slack / (horizon * horizon) : 0.0);
    }
    return report;
  }
  void flown(Vec3 a) override { guide_.flown(a); }
  void reset() override {
    guide_.reset();
    warm_of_ = warm_count_ = 0;
  }
  std::unique_ptr<MovingFilter> clone() const override { return std::make_unique<Mpc>(*this); }

 private:
  // p_k = p + k T v + sum_m reach[k][m] u_m,  v_k = v + sum_m speed[k][m] u_m; the Hessian follows.
  void predict() {
    const double t = options_.step_s;
    std::array<double, kMoves> times{};
    for (std::size_t k = 1; k <= kSteps; ++k) {
      const std::size_t move = std::min(k - 1, kMoves - 1);
      times[move] += 1;
      reach_[k] = reach_[k - 1], speed_[k] = speed_[k - 1];
      for (std::size_t m = 0; m < kMoves; ++m) reach_[k][m] += t * speed_[k - 1][m];
      reach_[k][move] += t * t / 2;
      speed_[k][move] += t;
    }
    for (std::size_t m = 0; m < kMoves; ++m) {
      for (std::size_t n = 0; n < kMoves; ++n) {
        double sum = m == n ? options_.input_weight * times[m] : 0;
        for (std::size_t k = 1; k <= kSteps; ++k) {
          sum += reach_[k][m] * reach_[k][n] + options_.velocity_weight * speed_[k][m] * speed_[k][n];
        }
        for (std::size_t j = 0; j < 3; ++j) hessian_[(3 * m + j) * kVariables + 3 * n + j] = 2 * sum;
      }
    }
    hessian_[kSlack * kVariables + kSlack] = 2 * options_.slack_weight;
  }

  void condense(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks) {
    const double t = options_.step_s, limit = guide_.config().avoidance.a_max;
    gradient_ = {};
    for (std::size_t j = 0; j < 3; ++j) {
      const double v = vehicle.velocity[j],
                   off = static_cast<double>(vehicle.position[j]) - guide_.avoidance().bypass[j];
      for (std::size_t k = 1; k <= kSteps; ++k) {
        const double p = off + static_cast<double>(k) * t * v;
        for (std::size_t m = 0; m < kMoves; ++m) {
          gradient_[3 * m + j] += 2 * (p * reach_[k][m] + options_.velocity_weight * v * speed_[k][m]);
        }
      }
    }
    rows_.assign((6 * kMoves + 1) * kVariables, 0);
    bounds_.assign(6 * kMoves + 1, -limit);
    for (std::size_t i = 0; i < 3 * kMoves; ++i) {
      rows_[2 * i * kVariables + i] = 1;
      rows_[(2 * i + 1) * kVariables + i] = -1;
    }
    rows_[6 * kMoves * kVariables + kSlack] = 1;
    bounds_.back() = 0;
    const Vec3 own = to_vec3(vehicle.velocity);
    for (std::size_t i = 0; i < tracks.size(); ++i) {
      const alula_encounter& m = guide_.encounters()[i];
      if (!m.active) continue;
      const Vec3 n = to_vec3(m.los);
      const double closes = dot(n, to_vec3(tracks[i].velocity) - own),
                   room = static_cast<double>(m.distance_m) -
                          alula_effective_clearance(&guide_.config(), &m, guide_.config().avoidance.h_max_s);
      for (std::size_t k = 1; k <= kSteps; ++k) {
        for (std::size_t move = 0; move < kMoves; ++move) {
          for (int j = 0; j < 3; ++j) rows_.push_back(-n[j] * reach_[k][move]);
        }
        rows_.push_back(1);
        bounds_.push_back(-(room + closes * static_cast<double>(k) * t));
      }
    }
  }

  MpcOptions options_;
  Guide guide_;
  QpSolver solver_;
  std::array<std::array<double, kMoves>, kSteps + 1> reach_{}, speed_{};
  std::array<double, kVariables * kVariables> hessian_{};
  std::array<double, kVariables> gradient_{};
  std::vector<double> rows_, bounds_;
  std::array<std::uint32_t, kVariables + 1> warm_{};
  std::size_t warm_of_ = 0, warm_count_ = 0;
};

}  // namespace

std::unique_ptr<MovingFilter> make_mpc(const MovingFilterOptions& options) { return std::make_unique<Mpc>(options); }

}  // namespace alula::flight
