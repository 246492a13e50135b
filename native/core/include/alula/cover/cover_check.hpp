// An exact check of a cover that shares no code with the hull construction.
//
// For every hull Q = conv(vertices), P = {x : normal . x <= offset}:
//   1. normals are non-zero and primitive, planes and vertices differ from each other;
//   2. every vertex satisfies every plane, so Q is inside P;
//   3. every plane touches at least three non-collinear vertices and leaves one strictly below,
//      so Q has volume and every plane carries a facet of it;
//   4. every edge of each such facet belongs to exactly two of them. The facets of a 3-polytope are
//      connected through edges, so a set of them that is closed this way is all of them: P = Q,
//      bounded, and no plane is missing;
//   5. every vertex is a corner of a facet, so it is extreme;
//   6. every member voxel v is inside: normal . v + sum max(normal, 0) <= offset for all planes;
//   7. every vertex is a corner of a member voxel, so the hull is the hull of its members.
// For the whole cover: the members are exactly the occupied voxels.
//
// Where polytopes are outer ones (P contains Q), 3 to 5 are replaced:
//   3. every plane touches a vertex, so its offset is exactly the support of the vertices;
//   4. the six planes of the bounding box are there, so P is bounded;
//   5. |n_i| <= 2^15 - 1, so that readers find the corners of P in 128 bits.
//
// Any integers are allowed in the arrays: 64-bit normals and offsets, 32-bit positions.
// Products are formed in 128 bits, where |n . x + ...| < 2^98; nothing can overflow.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

enum class Fault : std::int32_t {
  kEmptyHull,         // hull without planes, vertices or members
  kBadNormal,         // row: plane; zero or not primitive
  kRepeated,          // row: plane or vertex; not strictly increasing
  kVertexOutside,     // row: vertex; other: plane
  kUnsupportedPlane,  // row: plane; not a facet of the vertices
  kOpenEdge,          // row: plane; an edge of its facet is not shared with one other plane
  kIdleVertex,        // row: vertex; not extreme
  kMemberOrder,       // row: member; not strictly increasing
  kMemberOutside,     // row: member; other: plane
  kLooseVertex,       // row: vertex; not a corner of a member
  kNotCovered,        // row: occupied voxel that is no hull's member
  kNotOccupied,       // row: member that is not an occupied voxel
  kLoosePlane,        // row: plane of an outer polytope that touches no vertex; other: a vertex
  kLongNormal,        // row: plane of an outer polytope; a normal that is too long
  kOpenBox,           // an outer polytope without one of the planes of its bounding box
};

struct Violation {
  Fault fault;
  std::int64_t hull;   // -1: of the whole cover
  std::int64_t row;    // of the array that the fault names
  std::int64_t other;  // -1: none
};

// Views of the arrays of an alula/cover; `*_start` partition the rows.
struct CoverView {
  std::span<const std::int32_t> vertex;  // (V, 3)
  std::span<const std::int64_t> vertex_start;
  std::span<const std::int64_t> plane_normal;  // (F, 3)
  std::span<const std::int64_t> plane_offset, plane_start;
  std::span<const std::int32_t> member_index;  // (W, 3)
  std::span<const std::int64_t> member_start;
  bool is_outer = false;
};

// Returns the faults ordered by hull: for a plane only the first vertex outside, for a member only the first plane
// that cuts it. Throws std::invalid_argument when the starts are no partition, and std::overflow_error beyond 2^32
// pairs of a plane and a vertex or extreme member. Members are sorted; of the columns of equal x, those on the convex
// hull are extreme, and as polytopes are convex, all members are inside when these are. Time O(sum over hulls of
// (vertices + extreme members) * planes + members).
std::vector<Violation> check_hulls(const CoverView& cover, unsigned jobs, Control& control);

// Returns the faults kNotCovered and kNotOccupied of members (W, 3) against occupied voxels (M, 3), both in any
// order. Throws std::invalid_argument when the starts are no partition.
std::vector<Violation> check_occupied(std::span<const std::int32_t> member_index,
                                      std::span<const std::int64_t> member_start,
                                      std::span<const std::int32_t> occupied);

}  // namespace alula
