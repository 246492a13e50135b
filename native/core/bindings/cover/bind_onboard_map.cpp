// Bindings of alula/cover/onboard_map.hpp, alula/cover/map_check.hpp and the onboard readers of maps and tiles.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <memory>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "alula/base/parallel.hpp"
#include "alula/cover/map_check.hpp"
#include "alula/cover/onboard_image.hpp"
#include "alula/cover/onboard_map.hpp"
#include "alula/cover/tile_window.hpp"
#include "alula_map_near.h"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

template <class T>
using Out = nb::ndarray<nb::numpy, T>;

// (records, oblique planes, true if they are of the k-DOP family, largest normal, largest shift)
using Encoded = std::tuple<nb::bytes, std::uint64_t, bool, std::int32_t, std::int32_t>;

Encoded encode(const InRows3<std::int32_t>& vertex, const InVector<std::int64_t>& vertex_start,
               const InRows3<std::int64_t>& plane_normal, const InVector<std::int64_t>& plane_start,
               const std::tuple<std::int32_t, std::int32_t, std::int32_t>& origin, int largest_normal, unsigned jobs,
               nb::object progress) {
  PythonControl control(std::move(progress));
  MapRecords records;
  {
    const nb::gil_scoped_release release;
    const auto [x, y, z] = origin;
    const HullView hulls{as_span(vertex), as_span(vertex_start), as_span(plane_normal), as_span(plane_start)};
    records = encode_map_records(hulls, {x, y, z}, largest_normal, jobs, control);
  }
  return {nb::bytes(records.bytes.data(), records.bytes.size()), records.planes, records.is_kdop,
          records.largest_normal, records.largest_shift};
}

MapView view(const InRows3<std::int32_t>& lower, const InRows3<std::int32_t>& upper,
             const InRows3<std::int32_t>& normal, const InVector<std::int64_t>& offset,
             const InVector<std::int64_t>& plane_start) {
  return {as_span(lower), as_span(upper), as_span(normal), as_span(offset), as_span(plane_start)};
}

Out<std::int64_t> check_voxels(const InRows3<std::int32_t>& lower, const InRows3<std::int32_t>& upper,
                               const InRows3<std::int32_t>& normal, const InVector<std::int64_t>& offset,
                               const InVector<std::int64_t>& plane_start, const InRows3<std::int32_t>& voxel,
                               unsigned jobs, nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<std::int64_t> outside;
  {
    const nb::gil_scoped_release release;
    outside = voxels_outside(view(lower, upper, normal, offset, plane_start), as_span(voxel), jobs, control);
  }
  const std::size_t count = outside.size();
  return to_numpy(std::move(outside), {count});
}

Out<std::int64_t> check_polytopes(const InRows3<std::int32_t>& lower, const InRows3<std::int32_t>& upper,
                                  const InRows3<std::int32_t>& normal, const InVector<std::int64_t>& offset,
                                  const InVector<std::int64_t>& plane_start, const InRows3<std::int32_t>& vertex,
                                  const InVector<std::int64_t>& vertex_start) {
  std::vector<std::int64_t> outside;
  {
    const nb::gil_scoped_release release;
    outside =
        polytopes_outside(view(lower, upper, normal, offset, plane_start), as_span(vertex), as_span(vertex_start));
  }
  const std::size_t count = outside.size();
  return to_numpy(std::move(outside), {count});
}

std::vector<std::uint8_t> copied(const nb::bytes& image) {
  const auto* first = static_cast<const std::uint8_t*>(image.data());
  return {first, first + image.size()};
}

class OnboardMap {
 public:
  explicit OnboardMap(const nb::bytes& image) : image_(copied(image)) {}

  const alula_map& map() const { return image_.map(); }

  using Values = std::tuple<Out<float>, Out<std::uint32_t>, Out<float>>;

  Values psi(const InRows3<float>& points, unsigned jobs) const {
    return evaluate(points, jobs, 256, [this] {
      return [this](const float* x, alula_map_value* at) { return alula_map_evaluate(&map(), x, at); };
    });
  }

  Values psi_along(const InRows3<float>& points) const {
    return evaluate(points, 1, points.shape(0) + 1, [this] {
      auto near = std::make_unique<alula_map_near>();
      alula_map_near_open(near.get(), &map());
      return [near = std::move(near)](const float* x, alula_map_value* at) {
        return alula_map_near_evaluate(near.get(), x, at);
      };
    });
  }

  // Every record as read by the C iterator: lower and upper (n, 3), planes per hull (n), normal (K, 3),
  // depth (K).
  auto records() const {
    std::vector<std::int32_t> lower, upper, normal;
    std::vector<std::uint32_t> count, depth;
    std::uint32_t at = ALULA_MAP_HEADER_BYTES;
    for (std::uint32_t h = 0; h < map().hull_count; ++h) {
      alula_map_hull hull;
      if (alula_map_read(&map(), at, &hull) != ALULA_MAP_READY) throw std::logic_error("an open map is not readable");
      lower.insert(lower.end(), hull.lower, hull.lower + 3);
      upper.insert(upper.end(), hull.upper, hull.upper + 3);
      count.push_back(hull.plane_count);
      for (std::uint32_t l = 0; l < hull.plane_count; ++l) {
        const alula_map_plane plane = alula_map_plane_at(&map(), &hull, l);
        normal.insert(normal.end(), plane.normal, plane.normal + 3);
        depth.push_back(plane.depth);
      }
      at = hull.next;
    }
    const std::size_t hulls = count.size(), planes = depth.size();
    return std::tuple<Out<std::int32_t>, Out<std::int32_t>, Out<std::uint32_t>, Out<std::int32_t>,
                      Out<std::uint32_t>>{to_numpy(std::move(lower), {hulls, 3}),
                                          to_numpy(std::move(upper), {hulls, 3}), to_numpy(std::move(count), {hulls}),
                                          to_numpy(std::move(normal), {planes, 3}),
                                          to_numpy(std::move(depth), {planes})};
  }

