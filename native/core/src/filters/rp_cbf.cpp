// Barrier on rollouts: V is the maximum depth to which the manoeuvre, flown from here, enters an obstacle.
//
//   V = max over samples, obstacles and t of R_eff - |P(t)|,   grad V . (f + g u) <= -alpha V,   min |u - a_0|^2
//
// The policy (to the bypass point, or a stop) ignores obstacles, so one rollout of the vehicle serves all
// samples. At the worst sample, with n towards the obstacle and S = d p(t) / d (p, v):
//   n . (S_p v + S_v u - v_i - t a_i(0)) <= -alpha V.
// The violation reported is that of this row at unit length, so an acceleration, unless the row is short: when the
// worst time is far off, a command now has almost no effect there.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "alula/base/random.hpp"
#include "alula/filters/moving_guide.hpp"

namespace alula::flight {

using geometry::Vec3;

namespace {

constexpr double kNoSay = 0.01;  // [s]: the command has almost no effect on a shorter row
constexpr int kMostSteps = 64, kSubsteps = 10;

// Position of the vehicle at one time and its derivatives by the start state, per axis.
struct Reached {
  Vec3 p, by_p, by_v;
};

class RpCbf final : public MovingFilter {
 public:
  explicit RpCbf(const MovingFilterOptions& options)
      : options_(options.rp_cbf), guide_(options.config), nearest_(options.backend) {
    const RpCbfOptions& o = options_;
    if (!(o.step_s > 0 && o.horizon_s >= o.step_s && o.horizon_s <= kMostSteps * o.step_s && o.hold_s >= o.step_s &&
          o.alpha > 0 && o.alpha < 1e3 && o.horizon_s < 1e3 && o.samples >= 1 && o.samples <= 4096)) {
      throw std::invalid_argument("rp_cbf: 1 to 64 steps, alpha above 0, 1 to 4096 samples and hold_s >= step_s");
    }
    steps_ = static_cast<int>(std::lround(o.horizon_s / o.step_s));
    way_.resize(static_cast<std::size_t>(steps_) + 1);
    draw();
  }

  MovingReport filter(const alula_vehicle_state& vehicle, std::span<const alula_track> tracks,
                      std::span<const alula_wall> walls, Vec3 nominal) override {
    alula_guidance guidance;
    if (!guide_.step(vehicle, tracks, walls, nominal, guidance)) return {};
    const Vec3 target = to_vec3(guidance.desired);
    nearest_.clear();
    Vec3 a = target;
    bool holds = true;
    int iterations = 0;
    if (guide_.binds(guidance) && add_row(guidance, vehicle, tracks)) {
      const double limit = guide_.config().avoidance.a_max;
      nearest_.add_box(limit);
      holds = nearest_.solve(target, a, iterations);
      if (!holds) a = nearest_.least_violation(target, limit);
    }
    MovingReport report = guide_.finish(guidance, vehicle, walls, nominal, a, holds);
    report.feasible = holds;
    report.rows = nearest_.size() > 0 ? 1 : 0;
    report.iterations = static_cast<std::uint32_t>(iterations);
    guide_.missed(nearest_.violation(report.acceleration, kNoSay), report);
    return report;
  }
  void flown(Vec3 a) override { guide_.flown(a); }
  void reset() override { guide_.reset(); }
  std::unique_ptr<MovingFilter> clone() const override { return std::make_unique<RpCbf>(*this); }

 private:
  // Displacement that each sample adds to an obstacle with an envelope of 1, and its initial acceleration.
  void draw() {
    const RandomStream random{.seed = 0, .trial = 0};
    const auto size = static_cast<std::size_t>(options_.samples);
    drift_.resize(size * (static_cast<std::size_t>(steps_) + 1));
    first_.resize(size);
    const double t = options_.step_s;
    const auto held = static_cast<int>(std::lround(options_.hold_s / t));
    for (std::size_t s = 0; s < size; ++s) {
      Vec3 p, v, a;
      for (int k = 0; k < steps_; ++k) {
        if (k % held == 0) {
          const Vec3 normal = random.normals(s, static_cast<std::uint32_t>(k / held));
          for (int j = 0; j < 3; ++j) {
            const double uniform = std::erf(normal[j] / std::sqrt(2.0));  // uniform on (-1, 1)
            a[j] = s < size / 2 ? uniform : (uniform < 0 ? -1.0 : 1.0);
          }
          if (k == 0) first_[s] = a;
        }
        p = p + t * v + (t * t / 2) * a;
        v = v + t * a;
        drift_[s * way_.size() + static_cast<std::size_t>(k) + 1] = p;
      }
    }
  }

