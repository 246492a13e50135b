// Binding of alula/cover/union_measure.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <cmath>
#include <stdexcept>

#include "alula/cover/union_measure.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using Result = nb::typed<nb::dict, nb::str, nb::any>;

Result measure(const InRows3<double>& normal, const InVector<double>& offset, const InVector<std::int64_t>& start,
               const InRows3<double>& lower, const InRows3<double>& upper, const InRows3<std::int32_t>& voxels,
               double sliver, unsigned jobs, nb::object progress) {
  const std::size_t count = lower.shape(0);
  if (upper.shape(0) != count || start.size() != count + 1 || normal.shape(0) != offset.size() || start(0) != 0 ||
      start(count) != static_cast<std::int64_t>(offset.size()))
    throw std::invalid_argument("the arrays of the polytopes do not fit each other");
  for (std::size_t h = 0; h < count; ++h)
    if (start(h) > start(h + 1)) throw std::invalid_argument("`start` decreases");
  for (std::size_t i = 0; i < 3 * count; ++i)
    if (!(std::abs(lower.data()[i]) <= kLatticeLimit && std::abs(upper.data()[i]) <= kLatticeLimit))
      throw std::invalid_argument("a polytope lies out of range");
  PythonControl control(std::move(progress));
  UnionMeasure found;
  {
    const nb::gil_scoped_release release;
    ConvexSets sets;
    for (std::size_t h = 0; h < count; ++h) {
      for (std::int64_t p = start(h); p < start(h + 1); ++p) {
        const std::size_t at = static_cast<std::size_t>(p);
        sets.plane.push_back({{normal(at, 0), normal(at, 1), normal(at, 2)}, offset(at)});
      }
      sets.close({{lower(h, 0), lower(h, 1), lower(h, 2)}, {upper(h, 0), upper(h, 1), upper(h, 2)}});
    }
    static_assert(sizeof(Lattice) == 3 * sizeof(std::int32_t));
    const Occupancy occupancy({reinterpret_cast<const Lattice*>(voxels.data()), voxels.shape(0)});
    MeasureOptions options;
    options.sliver = sliver;
    found = union_measure(sets, voxels.shape(0) == 0 ? nullptr : &occupancy, options, jobs, control);
  }
  Result result;
  result["volume"] = found.volume;
  result["intersection"] = found.intersection;
  result["whole"] = found.whole;
  result["error"] = found.error;
  result["cuts"] = found.cuts;
  return result;
}

}  // namespace
}  // namespace alula

void bind_union_measure(nb::module_& m) {
  m.def(
      "union_measure", &alula::measure, "normal"_a, "offset"_a, "start"_a, "lower"_a, "upper"_a, "voxels"_a,
      "sliver"_a, "jobs"_a, "progress"_a.none(),
      "Volume of the union of polytopes {normal . x <= offset} with unit normals (F, 3), row-compressed by\n"
      "`start` (n + 1,), each within its box, in voxel edges; its intersection with sorted voxels (M, 3), how many\n"
      "of them lack no more than `sliver` of their volume, and a bound on the rounding error of both volumes.");
}
