#include "alula/formats/scene_rows.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/base/wide.hpp"

namespace alula {
namespace {

constexpr std::size_t kRows = 16384;

std::size_t chunks_of(std::size_t count) { return (count + kRows - 1) / kRows; }

void check_lengths(const SplatArrays& rows, std::size_t count) {
  if (rows.mean.size() != 3 * count || rows.scale.size() != 3 * count || rows.quat.size() != 4 * count ||
      rows.opacity.size() != count) {
    throw std::invalid_argument("arrays of different lengths");
  }
}

template <std::size_t Width>
bool any_nan(const float* v) {
  bool found = false;
  for (std::size_t i = 0; i < Width; ++i) found |= v[i] != v[i];
  return found;
}

template <std::size_t Width>
bool any_infinite(const float* v) {
  bool found = false;
  for (std::size_t i = 0; i < Width; ++i) found |= std::fabs(v[i]) > std::numeric_limits<float>::max();
  return found;
}

// Divides quaternions by their lengths, in double precision.
ALULA_WIDE void normalise(float* quat, std::size_t count) {
  constexpr std::size_t kTogether = 256;
  std::array<double, kTogether> length;
  for (std::size_t begin = 0; begin < count; begin += kTogether) {
    float* const rows = quat + 4 * begin;
    const std::size_t size = std::min(kTogether, count - begin);
    for (std::size_t i = 0; i < size; ++i) {
      const double w = rows[4 * i], x = rows[4 * i + 1], y = rows[4 * i + 2], z = rows[4 * i + 3];
      length[i] = std::sqrt(((w * w + x * x) + y * y) + z * z);
    }
    for (std::size_t i = 0; i < size; ++i) {
      for (std::size_t j = 0; j < 4; ++j) rows[4 * i + j] = static_cast<float>(rows[4 * i + j] / length[i]);
    }
  }
}

Removal not_finite(const float* mean, const float* scale, const float* quat, float opacity) {
  if (any_nan<3>(mean) || any_nan<3>(scale) || any_nan<4>(quat) || opacity != opacity) return Removal::kNotANumber;
  if (any_infinite<3>(mean)) return Removal::kInfiniteMean;
  if (any_infinite<3>(scale)) return Removal::kInfiniteScale;
  return any_infinite<4>(quat) ? Removal::kInfiniteRotation : Removal::kNone;
}

Removal removal_of(const float* mean, const float* scale, const float* quat, float opacity,
                   const RemovalRules& rules) {
  const float sum = ((mean[0] + mean[1]) + (mean[2] + opacity)) + ((scale[0] + scale[1]) + scale[2]) +
                    ((quat[0] + quat[1]) + (quat[2] + quat[3]));
  if (sum - sum != 0) {  // almost always a value that is not finite
    const Removal why = not_finite(mean, scale, quat, opacity);
    if (why != Removal::kNone) return why;
  }
  if (quat[0] == 0 && quat[1] == 0 && quat[2] == 0 && quat[3] == 0) return Removal::kZeroRotation;
  if (opacity < rules.min_opacity) return Removal::kMinOpacity;
  if (rules.crop) {
    for (std::size_t i = 0; i < 3; ++i) {
      if (!(mean[i] >= (*rules.crop)[i] && mean[i] <= (*rules.crop)[3 + i])) return Removal::kCrop;
    }
  }
  if (rules.crop_sphere) {
    const auto& sphere = *rules.crop_sphere;
    const double x = mean[0] - sphere[0], y = mean[1] - sphere[1], z = mean[2] - sphere[2];
    if (!((x * x + y * y) + z * z <= sphere[3] * sphere[3])) return Removal::kCropSphere;
  }
  if (rules.max_scale && std::max({scale[0], scale[1], scale[2]}) > *rules.max_scale) return Removal::kMaxScale;
  return Removal::kNone;
}

// The median: the middle value, or the mean of the two in the middle. A sample gives an interval that contains it
// with high probability, so only a few per cent of the values must be ordered.
double median(std::span<const float> values) {
  const std::size_t ranks[] = {(values.size() - 1) / 2, values.size() / 2};
  const auto place = [](std::vector<float>& of, std::size_t rank) {
    const auto at = of.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(of.begin(), at, of.end());
    return *at;
  };
  const std::size_t stride = std::max<std::size_t>(1, values.size() / 16384);
  std::vector<float> sample;
  for (std::size_t i = 0; i < values.size(); i += stride) sample.push_back(values[i]);
  const std::size_t middle = sample.size() / 2;
  const auto margin = static_cast<std::size_t>(2.0 * std::sqrt(static_cast<double>(sample.size())));  // 4 sigma
  const float low = place(sample, middle - std::min(middle, margin));
  const float high = place(sample, std::min(middle + margin, sample.size() - 1));
  std::size_t below = 0;
  std::vector<float> near;
  std::array<float, 1024> some;
  for (std::size_t begin = 0; begin < values.size(); begin += some.size()) {
    std::size_t found = 0;
    for (const float v : values.subspan(begin, std::min(some.size(), values.size() - begin))) {
      below += v < low;
      some[found] = v;  // avoids a branch that is mispredicted half of the time
      found += static_cast<std::size_t>(v >= low) & static_cast<std::size_t>(v <= high);
    }
    near.insert(near.end(), some.begin(), some.begin() + static_cast<std::ptrdiff_t>(found));
  }
  if (ranks[0] < below || ranks[1] >= below + near.size()) {
    below = 0;
    near.assign(values.begin(), values.end());
  }
  const double first = place(near, ranks[0] - below);
  return ranks[0] == ranks[1] ? first : (first + static_cast<double>(place(near, ranks[1] - below))) / 2.0;
}

// Contribution of a chunk of rows to the figures.
struct Extremes {
  std::array<float, 3> lower, upper;
  float scale_max = 0;
  std::size_t floored = 0;
};

void check_room(std::size_t have, std::size_t need) {
  if (have != 0 && have != need) throw std::invalid_argument("an output of another length");
}

}  // namespace

Screened screen_rows(const SplatArrays& rows, const RemovalRules& rules, std::span<std::uint8_t> removal,
                     unsigned jobs, Control& control) {
  const std::size_t count = removal.size();
  check_lengths(rows, count);
  std::vector<Screened> part(chunks_of(count));
  parallel_chunks(count, kRows, jobs, control, [&](std::size_t begin, std::size_t end) {
    Screened found;
    found.first_not_finite = count;
    for (std::size_t i = begin; i < end; ++i) {
      const Removal why =
          removal_of(&rows.mean[3 * i], &rows.scale[3 * i], &rows.quat[4 * i], rows.opacity[i], rules);
      removal[i] = static_cast<std::uint8_t>(why);
      ++found.count[removal[i]];
      const bool finite = why == Removal::kNone || why >= Removal::kZeroRotation;
      if (!finite && found.first_not_finite == count) found.first_not_finite = i;
    }
    part[begin / kRows] = found;
  });
  Screened whole;
  whole.first_not_finite = count;
  for (const Screened& one : part) {
    for (std::size_t i = 0; i < kRemovals; ++i) whole.count[i] += one.count[i];
    whole.first_not_finite = std::min(whole.first_not_finite, one.first_not_finite);
  }
  return whole;
}

KeptFigures keep_rows(const SplatArrays& rows, std::span<const std::uint8_t> color,
                      std::span<const std::uint8_t> removal, float scale_floor, const KeptArrays& out, unsigned jobs,
                      Control& control) {
  const std::size_t count = removal.size();
  check_lengths(rows, count);
  if (color.size() != 3 * count) throw std::invalid_argument("arrays of different lengths");
  std::vector<std::size_t> start(chunks_of(count) + 1);  // of the kept rows of each chunk
  for (std::size_t c = 0; c + 1 < start.size(); ++c) {
    const auto chunk = removal.subspan(c * kRows, std::min(kRows, count - c * kRows));
    start[c + 1] = start[c] + static_cast<std::size_t>(std::count(chunk.begin(), chunk.end(), std::uint8_t{0}));
  }
  const std::size_t kept = start.back();
  if (kept == 0) throw std::invalid_argument("no row is kept");
  check_room(out.mean.size(), 3 * kept);
  check_room(out.scale.size(), 3 * kept);
  check_room(out.quat.size(), 4 * kept);
  check_room(out.opacity.size(), kept);
  check_room(out.color.size(), 3 * kept);

  std::vector<float> longest(kept), opacity(out.opacity.empty() && kept != count ? kept : 0);
  float* const opacity_out = out.opacity.empty() ? opacity.data() : out.opacity.data();
  const bool copies_opacity = !(out.opacity.empty() && kept == count);
  std::vector<Extremes> part(chunks_of(count));
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  parallel_chunks(count, kRows, jobs, control, [&](std::size_t begin, std::size_t end) {
    Extremes found;
    found.lower.fill(kInfinity);
    found.upper.fill(-kInfinity);
    std::size_t to = start[begin / kRows];
    for (std::size_t i = begin; i < end; ++i) {
      if (removal[i] != 0) continue;
      const float* mean = &rows.mean[3 * i];
      const float* scale = &rows.scale[3 * i];
      bool floored = false;
      float largest = scale_floor;
      for (std::size_t j = 0; j < 3; ++j) {
        found.lower[j] = mean[j] < found.lower[j] ? mean[j] : found.lower[j];
        found.upper[j] = mean[j] > found.upper[j] ? mean[j] : found.upper[j];
        floored |= scale[j] < scale_floor;
        largest = scale[j] > largest ? scale[j] : largest;
        if (!out.mean.empty()) out.mean[3 * to + j] = mean[j];
        if (!out.scale.empty()) out.scale[3 * to + j] = scale[j] < scale_floor ? scale_floor : scale[j];
        if (!out.color.empty()) out.color[3 * to + j] = color[3 * i + j];
      }
      if (!out.quat.empty()) {
        for (std::size_t j = 0; j < 4; ++j) out.quat[4 * to + j] = rows.quat[4 * i + j];
      }
      if (copies_opacity) opacity_out[to] = rows.opacity[i];
      longest[to] = largest;
      found.scale_max = largest > found.scale_max ? largest : found.scale_max;
      found.floored += floored;
      ++to;
    }
    if (!out.quat.empty()) normalise(out.quat.data() + 4 * start[begin / kRows], to - start[begin / kRows]);
    part[begin / kRows] = found;
  });

  KeptFigures figures{};
  figures.lower.fill(kInfinity);
  figures.upper.fill(-kInfinity);
  for (const Extremes& one : part) {
    for (std::size_t j = 0; j < 3; ++j) {
      figures.lower[j] = std::min(figures.lower[j], one.lower[j] + 0.0f);
      figures.upper[j] = std::max(figures.upper[j], one.upper[j] + 0.0f);
    }
    figures.scale_max = std::max(figures.scale_max, one.scale_max);
    figures.floored += one.floored;
  }
  const std::span<const float> kept_opacity =
      copies_opacity ? std::span<const float>(opacity_out, kept) : rows.opacity;
  InterruptOnly quiet(control);
  parallel_chunks(2, 1, jobs, quiet, [&](std::size_t i, std::size_t) {
    if (i == 0) figures.scale_median = median(longest);
    if (i == 1) figures.opacity_median = median(kept_opacity);
  });
  return figures;
}

MappedFigures map_rows(std::span<const float> mean, std::span<const float> scale, std::span<const float> quat,
                       const RowMotion& motion, const MappedRows& out, unsigned jobs, Control& control) {
  const std::size_t count = mean.size() / 3;
  for (const auto& [have, width] : {std::pair{mean.size(), 3},
                                    {scale.size(), 3},
                                    {quat.size(), 4},
                                    {out.mean.size(), 3},
                                    {out.scale.size(), 3},
                                    {out.quat.size(), 4},
                                    {out.moved.empty() ? count : out.moved.size(), 1}}) {
    if (have != static_cast<std::size_t>(width) * count) throw std::invalid_argument("arrays of different lengths");
  }
  // Seven roundings of double precision at most; none where an axis is only exchanged or mirrored.
  std::array<double, 3> unit;
  for (std::size_t j = 0; j < 3; ++j) {
    const auto& r = motion.rotation[j];
    const auto ones = std::count_if(r.begin(), r.end(), [](double v) { return std::fabs(v) == 1; });
    const bool is_exact = std::count(r.begin(), r.end(), 0.0) == 2 && ones == 1;
    unit[j] = is_exact && motion.scale == 1 && motion.translation[j] == 0 ? 0 : 0x1p-50;
  }
  std::vector<MappedFigures> part(chunks_of(count), {0, count, count});
  parallel_chunks(count, kRows, jobs, control, [&](std::size_t begin, std::size_t end) {
    MappedFigures found{0, count, count};
    const auto& [a, b, c, d] = motion.quat_wxyz;
    for (std::size_t i = begin; i < end; ++i) {
      const double x = mean[3 * i], y = mean[3 * i + 1], z = mean[3 * i + 2];
      double squared = 0;
      bool fits = true, scale_fits = true;
      for (std::size_t j = 0; j < 3; ++j) {
        const auto& r = motion.rotation[j];
        const double a0 = r[0] * x, a1 = r[1] * y, a2 = r[2] * z, shift = motion.translation[j];
        const double now = motion.scale * ((a0 + a1) + a2) + shift;
        const double size = motion.scale * (std::fabs(a0) + std::fabs(a1) + std::fabs(a2)) + std::fabs(shift);
        const float rounded = out.mean[3 * i + j] = static_cast<float>(now);
        const double error = std::fabs(rounded - now) + unit[j] * size;
        squared += error * error;
        fits &= std::isfinite(rounded);
        const float semi = static_cast<float>(motion.scale * scale[3 * i + j]);
        out.scale[3 * i + j] = std::max(semi, std::numeric_limits<float>::min());
        scale_fits &= std::isfinite(semi);
      }
      const double moved = std::sqrt(squared) * (1 + 0x1p-50);
      found.moved_max = std::max(found.moved_max, moved);
      if (!out.moved.empty()) out.moved[i] = moved;
      if (!fits) found.bad_mean = std::min(found.bad_mean, i);
      if (!scale_fits) found.bad_scale = std::min(found.bad_scale, i);
      const double e = quat[4 * i], f = quat[4 * i + 1], g = quat[4 * i + 2], h = quat[4 * i + 3];
      const std::array<double, 4> turned{a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g,
                                         a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e};
      double length = 0;
      for (const double q : turned) length += q * q;
      length = std::sqrt(length);
      for (std::size_t j = 0; j < 4; ++j) out.quat[4 * i + j] = static_cast<float>(turned[j] / length);
    }
    part[begin / kRows] = found;
  });
  MappedFigures whole{0, count, count};
  for (const MappedFigures& one : part) {
    whole.moved_max = std::max(whole.moved_max, one.moved_max);
    whole.bad_mean = std::min(whole.bad_mean, one.bad_mean);
    whole.bad_scale = std::min(whole.bad_scale, one.bad_scale);
  }
  return whole;
}

}  // namespace alula
