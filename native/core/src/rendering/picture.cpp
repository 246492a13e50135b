#include "alula/rendering/picture.hpp"

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "alula/base/parallel.hpp"
#include "alula/base/require.hpp"
#include "tiles.hpp"

namespace alula::rendering {

namespace {

constexpr float kInfinite = std::numeric_limits<float>::infinity();
constexpr std::uint32_t kBetweenChecks = 32;  // Gaussians

// Four pixels of a row.
using Four = float __attribute__((vector_size(16)));
using FourInts = std::int32_t __attribute__((vector_size(16)));
constexpr int kLanes = 4;
constexpr Four kCount{0, 1, 2, 3};

Four all_four(float value) { return Four{value, value, value, value}; }
Four load(const float* from) {
  Four value;
  std::memcpy(&value, from, sizeof value);
  return value;
}
void store(float* to, Four value) { std::memcpy(to, &value, sizeof value); }

// 2^x for -126 <= x <= 0: the nearest integer power, and Taylor's polynomial of the rest. Relative error below 4e-6.
Four power_of_two(Four x) {
  const FourInts whole = __builtin_convertvector(x - 0.5f, FourInts);
  const Four f = x - __builtin_convertvector(whole, Four);
  Four p = f * 1.3333558e-3f + 9.6181291e-3f;
  p = p * f + 5.5504109e-2f;
  p = p * f + 2.4022651e-1f;
  p = p * f + 6.9314718e-1f;
  p = p * f + 1.0f;
  const FourInts bits = (whole + 127) << 23;
  return p * std::bit_cast<Four>(bits);
}

// One tile while it is being composited.
class Canvas {
 public:
  Canvas() {
    light_.fill(1), next_.fill(kInfinite), depth_.fill(kInfinite);
    for (auto& each : color_) each.fill(0);
    for (auto& each : sample_) each.fill(1);
  }

  void begin(const Fragments& fragments) {
    fragments_ = &fragments;
    for (std::size_t p = 0; p < kTilePixels; ++p) at_[p] = fragments.start[p], look_ahead(p);
    find_nearest();
  }

  // Composites all fragments in front of a depth.
  void advance(float depth) {
    if (!(nearest_ < depth)) return;
    for (std::size_t p = 0; p < kTilePixels; ++p)
      while (next_[p] < depth) add_fragment(p, fragments_->each[at_[p]++]), look_ahead(p);
    find_nearest();
  }

  // (x, y): upper left corner of the tile.
  void add(const Ellipse& e, float x, float y) {
    const int top = clipped(e.y - e.reach_y - y - 0.5f), bottom = clipped(e.y + e.reach_y - y + 0.5f);
    for (int row = top; row < bottom; ++row) {
      const float dy = y + static_cast<float>(row) + 0.5f - e.y;
      // along the row the exponent is a quadratic: where it is at most `most`
      const float middle = -e.xy * dy / e.xx;
      const float rest = 2 * e.most - (e.yy - e.xy * e.xy / e.xx) * dy * dy;
      if (!(rest > 0)) continue;
      const float half = std::sqrt(rest / e.xx);
      const int left = clipped(e.x + middle - half - x - 0.5f), right = clipped(e.x + middle + half - x + 0.5f);
      add_row(e, static_cast<std::size_t>(row) * kTile, left, right, x + 0.5f - e.x, dy);
    }
  }

  bool is_done() const {
    float most = 0;
    for (const float light : light_) most = std::max(most, light);
    return most < kLeastLight;
  }

  // Composites what is left of the fragments, and blends lines over what hides them.
  void finish() {
    advance(kInfinite);
    for (std::size_t p = 0; p < kTilePixels; ++p)
      for (std::uint32_t k = fragments_->start[p + 1]; k-- > fragments_->start[p];) {
        const Fragment& f = fragments_->each[k];
        if (!(f.through > 0)) continue;
        const float weight = f.through * f.alpha * (1 - seen_[k]);
        for (std::size_t c = 0; c < 3; ++c) color_[c][p] = (1 - weight) * color_[c][p] + weight * f.color[c];
        light_[p] *= 1 - weight;
      }
  }

  void copy(std::size_t x0, std::size_t y0, const Camera& camera, Picture& picture) const {
    for (std::size_t row = 0; row < kTile && y0 + row < camera.rows; ++row)
      for (std::size_t column = 0; column < kTile && x0 + column < camera.columns; ++column) {
        const std::size_t p = row * kTile + column, to = (y0 + row) * camera.columns + x0 + column;
        for (std::size_t c = 0; c < 3; ++c) picture.color[3 * to + c] = color_[c][p];
        picture.light[to] = light_[p], picture.depth[to] = depth_[p];
      }
  }

  void reserve_seen(std::size_t count) { seen_.assign(count, 0); }

 private:
  // The next whole number of pixels within the tile; 0 for NaN.
  static int clipped(float pixel) {
    constexpr auto most = static_cast<float>(kTile);
    return pixel > 0 ? static_cast<int>(std::ceil(std::min(pixel, most))) : 0;
  }

