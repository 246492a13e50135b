// What the parts of a picture share: tiles, Gaussians as ellipses, and fragments of triangles and lines.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "alula/rendering/picture.hpp"

namespace alula::rendering {

constexpr std::size_t kTile = 16, kTilePixels = kTile * kTile;
constexpr std::uint32_t kSamples = 4;

// A Gaussian in the picture: centre [px], inverse of its covariance (xx, xy, yy) [1/px^2], opacity, depth, colour.
// Beyond exponent `most`, and so more than `reach_y` above or below its centre, its alpha is below kLeastAlpha.
struct Ellipse {
  float x, y, xx, xy, yy, opacity, most, reach_y, depth;
  std::array<float, 3> color;
};

// Rectangle of tiles [left, right) x [top, bottom).
struct TileRange {
  std::uint16_t left = 0, top = 0, right = 0, bottom = 0;
};

struct Grid {
  std::size_t columns, rows;  // [tiles]
  explicit Grid(const Camera& camera)
      : columns((camera.columns + kTile - 1) / kTile), rows((camera.rows + kTile - 1) / kTile) {}
  std::size_t size() const { return columns * rows; }

  // Tiles that the rectangle meets; pixels [px].
  TileRange range(double left, double top, double right, double bottom) const {
    const auto at = [](double pixel, std::size_t count) {
      return static_cast<std::uint16_t>(std::clamp(pixel / kTile, 0.0, static_cast<double>(count)));
    };
    const auto after = [&](double pixel, std::size_t count) {
      return pixel < 0 ? std::uint16_t{0}
                       : static_cast<std::uint16_t>(std::min<std::size_t>(at(pixel, count) + 1u, count));
    };
    return {at(left, columns), at(top, rows), after(right, columns), after(bottom, rows)};
  }
};

// Rows of items by tile: those of tile t are item[start[t]] ... item[start[t + 1] - 1], in their order.
struct Bins {
  std::vector<std::uint32_t> start, item;
};
Bins binned(const Grid& grid, const std::vector<TileRange>& range);

struct Ellipses {
  std::vector<Ellipse> each;  // by depth
  Bins bins;
};
Ellipses project(const Camera& camera, const Gaussians& gaussians, const Grid& grid, unsigned jobs, Control& control);

// A triangle in the picture: its edges as a x + b y + c >= 0 inside [px], and its plane: a x + b y + c is the depth,
// or its inverse in perspective.
struct Facet {
  std::array<std::array<double, 3>, 3> edge;
  std::array<double, 3> plane;
  std::array<double, 4> box;  // left, top, right, bottom [px]
  double near, far;           // depths of its corners
  std::array<float, 3> color;
  float opacity;
};

// A segment in the picture: ends [px], 1 / depth or depth at them, half its width.
struct Stroke {
  std::array<double, 2> from, to;
  double from_depth, to_depth;
  float half_width, opacity, through;
  std::array<float, 3> color;
  std::int32_t line;
};

struct Shapes {
  bool is_parallel = false;
  std::vector<Facet> facet;
  std::vector<Stroke> stroke;
  Bins facet_bins, stroke_bins;
};
Shapes project(const Camera& camera, const Triangles& triangles, const Segments& segments, const Grid& grid);

// A triangle or a line in one pixel. `mask` has the samples that it covers, `alpha` its opacity there.
struct Fragment {
  float depth, alpha, through;
  std::uint32_t mask, order;
  std::int32_t line;  // -1 for triangles
  std::array<float, 3> color;
};

// Fragments of a tile: those of pixel p (row by row) are each[start[p]] ... each[start[p + 1] - 1], by depth.
struct Fragments {
  std::array<std::uint32_t, kTilePixels + 1> start{};
  std::vector<Fragment> each;
};
void fragments_of(const Shapes& shapes, const Grid& grid, std::size_t tile, Fragments& out);

}  // namespace alula::rendering