 private:
  // `make` returns a chunk's function that maps a position to a status and a value.
  template <typename Make>
  static Values evaluate(const InRows3<float>& points, unsigned jobs, std::size_t chunk, const Make& make) {
    const std::size_t count = points.shape(0);
    std::vector<float> value(count), normal(3 * count);
    std::vector<std::uint32_t> hull(count);
    {
      const nb::gil_scoped_release release;
      Control control;
      parallel_chunks(count, chunk, jobs, control, [&](std::size_t begin, std::size_t end) {
        const auto psi_at = make();
        for (std::size_t i = begin; i < end; ++i) {
          alula_map_value at;
          if (psi_at(points.data() + 3 * i, &at) != ALULA_MAP_READY)
            throw std::invalid_argument(status_text(ALULA_MAP_BAD_POSITION));
          value[i] = at.psi_m;
          hull[i] = at.hull;
          for (std::size_t j = 0; j < 3; ++j) normal[3 * i + j] = at.normal[j];
        }
      });
    }
    return {to_numpy(std::move(value), {count}), to_numpy(std::move(hull), {count}),
            to_numpy(std::move(normal), {count, 3})};
  }

  OnboardImage image_;
};

}  // namespace
}  // namespace alula

void bind_onboard_map(nb::module_& m) {
  using namespace alula;
  m.def("encode_map_records", &encode, "vertex"_a, "vertex_start"_a, "plane_normal"_a, "plane_start"_a, "origin"_a,
        "largest_normal"_a, "jobs"_a, "progress"_a.none(),
        "Encode the hulls of a cover as records of an onboard map: (bytes, oblique planes, whether the normals are "
        "of the\n"
        "k-DOP family, largest normal, largest shift). Raises ValueError, and OverflowError beyond 16 bits.");
  m.def("check_map_voxels", &check_voxels, "lower"_a, "upper"_a, "normal"_a, "offset"_a, "plane_start"_a, "voxel"_a,
        "jobs"_a, "progress"_a.none(),
        "Find exactly the rows of voxels (M, 3) that no hull of a decoded map contains.");
  m.def("check_map_polytopes", &check_polytopes, "lower"_a, "upper"_a, "normal"_a, "offset"_a, "plane_start"_a,
        "vertex"_a, "vertex_start"_a,
        "Find exactly the polytopes, given by vertices, that no hull of a decoded map with the same box contains.");
  nb::class_<TileSet>(
      m, "TileSet",
      "A map in tiles: index and images, as the C code of a microcontroller reads them.\n\n"
      "With a key, the signature of the index must match. Raises ValueError with the reader's message.")
      .def(
          "__init__",
          [](TileSet* self, const nb::bytes& index, const std::vector<nb::bytes>& images,
             const std::optional<nb::bytes>& key, const nb::bytes& signature) {
            std::vector<Bytes> all;
            for (const nb::bytes& image : images) all.push_back(copied(image));
            new (self) TileSet(copied(index), std::move(all), key ? std::optional(copied(*key)) : std::nullopt,
                               copied(signature));
          },
          "index"_a, "images"_a, nb::kw_only(), "key"_a = nb::none(), "signature"_a = nb::bytes("", 0))
      .def("__len__", &TileSet::size)
      .def_prop_ro("reach_m", [](const TileSet& self) { return static_cast<double>(self.open().reach_m); });
  nb::class_<OnboardMap>(m, "OnboardMap",
                         "An image of an onboard map, read by the C code that runs on a microcontroller.\n\n"
                         "Raises ValueError with the reader's message for an image that it rejects.")
      .def(nb::init<const nb::bytes&>(), "image"_a)
      .def_prop_ro("hulls", [](const OnboardMap& self) { return self.map().hull_count; })
      .def_prop_ro("planes", [](const OnboardMap& self) { return self.map().plane_count; })
      .def_prop_ro("margin_m", [](const OnboardMap& self) { return self.map().margin_m; })
      .def_prop_ro("extent_m", [](const OnboardMap& self) { return self.map().extent_m; })
      .def("records", &OnboardMap::records,
           "lower and upper (n, 3), oblique planes per hull (n), their normals (K, 3) and depths (K).")
      .def("psi", &OnboardMap::psi, "points"_a, nb::kw_only(), "jobs"_a = 0,
           "psi (N) [m], nearest hull (N) and normal (N, 3) at points (N, 3) [m].")
      .def("psi_along", &OnboardMap::psi_along, "points"_a,
           "The same, with a search warm-started from the previous points: for points close to one another.");
}