  void add_row(const Ellipse& e, std::size_t row, int left, int right, float dx0, float dy) {
    constexpr float kPerLn2 = 1.4426950f;
    const float across = 2 * e.xy * dy, constant = e.yy * dy * dy;
    const float least = -kPerLn2 * e.most;
    const Four none = all_four(0), most = all_four(kMostAlpha), half = all_four(0.5f), z = all_four(e.depth);
    float *light = light_.data() + row, *depth = depth_.data() + row;
    for (int i = left / kLanes * kLanes; i < right; i += kLanes) {
      const Four dx = kCount + (dx0 + static_cast<float>(i));
      const Four x = (-0.5f * kPerLn2) * ((e.xx * dx + across) * dx + constant);
      const Four alpha = e.opacity * power_of_two(x < least ? all_four(least) : (x > 0.0f ? none : x));
      const Four before = load(light + i);
      const Four weight = before * (x < least ? none : (alpha > most ? most : alpha)), after = before - weight;
      for (std::size_t c = 0; c < 3; ++c) {
        float* color = color_[c].data() + row + i;
        store(color, load(color) + weight * e.color[c]);
      }
      store(depth + i, (before > half) & (after <= half) ? z : load(depth + i));
      store(light + i, after);
    }
  }

  void add_fragment(std::size_t p, const Fragment& f) {
    float before = 0, covered = 0, after = 0;
    for (std::size_t s = 0; s < kSamples; ++s) {
      before += sample_[s][p];
      if ((f.mask >> s & 1u) != 0) covered += sample_[s][p], sample_[s][p] *= 1 - f.alpha;
      after += sample_[s][p];
    }
    const std::size_t k = static_cast<std::size_t>(&f - fragments_->each.data());
    seen_[k] = before > 0 ? light_[p] * covered / before : 0;
    if (!(before > 0)) return;
    const float per = light_[p] / before, weight = per * covered * f.alpha, rest = per * after;
    for (std::size_t c = 0; c < 3; ++c) color_[c][p] += weight * f.color[c];
    if (light_[p] > 0.5f && rest <= 0.5f) depth_[p] = f.depth;
    light_[p] = rest;
  }

  void look_ahead(std::size_t p) {
    next_[p] = at_[p] < fragments_->start[p + 1] ? fragments_->each[at_[p]].depth : kInfinite;
  }
  void find_nearest() {
    nearest_ = kInfinite;
    for (const float depth : next_) nearest_ = std::min(nearest_, depth);
  }

  std::array<float, kTilePixels> light_, depth_, next_;
  std::array<std::array<float, kTilePixels>, 3> color_;
  // Transmittance of the triangles and lines so far, at the samples of each pixel.
  std::array<std::array<float, kTilePixels>, kSamples> sample_;
  std::array<std::uint32_t, kTilePixels> at_{};
  std::vector<float> seen_;  // of each fragment: transmittance in front of it
  const Fragments* fragments_ = nullptr;
  float nearest_ = kInfinite;
};

void check(const Camera& camera, const Gaussians& g, const Triangles& t, const Segments& s) {
  require(camera.columns >= 1 && camera.columns <= kMostPixels && camera.rows >= 1 && camera.rows <= kMostPixels,
          "the picture is empty or too large");
  require(camera.focal > 0 && std::isfinite(camera.focal), "the focal length is not positive");
  require(std::isfinite(camera.near) && (camera.is_parallel || camera.near > 0), "the near plane is not in front");
  require(is_finite(camera.centre), "the camera's centre is not finite");
  const geometry::Mat3 square = camera.rotation * transpose(camera.rotation);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      require(std::abs(square[i][j] - (i == j ? 1.0 : 0.0)) < 1e-6, "the camera's rotation is not a rotation");
  const std::size_t n = g.opacity.size(), m = t.opacity.size(), l = s.line.size();
  require(g.mean.size() == 3 * n && g.covariance.size() == 9 * n && g.color.size() == 3 * n,
          "arrays of Gaussians differ in length");
  require(t.corner.size() == 9 * m && t.color.size() == 3 * m, "arrays of triangles differ in length");
  require(s.end.size() == 6 * l && s.color.size() == 3 * l && s.style.size() == 3 * l,
          "arrays of segments differ in length");
}

}  // namespace

Picture draw(const Camera& camera, const Gaussians& gaussians, const Triangles& triangles, const Segments& segments,
             unsigned jobs, Control& control) {
  check(camera, gaussians, triangles, segments);
  const Grid grid(camera);
  InterruptOnly quiet(control);
  const Ellipses ellipses = project(camera, gaussians, grid, jobs, quiet);
  const Shapes shapes = project(camera, triangles, segments, grid);
  const std::size_t pixels = camera.columns * camera.rows;
  Picture picture{std::vector<float>(3 * pixels), std::vector<float>(pixels), std::vector<float>(pixels)};
  parallel_chunks(grid.size(), 4, jobs, control, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    Fragments fragments;
    for (std::size_t tile = begin; tile < end; ++tile) {
      stop.check();
      const std::size_t x0 = tile % grid.columns * kTile, y0 = tile / grid.columns * kTile;
      fragments_of(shapes, grid, tile, fragments);
      Canvas canvas;
      canvas.reserve_seen(fragments.each.size());
      canvas.begin(fragments);
      const std::uint32_t first = ellipses.bins.start[tile], last = ellipses.bins.start[tile + 1];
      for (std::uint32_t k = first; k < last; ++k) {
        const Ellipse& ellipse = ellipses.each[ellipses.bins.item[k]];
        canvas.advance(ellipse.depth);
        canvas.add(ellipse, static_cast<float>(x0), static_cast<float>(y0));
        if ((k - first) % kBetweenChecks == kBetweenChecks - 1 && canvas.is_done()) break;
      }
      canvas.finish();
      canvas.copy(x0, y0, camera, picture);
    }
  });
  return picture;
}

}  // namespace alula::rendering
