// Rows of any bytes are read within their bounds; run it with sanitizers.
#include "alula/formats/ply_rows.hpp"

#include <cmath>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "alula/formats/decimal.hpp"
#include "alula/formats/exponential.hpp"
#include "alula/formats/scene_rows.hpp"
#include "check.hpp"

namespace {

using namespace alula;

struct Arrays {
  explicit Arrays(std::size_t count)
      : mean(3 * count), scale(3 * count), quat(4 * count), opacity(count), color(3 * count) {}
  PlyOutput into() { return {mean.data(), scale.data(), quat.data(), opacity.data(), color.data()}; }
  SplatArrays splats() const { return {mean, scale, quat, opacity}; }

  std::vector<float> mean, scale, quat, opacity;
  std::vector<std::uint8_t> color;
};

PlyPlaces places_every(std::size_t step, NumberType type) {
  PlyPlaces places;
  for (std::size_t c = 0; c < kPlyColumns; ++c) places[c] = PlyPlace{c * step, type};
  return places;
}

void any_bytes_become_a_scene_or_none() {
  std::mt19937 random(1);
  Control control;
  for (const std::size_t count : {1u, 127u, 129u, 20'000u}) {
    for (const auto& [type, size] : {std::pair{NumberType::kFloat32, 4u}, {NumberType::kFloat64, 8u}}) {
      const std::size_t row = kPlyColumns * size;
      std::vector<std::uint8_t> raw(count * row);  // exactly the required size
      for (auto& byte : raw) byte = static_cast<std::uint8_t>(random());
      Arrays made(count);
      decode_ply_rows(raw, row, count % 2 == 0, places_every(size, type), PlyColor::kHarmonic, count, made.into(), 3,
                      control);
      std::vector<std::uint8_t> removal(count);
      const Screened found = screen_rows(made.splats(), {0.1f, {}, {}, {}}, removal, 3, control);
      const std::size_t kept = found.count[0];
      if (kept == 0) continue;
      Arrays out(kept);
      const KeptFigures figures = keep_rows(made.splats(), made.color, removal, 1e-9f,
                                            {out.mean, out.scale, out.quat, out.opacity, out.color}, 3, control);
      for (const float value : out.quat) CHECK(std::fabs(value) <= 1);
      CHECK(figures.opacity_median >= 0.1f && figures.opacity_median <= 1);
    }
  }
}

void any_text_is_rows_or_an_error() {
  constexpr std::string_view kPieces[] = {"1", "-2.5e3", "\n",   " ",  "nan", "inf",  "+",
                                          ".", "e",      "\r\n", "\t", "x",   "1e999"};
  std::mt19937 random(2);
  Control control;
  for (int round = 0; round < 3000; ++round) {
    std::string text;
    const std::size_t pieces = random() % 60;
    for (std::size_t i = 0; i < pieces; ++i) {
      text += random() % 4 ? "7 " : kPieces[random() % std::size(kPieces)];
      if (i % 14 == 13) text += '\n';
    }
    const std::vector<std::uint8_t> raw(text.begin(), text.end());
    const PlyLines lines = find_lines(raw, 5);
    CHECK(lines.start.size() <= 5 && lines.trailing <= raw.size() + 1);
    Arrays made(lines.start.size());
    const auto wrong = decode_ply_text(raw, lines.start, 14, places_every(1, NumberType::kFloat64), PlyColor::kBytes,
                                       made.into(), 2, control);
    CHECK(!wrong || (wrong->row < lines.start.size() && wrong->begin <= wrong->end && wrong->end <= raw.size()));
  }
}

void numbers_end_where_they_end() {
  double value = 0;
  const std::string_view text = "12.5e1garbage";
  CHECK(parse_decimal(text.data(), text.data() + 6, &value) && value == 125);
  CHECK(parse_decimal(text.data(), text.data() + 4, &value) && value == 12.5);
  CHECK(!parse_decimal(text.data(), text.data() + 5, &value));  // 12.5e
  CHECK(!parse_decimal(text.data(), text.data(), &value));
  CHECK(parse_decimal(text.data(), text.data() + 2, nullptr));
}

void places_must_lie_in_the_row() {
  Control control;
  Arrays made(1);
  const std::vector<std::uint8_t> raw(56);
  bool refused = false;
  try {
    decode_ply_rows(raw, 55, false, places_every(4, NumberType::kFloat32), PlyColor::kHarmonic, 1, made.into(), 1,
                    control);
  } catch (const std::invalid_argument&) {
    refused = true;
  }
  CHECK(refused);
}

void exp_has_its_limits() {
  double x[] = {0, 1, -1e9, 1e9, std::nan(""), 0.5};
  portable_exp(x, x, 6);
  CHECK(x[0] == 1 && std::fabs(x[1] - 2.718281828459045) < 1e-15);
  CHECK(static_cast<float>(x[2]) == 0 && std::isinf(static_cast<float>(x[3])) && std::isnan(x[4]));
}

}  // namespace

int main() {
  any_bytes_become_a_scene_or_none();
  any_text_is_rows_or_an_error();
  numbers_end_where_they_end();
  places_must_lie_in_the_row();
  exp_has_its_limits();
  return alula_failures != 0;
}
