// The tracker allocates no memory after its construction.
#include "alula/tracking/tracker.hpp"

#include <cmath>
#include <utility>
#include <vector>

#include "allocations.hpp"
#include "check.hpp"

namespace {

using namespace alula::flight;
using alula::geometry::Vec3;

// Drifting objects on a grid; some are missed, and one detection is far from all.
void detect(std::size_t things, int scan, std::vector<Detection>& out) {
  out.clear();
  for (std::size_t i = 0; i < things; ++i) {
    if ((static_cast<std::size_t>(scan) + i) % 11 == 0) continue;
    const double at = static_cast<double>(i), t = 0.05 * scan;
    Detection d;
    d.position = Vec3{20 + 30 * at - 2 * t, 5 * std::sin(at) + t, 10};
    d.covariance = alula::geometry::diagonal({0.04, 0.09, 0.09});
    d.has_doppler = i % 2 == 0;
    d.los = d.position;
    d.range_rate = alula::geometry::dot(d.position, {-2, 1, 0}) / alula::geometry::norm(d.position);
    d.range_rate_sigma = 0.1;
    out.push_back(d);
  }
  Detection stray;
  stray.position = {-100.0 * scan, 1e4, 0};
  stray.covariance = alula::geometry::identity();
  out.push_back(stray);
}

void nothing_is_allocated(const TrackerOptions& options) {
  Tracker tracker(options);
  std::vector<Detection> detections;
  detections.reserve(64);
  const std::size_t before = allocations;
  for (int scan = 0; scan < 60; ++scan) {
    detect(40, scan, detections);
    tracker.update(0.05 * scan, detections);
    CHECK(tracker.tracks(0.05 * scan + 0.03).size() >= detections.size());
  }
  tracker.reset();
  CHECK(tracker.tracks(0).empty());
  CHECK(allocations == before);
}

}  // namespace

int main() {
  nothing_is_allocated({});
  TrackerOptions all;
  all.with_turn = all.gates_models = all.heavy_tails = all.adapts_transition = all.winner_takes_all = true;
  nothing_is_allocated(all);

  // Moving a tracker keeps its tracks.
  Tracker first;
  std::vector<Detection> detections;
  for (int scan = 0; scan < 9; ++scan) detect(3, scan, detections), first.update(0.05 * scan, detections);
  const Vec3 p = first.tracks(1)[0].p;
  Tracker second = std::move(first);
  CHECK(second.tracks(1)[0].p.x == p.x);
  CHECK(second.tracks(1)[0].is_confirmed);
  return alula_failures == 0 ? 0 : 1;
}
