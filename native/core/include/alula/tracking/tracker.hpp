// Tracks of moving obstacles: global nearest neighbours and interacting multiple models.
//
// Models: constant velocity (6 states), constant acceleration (9), optionally a coordinated turn. Association: the
// Hungarian method on squared Mahalanobis distances of innovations within a gate, confirmed tracks first, because a
// new track has a large covariance, fits any detection and would take theirs. Every unassigned detection starts a
// track. A track is confirmed after `confirm_hits` hits in the last `confirm_scans` scans. It is deleted after
// `delete_misses` misses in a row, or, outside the sensor's field of view, after `coast_s`.
//
// Source: Bar-Shalom, Li, Kirubarajan 2001, ch. 11.6 (IMM); the SAFE options: Mandaokar, Rinner 2025 (SAFE-IMM).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "alula/tracking/radar.hpp"

namespace alula::flight {

struct TrackerOptions {
  double gate = 30;  // squared Mahalanobis distance
  int confirm_hits = 5, confirm_scans = 6, delete_misses = 5;
  // A scan is no miss for a confirmed track if the sensor's field of view does not contain the track's position with
  // `field_margin` standard deviations: there the detection probability is 0 or unknown. The
  // track is predicted further, with a growing covariance, and deleted after `coast_s` without a detection. 0: every
  // scan counts. 3 s is the longest time to the closest approach that a manoeuvre considers.
  double coast_s = 3, field_margin = 2;
  double acceleration_noise = 0.5, jerk_noise = 0.2;  // spectral densities of the white acceleration and jerk
  bool with_turn = false;                             // third model
  double turn_noise = 0.1;  // spectral density of the white turn rate's derivative [rad^2/s^3]
  std::array<double, 4> transition{0.992, 0.008, 0.015, 0.985};  // per scan, row by row; of two models
  std::array<double, 2> prior{0.9, 0.1};
  std::array<double, 9> turn_transition{.986, .010, .004, .010, .986, .004, .015, .015, .970};  // of three
  std::array<double, 3> turn_prior{0.9, 0.05, 0.05};
  // Position (on top of the measurement's), velocity (without a Doppler measurement), acceleration; per axis.
  std::array<double, 3> start_variance{4, 25, 25};
  double cross_range_variance = 100;  // of the velocity across the line of sight, at the start [m^2/s^2]
  double turn_variance = 0.1;         // of the turn rate, at the start and for a model that has none [rad^2/s^2]
  // Variance of the acceleration of a model that has none, where models mix [m^2/s^4]: about the square of the
  // expected manoeuvres. With 0 every scan would pull the acceleration of the other model towards zero.
  double mixing_variance = 3;
  bool mixes = true;  // mixes initial conditions, as in the textbook; false: mixes at read-out only
  // SAFE-IMM, each on its own: see imm.hpp.
  bool gates_models = false, heavy_tails = false, adapts_transition = false, winner_takes_all = false;
  bool jamming = false;
};

struct Track {
  std::uint32_t id = 0;
  bool is_confirmed = false;
  geometry::Vec3 p, v, a;
  std::array<double, 21> covariance{};  // of (p, v): lower triangle, row by row
  double turning = 0;                   // total probability of the models that turn or accelerate
};

// One per flight. No allocation after the first scans.
class Tracker {
 public:
  // At most `most` tracks at a time. Throws std::invalid_argument for options out of range.
  explicit Tracker(const TrackerOptions& options = {}, std::size_t most = 128);
  ~Tracker();
  Tracker(Tracker&&) noexcept;
  Tracker& operator=(Tracker&&) noexcept;

  void reset();
  // Updates to time t [s]. All `detections` were made at t by one sensor, at most one per object, within `field`, or
  // anywhere if there is no field. A detection is dropped and counted if it is not finite, is beyond 1e9 (m, m/s),
  // has a covariance that is not positive semidefinite, or would start a track beyond the maximum number.
  // Throws std::invalid_argument, and changes nothing, unless t is within 1e6 s after the last scan.
  void update(double t, std::span<const Detection> detections, const FieldOfView* field = nullptr);
  // All tracks predicted to `t`, oldest first; for a t before the last scan, as of that scan. Valid until the next
  // call.
  // Throws std::invalid_argument if t is not finite or more than 1e6 s after the last scan.
  std::span<const Track> tracks(double t) const;
  std::uint64_t dropped() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Assignment of minimum cost: for each row its column or -1. A row without a column costs `gate`; costs above the
// gate, above 1e100 or not finite are forbidden. An infinite gate gives the maximum number of assignments. Hungarian
// method, by shortest augmenting paths: O(rows^2 (rows + columns)), far less when few costs are within the gate.
// Throws std::invalid_argument unless there are rows x columns costs and the gate is at least 0.
void assign(std::span<const double> cost, std::size_t rows, std::size_t columns, double gate,
            std::vector<int>& column);

}  // namespace alula::flight
