// Ellipsoids of a splat at a level, as affine images of the unit ball.
//
// A Gaussian with centre c, one-sigma semi-axes s and orientation R (rotation of its quaternion) is
// at level k the set {c + R diag(k s) u : |u| <= 1}. Its Minkowski sum with a ball of radius r lies
// in the ellipsoids with the same axes and semi-axes
//   a_j^2 = (1 + 1/p) (k s_j)^2 + (1 + p) r^2,
// for every p > 0, so rounding of p is harmless. No single p is tight everywhere: p = sqrt(sum_j (k s_j)^2 /
// (3 r^2)) is tight where the semi-axes are long, but a disc of radius d becomes sqrt(1 + d/r) r thick, 4 r or more;
// with p = 1/2 it is 1.22 r thick and sqrt(3) times as long. The intersection of both ellipsoids and the box of the
// sum itself is tight all around.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>

namespace alula {

using Triple = std::array<double, 3>;

// The first of these ellipsoids: a^2 -> scale a^2 + add for semi-axes or a shape matrix Sigma, with the p for long
// semi-axes.
struct Sum {
  double scale, add;
};
inline Sum outer_sum(double squares, double r) {  // squares = sum_j (k s_j)^2 = tr Sigma
  const double mean = std::sqrt(squares / 3);     // p r; p itself may overflow
  return {1 + r / mean, (r + mean) * r};
}

// Rows of a scene: centres (N, 3), one-sigma semi-axes (N, 3), quaternions w x y z (N, 4) of any
// positive norm; all in the unit of the scene. `loss` is empty, or bounds the error of each row against
// the original one (N, 3): of the centre; of a semi-axis, relative; of the rotation [rad].
struct Splats {
  std::span<const float> mean, scale, quat_wxyz, loss;
  std::size_t size() const { return mean.size() / 3; }
};

// The level k and the radius r of the ball that is added.
struct Level {
  double sigma = 1.0;
  double inflation = 0.0;
};

// Throws std::invalid_argument, naming the row, when lengths do not agree, a value is not finite, a semi-axis is
// not positive or a quaternion is zero; also when the level is invalid.
void check_splats(const Splats& splats, const Level& level, double voxel_size);

// The level at which row i contains every original row within its loss. With e, t, p its losses of scale,
// rotation and centre, and d = k' s the semi-axes at k' = k (1 + e), the level is k' and the radius
// r + p + t (max d - min d): an original semi-axis is at most (1 + e) times the stored one, a centre moves by at
// most p, and a rotation by t turns each direction by at most t. Over that angle the support function
// sqrt(sum_j d_j^2 n_j^2) of unit vectors n grows by at most t (max d - min d), because its gradient along the sphere
// is at most max d - min d. Rounded up.
Level level_of(const Splats& splats, std::size_t i, const Level& level);

// {c + A u : |u| <= 1} with A = R diag(axis); `row` are the rows of A, so |row i| is the half-width
// along axis i.
//
// Rounding, u = 2^-53: the relative error of every entry of R is at most 6 u despite cancellation (the
// products of 32-bit floats are exact, the four terms of the diagonal are summed with their
// remainders, |q|^2 takes 3 u and a division), plus an absolute error of at most u^2. The relative error of a
// semi-axis is at most 6 u. Semi-axes below 2 u of their sum are raised to that, which moves no point farther
// and keeps the effect of u^2 on a thin ellipsoid below u. So the relative error of entries of `row` is at most
// 13 u, and every point of the set is off by at most 17 u `reach`.
struct Ellipsoid {
  Triple centre{};
  std::array<Triple, 3> rotation{};  // rows of R
  Triple axis{};                     // semi-axes
  std::array<Triple, 3> row{};
  Triple half{};       // half-widths along the axes
  double reach = 0.0;  // sum of the semi-axes; no point is farther from the centre

  // Upper bound on all coordinates of the set and of the voxels of edge g that it touches.
  double extent(double g) const;
  // Lower bound on the number of closed voxels of edge g that touch the set, from its volume and its shadows along
  // the axes.
  double least_voxels(double g) const;
};

// Bounds of row i at a level: every point of it lies in `first`, in `second` if there is one, and
// within `half` of the centre along each axis (half-widths of the Minkowski sum itself, with a relative error of at
// most 18 u).
struct Bounds {
  Ellipsoid first;
  std::optional<Ellipsoid> second;
  Triple half{};
  Triple inner{};       // semi-axes k s_j + r of an ellipsoid within the sum, as |D n| + |r n| >= |(D + r) n|
  double excess = 0.0;  // bound on the distance of any point of `first` from the sum

  // The bound for the ellipsoid within the sum.
  double least_voxels(double g) const;
};

Bounds bounds_of(const Splats& splats, std::size_t i, const Level& level);

// Lower triangular L such that L u over the unit ball is the same set as A u, for the rows first, second, third of
// A: (x1, x2, x3) = (l11 u1, l21 u1 + l22 u2, l31 u1 + l32 u2 + l33 u3), diagonal positive.
// Computed by three plane rotations in u-space, so L is exact for a matrix with rows that differ from A's
// by at most 20 u |row i|: backward stable for every ratio of the semi-axes. Diagonal entries
// below `floor` are raised to it, which moves no point by more than `floor`.
struct Factor {
  double l11, l21, l22, l31, l32, l33;
};
Factor lower_factor(const Triple& first, const Triple& second, const Triple& third, double floor);

inline constexpr double kEps = std::numeric_limits<double>::epsilon();  // 2 u

}  // namespace alula
