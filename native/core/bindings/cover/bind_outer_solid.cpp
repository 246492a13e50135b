// Bindings of alula/cover/outer_solid.hpp.
#include <nanobind/nanobind.h>

#include <stdexcept>
#include <string>

#include "alula/base/parallel.hpp"
#include "alula/cover/outer_solid.hpp"
#include "arrays.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using Result = nb::typed<nb::dict, nb::str, nb::any>;

Result outer_solids(const InRows3<std::int64_t>& normal, const InVector<std::int64_t>& offset,
                    const InVector<std::int64_t>& plane_start, unsigned jobs) {
  const std::span<const std::int64_t> start = as_span(plane_start);
  bool is_partition = !start.empty() && start.front() == 0 && normal.shape(0) == offset.size() &&
                      start.back() == static_cast<std::int64_t>(offset.size());
  for (std::size_t h = 1; h < start.size(); ++h) is_partition = is_partition && start[h - 1] <= start[h];
  if (!is_partition) throw std::invalid_argument("starts do not partition the rows");
  std::vector<double> point;
  std::vector<std::int64_t> point_start{0}, triangle, triangle_start{0};
  std::vector<std::uint8_t> is_lattice;
  {
    const nb::gil_scoped_release release;
    std::vector<OuterSolid> found(start.size() - 1);
    Control quiet;
    parallel_chunks(found.size(), 16, jobs, quiet, [&](std::size_t begin, std::size_t end) {
      std::vector<LatticePlane> planes;
      for (std::size_t h = begin; h < end; ++h) {
        planes.clear();
        for (auto i = static_cast<std::size_t>(start[h]); i < static_cast<std::size_t>(start[h + 1]); ++i) {
          const std::int64_t* n = normal.data() + 3 * i;
          planes.push_back({{n[0], n[1], n[2]}, offset.data()[i]});
        }
        try {
          found[h] = outer_solid(planes);
        } catch (const std::invalid_argument& error) {
          throw std::invalid_argument("hull " + std::to_string(h) + ": " + error.what());
        }
      }
    });
    for (const OuterSolid& solid : found) {
      for (const std::int64_t row : solid.triangle) triangle.push_back(row + point_start.back());
      point.insert(point.end(), solid.point.begin(), solid.point.end());
      point_start.push_back(static_cast<std::int64_t>(point.size() / 3));
      triangle_start.push_back(static_cast<std::int64_t>(triangle.size() / 3));
      is_lattice.push_back(solid.is_lattice ? 1 : 0);
    }
  }
  Result result;
  const std::size_t hulls = is_lattice.size(), points = point.size() / 3, triangles = triangle.size() / 3;
  result["point"] = to_numpy(std::move(point), {points, 3});
  result["point_start"] = to_numpy(std::move(point_start), {hulls + 1});
  result["triangle"] = to_numpy(std::move(triangle), {triangles, 3});
  result["triangle_start"] = to_numpy(std::move(triangle_start), {hulls + 1});
  result["is_lattice"] = to_numpy(std::move(is_lattice), {hulls});
  return result;
}

}  // namespace
}  // namespace alula

void bind_outer_solid(nb::module_& m) {
  m.def("outer_solids", &alula::outer_solids, "normal"_a, "offset"_a, "plane_start"_a, "jobs"_a,
        "Corners and outward triangles of the polytopes normal . x <= offset, computed exactly and rounded at the "
        "end.");
}
