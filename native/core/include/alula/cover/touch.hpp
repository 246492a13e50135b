// Conservative occupancy of triangles, points and blocks on a voxel grid.
//
// A triangle, plus a ball of radius r, touches the closed cube of voxel i when their distance is at most r. Blocks of
// voxels around the triangle are halved until they are one voxel, and discarded when a direction n separates them:
//   min over the block of n.x - max over the triangle of n.x > r |n|.
// Candidates are the 13 directions of the separating-axis test of a triangle and a box (three axes, the normal, nine
// cross products of edges), which are complete for r = 0, and for a single voxel and r > 0 the direction between the
// closest points. For r > 0 a block within r of the triangle's point that is nearest to its centre needs no halving.
//
// Rounding, u = 2^-53, E = max |coordinate| + r + 2 g, |n| = sum of |n_i|: a side takes three products of numbers
// with a relative error of u (the corners i g, and coordinates that were multiplied by a scale once) and two
// sums, 4.1 u |n| E; r |n| 4 u |n| E; the difference 2 u |n| E: below 16 u |n| E. A block is discarded only with a
// gap of 512 u |n| E, so that `touch_check.hpp`, which demands 64 u |n| E, proves in double precision what is left
// unmarked. Hence
//   touched(triangle + ball of r) <= marked <= touched(triangle + ball of r + q),  q of about 1e-13 E,
// and for r > 0 at least 1e-6 E, where the direction between closest points has a relative error of about 1e-10.
//
// Points: the squared distance of each column of voxels to the axis through the point, with r + q.
// Cost: O(voxels) per triangle. Memory as `voxelize.hpp`. Results do not depend on the number of threads.
#pragma once

#include <optional>
#include <span>

#include "alula/base/control.hpp"
#include "alula/cover/voxel_grid.hpp"

namespace alula {

// Voxels that at least `min_count` triangles (corners (T, 3, 3)), each plus a ball, touch, and that touch the crop.
// Throws std::invalid_argument for malformed input, std::overflow_error beyond the budgets of `OverlapGrid`.
VoxelCounts touched_by_triangles(std::span<const double> corners, double radius, double voxel_size,
                                 const std::optional<Box6>& crop, std::uint32_t min_count, unsigned jobs,
                                 Control& control);

// The same for points (N, 3).
VoxelCounts touched_by_points(std::span<const double> points, double radius, double voxel_size,
                              const std::optional<Box6>& crop, std::uint32_t min_count, unsigned jobs,
                              Control& control);

// Voxels of blocks lower ... upper, (N, 3) each and inclusive, that touch the crop, and how many blocks hold each.
VoxelCounts voxels_of_blocks(std::span<const std::int32_t> lower, std::span<const std::int32_t> upper,
                             double voxel_size, const std::optional<Box6>& crop, unsigned jobs, Control& control);

// The voxels `touched` (sorted; those of a closed oriented surface without a crop) and all that the surface encloses,
// with a count of 0, as far as they touch the crop. A voxel that the surface does not touch is enclosed when its
// winding number is not 0. It is the same for all voxels between two touched ones of a column, and for those that
// share a face, so it is computed once for each group of them, as the sum of the solid angles of all triangles seen
// from the centre of a voxel of the group, which is at least half a voxel away from the surface.
// Throws std::invalid_argument if a sum is no whole number, as for a surface that is not closed.
VoxelCounts with_inside(const VoxelCounts& touched, std::span<const double> corners, double voxel_size,
                        const std::optional<Box6>& crop, unsigned jobs, Control& control);

}  // namespace alula
