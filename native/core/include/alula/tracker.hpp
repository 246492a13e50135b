// Tracks of moving obstacles: global nearest neighbours and interacting multiple models.
//
// Models: constant velocity (6 states), constant acceleration (9), optionally a coordinated turn. Association: the
// Hungarian method on squared Mahalanobis distances of innovations within a gate. A track is confirmed after
// `confirm_hits` of `confirm_scans` scans and deleted after `delete_misses` misses in a row.
//
// Source: Bar-Shalom, Li, Kirubarajan 2001, ch. 11.6 (IMM); the SAFE options: Mandaokar, Rinner 2025 (SAFE-IMM).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "alula/radar.hpp"

namespace alula::flight {

struct TrackerOptions {
  double gate = 30;  // squared Mahalanobis distance
  int confirm_hits = 5, confirm_scans = 6, delete_misses = 5;
  double acceleration_noise = 0.5, jerk_noise = 0.2;  // spectral densities of the white acceleration and jerk
  bool with_turn = false;                             // third model
  std::array<double, 4> transition{0.992, 0.008, 0.015, 0.985};
  std::array<double, 3> start_variance{4, 25, 25};  // position, velocity, acceleration per axis
  double cross_range_variance = 100;                // of the velocity across the line of sight, at the start
  bool mixes = true;                                // initial conditions, as in the textbook; false: at read-out only
  // SAFE-IMM, each on its own
  bool gates_models = false, heavy_tails = false, adapts_transition = false, winner_takes_all = false;
  bool jamming = false;
};

struct Track {
  std::uint32_t id = 0;
  bool is_confirmed = false;
  geometry::Vec3 p, v, a;
  std::array<double, 21> covariance{};  // of (p, v): lower triangle, row by row
  double turning = 0;                   // probability of the models that turn or accelerate
};

// One per flight. No allocation after the first scans.
class Tracker {
 public:
  // Throws std::invalid_argument for options that mean nothing.
  explicit Tracker(const TrackerOptions& options = {}, std::size_t most = 128);
  ~Tracker();
  Tracker(Tracker&&) noexcept;
  Tracker& operator=(Tracker&&) noexcept;

  void reset();
  // To time t [s], which must not be before the last; `detections` were all made then. A detection that is not finite
  // is dropped and counted.
  void update(double t, std::span<const Detection> detections);
  // All tracks predicted to `t`, oldest first; valid until the next call.
  std::span<const Track> tracks(double t) const;
  std::uint64_t dropped() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Assignment of least cost: for each row its column or -1; costs above `gate` are forbidden. Hungarian method.
void assign(std::span<const double> cost, std::size_t rows, std::size_t columns, double gate,
            std::vector<int>& column);

}  // namespace alula::flight
