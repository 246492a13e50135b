// Rows of a PLY file of Gaussians, binary or text, to activated values in single precision.
//
//   mean = x, y, z        scale_i = exp(scale_i)        opacity = 1 / (1 + exp(-opacity))
//   quat = rot_0..3, as they are                          colour = 0.5 + SH_C0 f_dc_i, or the bytes there
// evaluated in double precision (exponential.hpp) and rounded once. One pass over the bytes. Threads take
// blocks of rows and rows are independent, so results do not depend on the number of threads.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "alula/base/control.hpp"

namespace alula {

enum class NumberType : std::uint8_t { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

// The columns that are read, in this order; a missing one has no position.
constexpr std::size_t kPlyColumns = 14;
enum PlyColumn : std::size_t { kX = 0, kScale = 3, kRotation = 6, kOpacity = 10, kColor = 11 };

struct PlyPlace {
  std::size_t at;   // offset in a row [bytes]; in text, the number of the word
  NumberType type;  // in binary rows
};
using PlyPlaces = std::array<std::optional<PlyPlace>, kPlyColumns>;

enum class PlyColor { kGrey, kHarmonic, kBytes };

// Destination of the values of `count` rows. Without `scale_2` the third scale is 0; without colour it is 128.
struct PlyOutput {
  float* mean;          // (count, 3)
  float* scale;         // (count, 3)
  float* quat;          // (count, 4)
  float* opacity;       // (count)
  std::uint8_t* color;  // (count, 3)
};

// Decodes rows of fixed size. `rows` must hold count * row_size bytes, and each column must lie within a row
// (std::invalid_argument otherwise).
void decode_ply_rows(std::span<const std::uint8_t> rows, std::size_t row_size, bool big_endian,
                     const PlyPlaces& places, PlyColor color, std::size_t count, const PlyOutput& out, unsigned jobs,
                     Control& control);

// Lines that are not blank: the starts of the rows, and the size of the text after them.
struct PlyLines {
  std::vector<std::uint64_t> start;  // of the first `most` lines that are not blank
  std::size_t trailing = 0;          // bytes of further such lines, each with one for its end
};
PlyLines find_lines(std::span<const std::uint8_t> text, std::size_t most);

// The first row of text that does not consist of `width` numbers.
struct PlyTextError {
  std::size_t row;
  std::size_t words;       // number of words in the row; `width` when one of them is not a number,
  std::size_t begin, end;  // which then is text [begin, end)
};

// Decodes rows of text: each has `width` words, all of them decimal numbers, inf, infinity or nan, in any case
// and with any sign, rounded to the nearest double as in Python. Words that belong to no column are
// checked but not converted. Bytes of colour are clamped to 0..255 and truncated; NaN is 0.
std::optional<PlyTextError> decode_ply_text(std::span<const std::uint8_t> text, std::span<const std::uint64_t> start,
                                            std::size_t width, const PlyPlaces& places, PlyColor color,
                                            const PlyOutput& out, unsigned jobs, Control& control);

}  // namespace alula
