#include "alula/formats/ply_rows.hpp"

#include <algorithm>
#include <bit>
#include <cstring>
#include <memory>
#include <mutex>
#include <type_traits>

#include "alula/base/parallel.hpp"
#include "alula/base/wide.hpp"
#include "alula/formats/decimal.hpp"
#include "alula/formats/exponential.hpp"

namespace alula {
namespace {

constexpr std::size_t kBlock = 128;            // rows: 32 KiB of the widest common rows, which fit into L1
constexpr std::size_t kChunk = 8192;           // rows of one call of a thread
constexpr double kShC0 = 0.28209479177387814;  // 1 / (2 sqrt(pi))

using Block = std::array<std::array<double, kBlock>, kPlyColumns>;

template <class T>
T swapped(T value) {
  std::array<std::uint8_t, sizeof(T)> bytes;
  std::memcpy(bytes.data(), &value, sizeof(T));
  std::reverse(bytes.begin(), bytes.end());
  std::memcpy(&value, bytes.data(), sizeof(T));
  return value;
}

template <class T, bool Swap>
void gather_as(const std::uint8_t* at, std::size_t row_size, std::size_t count, double* out) {
  for (std::size_t i = 0; i < count; ++i, at += row_size) {
    T value;
    std::memcpy(&value, at, sizeof(T));
    out[i] = static_cast<double>(Swap ? swapped(value) : value);
  }
}

template <bool Swap>
void gather(NumberType type, const std::uint8_t* at, std::size_t row_size, std::size_t count, double* out) {
  switch (type) {
    case NumberType::kInt8:
      return gather_as<std::int8_t, Swap>(at, row_size, count, out);
    case NumberType::kUint8:
      return gather_as<std::uint8_t, Swap>(at, row_size, count, out);
    case NumberType::kInt16:
      return gather_as<std::int16_t, Swap>(at, row_size, count, out);
    case NumberType::kUint16:
      return gather_as<std::uint16_t, Swap>(at, row_size, count, out);
    case NumberType::kInt32:
      return gather_as<std::int32_t, Swap>(at, row_size, count, out);
    case NumberType::kUint32:
      return gather_as<std::uint32_t, Swap>(at, row_size, count, out);
    case NumberType::kFloat32:
      return gather_as<float, Swap>(at, row_size, count, out);
    case NumberType::kFloat64:
      return gather_as<double, Swap>(at, row_size, count, out);
  }
}

std::size_t size_of(NumberType type) {
  constexpr std::size_t kSizes[] = {1, 1, 2, 2, 4, 4, 4, 8};
  return kSizes[static_cast<std::size_t>(type)];
}

// Bytes of constant harmonics; NaN is black. With the limits in the same loop it would not be vectorised.
ALULA_WIDE void shade(double* value, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    const double v = 0.5 + kShC0 * value[i];
    const double above = v > 0.0 ? v : 0.0;
    value[i] = above < 1.0 ? above : 1.0;
  }
  constexpr double kShift = 0x1.8p52;  // added, it leaves the nearest integer, half to even
  for (std::size_t i = 0; i < count; ++i) value[i] = (value[i] * 255.0 + kShift) - kShift;
}

void clamp_bytes(double* value, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) value[i] = value[i] > 0.0 ? std::min(value[i], 255.0) : 0.0;
}

// Interleaves columns of single values into rows of `Width`.
template <std::size_t Width, class T>
void interleave(const std::array<double, kBlock>* column, std::size_t count, T* out) {
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t j = 0; j < Width; ++j) out[Width * i + j] = static_cast<T>(column[j][i]);
  }
}

// Activates the values of a block and stores them as rows from `begin` on; overwrites the block.
void store(Block& value, bool flat, PlyColor color, std::size_t begin, std::size_t count, const PlyOutput& out) {
  for (std::size_t i = 0; i < (flat ? 2 : 3); ++i) {
    portable_exp(value[kScale + i].data(), value[kScale + i].data(), count);
  }
  if (flat) value[kScale + 2].fill(0.0);
  portable_logistic(value[kOpacity].data(), value[kOpacity].data(), count);
  interleave<3>(&value[kX], count, out.mean + 3 * begin);
  interleave<3>(&value[kScale], count, out.scale + 3 * begin);
  interleave<4>(&value[kRotation], count, out.quat + 4 * begin);
  interleave<1>(&value[kOpacity], count, out.opacity + begin);
  for (std::size_t i = 0; i < 3; ++i) {
    if (color == PlyColor::kGrey) value[kColor + i].fill(128.0);
    if (color == PlyColor::kHarmonic) shade(value[kColor + i].data(), count);
    if (color == PlyColor::kBytes) clamp_bytes(value[kColor + i].data(), count);
  }
  interleave<3>(&value[kColor], count, out.color + 3 * begin);
}

