// Bindings of alula/geometry/obstacle_map.hpp and alula/cover/image_map.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "alula/cover/image_map.hpp"
#include "alula/geometry/obstacle_map.hpp"
#include "arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace alula;

namespace {

using Doubles = nb::ndarray<nb::numpy, double>;
using Record = nb::typed<nb::dict, nb::str, nb::any>;

constexpr std::array kKinds{"ellipsoid", "hull", "fence"};  // ObstacleKind

// value(i, memory) of each row.
template <class T, class Value>
std::vector<T> each(const ObstacleMap& map, std::size_t rows, Value&& value) {
  const nb::gil_scoped_release release;
  std::vector<T> result(rows);
  MapMemory memory = map.memory();
  for (std::size_t i = 0; i < rows; ++i) result[i] = static_cast<T>(value(i, memory));
  return result;
}

Doubles numbers(std::vector<double>&& values) {
  const std::size_t rows = values.size();
  return to_numpy(std::move(values), {rows});
}

nb::ndarray<nb::numpy, bool> truths(const std::vector<std::uint8_t>& values) {
  bool* owned = new bool[values.size()];
  std::copy(values.begin(), values.end(), owned);
  nb::capsule owner(owned, [](void* p) noexcept { delete[] static_cast<bool*>(p); });
  return nb::ndarray<nb::numpy, bool>(owned, {values.size()}, owner);
}

geometry::Vec3 row(const InRows3<double>& points, std::size_t i) {
  return geometry::from_rows(points.data() + 3 * i);
}

void require_pairs(const InRows3<double>& start, const InRows3<double>& end) {
  if (start.shape(0) != end.shape(0)) throw std::invalid_argument("start and end differ in length");
}

Record near(const ObstacleMap& map, const std::array<double, 3>& point, double reach, std::size_t most) {
  std::vector<Contact> found;
  {
    const nb::gil_scoped_release release;
    MapMemory memory = map.memory();
    map.near({point[0], point[1], point[2]}, reach, most, found, memory);
  }
  nb::list kind;
  std::vector<std::int64_t> index;
  std::vector<double> distance, normal, at;
  for (const Contact& contact : found) {
    kind.append(kKinds[static_cast<std::size_t>(contact.kind)]);
    index.push_back(contact.index), distance.push_back(contact.distance);
    for (int i = 0; i < 3; ++i) normal.push_back(contact.normal[i]), at.push_back(contact.point[i]);
  }
  const std::size_t n = found.size();
  Record record;
  record["kind"] = kind, record["index"] = to_numpy(std::move(index), {n});
  record["distance"] = to_numpy(std::move(distance), {n}), record["normal"] = to_numpy(std::move(normal), {n, 3});
  record["point"] = to_numpy(std::move(at), {n, 3});
  return record;
}

}  // namespace

void bind_obstacle_map(nb::module_& m) {
  nb::class_<ObstacleMap>(m, "ObstacleMap", "A static map of obstacles: alula/geometry/obstacle_map.hpp.")
      .def(
          "distance",
          [](const ObstacleMap& self, const InRows3<double>& points, double upto) {
            return numbers(each<double>(self, points.shape(0), [&](std::size_t i, MapMemory& memory) {
              return self.distance(row(points, i), upto, memory);
            }));
          },
          "points"_a, "upto"_a = std::numeric_limits<double>::infinity(),
          "Signed distance of each point where it is below `upto`, else some number of at least `upto`.")
      .def(
          "segment_distance",
          [](const ObstacleMap& self, const InRows3<double>& start, const InRows3<double>& end, double upto) {
            require_pairs(start, end);
            return numbers(each<double>(self, start.shape(0), [&](std::size_t i, MapMemory& memory) {
              return self.segment_distance(row(start, i), row(end, i), upto, memory);
            }));
          },
          "start"_a, "end"_a, "upto"_a,
          "Distance of each segment where it is below `upto`, else some number of at least `upto`; 0 in contact.")
      .def(
          "is_clear",
          [](const ObstacleMap& self, const InRows3<double>& start, const InRows3<double>& end, double radius) {
            require_pairs(start, end);
            return truths(each<std::uint8_t>(self, start.shape(0), [&](std::size_t i, MapMemory& memory) {
              return self.is_clear(row(start, i), row(end, i), radius, memory);
            }));
          },
          "start"_a, "end"_a, "radius"_a,
          "Whether the ball swept from start[i] to end[i] is free; never wrongly true.")
      .def("near", &near, "point"_a, "reach"_a, "most"_a,
           "The at most `most` obstacles nearer than `reach`, nearest first: kind, index, distance, normal, point.");
  nb::class_<EllipsoidMap, ObstacleMap>(m, "EllipsoidMap", "The ungrown ellipsoids of an index.")
      .def(
          "__init__",
          [](EllipsoidMap* self, std::shared_ptr<EllipsoidIndex> index) {
            new (self) EllipsoidMap(std::move(index));
          },
          "index"_a);
  nb::class_<EllipsoidSetMap, ObstacleMap>(m, "EllipsoidSetMap", "The ellipsoids of a set, without an index.")
      .def(
          "__init__",
          [](EllipsoidSetMap* self, std::shared_ptr<EllipsoidSet> set) {
            new (self) EllipsoidSetMap(std::move(set));
          },
          "set"_a);
  nb::class_<HullMap, ObstacleMap>(m, "HullMap", "Convex hulls.")
      .def(
          "__init__", [](HullMap* self, std::shared_ptr<PolytopeSet> hulls) { new (self) HullMap(std::move(hulls)); },
          "hulls"_a);
  nb::class_<FenceMap, ObstacleMap>(m, "FenceMap", "A convex polytope whose inside is free.")
      .def(
          "__init__",
          [](FenceMap* self, const InRows3<double>& normals, const InVector<double>& offsets) {
            if (normals.shape(0) != offsets.shape(0))
              throw std::invalid_argument("normals and offsets differ in length");
            std::vector<geometry::HalfSpace> planes;
            for (std::size_t l = 0; l < offsets.size(); ++l) planes.push_back({row(normals, l), offsets.data()[l]});
            new (self) FenceMap(std::move(planes));
          },
          "normals"_a, "offsets"_a, "The polytope {x : normal . x <= offset} with unit normals.");
  nb::class_<ImageMap, ObstacleMap>(m, "ImageMap", "The image of an onboard map, read in place.")
      .def(
          "__init__",
          [](ImageMap* self, const nb::bytes& image) {
            const auto* first = static_cast<const std::uint8_t*>(image.data());
            new (self) ImageMap(
                std::make_shared<const OnboardImage>(std::vector<std::uint8_t>(first, first + image.size())));
          },
          "image"_a);
  nb::class_<GrownMap, ObstacleMap>(m, "GrownMap", "The obstacles of a map, grown by a length.")
      .def(
          "__init__",
          [](GrownMap* self, std::shared_ptr<ObstacleMap> map, double by) {
            new (self) GrownMap(std::move(map), by);
          },
          "map"_a, "by"_a);
  nb::class_<MapUnion, ObstacleMap>(m, "MapUnion", "All obstacles of several maps.")
      .def(
          "__init__",
          [](MapUnion* self, const std::vector<std::shared_ptr<ObstacleMap>>& maps) {
            new (self) MapUnion({maps.begin(), maps.end()});
          },
          "maps"_a);
}
