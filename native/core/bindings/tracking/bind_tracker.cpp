// Bindings of alula/tracking/tracker.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "alula/tracking/tracker.hpp"
#include "arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula::flight {
namespace {

using Covariances = In<double, nb::shape<-1, 3, 3>>;
using TracksDict = nb::typed<nb::dict, nb::str, nb::any>;

void expect_rows(std::size_t rows, std::size_t expected, const char* what) {
  if (rows != expected) throw std::invalid_argument(what);
}

void update(Tracker& self, double t, InRows3<double> position, Covariances covariance,
            std::optional<InRows3<double>> los, std::optional<InVector<double>> range_rate, double range_rate_sigma,
            const FieldOfView* field) {
  const std::size_t n = position.shape(0);
  expect_rows(covariance.shape(0), n, "there must be a covariance per position");
  if (los.has_value() != range_rate.has_value()) throw std::invalid_argument("range_rate needs los, and los it");
  if (los) expect_rows(los->shape(0), n, "there must be a line of sight per position");
  if (range_rate) expect_rows(range_rate->shape(0), n, "there must be a range rate per position");
  std::vector<Detection> detections(n);
  for (std::size_t i = 0; i < n; ++i) {
    Detection& d = detections[i];
    d.position = geometry::from_rows(position.data() + 3 * i);
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k) d.covariance[j][k] = covariance.data()[9 * i + static_cast<std::size_t>(3 * j + k)];
    if (!los) continue;
    d.has_doppler = true;
    d.los = geometry::from_rows(los->data() + 3 * i);
    d.range_rate = range_rate->data()[i];
    d.range_rate_sigma = range_rate_sigma;
  }
  self.update(t, detections, field);  // microseconds, and of an object that threads may share: with the GIL
}

TracksDict tracks(const Tracker& self, double t) {
  const std::span<const Track> all = self.tracks(t);
  const std::size_t n = all.size();
  std::vector<std::uint32_t> id(n);
  auto* is_confirmed = new bool[n];
  const nb::capsule owner(is_confirmed, [](void* p) noexcept { delete[] static_cast<bool*>(p); });
  std::vector<double> p, v, a, covariance(36 * n), turning(n);
  const auto add = [](std::vector<double>& rows, geometry::Vec3 x) { rows.insert(rows.end(), {x.x, x.y, x.z}); };
  for (std::size_t i = 0; i < n; ++i) {
    const Track& track = all[i];
    id[i] = track.id, is_confirmed[i] = track.is_confirmed, turning[i] = track.turning;
    add(p, track.p), add(v, track.v), add(a, track.a);
    std::size_t at = 0;
    double* matrix = covariance.data() + 36 * i;
    for (std::size_t k = 0; k < 6; ++k)
      for (std::size_t l = 0; l <= k; ++l) matrix[6 * k + l] = matrix[6 * l + k] = track.covariance[at++];
  }
  nb::dict result;
  result["id"] = to_numpy(std::move(id), {n});
  result["is_confirmed"] = nb::ndarray<nb::numpy, bool>(is_confirmed, {n}, owner);
  result["p"] = to_numpy(std::move(p), {n, 3});
  result["v"] = to_numpy(std::move(v), {n, 3});
  result["a"] = to_numpy(std::move(a), {n, 3});
  result["covariance"] = to_numpy(std::move(covariance), {n, 6, 6});
  result["turning"] = to_numpy(std::move(turning), {n});
  return result;
}

nb::ndarray<nb::numpy, int> assigned(In<double, nb::shape<-1, -1>> cost, double gate) {
  std::vector<int> column;
  {
    const nb::gil_scoped_release release;
    assign(as_span(cost), cost.shape(0), cost.shape(1), gate, column);
  }
  const std::size_t rows = column.size();
  return to_numpy(std::move(column), {rows});
}

