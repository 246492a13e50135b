// Bindings of alula/filters/polytope_cbf.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "alula/base/parallel.hpp"
#include "alula/filters/option_fields.hpp"
#include "alula/filters/polytope_cbf.hpp"
#include "alula_chord.h"
#include "arrays.hpp"
#include "fields.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

template <class T>
using Out = nb::ndarray<nb::numpy, T>;

// Arguments of a filter other than its polytopes.
struct PolytopeCbfArguments {
  double extent_m = 0;
  PolytopeCbfConfig config;
};

}  // namespace

template <>
struct Fields<PolytopeCbfArguments> {
  static constexpr std::tuple all{Field{"extent_m", &PolytopeCbfArguments::extent_m,
                                        "bound of the coordinates of all positions [m]", Limits{}, true},
                                  Nested{&PolytopeCbfArguments::config}};
};

namespace {

PolytopeCbfArguments arguments_of(const nb::kwargs& given) {
  PolytopeCbfArguments arguments;
  fields::assign(arguments, given, "PolytopeCbf");
  return arguments;
}

void construct(PolytopeCbf* self, const InRows3<double>& normal, const InVector<double>& offset,
               const InVector<std::int64_t>& plane_start, const nb::kwargs& others) {
  const PolytopeCbfArguments arguments = arguments_of(others);
  const Polytopes polytopes{as_span(normal), as_span(offset), as_span(plane_start)};
  auto map = std::make_shared<const PolytopeMap>(make_polytope_map(polytopes, arguments.extent_m));
  new (self) PolytopeCbf(std::move(map), arguments.config);
}

PolytopeCbf from_image(const nb::bytes& image, const nb::kwargs& others) {
  const PolytopeCbfArguments arguments = arguments_of(others);
  const auto* first = static_cast<const std::uint8_t*>(image.data());
  auto open = std::make_shared<const OnboardImage>(std::vector<std::uint8_t>(first, first + image.size()));
  return {std::move(open), arguments.extent_m, arguments.config};
}

PolytopeCbf from_tiles(const std::shared_ptr<TileSet>& tiles, std::uint32_t load_calls, const nb::kwargs& others) {
  const PolytopeCbfArguments arguments = arguments_of(others);
  return {TileWindow(tiles, load_calls), arguments.extent_m, arguments.config};
}

std::tuple<std::int64_t, bool> tile(const PolytopeCbf& self) {
  if (!self.window()) throw std::invalid_argument("the filter reads no tiles");
  const auto found = self.window()->tile();
  return {found ? static_cast<std::int64_t>(*found) : -1, self.window()->place() == ALULA_TILES_INSIDE};
}

std::tuple<Triple, int, double, double, std::int64_t> filter_velocity(PolytopeCbf& self, const Triple& x,
                                                                      const Triple& u_nom) {
  const FilterOutput output = self.filter(x, u_nom);
  const auto active = output.detail.active;
  return {output.u, static_cast<int>(output.status), output.detail.margin_m, output.detail.hard_margin_m,
          active == ALULA_NO_HULL ? -1 : static_cast<std::int64_t>(active)};
}

std::tuple<Out<double>, Out<double>, Out<double>> psi(const PolytopeCbf& self, const InRows3<double>& points,
                                                      unsigned jobs) {
  const std::size_t count = points.shape(0);
  std::vector<double> smooth(count), hard(count), gradient(3 * count);
  {
    const nb::gil_scoped_release release;
    Control control;
    parallel_chunks(count, 256, jobs, control, [&](std::size_t begin, std::size_t end) {
      PolytopeCbf own(self);
      for (std::size_t i = begin; i < end; ++i) {
        const double* p = points.data() + 3 * i;
        const alula_polytope_value value = own.evaluate({p[0], p[1], p[2]});
        smooth[i] = value.smooth;
        hard[i] = value.hard;
        for (std::size_t j = 0; j < 3; ++j) gradient[3 * i + j] = value.gradient[j];
      }
    });
  }
  return {to_numpy(std::move(smooth), {count}), to_numpy(std::move(hard), {count}),
          to_numpy(std::move(gradient), {count, 3})};
}

std::tuple<Out<float>, Out<std::uint32_t>, Out<float>, Out<float>, double, double> map_arrays(
    const PolytopeCbf& self) {
  if (self.map() == nullptr) throw std::invalid_argument("the filter reads an image");
  const PolytopeMap& map = *self.map();
  const std::size_t hulls = map.plane_start.size() - 1;
  return {to_numpy(std::vector(map.plane), {map.plane.size() / 4, 4}),
          to_numpy(std::vector(map.plane_start), {hulls + 1}),
          to_numpy(std::vector(map.lower), {hulls, 3}),
          to_numpy(std::vector(map.upper), {hulls, 3}),
          map.extent_m,
          map.slack_m};
}

std::tuple<std::uint32_t, std::uint32_t, std::uint32_t, std::uint32_t, std::uint32_t> work(const PolytopeCbf& self) {
  const alula_polytope_work& w = self.work();
  return {w.boxes, w.hulls, w.planes, w.made, w.exponentials};
}

// The chord of a vehicle that lags, as on a microcontroller.
class OnboardChord {
 public:
  OnboardChord(const nb::bytes& image, const PolytopeCbfConfig& config, double lag_s, double extent_m)
      : image_(std::vector<std::uint8_t>(static_cast<const std::uint8_t*>(image.data()),
                                         static_cast<const std::uint8_t*>(image.data()) + image.size())) {
    const alula_polytope_cbf_config rounded = to_onboard(config);
    if (alula_chord_open(&chord_, &image_.map(), round_up(extent_m), &rounded, static_cast<float>(lag_s)) !=
        ALULA_READY)
      throw std::invalid_argument("the onboard filter rejects the map or the parameters");
  }

