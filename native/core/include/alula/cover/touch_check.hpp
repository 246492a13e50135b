// Proof that a set of voxels contains triangles, by a method that is independent of `touch.hpp`.
//
// Each triangle is halved at its longest edge until its box spans a few voxels. Each voxel near a piece that is not
// in the set must be separated from the piece by a plane whose normal n has
//   max over the piece of n.x + r |n| < min over the voxel of n.x.
// Candidates are the normals of all pairs of features of a triangle and a box: the three axes, the piece's normal,
// the nine cross products of edges, and for r > 0 the directions from each vertex to the voxel and from each edge to
// each corner of the voxel. A point is a triangle with three equal corners.
//
// Rounding, u = 2^-53, E = max |coordinate| + r + 2 g: `touch.hpp` derives 16 u |n| E for the test; the corners of
// pieces are off by less than 48 u E after 48 halvings. A proof demands a gap of 64 u |n| E. A touched voxel is never
// accepted; one that is not touched may be reported when it is closer than about 1e-13 E.
//
// Inside of a closed surface: a voxel that is not in the set touches no triangle, by the first proof, so its winding
// number is that of each of its points, and that of all voxels of a run along x between voxels of the set. It is
// counted along a ray in the direction of x from a point of the run, with signs of determinants whose rounding errors
// are bounded; a ray that passes too close to an edge is replaced by another one.
#pragma once

#include "alula/cover/separation.hpp"

namespace alula {

// Voxels outside of the set `index` (M, 3) that touch the crop and that are not proven to be touched by fewer than
// `min_count` triangles (corners (T, 3, 3)), each plus a ball. `ellipsoid` of the result is the first triangle.
// Throws std::invalid_argument for malformed input, std::overflow_error when far more are missing than are listed.
Unproven unproven_triangles(std::span<const double> corners, double radius, double voxel_size,
                            const std::optional<Box6>& crop, std::uint32_t min_count,
                            std::span<const std::int32_t> index, unsigned jobs, Control& control);

// Voxels outside of the set that touch the crop and are not proven to lie outside of a closed oriented surface,
// given that the surface touches none of them. `ellipsoid` of the result is -1.
Unproven unproven_outside(std::span<const double> corners, double voxel_size, const std::optional<Box6>& crop,
                          std::span<const std::int32_t> index, unsigned jobs, Control& control);

}  // namespace alula