  void roll_out(const alula_guidance& guidance, const alula_vehicle_state& vehicle) {
    const alula_avoidance_config& c = guide_.config().avoidance;
    const bool bypasses = guidance.mode == ALULA_AVOID;
    const double kp = bypasses ? c.kp : 0.0, kd = bypasses ? c.kd : c.brake * 2.0 / c.stop_s, limit = c.a_max,
                 h = options_.step_s / kSubsteps;
    for (int j = 0; j < 3; ++j) {
      double p = vehicle.position[j], v = vehicle.velocity[j], pp = 1, pv = 0, vp = 0, vv = 1;
      const double target = guide_.avoidance().bypass[j];
      for (std::size_t k = 0; k < way_.size(); ++k) {
        way_[k].p[j] = p, way_[k].by_p[j] = pp, way_[k].by_v[j] = pv;
        for (int sub = 0; sub < kSubsteps; ++sub) {
          double a = kp * (target - p) - kd * v;
          const bool inside = std::fabs(a) < limit;
          a = std::clamp(a, -limit, limit);
          const double ap = inside ? -kp * pp - kd * vp : 0, av = inside ? -kp * pv - kd * vv : 0;
          p += h * v + h * h / 2 * a, pp += h * vp + h * h / 2 * ap, pv += h * vv + h * h / 2 * av;
          v += h * a, vp += h * ap, vv += h * av;
        }
      }
    }
  }

  // Adds the row of the worst sample, not scaled; false if no obstacle approaches.
  bool add_row(const alula_guidance& guidance, const alula_vehicle_state& vehicle,
               std::span<const alula_track> tracks) {
    double value = -std::numeric_limits<double>::infinity();
    std::size_t worst = 0, sample = 0, at = 0;
    bool any = false;
    for (std::size_t i = 0; i < tracks.size(); ++i) {
      const alula_encounter& m = guide_.encounters()[i];
      if (!m.active) continue;
      if (!any) roll_out(guidance, vehicle);
      any = true;
      const double clearance = alula_effective_clearance(&guide_.config(), &m, guide_.config().avoidance.h_max_s);
      // Squared distances first: the square root of the minimum is enough.
      double least = std::numeric_limits<double>::infinity();
      std::size_t least_sample = 0, least_at = 0;
      for (std::size_t k = 0; k < way_.size(); ++k) {
        const Vec3 p = path(tracks[i], k) - way_[k].p;
        for (std::size_t s = 0; s < first_.size(); ++s) {
          const Vec3 off = p + static_cast<double>(m.envelope) * drift_[s * way_.size() + k];
          const double square = dot(off, off);
          if (square < least) least = square, least_sample = s, least_at = k;
        }
      }
      const double depth = clearance - std::sqrt(least);
      if (depth > value) value = depth, worst = i, sample = least_sample, at = least_at;
    }
    if (!any) return false;
    const double envelope = guide_.encounters()[worst].envelope, t = static_cast<double>(at) * options_.step_s;
    const Vec3 off = path(tracks[worst], at) - way_[at].p + envelope * drift_[sample * way_.size() + at];
    const double distance = norm(off);
    const Vec3 n = distance > 1e-6 ? (1 / distance) * off : to_vec3(guide_.encounters()[worst].los);
    Vec3 row;
    double drift = -dot(n, to_vec3(tracks[worst].velocity) + (t * envelope) * first_[sample]);
    for (int j = 0; j < 3; ++j) {
      row[j] = n[j] * way_[at].by_v[j];
      drift += n[j] * way_[at].by_p[j] * vehicle.velocity[j];
    }
    nearest_.add(row, -options_.alpha * value - drift);
    return true;
  }

  Vec3 path(const alula_track& track, std::size_t k) const {
    return to_vec3(track.position) + (static_cast<double>(k) * options_.step_s) * to_vec3(track.velocity);
  }

  RpCbfOptions options_;
  Guide guide_;
  NearestPoint nearest_;
  int steps_ = 0;
  std::vector<Vec3> drift_, first_;
  std::vector<Reached> way_;
};

}  // namespace

std::unique_ptr<MovingFilter> make_rp_cbf(const MovingFilterOptions& options) {
  return std::make_unique<RpCbf>(options);
}

}  // namespace alula::flight
