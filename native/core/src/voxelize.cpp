#include "alula/voxelize.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include "alula/parallel.hpp"

namespace alula {

namespace {

constexpr double kPad = 256 * kEps;       // q / E
constexpr double kRadius = 1 + 4 * kEps;  // of the ball, so that w is never rounded below the true one
constexpr double kMiss = -std::numeric_limits<double>::infinity();

// The plane over one edge of a column, first coordinate fixed: an arc of the upper surface.
struct Cut {
  bool inside;   // the apex is above this column as far as this axis is concerned: there is no edge
  double shift;  // second coordinate at u2 = 0
  double lift;   // height at u2 = 0, without the arc
  double w;      // radius of the arc in u; negative when the edge misses the ellipsoid
  double best;   // u2 of the arc's highest point
};

// One horizontal axis, for the upper (sign 1) or the lower surface mirrored upward (sign -1).
class Side {
 public:
  Side(const Factor& f, double sign, double pad)
      : f_(f),
        sign_(sign),
        pad_(pad),
        inverse_l11_(1 / f.l11),
        inverse_l22_(1 / f.l22),
        l32_(sign * f.l32),
        rise_(std::sqrt(f.l32 * f.l32 + f.l33 * f.l33)),
        apex_(sign * f.l11 * f.l31 / std::sqrt(f.l31 * f.l31 + rise_ * rise_)) {}

  // The edge that faces the apex, of the columns between lower and upper along this axis.
  Cut cut(double lower, double upper) const {
    if (lower > apex_ + 2 * pad_) return edge(lower - pad_);
    if (upper < apex_ - 2 * pad_) return edge(upper + pad_);
    return {true, 0, 0, 0, 0};
  }

  // Highest point of the surface above an edge, second coordinate between lower and upper.
  double highest(const Cut& cut, double lower, double upper) const {
    if (cut.w < 0) return kMiss;
    const double a = (lower - 4 * pad_ - cut.shift) * inverse_l22_;
    const double b = (upper + 4 * pad_ - cut.shift) * inverse_l22_;
    if (a > cut.w || b < -cut.w) return kMiss;
    if (cut.best >= a && cut.best <= b) return cut.lift + cut.w * rise_;
    const double u = cut.best < a ? a : b;
    return cut.lift + l32_ * u + f_.l33 * std::sqrt(std::max(0.0, (cut.w - u) * (cut.w + u)));
  }

 private:
  Cut edge(double at) const {
    const double t = at * inverse_l11_;
    if (!(std::abs(t) < kRadius)) return {false, 0, 0, -1, 0};
    const double w = std::sqrt((kRadius - t) * (kRadius + t));
    return {false, f_.l21 * t, sign_ * f_.l31 * t, w, w * l32_ / rise_};
  }

  Factor f_;
  double sign_, pad_, inverse_l11_, inverse_l22_, l32_, rise_, apex_;
};

struct Span {
  double lower, upper;  // a column's extent along an axis, relative to the centre
};

// Edges of all columns along one axis, for the upper and the lower surface.
struct Edges {
  std::vector<Span> span;
  std::vector<Cut> top, bottom;

  void fill(const Side& up, const Side& down, std::int32_t first, std::int32_t last, double g, double centre) {
    span.clear(), top.clear(), bottom.clear();
    for (std::int64_t i = first; i <= last; ++i) {
      const Span s{double(i) * g - centre, double(i + 1) * g - centre};
      span.push_back(s);
      top.push_back(up.cut(s.lower, s.upper));
      bottom.push_back(down.cut(s.lower, s.upper));
    }
  }
};

double height(const Side& x_side, const Cut& x, const Span& x_span, const Side& y_side, const Cut& y,
              const Span& y_span, double apex) {
  if (x.inside && y.inside) return apex;
  double best = kMiss;
  if (!x.inside) best = x_side.highest(x, y_span.lower, y_span.upper);
  if (!y.inside) best = std::max(best, y_side.highest(y, x_span.lower, x_span.upper));
  return best;
}

class Marker {
 public:
  Marker(OverlapGrid& grid, double g, const CropRange& crop) : writer_(grid), g_(g), crop_(crop) {}

