// Conservative occupancy of ellipsoids on a voxel grid, exact up to a derived rounding bound.
//
// An ellipsoid meets a column of voxels in a convex set, so the voxels of the column that it touches
// are one run in z. With the triangular factor of the ellipsoid, x = l11 u1, y = l21 u1 + l22 u2,
// z = l31 u1 + l32 u2 + l33 u3 over the unit ball, the upper surface over the (x, y) plane is concave.
// Its maximum over the column's rectangle is the apex if that is inside; otherwise it lies on one of the
// at most two edges that face the apex. On x = const u1 is fixed, and the remaining problem is
//   max l32 u2 + l33 sqrt(w^2 - u2^2),  w^2 = 1 - u1^2,  u2 in an interval,
// which has a clamped closed form. Edges y = const use the factor with x and y exchanged; the lower surface is
// the mirror image.
//
// The factor is not computed from the covariance. With v_x, v_y, v_z the rows of R diag(a) and
// c_x = v_y x v_z = (R_x1 a2 a3, R_x2 a1 a3, R_x3 a1 a2), c_y, c_z likewise,
//   l11 = |v_x|       l21 = v_x.v_y / |v_x|     l31 = v_x.v_z / |v_x|    apex x = v_x.v_z / |v_z|
//   l22 = |c_z|/|v_x|  l33 = a1 a2 a3 / |c_z|    l32 = -c_y.c_z / (|v_x| |c_z|)
// and |(l32, l33)| = |c_y| / |v_x|. Lengths are sums of squares of entries with a small relative error
// (ellipsoid.hpp), so all l_ii have one; the error of dot products is small relative to the two lengths.
//
// Rounding, u = 2^-53, E = Ellipsoid::extent (a bound of all coordinates, inflation included):
//   relative: |v| 16 u, |c| 23 u, l22 41 u, l33 44 u; absolute: v.v 29 u |v||v|, c.c 43 u |c||c|
//   x: edges 18 u |v_x| + 3 u E; ball radius 1 + 8 u, upward           26 u |v_x| +  3 u E
//   y: shift l21 u1 47 u, width l22 u2 41 u, u1 and u2 each 8 u        76 u |v_y| +  3 u E
//   z: l31 u1 47 u; l32 u2 85 u and l33 u3 44 u of |c_y|/|v_x|        115 u |v_z| +  6 u E
// together less than 125 u E as a move of the surface along each axis. Edges and heights are moved
// outward by q = 512 u E, interval ends and the choice of edges by up to 4 q, which covers the
// inconsistency of separately rounded edges. Hence
//   touched(ellipsoid + cube of half-width 380 u E) <= marked <= touched(ellipsoid + cube of 5 q),
// where + is the Minkowski sum; q is 1.2e-12 m at 20 m. For a grown ellipsoid, a voxel is marked if it touches both
// ellipsoids and the box of `bounds_of`; the second ellipsoid is used only where the first exceeds the sum by a
// quarter of a voxel or more. The bounds above hold for each of these sets. The margin between 125 u E and 380 u E
// lets `separation.hpp` prove in double precision every voxel that is not marked. Whether a voxel is
// marked does not depend on the crop or the tile.
//
// Cost: O(columns) per ellipsoid, plus O(voxels / 8) to count; most ellipsoids of a scene have a box
// of one line of voxels, which needs no factor. Memory: 512 bytes per occupied brick of 4 x 4 x 8 voxels,
// at most 2 GiB, and 16 bytes per voxel of the result, at most 2 GiB (voxel_grid.hpp); 1 byte per
// ellipsoid.
#pragma once

#include "alula/base/control.hpp"
#include "alula/cover/voxel_grid.hpp"
#include "alula/geometry/ellipsoid.hpp"

namespace alula {

// The part of an ellipsoid that is marked within the crop: nothing, all, or a part.
enum class Reach : std::uint8_t { kOutside = 0, kWithin = 1, kCut = 2 };

struct Voxelized {
  VoxelCounts voxels;               // number of ellipsoids that touch each voxel, at least min_overlap
  std::vector<std::uint8_t> reach;  // (N): Reach of each ellipsoid
};

// All voxels that at least `min_overlap` ellipsoids touch, and that touch the crop box, in
// lexicographic order; the same for every number of jobs. With a tile: the subset that lies in it.
// The ellipsoids are clipped before anything is stored. Throws std::invalid_argument for malformed
// input, and std::overflow_error when the voxels exceed the memory budget or 32-bit indices.
Voxelized voxelize(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
                   const std::optional<Block>& tile, std::uint32_t min_overlap, unsigned jobs, Control& control);

// The budgets of `voxelize`, which the proof in `separation.hpp` shares; a refusal proves nothing. Both throw
// std::overflow_error before the work. The first: an ellipsoid within the range touches more than
// OverlapGrid::kMaxVoxels.
void check_each_budget(const Splats& splats, const Level& level, double g, const CropRange& range);
// The second: the touched voxels within the range need more than OverlapGrid::kMaxBricks. Found by a coarse pass with
// voxels of four times the edge: a brick holds two coarse voxels, and every touched one holds a touched voxel. The
// pass runs only if the boxes are so large that the limit may be exceeded.
void check_budgets(const Splats& splats, const Level& level, double g, const CropRange& range, unsigned jobs,
                   Control& control);

// What ellipsoids of a low opacity mark in a box of coarse cells. The rank of an opacity is the number of limits that
// are not above it, 0 ... L.
struct OpacityTally {
  static constexpr std::size_t kMaxCells = std::size_t{1} << 28;

  std::vector<std::int64_t> gaussians;  // (L + 1): rows of each rank
  std::vector<std::int64_t> cells;      // (L + 1): cells by the highest rank of the rows that touch them
};

// The tally of the ellipsoids at level 1, for ascending limits, in the cells origin + edge ([i, i + 1] x ...) with
// indices 0 ... size - 1. Rows that are not finite or have no rotation do not count; semi-axes are at least 1e-6 and
// at most 1e4 cells. For judging limits only: cells are found in single precision. The same for every number of jobs.
// Throws std::invalid_argument for malformed input.
OpacityTally tally_opacity(const Splats& splats, std::span<const float> opacity, std::span<const float> limit,
                           const Triple& origin, double edge, const Index3& size, unsigned jobs, Control& control);

// Ellipsoids that may touch each tile {edge t ... edge t + edge - 1}^3 of voxels, by their boxes
// within the crop. Tiles that no ellipsoid may touch are left out.
struct Tiles {
  static constexpr std::size_t kMaxTiles = std::size_t{1} << 20;
  static constexpr std::size_t kMaxEntries = std::size_t{1} << 27;

  std::vector<std::int32_t> tile;   // (T, 3) t, in lexicographic order
  std::vector<std::int64_t> start;  // (T + 1): rows of tile i are row[start[i]] ... row[start[i + 1] - 1]
  std::vector<std::uint32_t> row;   // ellipsoids, ascending within a tile
};

// Throws as `voxelize` does, and std::overflow_error when there would be more than kMaxTiles tiles or
// kMaxEntries rows.
Tiles tiles_of(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
               std::int32_t edge, Control& control);

}  // namespace alula
