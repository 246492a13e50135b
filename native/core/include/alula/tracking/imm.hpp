// Interacting multiple models (IMM) of one track.
//
// Per scan: the probabilities pass through the transition matrix; each model starts from the mixture of all models
// (or, without `mixes`, from its own state), is predicted and corrected; and the probabilities are weighted by the
// likelihoods of the innovations. A state that a model lacks (an acceleration, a rate of turn) enters the mixture as
// zero with a stated variance.
//
// The additions of SAFE-IMM, each an option:
//   gates_models       a model whose innovation has a squared distance beyond the 0.999 quantile of chi^2 (twice that
//                      under jamming) is not corrected, unless it was the most probable one at the last scan
//   heavy_tails        once a one-sided cumulative sum of (mean squared distance / size - 1.1) exceeds 8, likelihoods
//                      are those of Student's t with 5 degrees of freedom (1 under jamming)
//   adapts_transition  the transition matrix adapts to the evidence with
//                      alpha = min(0.7, 0.1 G + 0.5 entropy / log M). It is blended by alpha with a copy of itself in
//                      which 0.15 alpha moved from `velocity` to `acceleration`, 0.05 (0.7 - alpha) back, and
//                      0.1 alpha from the most probable model's self-transition to the others in equal parts
//   winner_takes_all   the read-out is the most probable model, if for 2 corrections in a row that moves the position
//                      by no more than B = t sqrt(trace(Pbar) d2) <= 1.95 [m] (t: probability of the others, Pbar:
//                      mean of the winner's and the others' position covariance, d2: mean squared distance of the
//                      others in it) and the winner has probability 0.6 or G >= 3
// G is the cumulative sum, within [0, 20], of the log-likelihood ratio of the best other model to `velocity`.
//
// Source: Bar-Shalom, Li, Kirubarajan 2001, ch. 11.6; the additions: Mandaokar, Rinner 2025 (SAFE-IMM). The bounds of
// the sums, the summands of G, and the use of the position in B are choices of this implementation.
#pragma once

#include "alula/tracking/motion_models.hpp"
#include "alula/tracking/tracker.hpp"

namespace alula::flight {

inline constexpr int kMostModels = 3;

// The rules common to all tracks.
struct ImmRules {
  explicit ImmRules(const TrackerOptions& options);

  TrackerOptions options;
  int models;
  double transition[kMostModels][kMostModels] = {};
  double prior[kMostModels] = {};
  MotionNoise noise;
};

class Imm {
 public:
  // Starts at the position of the measurement, with its velocity along the line of sight if it has one.
  void start(const ImmRules& rules, const Measurement& measurement);
  // Mixes and predicts by dt >= 0: the first half of a scan, with or without a measurement.
  void predict(const ImmRules& rules, double dt);
  void correct(const ImmRules& rules, const Measurement& measurement);

  // Current (p, v) of the mixture.
  Belief mixture() const;
  // The read-out, predicted by dt without transitions; fills all fields but `id` and `is_confirmed`.
  void read(const ImmRules& rules, double dt, Track& track) const;

 private:
  void adapt(const ImmRules& rules, double (&transition)[kMostModels][kMostModels]) const;
  void weigh(const ImmRules& rules, const Innovation (&innovation)[kMostModels], int size);
  bool may_read_winner() const;
  int most_probable() const;

  int models_ = 2;
  int winner_ = 0;  // the most probable model at the last correction
  double probability_[kMostModels] = {};
  Belief belief_[kMostModels];
  double surprise_ = 0;  // cumulative sum of innovations that are too large
  double evidence_ = 0;  // G
  int clear_scans_ = 0;  // consecutive corrections that allow reading out the winner
};

}  // namespace alula::flight
