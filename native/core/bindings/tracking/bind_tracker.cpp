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
#include "fields.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {

template <>
struct Fields<flight::TrackerOptions> {
  using Options = flight::TrackerOptions;
  static constexpr std::tuple all{
      Field{"gate", &Options::gate, "maximum squared Mahalanobis distance of an association"},
      Field{"confirm_hits", &Options::confirm_hits, "hits that confirm a track"},
      Field{"confirm_scans", &Options::confirm_scans, "number of scans in which these hits must occur"},
      Field{"delete_misses", &Options::delete_misses, "misses in a row that delete a track"},
      Field{"coast_s", &Options::coast_s,
            "time without a detection, out of the field of view, that deletes a confirmed track [s]"},
      Field{"field_margin", &Options::field_margin,
            "standard deviations of a position that the field of view must contain"},
      Field{"acceleration_noise", &Options::acceleration_noise,
            "spectral density of the white acceleration [m^2/s^3]"},
      Field{"jerk_noise", &Options::jerk_noise, "spectral density of the white jerk [m^2/s^5]"},
      Field{"with_turn", &Options::with_turn, "use the model of a coordinated turn"},
      Field{"turn_noise", &Options::turn_noise, "spectral density of the turn rate's derivative [rad^2/s^3]"},
      Field{"transition", &Options::transition,
            "transition probabilities per scan, of constant velocity and acceleration"},
      Field{"prior", &Options::prior, "prior probabilities of these models"},
      Field{"turn_transition", &Options::turn_transition,
            "transition probabilities per scan, of these models and the turn"},
      Field{"turn_prior", &Options::turn_prior, "prior probabilities of these three models"},
      Field{"start_variance", &Options::start_variance,
            "initial variances of position, velocity and acceleration per axis"},
      Field{"cross_range_variance", &Options::cross_range_variance,
            "variance of the initial velocity across the line of sight [m^2/s^2]"},
      Field{"turn_variance", &Options::turn_variance,
            "variance of the turn rate, initially and in models without it [rad^2/s^2]"},
      Field{"mixing_variance", &Options::mixing_variance,
            "variance of the acceleration in models without it, when models mix [m^2/s^4]"},
      Field{"mixes", &Options::mixes, "models restart from mixtures in each scan"},
      Field{"gates_models", &Options::gates_models, "SAFE-IMM"},
      Field{"heavy_tails", &Options::heavy_tails, "SAFE-IMM"},
      Field{"adapts_transition", &Options::adapts_transition, "SAFE-IMM"},
      Field{"winner_takes_all", &Options::winner_takes_all, "SAFE-IMM"},
      Field{"jamming", &Options::jamming, "SAFE-IMM"}};
};

namespace flight {
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
  self.update(t, detections, field);  // takes microseconds, and threads may share the object: keep the GIL
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

}  // namespace
}  // namespace flight
}  // namespace alula

void bind_tracker(nb::module_& m) {
  using namespace alula;
  using namespace alula::flight;
  fields::bind<TrackerOptions>(m, "TrackerOptions", "Options of the tracker; immutable.");
  nb::class_<Tracker>(m, "Tracker", "Tracks of moving obstacles: nearest neighbours and interacting multiple models.")
      .def(nb::init<const TrackerOptions&, std::size_t>(), "options"_a = TrackerOptions{}, "most"_a = 128,
           "Create a tracker with at most `most` tracks at a time. ValueError for invalid options.")
      .def("reset", &Tracker::reset, "Delete all tracks.")
      .def(
          "update", &update, "t"_a, "position"_a, "covariance"_a, "los"_a = nb::none(), "range_rate"_a = nb::none(),
          "range_rate_sigma"_a = 0.1, "field"_a.none() = nb::none(),
          "Process one scan at t [s]: positions (N, 3) [m] with covariances (N, 3, 3), world frame; optionally the "
          "rates "
          "(N,) "
          "[m/s] along the lines of sight (N, 3) from the sensor. Rows that are not finite or have no covariance are "
          "dropped and counted. A confirmed track outside the field coasts. ValueError unless t is within "
          "1e6 s after the last scan.")
      .def("tracks", &tracks, "t"_a,
           "All tracks predicted to t [s], oldest first: id, is_confirmed, p, v, a (N, 3), covariance of (p, v) "
           "(N, 6, 6), turning (N,): the probability of the models that accelerate or turn.")
      .def_prop_ro("dropped", &Tracker::dropped, "Number of detections dropped since the start.");
  m.def("assign", &assigned, "cost"_a, "gate"_a = std::numeric_limits<double>::infinity(),
        "Assign to each row of the costs a column or -1 at minimum cost: a row without a column costs `gate`, costs "
        "above "
        "it "
        "or not finite are forbidden; without a gate as many rows as possible get one.");
}
