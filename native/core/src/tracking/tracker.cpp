#include "alula/tracking/tracker.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "alula/tracking/assignment.hpp"
#include "alula/tracking/imm.hpp"

namespace alula::flight {
namespace {

constexpr std::size_t kUsualDetections = 64;  // in a scan; more enlarge the memory
constexpr double kLongest = 1e6;              // longest time without a scan [s]; covariances must stay finite

double trace3(const double (&m)[kMostStates][kMostStates]) { return m[0][0] + m[1][1] + m[2][2]; }

}  // namespace

struct Tracker::State {
  // A track with its history of hits and misses.
  struct Kept {
    std::uint32_t id = 0;
    bool is_confirmed = false;
    std::uint64_t hits = 0;  // of the last 64 scans, the latest in bit 0
    int misses = 0;          // in a row
    double seen_s = 0;       // time of the last hit
    Imm imm;
  };

  State(const TrackerOptions& options, std::size_t room) : rules(options), most(room) {
    if (most == 0) throw std::invalid_argument("a tracker needs room for a track");
    tracks.reserve(most), mixtures.reserve(most), answer.reserve(most), rows.reserve(most);
    reserve(kUsualDetections);
  }

  void reserve(std::size_t detections) {
    measured.reserve(detections), is_taken.reserve(detections);
    cost.reserve(most * detections);
    assignment.reserve(most, detections);
  }

  void gather(std::span<const Detection> detections);
  void associate(bool confirmed);
  void record(Kept& track, bool is_hit);
  bool is_out_of_sight(const Kept& track, const Belief& mixture) const;
  void start(const Measurement& measurement);

  ImmRules rules;
  std::size_t most;
  const FieldOfView* field = nullptr;  // of this scan
  bool has_begun = false;
  double last = 0;
  std::uint32_t next_id = 1;
  std::uint64_t dropped = 0;
  std::vector<Kept> tracks;  // by id
  std::vector<Belief> mixtures;
  std::vector<Measurement> measured;
  std::vector<char> is_taken;
  std::vector<std::size_t> rows;  // tracks that are being assigned
  std::vector<double> cost;
  Assignment assignment;
  std::vector<Track> answer;
};

void Tracker::State::gather(std::span<const Detection> detections) {
  measured.clear();
  for (const Detection& detection : detections) {
    Measurement measurement;
    if (measure(detection, measurement)) {
      measured.push_back(measurement);
    } else {
      ++dropped;
    }
  }
  is_taken.assign(measured.size(), 0);
}

void Tracker::State::record(Kept& track, bool is_hit) {
  const TrackerOptions& o = rules.options;
  track.hits = track.hits << 1 | (is_hit ? 1U : 0U);
  track.misses = is_hit ? 0 : track.misses + 1;
  if (is_hit) track.seen_s = last;
  const std::uint64_t window = ~std::uint64_t{0} >> (64 - o.confirm_scans);
  track.is_confirmed |= std::popcount(track.hits & window) >= o.confirm_hits;
}

bool Tracker::State::is_out_of_sight(const Kept& track, const Belief& mixture) const {
  const TrackerOptions& o = rules.options;
  if (field == nullptr || !track.is_confirmed || !(last - track.seen_s <= o.coast_s)) return false;
  geometry::Mat3 covariance;
  for (int k = 0; k < 3; ++k)
    for (int l = 0; l < 3; ++l) covariance[k][l] = mixture.P[k][l];
  return !field->holds({mixture.x[0], mixture.x[1], mixture.x[2]}, covariance, o.field_margin);
}

// GNN: assigns the remaining detections to the confirmed tracks, or to the others.
void Tracker::State::associate(bool confirmed) {
  rows.clear();
  for (std::size_t i = 0; i < tracks.size(); ++i)
    if (tracks[i].is_confirmed == confirmed) rows.push_back(i);
  const std::size_t columns = measured.size();
  cost.assign(rows.size() * columns, std::numeric_limits<double>::infinity());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Belief& mixture = mixtures[rows[i]];
    const double spread = trace3(mixture.P);
    for (std::size_t j = 0; j < columns; ++j) {
      if (is_taken[j]) continue;
      const Measurement& m = measured[j];
      double squared = 0;
      for (int k = 0; k < 3; ++k) squared += (m.z[k] - mixture.x[k]) * (m.z[k] - mixture.x[k]);
      // Lower bound of the distance: all variance along the difference.
      if (squared > rules.options.gate * (spread + m.R[0][0] + m.R[1][1] + m.R[2][2])) continue;
      const Innovation innovation = innovate(mixture, m);
      if (innovation.is_valid) cost[i * columns + j] = innovation.distance;
    }
  }
  const std::span<const int> column = assignment.solve(cost, rows.size(), columns, rules.options.gate);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    Kept& track = tracks[rows[i]];
    if (column[i] >= 0) {
      const auto j = static_cast<std::size_t>(column[i]);
      is_taken[j] = 1;
      track.imm.correct(rules, measured[j]);
    }
    if (column[i] >= 0 || !is_out_of_sight(track, mixtures[rows[i]])) record(track, column[i] >= 0);
  }
}

void Tracker::State::start(const Measurement& measurement) {
  if (tracks.size() == most) {
    ++dropped;
    return;
  }
  Kept& track = tracks.emplace_back();
  track.id = next_id++;
  track.imm.start(rules, measurement);
  record(track, true);
}

Tracker::Tracker(const TrackerOptions& options, std::size_t most) : state_(std::make_unique<State>(options, most)) {}
Tracker::~Tracker() = default;
Tracker::Tracker(Tracker&&) noexcept = default;
Tracker& Tracker::operator=(Tracker&&) noexcept = default;

void Tracker::reset() {
  State& s = *state_;
  s.has_begun = false;
  s.last = 0, s.next_id = 1, s.dropped = 0;
  s.tracks.clear();
}

void Tracker::update(double t, std::span<const Detection> detections, const FieldOfView* field) {
  State& s = *state_;
  if (!std::isfinite(t) || (s.has_begun && !(t >= s.last && t - s.last <= kLongest)))
    throw std::invalid_argument("the time of a scan must be within 1e6 s after the last");
  s.gather(detections);
  s.mixtures.clear();
  for (State::Kept& track : s.tracks) {
    track.imm.predict(s.rules, t - s.last);
    s.mixtures.push_back(track.imm.mixture());
  }
  s.has_begun = true;
  s.last = t;
  s.field = field;
  s.associate(true);  // before the others, which may become confirmed now
  s.associate(false);
  std::erase_if(s.tracks, [&](const State::Kept& track) { return track.misses >= s.rules.options.delete_misses; });
  for (std::size_t j = 0; j < s.measured.size(); ++j)
    if (!s.is_taken[j]) s.start(s.measured[j]);
}

std::span<const Track> Tracker::tracks(double t) const {
  State& s = *state_;
  if (!std::isfinite(t) || (s.has_begun && t - s.last > kLongest))
    throw std::invalid_argument("the time of a prediction must be within 1e6 s after the last scan");
  s.answer.resize(s.tracks.size());
  const double dt = s.has_begun ? std::max(0.0, t - s.last) : 0;
  for (std::size_t i = 0; i < s.tracks.size(); ++i) {
    Track& track = s.answer[i];
    track.id = s.tracks[i].id;
    track.is_confirmed = s.tracks[i].is_confirmed;
    s.tracks[i].imm.read(s.rules, dt, track);
  }
  return s.answer;
}

std::uint64_t Tracker::dropped() const { return state_->dropped; }

}  // namespace alula::flight