void bind_options(nb::module_& m) {
  const TrackerOptions o;
  nb::class_<TrackerOptions>(m, "TrackerOptions", "How moving obstacles are tracked; fixed once made.")
      .def(
          "__init__",
          [](TrackerOptions* self, double gate, int confirm_hits, int confirm_scans, int delete_misses,
             double coast_s, double field_margin, double acceleration_noise, double jerk_noise, double turn_noise,
             bool with_turn, std::array<double, 4> transition, std::array<double, 2> prior,
             std::array<double, 9> turn_transition, std::array<double, 3> turn_prior,
             std::array<double, 3> start_variance, double cross_range_variance, double turn_variance,
             double mixing_variance, bool mixes, bool gates_models, bool heavy_tails, bool adapts_transition,
             bool winner_takes_all, bool jamming) {
            new (self) TrackerOptions{.gate = gate,
                                      .confirm_hits = confirm_hits,
                                      .confirm_scans = confirm_scans,
                                      .delete_misses = delete_misses,
                                      .coast_s = coast_s,
                                      .field_margin = field_margin,
                                      .acceleration_noise = acceleration_noise,
                                      .jerk_noise = jerk_noise,
                                      .with_turn = with_turn,
                                      .turn_noise = turn_noise,
                                      .transition = transition,
                                      .prior = prior,
                                      .turn_transition = turn_transition,
                                      .turn_prior = turn_prior,
                                      .start_variance = start_variance,
                                      .cross_range_variance = cross_range_variance,
                                      .turn_variance = turn_variance,
                                      .mixing_variance = mixing_variance,
                                      .mixes = mixes,
                                      .gates_models = gates_models,
                                      .heavy_tails = heavy_tails,
                                      .adapts_transition = adapts_transition,
                                      .winner_takes_all = winner_takes_all,
                                      .jamming = jamming};
          },
          nb::kw_only(), "gate"_a = o.gate, "confirm_hits"_a = o.confirm_hits, "confirm_scans"_a = o.confirm_scans,
          "delete_misses"_a = o.delete_misses, "coast_s"_a = o.coast_s, "field_margin"_a = o.field_margin,
          "acceleration_noise"_a = o.acceleration_noise, "jerk_noise"_a = o.jerk_noise, "turn_noise"_a = o.turn_noise,
          "with_turn"_a = o.with_turn, "transition"_a = o.transition, "prior"_a = o.prior,
          "turn_transition"_a = o.turn_transition, "turn_prior"_a = o.turn_prior,
          "start_variance"_a = o.start_variance, "cross_range_variance"_a = o.cross_range_variance,
          "turn_variance"_a = o.turn_variance, "mixing_variance"_a = o.mixing_variance, "mixes"_a = o.mixes,
          "gates_models"_a = o.gates_models, "heavy_tails"_a = o.heavy_tails,
          "adapts_transition"_a = o.adapts_transition, "winner_takes_all"_a = o.winner_takes_all,
          "jamming"_a = o.jamming,
          "gate: of a squared Mahalanobis distance. *_noise: spectral densities [m^2/s^3, m^2/s^5, rad^2/s^3]. "
          "transition (per scan) and prior: of constant velocity and acceleration; turn_*: of these and a "
          "coordinated "
          "turn, used with_turn. start_variance: position, velocity, acceleration per axis. mixing_variance, "
          "turn_variance: of the acceleration and the turn rate that a model without them lends to the others. "
          "mixes: "
          "models restart from mixtures each scan. The last five are additions of SAFE-IMM.");
}

}  // namespace
}  // namespace alula::flight

void bind_tracker(nb::module_& m) {
  using namespace alula::flight;
  bind_options(m);
  nb::class_<Tracker>(m, "Tracker", "Tracks of moving obstacles: nearest neighbours and interacting multiple models.")
      .def(nb::init<const TrackerOptions&, std::size_t>(), "options"_a = TrackerOptions{}, "most"_a = 128,
           "Of at most `most` tracks at a time. ValueError for options that mean nothing.")
      .def("reset", &Tracker::reset, "Forget everything.")
      .def(
          "update", &update, "t"_a, "position"_a, "covariance"_a, "los"_a = nb::none(), "range_rate"_a = nb::none(),
          "range_rate_sigma"_a = 0.1, "field"_a.none() = nb::none(),
          "One scan at t [s]: positions (N, 3) [m] with covariances (N, 3, 3), world frame; optionally the rates "
          "(N,) "
          "[m/s] along the lines of sight (N, 3) from the sensor. Rows that are not finite or have no covariance are "
          "dropped and counted. A confirmed track that the field does not hold coasts. ValueError unless t is within "
          "1e6 s after the last scan.")
      .def("tracks", &tracks, "t"_a,
           "All tracks predicted to t [s], oldest first: id, is_confirmed, p, v, a (N, 3), covariance of (p, v) "
           "(N, 6, 6), turning (N,): the probability of the models that accelerate or turn.")
      .def_prop_ro("dropped", &Tracker::dropped, "Detections that were not used since the start.");
  m.def("assign", &assigned, "cost"_a, "gate"_a = std::numeric_limits<double>::infinity(),
        "For each row of the costs its column or -1, at least cost: a row without a column costs `gate`, costs above "
        "it "
        "or not finite are forbidden; without a gate as many rows as possible get one.");
}
