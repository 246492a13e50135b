#include "alula/tracking/imm.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "alula/base/require.hpp"

namespace alula::flight {
namespace {

constexpr double kGate[] = {16.26623619623813, 18.46682695290317};  // chi^2 of 3 and 4 degrees, quantile 0.999
constexpr double kDrift = 0.1, kAlarm = 8, kMostSurprise = 16;
constexpr double kMostEvidence = 20, kEvidence = 3;
constexpr double kMostAlpha = 0.7;
constexpr double kReadBound = 2 - 0.05;  // [m]
constexpr int kReadScans = 2;
constexpr double kReadProbability = 0.6;
constexpr int kShared = 6;  // (p, v), states of every model

MotionModel model_of(int i) { return static_cast<MotionModel>(i); }

// Sum <- sum + w (P + d d') over K states.
template <int K>
void add_spread(double w, const Belief& belief, const double* d, Belief& sum) {
  for (int k = 0; k < K; ++k)
    for (int l = 0; l < K; ++l) sum.P[k][l] += w * (belief.P[k][l] + d[k] * d[l]);
}

// Sums beliefs with weights into one with N states; `target` is the model that has all of them.
template <int N>
void mix(const Belief* belief, const double* weight, int models, int target, double missing_variance,
         Belief& result) {
  double mean[N] = {};
  for (int i = 0; i < models; ++i) {
    const int known = i == target ? N : kShared;
    for (int k = 0; k < known; ++k) mean[k] += weight[i] * belief[i].x[k];
  }
  std::copy_n(mean, N, result.x);
  for (int k = 0; k < N; ++k) std::fill_n(result.P[k], N, 0.0);
  for (int i = 0; i < models; ++i) {
    if (weight[i] == 0) continue;
    double d[N];
    if (i == target) {
      for (int k = 0; k < N; ++k) d[k] = belief[i].x[k] - mean[k];
      add_spread<N>(weight[i], belief[i], d, result);
      continue;
    }
    for (int k = 0; k < kShared; ++k) d[k] = belief[i].x[k] - mean[k];
    add_spread<kShared>(weight[i], belief[i], d, result);
    // The states that this model lacks count as 0, with the variance of a missing state.
    for (int k = kShared; k < N; ++k) d[k] = -mean[k], result.P[k][k] += weight[i] * missing_variance;
    for (int k = kShared; k < N; ++k)
      for (int l = 0; l < N; ++l) result.P[k][l] += weight[i] * (d[k] * d[l]);
    for (int k = 0; k < kShared; ++k)
      for (int l = kShared; l < N; ++l) result.P[k][l] += weight[i] * (d[k] * d[l]);
  }
}

bool is_variance(double value) { return value >= 0 && value <= 1e18; }

// Copies rows of probabilities.
void set_probabilities(const double* from, int count, double* to) {
  double sum = 0;
  for (int i = 0; i < count; ++i) {
    require(from[i] >= 0 && from[i] <= 1, "probabilities of models must be in [0, 1]");
    sum += from[i];
  }
  require(std::abs(sum - 1) <= 1e-6, "rows of the transition matrix and the prior must sum to 1");
  for (int i = 0; i < count; ++i) to[i] = from[i] / sum;
}

double weighted(const double* weight, const double* value, int count) {
  double sum = 0;
  for (int i = 0; i < count; ++i) sum += weight[i] * value[i];
  return sum;
}

}  // namespace

ImmRules::ImmRules(const TrackerOptions& o)
    : options(o), models(o.with_turn ? 3 : 2), noise{o.acceleration_noise, o.jerk_noise, o.turn_noise} {
  require(o.gate > 0, "the gate must be above 0");
  require(o.confirm_hits >= 1 && o.confirm_hits <= o.confirm_scans && o.confirm_scans <= 64,
          "confirmation needs 1 <= hits <= scans <= 64");
  require(o.delete_misses >= 1, "a track is deleted after at least 1 miss");
  require(o.coast_s >= 0 && o.coast_s <= 1e6, "a track may coast for 0..1e6 s");
  require(o.field_margin >= 0 && o.field_margin <= 100, "the margin of a field of view must be in 0..100");
  require(is_variance(o.acceleration_noise) && is_variance(o.jerk_noise) && is_variance(o.turn_noise),
          "spectral densities of noise must be in [0, 1e18]");
  for (const double v : o.start_variance) require(is_variance(v), "start variances must be in [0, 1e18]");
  require(is_variance(o.cross_range_variance) && is_variance(o.turn_variance) && is_variance(o.mixing_variance),
          "variances must be in [0, 1e18]");
  for (int i = 0; i < models; ++i)
    set_probabilities(o.with_turn ? &o.turn_transition[static_cast<std::size_t>(3 * i)]
                                  : &o.transition[static_cast<std::size_t>(2 * i)],
                      models, transition[i]);
  set_probabilities(o.with_turn ? o.turn_prior.data() : o.prior.data(), models, prior);
}

void Imm::start(const ImmRules& rules, const Measurement& m) {
  const TrackerOptions& o = rules.options;
  *this = {};
  models_ = rules.models;
  std::copy_n(rules.prior, models_, probability_);
  winner_ = most_probable();
  Belief& first = belief_[0];
  const bool has_rate = m.size == 4;
  for (int i = 0; i < 3; ++i) {
    first.x[i] = m.z[i];
    first.x[i + 3] = has_rate ? m.z[3] * m.los[i] : 0;
    for (int j = 0; j < 3; ++j) {
      const double unit = i == j ? 1 : 0, along = m.los[i] * m.los[j];
      first.P[i][j] = m.R[i][j] + unit * o.start_variance[0];
      first.P[i + 3][j + 3] =
          has_rate ? m.R[3][3] * along + o.cross_range_variance * (unit - along) : unit * o.start_variance[1];
    }
  }
  for (int model = 1; model < models_; ++model) belief_[model] = first;
  for (int i = 6; i < 9; ++i) belief_[1].P[i][i] = o.start_variance[2];
  belief_[2].P[6][6] = o.turn_variance;
}

int Imm::most_probable() const {
  return static_cast<int>(std::max_element(probability_, probability_ + models_) - probability_);
}

void Imm::adapt(const ImmRules& rules, double (&transition)[kMostModels][kMostModels]) const {
  std::copy_n(&rules.transition[0][0], kMostModels * kMostModels, &transition[0][0]);
  if (!rules.options.adapts_transition) return;
  double entropy = 0;
  for (int i = 0; i < models_; ++i)
    if (probability_[i] > 0) entropy -= probability_[i] * std::log(probability_[i]);
  const double alpha = std::min(kMostAlpha, 0.1 * evidence_ + 0.5 * entropy / std::log(models_));
  const auto move = [&](int from, int to, double probability) {
    probability = std::min(probability, transition[from][from]);
    transition[from][from] -= probability;
    transition[from][to] += probability;
  };
  move(0, 1, 0.15 * alpha);
  move(1, 0, 0.05 * (kMostAlpha - alpha));
  for (int to = 0; to < models_; ++to)
    if (to != winner_) move(winner_, to, 0.1 * alpha / (models_ - 1));
  for (int i = 0; i < models_; ++i) {
    double sum = 0;
    for (int j = 0; j < models_; ++j)
      sum += transition[i][j] = (1 - alpha) * rules.transition[i][j] + alpha * transition[i][j];
    for (int j = 0; j < models_; ++j) transition[i][j] /= sum;
  }
}

void Imm::predict(const ImmRules& rules, double dt) {
  double transition[kMostModels][kMostModels], next[kMostModels] = {};
  adapt(rules, transition);
  for (int i = 0; i < models_; ++i)
    for (int j = 0; j < models_; ++j) next[j] += transition[i][j] * probability_[i];
  if (rules.options.mixes) {
    Belief mixed[kMostModels];
    for (int j = 0; j < models_; ++j) {
      double weight[kMostModels] = {};
      for (int i = 0; i < models_; ++i)
        weight[i] = next[j] > 0 ? transition[i][j] * probability_[i] / next[j] : (i == j ? 1 : 0);
      if (j == 0) mix<6>(belief_, weight, models_, j, 0, mixed[j]);
      if (j == 1) mix<9>(belief_, weight, models_, j, rules.options.mixing_variance, mixed[j]);
      if (j == 2) mix<7>(belief_, weight, models_, j, rules.options.turn_variance, mixed[j]);
    }
    std::copy_n(mixed, models_, belief_);
  }
  for (int j = 0; j < models_; ++j) {
    probability_[j] = next[j];
    flight::predict(model_of(j), rules.noise, dt, belief_[j]);
  }
}

void Imm::correct(const ImmRules& rules, const Measurement& m) {
  const double gate = kGate[m.size - 3] * (rules.options.jamming ? 2 : 1);
  Innovation innovation[kMostModels];
  for (int j = 0; j < models_; ++j) {
    innovation[j] = innovate(belief_[j], m);
    if (rules.options.gates_models && j != winner_ && innovation[j].distance > gate) continue;
    flight::correct(model_of(j), m, innovation[j], belief_[j]);
  }
  weigh(rules, innovation, m.size);
  clear_scans_ = rules.options.winner_takes_all && may_read_winner() ? clear_scans_ + 1 : 0;
}

void Imm::weigh(const ImmRules& rules, const Innovation (&innovation)[kMostModels], int size) {
  double distance[kMostModels] = {};
  for (int j = 0; j < models_; ++j) {
    if (!innovation[j].is_valid) return;  // the likelihoods cannot be compared
    distance[j] = innovation[j].distance;
  }
  const double mean = weighted(probability_, distance, models_);
  surprise_ = std::clamp(surprise_ + mean / size - 1 - kDrift, 0.0, kMostSurprise);  // CUSUM of the NIS
  const bool is_heavy = rules.options.heavy_tails && surprise_ > kAlarm;
  const double freedom = rules.options.jamming ? 1 : 5;
  double likelihood[kMostModels];  // logarithms, without the terms common to all models
  for (int j = 0; j < models_; ++j) {
    const double tail = is_heavy ? (freedom + size) * std::log1p(distance[j] / freedom) : distance[j];
    likelihood[j] = -0.5 * (innovation[j].log_determinant + tail);
  }
  const double other = *std::max_element(likelihood + 1, likelihood + models_);
  evidence_ = std::clamp(evidence_ + other - likelihood[0], 0.0, kMostEvidence);

  double best = -std::numeric_limits<double>::infinity(), sum = 0;
  for (int j = 0; j < models_; ++j)
    if (probability_[j] > 0) best = std::max(best, likelihood[j]);
  for (int j = 0; j < models_; ++j)
    if (probability_[j] > 0) sum += probability_[j] *= std::exp(likelihood[j] - best);
  for (int j = 0; j < models_; ++j) probability_[j] /= sum;
  winner_ = most_probable();
}

bool Imm::may_read_winner() const {
  const double rivals = 1 - probability_[winner_];
  if (probability_[winner_] < kReadProbability && evidence_ < kEvidence) return false;
  if (!(rivals > 0)) return true;
  // The position alone, as a belief that each rival measures without noise.
  Belief mean;
  for (int j = 0; j < models_; ++j) {
    const double weight = j == winner_ ? 0.5 : 0.5 * probability_[j] / rivals;
    for (int k = 0; k < 3; ++k)
      for (int l = 0; l < 3; ++l) mean.P[k][l] += weight * belief_[j].P[k][l];
  }
  std::copy_n(belief_[winner_].x, 3, mean.x);
  double squared = 0;
  for (int j = 0; j < models_; ++j) {
    if (j == winner_) continue;
    Measurement rival;
    std::copy_n(belief_[j].x, 3, rival.z);
    const Innovation difference = innovate(mean, rival);
    if (!difference.is_valid) return false;
    squared += probability_[j] / rivals * difference.distance;
  }
  return rivals * std::sqrt((mean.P[0][0] + mean.P[1][1] + mean.P[2][2]) * squared) <= kReadBound;
}

Belief Imm::mixture() const {
  Belief result;
  mix<kShared>(belief_, probability_, models_, -1, 0, result);
  return result;
}

void Imm::read(const ImmRules& rules, double dt, Track& track) const {
  const bool is_hard = clear_scans_ >= kReadScans;
  Belief ahead[kMostModels], result;
  track.a = {};
  for (int j = 0; j < models_; ++j) {
    if (is_hard && j != winner_) continue;
    ahead[j] = belief_[j];
    flight::predict(model_of(j), rules.noise, dt, ahead[j]);
    track.a += (is_hard ? 1 : probability_[j]) * acceleration(model_of(j), ahead[j]);
  }
  if (is_hard) {
    result = ahead[winner_];
  } else {
    mix<kShared>(ahead, probability_, models_, -1, 0, result);
  }
  track.p = {result.x[0], result.x[1], result.x[2]};
  track.v = {result.x[3], result.x[4], result.x[5]};
  std::size_t at = 0;
  for (int k = 0; k < kShared; ++k)
    for (int l = 0; l <= k; ++l) track.covariance[at++] = result.P[k][l];
  track.turning = 1 - probability_[0];
}

}  // namespace alula::flight
