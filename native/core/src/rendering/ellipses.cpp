// Gaussians as ellipses in the picture, ordered by depth and binned by tile.
#include <cmath>
#include <numeric>

#include "alula/base/parallel.hpp"
#include "tiles.hpp"

namespace alula::rendering {

using geometry::Mat3;
using geometry::Vec3;

namespace {

constexpr double kBeyond = 1.3;  // times the half width of the picture: limit of x/z and y/z in the Jacobian
constexpr std::size_t kChunk = 4096;

// Projects one Gaussian; false when there is nothing to see of it.
bool project_one(const Camera& camera, const Gaussians& g, std::size_t i, const Grid& grid, Ellipse& ellipse,
                 TileRange& range) {
  const float* m = g.mean.data() + 3 * i;
  const float* s = g.covariance.data() + 9 * i;
  const double opacity = static_cast<double>(g.opacity[i]);
  if (!(opacity >= kLeastAlpha) || !std::isfinite(opacity)) return false;
  const Vec3 p = camera.seen({m[0], m[1], m[2]});
  if (!is_finite(p) || !(p.z > camera.near)) return false;
  const double scale = camera.is_parallel ? camera.focal : camera.focal / p.z;
  Vec3 right{scale, 0, 0}, down{0, scale, 0};  // rows of J
  if (!camera.is_parallel) {
    const double most_x = kBeyond * 0.5 * static_cast<double>(camera.columns) / camera.focal;
    const double most_y = kBeyond * 0.5 * static_cast<double>(camera.rows) / camera.focal;
    right.z = -scale * std::clamp(p.x / p.z, -most_x, most_x);
    down.z = -scale * std::clamp(p.y / p.z, -most_y, most_y);
  }
  const Mat3 sigma{{{s[0], s[1], s[2]}, {s[3], s[4], s[5]}, {s[6], s[7], s[8]}}};
  const Vec3 a = transposed_times(camera.rotation, right), b = transposed_times(camera.rotation, down);
  const Vec3 sa = sigma * a, sb = sigma * b;
  const double xx = dot(a, sa) + kLowPass, xy = dot(a, sb), yy = dot(b, sb) + kLowPass;
  const double determinant = xx * yy - xy * xy;
  if (!(determinant > 0) || !(xx > 0) || !std::isfinite(determinant)) return false;
  const double most = std::log(opacity / kLeastAlpha);
  const double reach_x = std::sqrt(2 * most * xx), reach_y = std::sqrt(2 * most * yy);
  const auto [x, y] = camera.pixel(p);
  if (!(x + reach_x > 0) || !(y + reach_y > 0) || !(x - reach_x < static_cast<double>(camera.columns)) ||
      !(y - reach_y < static_cast<double>(camera.rows)))
    return false;
  range = grid.range(x - reach_x, y - reach_y, x + reach_x, y + reach_y);
  const auto as_float = [](double value) { return static_cast<float>(value); };
  ellipse = {as_float(x),
             as_float(y),
             as_float(yy / determinant),
             as_float(-xy / determinant),
             as_float(xx / determinant),
             as_float(opacity),
             as_float(most),
             as_float(reach_y),
             as_float(p.z),
             {static_cast<float>(g.color[3 * i]), static_cast<float>(g.color[3 * i + 1]),
              static_cast<float>(g.color[3 * i + 2])}};
  return true;
}

}  // namespace

Bins binned(const Grid& grid, const std::vector<TileRange>& range) {
  Bins bins;
  bins.start.assign(grid.size() + 1, 0);
  const auto each = [&](auto&& body) {
    for (std::size_t i = 0; i < range.size(); ++i)
      for (std::size_t y = range[i].top; y < range[i].bottom; ++y)
        for (std::size_t x = range[i].left; x < range[i].right; ++x) body(i, y * grid.columns + x);
  };
  each([&](std::size_t, std::size_t tile) { ++bins.start[tile + 1]; });
  std::partial_sum(bins.start.begin(), bins.start.end(), bins.start.begin());
  bins.item.resize(bins.start.back());
  std::vector<std::uint32_t> next(bins.start.begin(), bins.start.end() - 1);
  each([&](std::size_t i, std::size_t tile) { bins.item[next[tile]++] = static_cast<std::uint32_t>(i); });
  return bins;
}

Ellipses project(const Camera& camera, const Gaussians& gaussians, const Grid& grid, unsigned jobs,
                 Control& control) {
  const std::size_t count = gaussians.opacity.size();
  std::vector<Ellipse> all(count);
  std::vector<TileRange> range(count);
  std::vector<std::uint8_t> is_seen(count);
  parallel_chunks(count, kChunk, jobs, control, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      is_seen[i] = project_one(camera, gaussians, i, grid, all[i], range[i]) ? 1 : 0;
  });
  std::vector<std::uint32_t> order;
  order.reserve(count);
  for (std::size_t i = 0; i < count; ++i)
    if (is_seen[i]) order.push_back(static_cast<std::uint32_t>(i));
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return all[a].depth < all[b].depth || (all[a].depth == all[b].depth && a < b);
  });
  Ellipses found;
  found.each.reserve(order.size());
  std::vector<TileRange> ordered;
  ordered.reserve(order.size());
  for (const std::uint32_t i : order) found.each.push_back(all[i]), ordered.push_back(range[i]);
  found.bins = binned(grid, ordered);
  return found;
}

}  // namespace alula::rendering
