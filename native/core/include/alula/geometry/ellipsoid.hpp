// Ellipsoids of a splat at a level, as affine images of the unit ball.
//
// A Gaussian with centre c, one-sigma semi-axes s and orientation R (rotation of its quaternion) is
// at level k the set {c + R diag(k s) u : |u| <= 1}. Its Minkowski sum with a ball of radius r lies
// in the ellipsoids with the same axes and semi-axes
//   a_j^2 = (1 + 1/p) (k s_j)^2 + (1 + p) r^2,
// whatever p > 0 and its rounding. None is close everywhere: p = sqrt(sum_j (k s_j)^2 / (3 r^2)) fits
// where the semi-axes are long, but a disc of radius d becomes sqrt(1 + d/r) r thick, 4 r or more;
// p = 1/2 is 1.22 r thick there and sqrt(3) as long. What lies in both, and in the box of the sum
// itself, is close to it all around.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>

namespace alula {

using Vec3 = std::array<double, 3>;

// Semi-axes, or a shape matrix Sigma, of the first: a^2 -> scale a^2 + add, with the p that fits long ones.
struct Sum {
  double scale, add;
};
inline Sum outer_sum(double squares, double r) {  // squares = sum_j (k s_j)^2 = tr Sigma
  const double mean = std::sqrt(squares / 3);     // p r; p itself may overflow
  return {1 + r / mean, (r + mean) * r};
}

// Rows of a scene: centres (N, 3), one-sigma semi-axes (N, 3), quaternions w x y z (N, 4) of any
// positive norm; all in the unit of the scene. `loss` is empty, or holds how far each row may be from
// the one it stands for (N, 3): of the centre; of a semi-axis, relatively; of the rotation [rad].
struct Splats {
  std::span<const float> mean, scale, quat_wxyz, loss;
  std::size_t size() const { return mean.size() / 3; }
};

// The level k and the radius r of the ball that is added.
struct Level {
  double sigma = 1.0;
  double inflation = 0.0;
};

// Throws std::invalid_argument when lengths do not agree, a value is not finite, a semi-axis is not
// positive or a quaternion is zero, naming the row; or when the level means nothing.
void check_splats(const Splats& splats, const Level& level, double voxel_size);

// The level of row i that contains every row it may stand for. With e, t, p its losses of scale,
// rotation and centre, and d = k' s the semi-axes at k' = k (1 + e), the level is k' and the radius
// r + p + t (max d - min d): a semi-axis is at most (1 + e) of its own, a centre moves by at most p, and a
// rotation by t turns each direction by at most t, over which the support function sqrt(sum_j d_j^2 n_j^2) of
// unit vectors n, whose gradient along the sphere is at most max d - min d, grows by no more than
// that. Rounded up.
Level level_of(const Splats& splats, std::size_t i, const Level& level);

// {c + A u : |u| <= 1} with A = R diag(axis); `row` are the rows of A, so |row i| is the half-width
// along axis i.
//
// Rounding, u = 2^-53: every entry of R is off by at most 6 u of itself, whatever cancels in it (the
// products of 32-bit floats are exact, the four terms of the diagonal are summed with their
// remainders, |q|^2 takes 3 u and a division), and by no more than u^2 beside that. A semi-axis is off by at
// most 6 u of itself. Those below 2 u of their sum are raised to that, which moves no point farther
// and keeps what u^2 does to a thin ellipsoid below u. Entries of `row` are so off by at most 13 u of
// themselves, and every point of the set by at most 17 u `reach`.
struct Ellipsoid {
  Vec3 centre{};
  std::array<Vec3, 3> rotation{};  // rows of R
  Vec3 axis{};                     // semi-axes
  std::array<Vec3, 3> row{};
  Vec3 half{};         // half-widths along the axes
  double reach = 0.0;  // sum of the semi-axes; no point is farther from the centre

  // Bound of all coordinates of the set and of the voxels of edge g that it touches.
  double extent(double g) const;
  // No fewer closed voxels of edge g touch the set: its volume and its shadows along the axes.
  double least_voxels(double g) const;
};

// Bounds of row i at a level: every point of it lies in `first`, in `second` if there is one, and
// within `half` of the centre along each axis (half-widths of the Minkowski sum itself, off by at most
// 18 u of themselves).
struct Bounds {
  Ellipsoid first;
  std::optional<Ellipsoid> second;
  Vec3 half{};
  Vec3 inner{};         // semi-axes k s_j + r of one within the sum, as |D n| + |r n| >= |(D + r) n|
  double excess = 0.0;  // no point of `first` is farther than that from the sum

  // As of the ellipsoid within the sum.
  double least_voxels(double g) const;
};

Bounds bounds_of(const Splats& splats, std::size_t i, const Level& level);

// Lower triangular L with L u over the unit ball the same set as the rows first, second, third of A
// times u: (x1, x2, x3) = (l11 u1, l21 u1 + l22 u2, l31 u1 + l32 u2 + l33 u3), diagonal positive.
// Made by three plane rotations in u-space, so row i is that of a matrix whose row differs from A's
// by at most 20 u |row i|: backward stable whatever the ratio of the semi-axes. Diagonal entries
// below `floor` are raised to it, which moves no point by more than that.
struct Factor {
  double l11, l21, l22, l31, l32, l33;
};
Factor lower_factor(const Vec3& first, const Vec3& second, const Vec3& third, double floor);

inline constexpr double kEps = std::numeric_limits<double>::epsilon();  // 2 u

}  // namespace alula
