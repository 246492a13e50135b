// Bindings of alula/cover/cover_check.hpp.
#include <nanobind/nanobind.h>

#include <stdexcept>

#include "alula/cover/cover_check.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using Violations = nb::ndarray<nb::numpy, std::int64_t>;

Violations to_rows(const std::vector<Violation>& found) {
  std::vector<std::int64_t> rows;
  rows.reserve(4 * found.size());
  for (const Violation& v : found)
    rows.insert(rows.end(), {static_cast<std::int64_t>(v.fault), v.hull, v.row, v.other});
  return to_numpy(std::move(rows), {found.size(), 4});
}

CoverView view(const InRows3<std::int32_t>& vertex, const InVector<std::int64_t>& vertex_start,
               const InRows3<std::int64_t>& plane_normal, const InVector<std::int64_t>& plane_offset,
               const InVector<std::int64_t>& plane_start, const InRows3<std::int32_t>& member_index,
               const InVector<std::int64_t>& member_start, bool is_outer) {
  return {as_span(vertex),      as_span(vertex_start), as_span(plane_normal), as_span(plane_offset),
          as_span(plane_start), as_span(member_index), as_span(member_start), is_outer};
}

Violations check_cover_hulls(const InRows3<std::int32_t>& vertex, const InVector<std::int64_t>& vertex_start,
                             const InRows3<std::int64_t>& plane_normal, const InVector<std::int64_t>& plane_offset,
                             const InVector<std::int64_t>& plane_start, const InRows3<std::int32_t>& member_index,
                             const InVector<std::int64_t>& member_start, bool is_outer, unsigned jobs,
                             nb::object progress) {
  PythonControl control(std::move(progress));
  std::vector<Violation> found;
  {
    const nb::gil_scoped_release release;
    found = check_hulls(
        view(vertex, vertex_start, plane_normal, plane_offset, plane_start, member_index, member_start, is_outer),
        jobs, control);
  }
  return to_rows(found);
}

Violations check_cover_occupied(const InRows3<std::int32_t>& member_index, const InVector<std::int64_t>& member_start,
                                const InRows3<std::int32_t>& occupied) {
  std::vector<Violation> found;
  {
    const nb::gil_scoped_release release;
    found = check_occupied(as_span(member_index), as_span(member_start), as_span(occupied));
  }
  return to_rows(found);
}

const char* fault_text(std::int32_t fault) {
  switch (static_cast<Fault>(fault)) {
    case Fault::kEmptyHull:
      return "hull is empty";
    case Fault::kBadNormal:
      return "normal is zero or not primitive";
    case Fault::kRepeated:
      return "planes or vertices are not sorted and unique";
    case Fault::kVertexOutside:
      return "vertex is outside its hull";
    case Fault::kUnsupportedPlane:
      return "plane is no facet of its hull";
    case Fault::kOpenEdge:
      return "hull is not closed";
    case Fault::kIdleVertex:
      return "vertex is not extreme";
    case Fault::kMemberOrder:
      return "members are not sorted and unique";
    case Fault::kMemberOutside:
      return "member is outside its hull";
    case Fault::kLooseVertex:
      return "vertex is no corner of a member";
    case Fault::kNotCovered:
      return "voxel is not covered";
    case Fault::kNotOccupied:
      return "member is not an occupied voxel";
    case Fault::kLoosePlane:
      return "plane does not touch its hull";
    case Fault::kLongNormal:
      return "normal is too long for an outer polytope";
    case Fault::kOpenBox:
      return "a plane of the bounding box is missing";
  }
  throw std::invalid_argument("no such fault");
}

}  // namespace
}  // namespace alula

void bind_cover_check(nb::module_& m) {
  m.def("check_cover_hulls", &alula::check_cover_hulls, "vertex"_a, "vertex_start"_a, "plane_normal"_a,
        "plane_offset"_a, "plane_start"_a, "member_index"_a, "member_start"_a, "is_outer"_a, "jobs"_a,
        "progress"_a.none(),
        "Check each hull of a cover exactly. Returns rows (fault, hull, row, other), ordered by hull.");
  m.def("check_cover_occupied", &alula::check_cover_occupied, "member_index"_a, "member_start"_a, "occupied"_a,
        "Check that the members of a cover are exactly the occupied voxels. Returns rows as check_cover_hulls.");
  m.def("cover_fault", &alula::fault_text, "fault"_a, "Meaning of a fault number of the checks above.");
}
