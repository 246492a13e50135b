// Selection of the Gaussians of a file that enter a scene, and their arrays, in two passes over the rows; and their
// similarity transform.
//
// Rows are independent and sums run over fixed chunks, so results do not depend on the number of threads.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

// Reason why a row is left out: the first that applies, in this order.
enum class Removal : std::uint8_t {
  kNone,
  kNotANumber,    // a NaN anywhere
  kInfiniteMean,  // of x, y or z
  kInfiniteScale,
  kInfiniteRotation,
  kZeroRotation,  // a quaternion of length 0 in double precision
  kMinOpacity,    // opacity below the minimum
  kCrop,          // a centre outside the box
  kCropSphere,    // a centre farther than the radius from the sphere's centre, by squares in double precision
  kMaxScale,      // a semi-axis above the maximum
};
constexpr std::size_t kRemovals = 10;

struct SplatArrays {
  std::span<const float> mean;     // (N, 3)
  std::span<const float> scale;    // (N, 3)
  std::span<const float> quat;     // (N, 4)
  std::span<const float> opacity;  // (N)
};

struct RemovalRules {
  float min_opacity;
  std::optional<std::array<double, 6>> crop;         // lower, upper
  std::optional<std::array<double, 4>> crop_sphere;  // centre, radius
  std::optional<float> max_scale;
};

struct Screened {
  std::array<std::size_t, kRemovals> count{};  // by `Removal`
  std::size_t first_not_finite = 0;            // first row that is not finite; N if there is none
};

// Writes the `Removal` of each row. Throws std::invalid_argument when lengths do not agree.
Screened screen_rows(const SplatArrays& rows, const RemovalRules& rules, std::span<std::uint8_t> removal,
                     unsigned jobs, Control& control);

// Destination of the kept rows, in order; an empty span is not written.
struct KeptArrays {
  std::span<float> mean, scale, quat, opacity;
  std::span<std::uint8_t> color;
};

struct KeptFigures {
  std::array<float, 3> lower, upper;  // of the centres; -0 counts as 0
  float scale_max;
  double scale_median, opacity_median;  // of the longest semi-axes; mean of the middle two if rows are even
  std::size_t floored;                  // rows with a semi-axis below the floor
};

// Copies the rows with removal 0: quaternions divided by their length in double precision, semi-axes
// raised to the floor, the rest unchanged. At least one row must be kept; kept rows must be finite, with no
// negative semi-axis or opacity. Throws std::invalid_argument when lengths do not agree or none is kept.
KeptFigures keep_rows(const SplatArrays& rows, std::span<const std::uint8_t> color,
                      std::span<const std::uint8_t> removal, float scale_floor, const KeptArrays& out, unsigned jobs,
                      Control& control);

// x -> scale R x + translation, with R also as a unit quaternion.
struct RowMotion {
  double scale;
  std::array<std::array<double, 3>, 3> rotation;  // rows
  std::array<double, 3> translation;
  std::array<double, 4> quat_wxyz;
};

struct MappedRows {
  std::span<float> mean, scale, quat;  // (N, 3), (N, 3), (N, 4)
  std::span<double> moved;             // (N), or empty: bound on the distance of each centre from its exact place
};

struct MappedFigures {
  double moved_max;                 // the largest bound
  std::size_t bad_mean, bad_scale;  // the first rows that do not fit single precision; N if there is none
};

// Writes the rows in the new frame, computed in double precision and rounded: semi-axes no smaller than the least
// normal number, quaternions of length 1. Throws std::invalid_argument when lengths do not agree.
MappedFigures map_rows(std::span<const float> mean, std::span<const float> scale, std::span<const float> quat,
                       const RowMotion& motion, const MappedRows& out, unsigned jobs, Control& control);

}  // namespace alula
