// Triangles and lines: cut at the near plane, projected, binned by tile, and turned into fragments.
#include <cmath>

#include "tiles.hpp"

namespace alula::rendering {

using geometry::Vec3;

namespace {

// Samples of a pixel, from its upper left corner: each in another row and another column of a 4 x 4 grid.
constexpr std::array<std::array<double, 2>, kSamples> kSample{
    {{0.375, 0.125}, {0.875, 0.375}, {0.125, 0.625}, {0.625, 0.875}}};
constexpr float kSameLine = 0.02f;   // segments of one line whose depths differ by a smaller fraction count once
constexpr double kLeastArea = 1e-9;  // twice the area of a triangle [px^2]

std::array<float, 3> color_at(std::span<const std::uint8_t> color, std::size_t i) {
  return {static_cast<float>(color[3 * i]), static_cast<float>(color[3 * i + 1]),
          static_cast<float>(color[3 * i + 2])};
}

// Where the segment from a to b crosses the near plane.
Vec3 crossing(Vec3 a, Vec3 b, double near) {
  Vec3 found = a + ((near - a.z) / (b.z - a.z)) * (b - a);
  found.z = near;
  return found;
}

// The quantity that is affine in the picture: depth in parallel projection, else its inverse.
double affine(const Camera& camera, double z) { return camera.is_parallel ? z : 1 / z; }
double depth_of(bool is_parallel, double value) { return is_parallel ? value : 1 / value; }

void add_facet(const Camera& camera, const std::array<Vec3, 3>& corner, std::array<float, 3> color, float opacity,
               const Grid& grid, Shapes& shapes, std::vector<TileRange>& ranges) {
  std::array<std::array<double, 2>, 3> p;
  std::array<double, 3> w;
  for (std::size_t k = 0; k < 3; ++k) p[k] = camera.pixel(corner[k]), w[k] = affine(camera, corner[k].z);
  const double area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
  if (!(std::abs(area) > kLeastArea) || !std::isfinite(area)) return;
  Facet facet{{}, {}, {p[0][0], p[0][1], p[0][0], p[0][1]}, corner[0].z, corner[0].z, color, opacity};
  for (std::size_t k = 0; k < 3; ++k) {
    facet.box = {std::min(facet.box[0], p[k][0]), std::min(facet.box[1], p[k][1]), std::max(facet.box[2], p[k][0]),
                 std::max(facet.box[3], p[k][1])};
    facet.near = std::min(facet.near, corner[k].z), facet.far = std::max(facet.far, corner[k].z);
    const auto &a = p[(k + 1) % 3], &b = p[(k + 2) % 3];  // the edge opposite to corner k, 1 there
    facet.edge[k] = {(a[1] - b[1]) / area, (b[0] - a[0]) / area, (a[0] * b[1] - b[0] * a[1]) / area};
    for (std::size_t j = 0; j < 3; ++j) facet.plane[j] += w[k] * facet.edge[k][j];
  }
  const TileRange range = grid.range(facet.box[0], facet.box[1], facet.box[2], facet.box[3]);
  if (range.left >= range.right || range.top >= range.bottom) return;
  shapes.facet.push_back(facet), ranges.push_back(range);
}

void add_triangle(const Camera& camera, const Triangles& triangles, std::size_t i, const Grid& grid, Shapes& shapes,
                  std::vector<TileRange>& ranges) {
  std::array<Vec3, 4> cut;
  std::size_t count = 0;
  std::array<Vec3, 3> corner;
  for (std::size_t k = 0; k < 3; ++k) {
    corner[k] = camera.seen(geometry::from_rows(triangles.corner.data() + 9 * i + 3 * k));
    if (!is_finite(corner[k])) return;
  }
  for (std::size_t k = 0; k < 3; ++k) {
    const Vec3 a = corner[k], b = corner[(k + 1) % 3];
    if (a.z > camera.near) cut[count++] = a;
    if ((a.z > camera.near) != (b.z > camera.near)) cut[count++] = crossing(a, b, camera.near);
  }
  const float opacity = std::min(triangles.opacity[i], 1.0f);
  if (!(opacity > 0)) return;
  for (std::size_t k = 2; k < count; ++k)
    add_facet(camera, {cut[0], cut[k - 1], cut[k]}, color_at(triangles.color, i), opacity, grid, shapes, ranges);
}

void add_segment(const Camera& camera, const Segments& segments, std::size_t i, const Grid& grid, Shapes& shapes,
                 std::vector<TileRange>& ranges) {
  Vec3 a = camera.seen(geometry::from_rows(segments.end.data() + 6 * i));
  Vec3 b = camera.seen(geometry::from_rows(segments.end.data() + 6 * i + 3));
  const float* style = segments.style.data() + 3 * i;
  const float width = style[0], opacity = std::min(style[1], 1.0f), through = std::clamp(style[2], 0.0f, 1.0f);
  if (!is_finite(a) || !is_finite(b) || !(width > 0) || !std::isfinite(width) || !(opacity > 0)) return;
  if (!(a.z > camera.near) && !(b.z > camera.near)) return;
  if (!(a.z > camera.near)) a = crossing(b, a, camera.near);
  if (!(b.z > camera.near)) b = crossing(a, b, camera.near);
  const auto p = camera.pixel(a), q = camera.pixel(b);
  const float half = 0.5f * width;
  const double reach = half + 0.5;
  const TileRange range = grid.range(std::min(p[0], q[0]) - reach, std::min(p[1], q[1]) - reach,
                                     std::max(p[0], q[0]) + reach, std::max(p[1], q[1]) + reach);
  if (range.left >= range.right || range.top >= range.bottom) return;
  shapes.stroke.push_back({p, q, affine(camera, a.z), affine(camera, b.z), half, opacity, through,
                           color_at(segments.color, i), segments.line[i]});
  ranges.push_back(range);
}

// Where a pixel's centre is nearest to a stroke: fraction along it, and the distance [px].
struct Nearest {
  double along, distance;
};
Nearest nearest(const Stroke& s, double x, double y) {
  const double dx = s.to[0] - s.from[0], dy = s.to[1] - s.from[1];
  const double square = dx * dx + dy * dy;
  const double t = square > 0 ? std::clamp(((x - s.from[0]) * dx + (y - s.from[1]) * dy) / square, 0.0, 1.0) : 0.0;
  const double ex = x - s.from[0] - t * dx, ey = y - s.from[1] - t * dy;
  return {t, std::sqrt(ex * ex + ey * ey)};
}

struct Rectangle {
  std::size_t left, top, right, bottom;  // pixels [left, right) x [top, bottom) of a tile
};
// Pixels of the tile at (x0, y0) that a box [px] meets.
Rectangle within(std::size_t x0, std::size_t y0, double left, double top, double right, double bottom) {
  const auto clipped = [](double value, std::size_t origin) {
    return static_cast<std::size_t>(std::clamp(value - static_cast<double>(origin), 0.0, static_cast<double>(kTile)));
  };
  return {clipped(std::floor(left), x0), clipped(std::floor(top), y0), clipped(std::floor(right) + 1, x0),
          clipped(std::floor(bottom) + 1, y0)};
}

struct Placed {
  std::uint32_t pixel;
  Fragment fragment;
};

void add_fragments(const Facet& f, bool is_parallel, std::size_t x0, std::size_t y0, std::uint32_t order,
                   std::vector<Placed>& out) {
  const Rectangle box = within(x0, y0, f.box[0], f.box[1], f.box[2], f.box[3]);
  for (std::size_t row = box.top; row < box.bottom; ++row)
    for (std::size_t column = box.left; column < box.right; ++column) {
      const double x = static_cast<double>(x0 + column), y = static_cast<double>(y0 + row);
      std::uint32_t mask = 0;
      for (std::size_t s = 0; s < kSamples; ++s) {
        const double u = x + kSample[s][0], v = y + kSample[s][1];
        bool is_inside = true;
        for (const auto& e : f.edge) is_inside &= e[0] * u + e[1] * v + e[2] >= 0;
        if (is_inside) mask |= 1u << s;
      }
      if (mask == 0) continue;
      const double value = f.plane[0] * (x + 0.5) + f.plane[1] * (y + 0.5) + f.plane[2];
      // outside of the triangle its plane may be anywhere
      const double depth = std::clamp(value > 0 || is_parallel ? depth_of(is_parallel, value) : f.far, f.near, f.far);
      out.push_back({static_cast<std::uint32_t>(row * kTile + column),
                     {static_cast<float>(depth), f.opacity, 0, mask, order, -1, f.color}});
    }
}

void add_fragments(const Stroke& s, bool is_parallel, std::size_t x0, std::size_t y0, std::uint32_t order,
                   std::vector<Placed>& out) {
  const double reach = static_cast<double>(s.half_width) + 0.5;
  const double middle = 0.5 * kTile, corner = 0.7072 * kTile;
  if (nearest(s, static_cast<double>(x0) + middle, static_cast<double>(y0) + middle).distance > corner + reach)
    return;
  const Rectangle box = within(x0, y0, std::min(s.from[0], s.to[0]) - reach, std::min(s.from[1], s.to[1]) - reach,
                               std::max(s.from[0], s.to[0]) + reach, std::max(s.from[1], s.to[1]) + reach);
  for (std::size_t row = box.top; row < box.bottom; ++row)
    for (std::size_t column = box.left; column < box.right; ++column) {
      const Nearest at = nearest(s, static_cast<double>(x0 + column) + 0.5, static_cast<double>(y0 + row) + 0.5);
      // a line thinner than a pixel is paler, not thinner
      const double cover =
          std::clamp(reach - at.distance, 0.0, std::min(1.0, 2.0 * static_cast<double>(s.half_width)));
      const float alpha = static_cast<float>(cover) * s.opacity;
      if (!(alpha >= kLeastAlpha)) continue;
      const double depth = depth_of(is_parallel, (1 - at.along) * s.from_depth + at.along * s.to_depth);
      out.push_back({static_cast<std::uint32_t>(row * kTile + column),
                     {static_cast<float>(depth), alpha, s.through, (1u << kSamples) - 1, order, s.line, s.color}});
    }
}

// Joins fragments of one line at nearly the same depth: the nearest, with the largest coverage.
void join_lines(std::vector<Fragment>& each, std::size_t begin) {
  std::size_t kept = begin;
  for (std::size_t i = begin; i < each.size(); ++i) {
    bool is_joined = false;
    for (std::size_t j = begin; j < kept && each[i].line >= 0 && !is_joined; ++j)
      if (each[j].line == each[i].line && each[i].depth - each[j].depth <= kSameLine * std::abs(each[i].depth)) {
        if (each[i].alpha > each[j].alpha) each[j].alpha = each[i].alpha, each[j].color = each[i].color;
        is_joined = true;
      }
    if (!is_joined) each[kept++] = each[i];
  }
  each.resize(kept);
}

}  // namespace

Shapes project(const Camera& camera, const Triangles& triangles, const Segments& segments, const Grid& grid) {
  Shapes shapes;
  shapes.is_parallel = camera.is_parallel;
  std::vector<TileRange> facet_range, stroke_range;
  for (std::size_t i = 0; i < triangles.opacity.size(); ++i)
    add_triangle(camera, triangles, i, grid, shapes, facet_range);
  for (std::size_t i = 0; i < segments.line.size(); ++i) add_segment(camera, segments, i, grid, shapes, stroke_range);
  shapes.facet_bins = binned(grid, facet_range);
  shapes.stroke_bins = binned(grid, stroke_range);
  return shapes;
}

void fragments_of(const Shapes& shapes, const Grid& grid, std::size_t tile, Fragments& out) {
  const std::size_t x0 = tile % grid.columns * kTile, y0 = tile / grid.columns * kTile;
  std::vector<Placed> placed;
  std::uint32_t order = 0;
  for (std::uint32_t k = shapes.facet_bins.start[tile]; k < shapes.facet_bins.start[tile + 1]; ++k)
    add_fragments(shapes.facet[shapes.facet_bins.item[k]], shapes.is_parallel, x0, y0, order++, placed);
  for (std::uint32_t k = shapes.stroke_bins.start[tile]; k < shapes.stroke_bins.start[tile + 1]; ++k)
    add_fragments(shapes.stroke[shapes.stroke_bins.item[k]], shapes.is_parallel, x0, y0, order++, placed);
  std::sort(placed.begin(), placed.end(), [](const Placed& a, const Placed& b) {
    if (a.pixel != b.pixel) return a.pixel < b.pixel;
    if (a.fragment.depth != b.fragment.depth) return a.fragment.depth < b.fragment.depth;
    return a.fragment.order < b.fragment.order;
  });
  out.each.clear();
  std::size_t k = 0;
  for (std::uint32_t pixel = 0; pixel < kTilePixels; ++pixel) {
    out.start[pixel] = static_cast<std::uint32_t>(out.each.size());
    for (; k < placed.size() && placed[k].pixel == pixel; ++k) out.each.push_back(placed[k].fragment);
    join_lines(out.each, out.start[pixel]);
  }
  out.start[kTilePixels] = static_cast<std::uint32_t>(out.each.size());
}

}  // namespace alula::rendering
