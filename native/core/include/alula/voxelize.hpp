// Conservative occupancy of ellipsoids on a voxel grid, exact up to a derived rounding bound.
//
// An ellipsoid meets a column of voxels in a convex set, so the voxels of the column that it touches
// are one run in z. With the triangular factor of the ellipsoid, x = l11 u1, y = l21 u1 + l22 u2,
// z = l31 u1 + l32 u2 + l33 u3 over the unit ball, the upper surface over the (x, y) plane is concave.
// Its maximum over the column's rectangle is the apex if that is inside, else it lies on one of the
// at most two edges that face the apex; on x = const u1 is fixed and what is left is
//   max l32 u2 + l33 sqrt(w^2 - u2^2),  w^2 = 1 - u1^2,  u2 in an interval,
// a clamped closed form; edges y = const use the factor with x and y exchanged, the lower surface is
// the mirror image. The factor comes from plane rotations of R diag(k s), never from the covariance,
// so flat and thin ellipsoids lose nothing.
//
// Rounding, u = 2^-53, E = Ellipsoid::extent (a bound of all coordinates, inflation included):
//   rows of A against the true ellipsoid      17 u E      grid lines minus centre     3 u E
//   rotations                                 25 u E      u1, u2 as moved edges       6 u E
//   w is rounded up (ball radius 1 + 8 u)      8 u E      surface height and cz + z   8 u E
// together less than 67 u E as a move of the surface. Edges and heights are moved outward by
// q = 512 u E, interval ends and the choice of edges by up to 4 q, which covers the inconsistency of
// separately rounded edges. Hence
//   touched(ellipsoid + cube of half-width 440 u E) <= marked <= touched(ellipsoid + cube of 5 q),
// where + is the Minkowski sum; q is 1.2e-12 m at 20 m. The room between 67 u E and 440 u E lets
// `separation.hpp` prove in double precision every voxel that is not marked.
//
// Cost: O(columns) per ellipsoid, plus O(voxels / 8) to count; memory 512 bytes per occupied brick
// of 4 x 4 x 8 voxels, bounded (voxel_grid.hpp).
#pragma once

#include "alula/control.hpp"
#include "alula/ellipsoid.hpp"
#include "alula/voxel_grid.hpp"

namespace alula {

struct Voxelized {
  VoxelCounts voxels;       // how many ellipsoids touch each voxel
  std::size_t outside = 0;  // ellipsoids that touch no voxel of the crop
  std::size_t cut = 0;      // ellipsoids that may touch voxels in and out of the crop
};

// All voxels that an ellipsoid touches and that touch the crop box, in lexicographic order; the same
// for every number of jobs. The ellipsoids are clipped to the crop before anything is stored.
// Throws std::invalid_argument for malformed input, std::overflow_error when the voxels exceed the
// memory budget or 32-bit indices.
Voxelized voxelize(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
                   unsigned jobs, Control& control);

}  // namespace alula
