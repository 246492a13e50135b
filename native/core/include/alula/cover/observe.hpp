// Space that cameras saw: a conservative depth image of ellipsoids, and the voxels in front of it.
//
// Depth is the coordinate z along the optical axis. A pixel holds a lower bound on the depth of every point of an
// ellipsoid in the pixel's whole pyramid, not only on its centre ray. So a point of less depth in that pyramid is in
// front of every surface: the segment to the camera has less depth yet.
//
// The bound is exact but for rounding. With u = x / z, v = y / z, w = 1 / z an ellipsoid in front of the camera is
// again an ellipsoid in (u, v, w), and a pixel's pyramid is a column over a rectangle; the largest w over the column
// has a closed form (as in voxelize.hpp). With centre c, rows A_x, A_y, A_z in the camera's frame, x and y sheared so
// that c_x = c_y = 0, and D = c_z^2 - |A_z|^2, the dual quadric gives
//   centre       (-A_x.A_z, -A_y.A_z, c_z) / D
//   covariance   uu: (A_x.A_z / D)^2 + |A_x|^2 / D    uv: A_x.A_z A_y.A_z / D^2 + A_x.A_y / D
//                uw: -A_x.A_z c_z / D^2               ww: |A_z|^2 / D^2
// without cancellation. An ellipsoid that reaches behind the camera is first cut into slabs z1 <= z <= z2: in the
// coordinates of the unit ball, m along the normal of the slab t1 <= m <= t2, every ellipsoid
//   |y|^2 - 1 + q (m - t1) (m - t2) <= 0, q >= 0
// contains the part in the slab, and with a large q none of it is behind the camera.
//
// Rounding: covariances grow by 1e-10 of their diagonal and of the terms that cancel in the shear, pixels by 1e-6 of
// their width and 1 / z by 1e-9. These exceed the rounding errors, which are below 1e-14 of the same figures.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/voxel_grid.hpp"
#include "alula/geometry/ellipsoid.hpp"

namespace alula {

// A pinhole camera: x_camera = rotation (x - centre), x right, y down, z forward. Its image is the rectangle left <=
// x/z <= right, top <= y/z <= bottom, divided into columns x rows pixels.
struct Pinhole {
  std::array<Triple, 3> rotation{};
  Triple centre{};
  double left = 0, top = 0, right = 0, bottom = 0;
  std::size_t columns = 0, rows = 0;
};

struct SightLimits {
  double near = 0.1;   // smallest depth of a voxel that is seen
  double range = 5.0;  // depth up to which a pixel sees that no surface touches
};

struct Depth {
  std::vector<float> nearness;  // (rows, columns): upper bound on 1 / z of every surface in the pixel, or 1 / range
  bool blind = false;           // an ellipsoid touches the camera, which then sees nothing
};

// Ellipsoids at a level, prepared for many cameras. Memory: 104 bytes each, twice that where the sum with a ball
// needs both of its bounds (ellipsoid.hpp).
class Occluders {
 public:
  // Throws std::invalid_argument as check_splats does. `worth`: excess of the first bound [unit of the splats] that
  // justifies the second.
  Occluders(const Splats& splats, const Level& level, double worth, unsigned jobs, Control& control);
  Depth depth(const Pinhole& camera, const SightLimits& limits) const;

 private:
  struct Solid {
    Triple centre;
    std::array<Triple, 3> row;
    float reach;
    bool is_pair;  // with the next one: the set lies in both
  };
  std::vector<Solid> solid_;
};

// A box of voxels lower ... lower + size - 1, dense in C order; voxel i is the closed cube [i g, (i + 1) g].
struct DenseBox {
  double g = 0;
  Index3 lower{};
  std::array<std::size_t, 3> size{};
};

struct Views {
  std::vector<std::uint16_t> count;  // per voxel of the box: cameras that see it
  std::vector<std::uint64_t> seen;   // per camera: voxels that it sees
  std::vector<std::uint8_t> blind;   // per camera: an ellipsoid touches it
};

// Counts for each voxel the cameras that see it: its whole cube, grown by `margin` as far as the image and the near
// limit are concerned, is in the image and beyond the near limit, every pixel that it touches is free up to its
// farthest corner, and so is the chain of voxels from it to the camera of blocked voxels, which closes gaps between
// ellipsoids that are narrower than a voxel. Blocked voxels are never seen. At most 65,535 cameras.
// The result does not depend on the number of jobs. Per thread: one depth image, and 1 byte per voxel of the box.
Views observe(const Occluders& occluders, std::span<const Pinhole> cameras, const SightLimits& limits,
              const DenseBox& box, std::span<const std::uint8_t> blocked, double margin, unsigned jobs,
              Control& control);

}  // namespace alula
