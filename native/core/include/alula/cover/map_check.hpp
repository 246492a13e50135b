// An exact check of an onboard map that shares no code with its writer or with the onboard reader.
//
// Hull h is {x : lower <= x <= upper, normal . x <= offset for each of its planes}. Voxel v, the closed
// cube [v, v + 1], is inside when normal . v + sum max(normal, 0) <= offset for all planes and the box
// holds it: integers below 2^62, as normals are at most 2^15 and offsets at most 2^50 (checked).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

struct MapView {
  std::span<const std::int32_t> lower, upper;  // (n, 3)
  std::span<const std::int32_t> normal;        // (K, 3)
  std::span<const std::int64_t> offset;        // (K)
  std::span<const std::int64_t> plane_start;   // (n + 1)
};

// Rows of `voxel` (M, 3), in any order, that no single hull contains; increasing.
//
// Over each occupied column a hull is an interval of z, computed by rounded integer divisions. Time
// O(M log M + sum over hulls of occupied columns in its box * (planes + log column) + marked voxels).
std::vector<std::int64_t> voxels_outside(const MapView& map, std::span<const std::int32_t> voxel, unsigned jobs,
                                         Control& control);

// Polytopes conv(vertices) that no hull with the same box contains; increasing.
// Time O(sum over polytopes of vertices * planes).
std::vector<std::int64_t> polytopes_outside(const MapView& map, std::span<const std::int32_t> vertex,
                                            std::span<const std::int64_t> vertex_start);

// Both throw std::invalid_argument when arrays do not fit together or values are out of range.

}  // namespace alula
