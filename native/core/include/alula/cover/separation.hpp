// Proof that a set of voxels contains ellipsoids, by a method that is independent of `voxelize.hpp`.
//
// For each ellipsoid its outward integer bounds, clipped to the crop, are cut into blocks. A block with
// all voxels in the set needs no proof. Any other is discarded when a direction n separates
// it from the ellipsoid e = {c + R diag(k s) u + b : |u| <= 1, |b| <= r}:
//   n.c + sqrt(sum_j (k s_j R_j.n)^2) + r |n| < min over the block of n.x.
// The left side is the exact support of the Minkowski sum; the proof uses no outer ellipsoid and no
// factorisation. Any n proves. The candidates are descent steps towards the
// point of the block that is nearest in the ellipsoid's metric, then, for a single voxel, the normals
// of all its 26 features from triangular factors of the voxel grown by 256 u E (u = 2^-53, E as
// below). These are backward stable, so the best of them separates every voxel that `voxelize` left unmarked.
//
// Rounding of the two sides, standard model, |n| = sum of |n_i|, E = max |c_i| + k sum s_j + r + g:
//   corner g i minus c, times n_i, summed           5.1 u |n| (max |g i| + max |c|)
//   R from rotating the unit vectors                10 u per entry, R_j.n 13 u |n|
//   k s_j R_j.n and its norm                        18 u |n| k sum s_j
//   r |n|, differences                              6 u |n| E
// and max |g i| <= E + g within the bounds: together below 48 u |n| E. The proof requires a gap of 64 u |n| E.
// Nothing underflows: inputs are 32-bit floats and entries of n below 2^-60 of its largest are zero.
//
// A single voxel that is neither in the set nor discarded counts as touched. The set is proven when
// no voxel outside it is touched by `min_overlap` ellipsoids or more. A voxel may be reported although it is not
// touched (when it is closer than about 1e-13 E, or, for r > 0, when the outer ellipsoid of
// `ellipsoid.hpp`, with the metric that guides the search, touches it). A touched voxel is never accepted.
//
// Cost: O(volume / 512 + boundary voxels outside the set) per ellipsoid; memory 64 bytes per brick of
// 8^3 voxels of the set, and counters for touched voxels outside it.
#pragma once

#include "alula/base/control.hpp"
#include "alula/cover/voxel_grid.hpp"
#include "alula/geometry/ellipsoid.hpp"

namespace alula {

struct Unproven {
  static constexpr std::size_t kMaxListed = 100;
  std::size_t total = 0;                // number of voxels missing in the set
  std::vector<std::int32_t> voxel;      // (K, 3): the first of them in lexicographic order
  std::vector<std::int64_t> ellipsoid;  // (K): the first ellipsoid that touches each
};

// `index` (M, 3) is the set, in any order. Throws as `voxelize` does.
Unproven unproven_voxels(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
                         std::uint32_t min_overlap, std::span<const std::int32_t> index, unsigned jobs,
                         Control& control);

}  // namespace alula