void check_places(const PlyPlaces& places, PlyColor color) {
  for (std::size_t c = 0; c < kPlyColumns; ++c) {
    const bool optional = c == kScale + 2 || (c >= kColor && color == PlyColor::kGrey);
    if (!places[c] && !optional) throw std::invalid_argument("a required column is missing");
  }
}

constexpr bool is_space(std::uint8_t c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

}  // namespace

void decode_ply_rows(std::span<const std::uint8_t> rows, std::size_t row_size, bool big_endian,
                     const PlyPlaces& places, PlyColor color, std::size_t count, const PlyOutput& out, unsigned jobs,
                     Control& control) {
  check_places(places, color);
  if (row_size == 0 || rows.size() / row_size < count) throw std::invalid_argument("fewer bytes than rows need");
  for (const auto& place : places) {
    if (place && (place->at > row_size || row_size - place->at < size_of(place->type))) {
      throw std::invalid_argument("a place outside the row");
    }
  }
  const bool swap = big_endian == (std::endian::native == std::endian::little);
  parallel_chunks(count, kChunk, jobs, control, [&](std::size_t begin, std::size_t end) {
    auto block = std::make_unique<Block>();
    for (std::size_t row = begin; row < end; row += kBlock) {
      const std::size_t size = std::min(kBlock, end - row);
      for (std::size_t c = 0; c < kPlyColumns; ++c) {
        if (!places[c]) continue;
        const std::uint8_t* at = rows.data() + row * row_size + places[c]->at;
        const auto function = swap ? gather<true> : gather<false>;
        function(places[c]->type, at, row_size, size, (*block)[c].data());
      }
      store(*block, !places[kScale + 2], color, row, size, out);
    }
  });
}

PlyLines find_lines(std::span<const std::uint8_t> text, std::size_t most) {
  PlyLines lines;
  const std::uint8_t* const end = text.data() + text.size();
  for (const std::uint8_t* line = text.data(); line < end;) {
    const void* found = std::memchr(line, '\n', static_cast<std::size_t>(end - line));
    const std::uint8_t* const stop = found ? static_cast<const std::uint8_t*>(found) : end;
    if (!std::all_of(line, stop, is_space)) {
      if (lines.start.size() < most) {
        lines.start.push_back(static_cast<std::uint64_t>(line - text.data()));
      } else {
        lines.trailing += static_cast<std::size_t>(stop - line) + 1;
      }
    }
    line = stop + 1;
  }
  return lines;
}

std::optional<PlyTextError> decode_ply_text(std::span<const std::uint8_t> text, std::span<const std::uint64_t> start,
                                            std::size_t width, const PlyPlaces& places, PlyColor color,
                                            const PlyOutput& out, unsigned jobs, Control& control) {
  check_places(places, color);
  std::vector<std::size_t> column(width, kPlyColumns);  // of each word; kPlyColumns: no column
  for (std::size_t c = 0; c < kPlyColumns; ++c) {
    if (!places[c]) continue;
    if (places[c]->at >= width) throw std::invalid_argument("a place outside the row");
    column[places[c]->at] = c;
  }
  for (const std::uint64_t at : start) {
    if (at > text.size()) throw std::invalid_argument("a row starts outside the text");
  }
  std::mutex mutex;
  std::optional<PlyTextError> first;  // the first of all rows, independent of the threads

  auto parse = [&](std::size_t row, std::size_t slot, Block& block) -> std::optional<PlyTextError> {
    std::optional<PlyTextError> wrong;
    std::size_t words = 0;
    std::size_t at = start[row];
    while (true) {
      while (at < text.size() && text[at] != '\n' && is_space(text[at])) ++at;
      if (at == text.size() || text[at] == '\n') break;
      const std::size_t begin = at;
      while (at < text.size() && !is_space(text[at])) ++at;
      if (words < width && !wrong) {
        const char* word = reinterpret_cast<const char*>(text.data()) + begin;
        const std::size_t c = column[words];
        double* const value = c < kPlyColumns ? &block[c][slot] : nullptr;
        if (!parse_decimal(word, word + (at - begin), value)) wrong = PlyTextError{row, width, begin, at};
      }
      ++words;
    }
    if (words != width) return PlyTextError{row, words, 0, 0};
    return wrong;
  };

  parallel_chunks(start.size(), kChunk / 8, jobs, control, [&](std::size_t begin, std::size_t end) {
    {
      const std::lock_guard lock(mutex);
      if (first && first->row < begin) return;
    }
    auto block = std::make_unique<Block>();
    for (std::size_t row = begin; row < end; row += kBlock) {
      const std::size_t size = std::min(kBlock, end - row);
      for (std::size_t i = 0; i < size; ++i) {
        if (const auto wrong = parse(row + i, i, *block)) {
          const std::lock_guard lock(mutex);
          if (!first || wrong->row < first->row) first = wrong;
          return;
        }
      }
      store(*block, !places[kScale + 2], color, row, size, out);
    }
  });
  return first;
}

}  // namespace alula
