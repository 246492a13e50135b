// Pictures without a graphics card: Gaussians of a splat, triangles and lines, composited from front to back.
//
// A point has the coordinates x right, y down and z forward in the camera's frame, x_camera = rotation (x_world -
// centre). Its pixel is (c_x + f x / z, c_y + f y / z), or in parallel projection (c_x + f x, c_y + f y), with (c_x,
// c_y) the middle of the picture; the centre of the upper left pixel is (0.5, 0.5). Depth is z in both projections.
//
// Gaussians. The projection is replaced by its tangent at the Gaussian's centre, with Jacobian
//   J = [f/z 0 -f x/z^2; 0 f/z -f y/z^2]   (perspective)      J = [f 0 0; 0 f 0]   (parallel),
// so a covariance Sigma becomes Sigma' = J R Sigma R' J' + 0.3 I [px^2]. The second term is the low-pass filter of
// the pixels. As x/z and y/z of centres outside of the picture make J useless, they are limited to 1.3 times the
// border's. At the pixel's centre p the Gaussian with opacity o and projected centre m has
//   alpha = min(0.99, o exp(-(p - m)' inv(Sigma') (p - m) / 2)),   none below 1/255.
// All Gaussians are ordered by the depth of their centres, equal ones by their row, and composited from front to
// back,
//   C += T alpha c,   T *= 1 - alpha,   T = 1 at first,
// until T is below 1/1000 in all pixels of a tile of 16 x 16 pixels.
// Source: Zwicker, Pfister, van Baar and Gross 2001, EWA volume splatting (the tangent J and the low-pass filter);
// Kerbl, Kopanas, Leimkuehler and Drettakis 2023, 3D Gaussian splatting, eqs. 3 (compositing) and 5 (Sigma'),
// appendix C (0.99 and 1/255), and its program (0.3 and 1.3).
//
// Triangles are flat, and seen from both sides. Each pixel has four samples, which a triangle covers or not, at the
// depth of its plane at the pixel's centre. Lines have round ends, a width in pixels, and the coverage
//   clip(width / 2 + 1/2 - distance of the pixel's centre, 0, 1).
// Overlapping segments of one line count once. Both are composited with the Gaussians at their depth, so what lies
// behind matter is hidden. A line with `through` > 0 is also blended over what hides it, with this opacity.
//
// Depth of a pixel: of the Gaussian, triangle or line at which T falls to 1/2; infinite where it does not.
//
// Gaussians and shapes in front of the near plane are left out or cut there. A Gaussian is skipped where a value is
// not finite, its opacity is below 1/255, or Sigma' is not positive definite; a triangle or a line where a value is
// not finite.
// Arithmetic: single precision in pixels, without library functions, so the same bits on every machine and for every
// number of threads. Complexity: O(n log n) for the order and O(pixels covered) for the rest.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula::rendering {

constexpr double kLowPass = 0.3;              // [px^2]
constexpr float kLeastAlpha = 1.0f / 255.0f;  // a smaller one cannot be seen
constexpr float kMostAlpha = 0.99f;
constexpr float kLeastLight = 1e-3f;          // transmittance at which a tile is done
constexpr std::size_t kMostPixels = 1 << 14;  // along an axis

struct Camera {
  geometry::Mat3 rotation{};  // rows: right, down, forward in the world's frame
  geometry::Vec3 centre{};    // [m]
  double focal = 1;           // [px], in parallel projection [px/m]
  bool is_parallel = false;
  double near = 0.1;  // depth of the near plane [m]
  std::size_t columns = 0, rows = 0;

  geometry::Vec3 seen(geometry::Vec3 world) const { return rotation * (world - centre); }
  // Pixel of a point in the camera's frame.
  std::array<double, 2> pixel(geometry::Vec3 p) const {
    const double scale = is_parallel ? focal : focal / p.z;
    return {0.5 * static_cast<double>(columns) + scale * p.x, 0.5 * static_cast<double>(rows) + scale * p.y};
  }
};

// Gaussians: centres (N, 3), covariances (N, 3, 3), colours (N, 3) and opacities (N); world frame, metres.
struct Gaussians {
  std::span<const float> mean, covariance;
  std::span<const std::uint8_t> color;
  std::span<const float> opacity;
};

// Triangles: corners (T, 3, 3) [m], colours (T, 3), opacities (T).
struct Triangles {
  std::span<const double> corner;
  std::span<const std::uint8_t> color;
  std::span<const float> opacity;
};

// Segments of lines: ends (L, 2, 3) [m], colours (L, 3), and per segment (L, 3) width [px], opacity and `through`.
// Segments with the same number in `line` (L) are parts of one line.
struct Segments {
  std::span<const double> end;
  std::span<const std::uint8_t> color;
  std::span<const float> style;
  std::span<const std::int32_t> line;
};

// Rows from the top. `color` (rows, columns, 3), 0 to 255, without what is behind; `light` (rows, columns): fraction
// of the background that is seen; `depth` (rows, columns) [m].
struct Picture {
  std::vector<float> color, light, depth;
};

// Throws std::invalid_argument when the lengths of arrays do not agree, the camera is not finite, its rotation is not
// one, or its picture is empty or has more than kMostPixels along an axis.
Picture draw(const Camera& camera, const Gaussians& gaussians, const Triangles& triangles, const Segments& segments,
             unsigned jobs, Control& control);

}  // namespace alula::rendering