  std::tuple<Triple, int, double, double> filter(const Triple& x, const Triple& v, const Triple& u_nom,
                                                 bool is_taking_off) {
    float numbers[3][3];
    for (std::size_t i = 0; i < 3; ++i) {
      numbers[0][i] = static_cast<float>(x[i]);
      numbers[1][i] = static_cast<float>(v[i]);
      numbers[2][i] = static_cast<float>(u_nom[i]);
    }
    alula_polytope_result result;
    const auto status = alula_chord_filter(&chord_, numbers[0], numbers[1], numbers[2], is_taking_off, &result);
    return {{result.u[0], result.u[1], result.u[2]}, static_cast<int>(status), result.margin_m, result.hard_margin_m};
  }

  std::array<std::uint32_t, 6> work() const {
    const alula_polytope_work& w = chord_.hulls.work;
    return {w.boxes, w.hulls, w.planes, w.made, chord_.count, chord_.soft};
  }

 private:
  OnboardImage image_;
  alula_chord chord_;
};

}  // namespace
}  // namespace alula

void bind_polytope_cbf(nb::module_& m) {
  using namespace alula;
  fields::bind<PolytopeCbfConfig>(m, "PolytopeCbfConfig", "Parameters of the onboard safety filter among polytopes.");
  nb::class_<PolytopeCbf>(
      m, "PolytopeCbf",
      "The onboard safety filter among convex polytopes {x : normal . x <= offset}.\n\n"
      "Normals are outward unit vectors (F, 3), offsets in metres, world frame; extent_m bounds\n"
      "the coordinates of all positions. Raises ValueError for arguments that the filter rejects.")
      .def("__init__", &construct, "normal"_a, "offset"_a, "plane_start"_a, "others"_a,
           nb::sig(fields::signature(PolytopeCbfArguments{},
                                     "self, normal: NDArray[numpy.float64], offset: NDArray[numpy.float64], "
                                     "plane_start: NDArray[numpy.int64]")
                       .c_str()),
           fields::documentation(PolytopeCbfArguments{}).c_str())
      .def_prop_ro("config", &PolytopeCbf::config)
      .def("filter", &filter_velocity, "x"_a, "u_nom"_a,
           "(u, status, margin of the smooth psi, margin of the hard psi, nearest hull or -1); margins in metres.")
      .def_static(
          "from_image", &from_image, "image"_a, "others"_a,
          nb::sig(("@staticmethod\n" +
                   fields::signature(PolytopeCbfArguments{}, "image: bytes", "from_image", "PolytopeCbf"))
                      .c_str()),
          "Create the filter from an image of an onboard map, as on a microcontroller. Raises ValueError with\n"
          "the reader's message for an image that it rejects.")
      .def_static(
          "from_tiles", &from_tiles, "tiles"_a, "load_calls"_a, "others"_a,
          nb::sig(("@staticmethod\n" + fields::signature(PolytopeCbfArguments{}, "tiles: TileSet, load_calls: int",
                                                         "from_tiles", "PolytopeCbf"))
                      .c_str()),
          "Create the filter from tiles, of which two are resident: after the first, one that is needed comes\n"
          "`load_calls` calls later, and far from all resident ones commands are refused. Raises ValueError when the "
          "tiles do not\n"
          "reach far enough for the commands of the whole map.")
      .def("tile", &tile, "Row of the resident tile of the last call or -1, and whether it was in its region.")
      .def_prop_ro("reach_m", &PolytopeCbf::reach_m, "Hulls with a larger psi cannot change a command [m].")
      .def("reset", &PolytopeCbf::reset, "Before another flight: no tile is resident.")
      .def("work", &work,
           "Counts of the last call of `filter`: boxes, hulls, planes of these hulls, planes that were\n"
           "decoded, exponentials of planes.")
      .def("psi", &psi, "points"_a, nb::kw_only(), "jobs"_a = 0,
           "Smooth psi (N), hard psi (N) and the gradient of the smooth one (N, 3) at points (N, 3) [m].")
      .def("map_arrays", &map_arrays,
           "The single-precision map: plane (F, 4), plane_start (n + 1), lower and upper (n, 3), extent and slack "
           "[m].");

  nb::class_<OnboardChord>(m, "OnboardChord",
                           "The onboard filter of a vehicle that follows velocities with a lag: alula_chord.h.")
      .def(nb::init<const nb::bytes&, const PolytopeCbfConfig&, double, double>(), "image"_a, "config"_a, "lag_s"_a,
           "extent_m"_a = 0.0)
      .def("filter", &OnboardChord::filter, "x"_a, "v"_a, "u_nom"_a, "is_taking_off"_a = false,
           "(u, status, least D_k - r, psi - r at x); margins in metres.")
      .def("work", &OnboardChord::work,
           "Of the last call: boxes, hulls, values of planes, decoded planes, rows, those inside margins.");

  m.def(
      "onboard_exp_log",
      [](const InVector<float>& x) -> std::tuple<Out<float>, Out<float>> {
        std::vector<float> exponential, logarithm;
        for (const float value : as_span(x)) {
          exponential.push_back(alula_expf(value));
          logarithm.push_back(alula_logf(value));
        }
        const std::size_t count = exponential.size();
        return {to_numpy(std::move(exponential), {count}), to_numpy(std::move(logarithm), {count})};
      },
      "x"_a, "The onboard exponential and logarithm, for checking their error bounds.");
}
