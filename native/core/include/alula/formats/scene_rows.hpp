// Which Gaussians of a file enter a scene, and their arrays; two passes over the rows.
//
// Each row is on its own and sums run over fixed chunks, so results do not depend on the threads.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

// Why a row is left out: the first of these that it meets, in this order.
enum class Removal : std::uint8_t {
  kNone,
  kNotANumber,    // a NaN anywhere
  kInfiniteMean,  // of x, y or z
  kInfiniteScale,
  kInfiniteRotation,
  kZeroRotation,  // a quaternion of length 0 in double precision
  kMinOpacity,    // opacity below it
  kCrop,          // a centre outside the box
  kCropSphere,    // or farther from the centre than the radius, by squares in double precision
  kMaxScale,      // a semi-axis above it
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
  std::size_t first_not_finite = 0;            // row, where one is; else N
};

// Writes the `Removal` of each row. std::invalid_argument when lengths do not agree.
Screened screen_rows(const SplatArrays& rows, const RemovalRules& rules, std::span<std::uint8_t> removal,
                     unsigned jobs, Control& control);

// Where the kept rows go, in order; an empty span is not written.
struct KeptArrays {
  std::span<float> mean, scale, quat, opacity;
  std::span<std::uint8_t> color;
};

struct KeptFigures {
  std::array<float, 3> lower, upper;  // of the centres; -0 counts as 0
  float scale_max;
  double scale_median, opacity_median;  // of the longest semi-axes; the middle of two where rows are even
  std::size_t floored;                  // rows with a semi-axis below the floor
};

// Copies the rows whose removal is 0: quaternions divided by their length in double precision, semi-axes
// no smaller than the floor, the rest unchanged. At least one row must be kept, all of them finite and no
// semi-axis or opacity negative. std::invalid_argument when lengths do not agree or none is kept.
KeptFigures keep_rows(const SplatArrays& rows, std::span<const std::uint8_t> color,
                      std::span<const std::uint8_t> removal, float scale_floor, const KeptArrays& out, unsigned jobs,
                      Control& control);

}  // namespace alula