  // Adds the voxels of one ellipsoid within the crop.
  void mark(const Ellipsoid& e) {
    const double pad = kPad * e.extent(g_);
    Vec3 lower, upper;
    bool whole = true;
    for (std::size_t a = 0; a < 3; ++a) {
      lower[a] = e.centre[a] - e.half[a] - pad;
      upper[a] = e.centre[a] + e.half[a] + pad;
      whole &= std::floor(lower[a] / g_) >= crop_.lower[a] && std::floor(upper[a] / g_) <= crop_.upper[a];
    }
    const Block block = clipped_block(lower, upper, g_, crop_);
    if (block.empty()) {
      ++outside;
      return;
    }
    if (whole) check_voxel_budget(e.least_voxels(g_));
    const std::size_t marked = columns(e, block, pad);
    outside += marked == 0;
    cut += marked != 0 && !whole;
  }

  void finish() { writer_.finish(); }

  std::size_t outside = 0, cut = 0;

 private:
  std::size_t columns(const Ellipsoid& e, const Block& block, double pad) {
    if (block.lower[0] == block.upper[0] && block.lower[1] == block.upper[1] && within_column(e, block, pad)) {
      writer_.add({block.lower[0], block.lower[1], block.lower[2], block.upper[2]});
      return 1;
    }
    const double floor = kEps * e.reach;
    const Factor xy = lower_factor(e.row[0], e.row[1], e.row[2], floor);
    const Factor yx = exchanged(xy, floor);
    const Side x_up(xy, 1, pad), x_down(xy, -1, pad), y_up(yx, 1, pad), y_down(yx, -1, pad);
    x_.fill(x_up, x_down, block.lower[0], block.upper[0], g_, e.centre[0]);
    y_.fill(y_up, y_down, block.lower[1], block.upper[1], g_, e.centre[1]);
    std::size_t marked = 0;
    for (std::size_t i = 0; i < x_.span.size(); ++i)
      for (std::size_t j = 0; j < y_.span.size(); ++j) {
        const double top = height(x_up, x_.top[i], x_.span[i], y_up, y_.top[j], y_.span[j], e.half[2]);
        if (top == kMiss) continue;
        const double bottom = height(x_down, x_.bottom[i], x_.span[i], y_down, y_.bottom[j], y_.span[j], e.half[2]);
        if (bottom == kMiss) continue;
        const double first = std::max(std::floor((e.centre[2] - bottom - pad) / g_), double(block.lower[2]));
        const double last = std::min(std::floor((e.centre[2] + top + pad) / g_), double(block.upper[2]));
        if (!(first <= last)) continue;
        writer_.add({block.lower[0] + static_cast<std::int32_t>(i), block.lower[1] + static_cast<std::int32_t>(j),
                     static_cast<std::int32_t>(first), static_cast<std::int32_t>(last)});
        ++marked;
      }
    return marked;
  }

  // Whether nothing was cropped away beside the only column.
  bool within_column(const Ellipsoid& e, const Block& block, double pad) const {
    bool within = true;
    for (std::size_t a = 0; a < 2; ++a)
      within &= std::floor((e.centre[a] - e.half[a] - pad) / g_) == block.lower[a] &&
                std::floor((e.centre[a] + e.half[a] + pad) / g_) == block.upper[a];
    return within;
  }

  OverlapGrid::Writer writer_;
  double g_;
  CropRange crop_;
  Edges x_, y_;
};

}  // namespace

Voxelized voxelize(const Splats& splats, const Level& level, double voxel_size, const std::optional<Box6>& crop,
                   unsigned jobs, Control& control) {
  check_splats(splats, level, voxel_size);
  const CropRange range = crop_range(crop, voxel_size);
  OverlapGrid grid;
  std::atomic<std::size_t> outside{0}, cut{0};
  parallel_chunks(splats.size(), 1024, jobs, control, [&](std::size_t begin, std::size_t end) {
    Marker marker(grid, voxel_size, range);
    for (std::size_t i = begin; i < end; ++i) marker.mark(outer_ellipsoid(splats, i, level));
    marker.finish();
    outside += marker.outside;
    cut += marker.cut;
  });
  Control quiet;
  return {grid.collect(1, jobs, quiet), outside, cut};
}

}  // namespace alula
