// Bindings of alula/formats/ply_rows.hpp and alula/formats/exponential.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string_view.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <string_view>
#include <tuple>

#include "alula/formats/exponential.hpp"
#include "alula/formats/ply_rows.hpp"
#include "arrays.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

using Bytes = InVector<std::uint8_t>;
// (offset or number of the word, NumPy's code of the type), in the order of PlyColumn.
using Places = std::vector<std::optional<std::pair<std::size_t, std::string_view>>>;

NumberType type_of(std::string_view code) {
  constexpr std::string_view kCodes[] = {"i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"};
  for (std::size_t i = 0; i < std::size(kCodes); ++i) {
    if (code == kCodes[i]) return static_cast<NumberType>(i);
  }
  throw std::invalid_argument("a type that no PLY file has");
}

PlyPlaces places_of(const Places& given) {
  if (given.size() != kPlyColumns) throw std::invalid_argument("need one place or None for each of 14 columns");
  PlyPlaces places;
  for (std::size_t c = 0; c < kPlyColumns; ++c) {
    if (given[c]) places[c] = PlyPlace{given[c]->first, type_of(given[c]->second)};
  }
  return places;
}

PlyColor color_of(std::string_view name) {
  if (name == "harmonic") return PlyColor::kHarmonic;
  if (name == "bytes") return PlyColor::kBytes;
  if (name == "grey") return PlyColor::kGrey;
  throw std::invalid_argument("color is harmonic, bytes or grey");
}

struct Outputs {
  IntoRows3<float> mean, scale;
  IntoRows4<float> quat;
  IntoVector<float> opacity;
  IntoRows3<std::uint8_t> color;

  PlyOutput at(std::size_t count) const {
    for (const std::size_t rows : {mean.shape(0), scale.shape(0), quat.shape(0), opacity.shape(0), color.shape(0)}) {
      if (rows != count) throw std::invalid_argument("an output of another length");
    }
    return {mean.data(), scale.data(), quat.data(), opacity.data(), color.data()};
  }
};

void decode_rows(const Bytes& rows, std::size_t row_size, bool big_endian, const Places& places,
                 std::string_view color, IntoRows3<float> mean, IntoRows3<float> scale, IntoRows4<float> quat,
                 IntoVector<float> opacity, IntoRows3<std::uint8_t> out_color, unsigned jobs, nb::object progress) {
  const std::size_t count = mean.shape(0);
  const PlyOutput out = Outputs{mean, scale, quat, opacity, out_color}.at(count);
  const PlyPlaces found = places_of(places);
  const PlyColor kind = color_of(color);
  PythonControl control(std::move(progress));
  const nb::gil_scoped_release release;
  decode_ply_rows(as_span(rows), row_size, big_endian, found, kind, count, out, jobs, control);
}

std::optional<std::tuple<std::size_t, std::size_t, std::size_t, std::size_t>> decode_text(
    const Bytes& text, const InVector<std::uint64_t>& start, std::size_t width, const Places& places,
    std::string_view color, IntoRows3<float> mean, IntoRows3<float> scale, IntoRows4<float> quat,
    IntoVector<float> opacity, IntoRows3<std::uint8_t> out_color, unsigned jobs, nb::object progress) {
  const auto starts = as_span(start);
  const PlyOutput out = Outputs{mean, scale, quat, opacity, out_color}.at(starts.size());
  const PlyPlaces found = places_of(places);
  const PlyColor kind = color_of(color);
  PythonControl control(std::move(progress));
  std::optional<PlyTextError> wrong;
  {
    const nb::gil_scoped_release release;
    wrong = decode_ply_text(as_span(text), starts, width, found, kind, out, jobs, control);
  }
  if (!wrong) return std::nullopt;
  return std::make_tuple(wrong->row, wrong->words, wrong->begin, wrong->end);
}

template <void (*Function)(const double*, double*, std::size_t)>
nb::ndarray<nb::numpy, double> each(const InVector<double>& x) {
  std::vector<double> values(x.size());
  {
    const nb::gil_scoped_release release;
    Function(x.data(), values.data(), values.size());
  }
  const std::size_t count = values.size();
  return to_numpy(std::move(values), {count});
}

}  // namespace
}  // namespace alula

void bind_ply_rows(nb::module_& m) {
  using namespace alula;
  m.def("decode_ply_rows", &decode_rows, "rows"_a, "row_size"_a, "big_endian"_a, "places"_a, "color"_a,
        "mean"_a.noconvert(), "scale"_a.noconvert(), "quat"_a.noconvert(), "opacity"_a.noconvert(),
        "out_color"_a.noconvert(), "jobs"_a = 0, "progress"_a = nb::none(),
        "Decode binary rows of Gaussians into the given arrays, as many as these have rows. `places` has for x, y,\n"
        "z, scale_0..2, rot_0..3, opacity and three columns of colour (offset in the row, NumPy's code of the "
        "type),\n"
        "or None without scale_2 or colour; `color` is harmonic, bytes or grey. The same bits on every machine.");
  m.def(
      "find_lines",
      [](const Bytes& text, std::size_t most) {
        PlyLines lines;
        {
          const nb::gil_scoped_release release;
          lines = find_lines(as_span(text), most);
        }
        const std::size_t count = lines.start.size();
        return std::make_tuple(to_numpy(std::move(lines.start), {count}), lines.trailing);
      },
      "text"_a, "most"_a, "Starts of the first `most` lines that are not blank, and the bytes of all further ones.");
  m.def("decode_ply_text", &decode_text, "text"_a, "start"_a, "width"_a, "places"_a, "color"_a, "mean"_a.noconvert(),
        "scale"_a.noconvert(), "quat"_a.noconvert(), "opacity"_a.noconvert(), "out_color"_a.noconvert(), "jobs"_a = 0,
        "progress"_a = nb::none(),
        "As decode_ply_rows for lines of `width` numbers that start at `start`; places count words. None, or what\n"
        "is wrong first: (row, its words, begin and end of a word that is no number if it has `width` of them).");
  m.def("portable_exp", &each<portable_exp>, "x"_a,
        "exp of each to less than 1.3 units in the last place, the same bits on every machine. Arguments beyond\n"
        "+-200 count as +-200, which is infinity and zero in single precision; NaN stays NaN.");
  m.def("portable_logistic", &each<portable_logistic>, "x"_a, "1 / (1 + exp(-x)) of each, by portable_exp.");
}
