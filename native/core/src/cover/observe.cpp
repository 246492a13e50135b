#include "alula/cover/observe.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>

#include "alula/base/parallel.hpp"
#include "alula/geometry/surfaces.hpp"

namespace alula {

namespace {

using surfaces::dot;

constexpr double kGrowth = 1e-10;     // of the covariances
constexpr double kPixel = 1e-6;       // of a pixel
constexpr double kNearer = 1 + 1e-9;  // of 1 / z, together with its rounding to single precision
constexpr double kStart = 1.0 / 16;   // first slab, in near limits
constexpr double kMiss = -1;

float rounded_up(double w) {
  return std::nextafter(static_cast<float>(w * kNearer), std::numeric_limits<float>::infinity());
}

// A set in the camera's frame: {centre + row u : |u| <= 1}.
struct Body {
  Triple centre;
  std::array<Triple, 3> row;
  double depth;  // half-width along z
};

// The ellipsoid in (column, row, 1 / z), and the largest 1 / z over a rectangle of the image.
class Projection {
 public:
  // Of a body in front of the camera, scaled to pixels: column = fx x / z + ox.
  Projection(const Body& body, double fx, double fy, double ox, double oy) {
    const Triple& c = body.centre;
    const Triple& az = body.row[2];
    const double far = body.depth, inverse = 1 / ((c[2] - far) * (c[2] + far));
    const double x = c[0] / c[2], y = c[1] / c[2];
    Triple ax, ay;
    for (std::size_t j = 0; j < 3; ++j) {
      ax[j] = fx * (body.row[0][j] - x * az[j]);
      ay[j] = fy * (body.row[1][j] - y * az[j]);
    }
    const double lost_x = fx * (std::sqrt(dot(body.row[0], body.row[0])) + std::abs(x) * far);
    const double lost_y = fy * (std::sqrt(dot(body.row[1], body.row[1])) + std::abs(y) * far);
    const double xz = dot(ax, az) * inverse, yz = dot(ay, az) * inverse, w = c[2] * inverse;
    u_ = fx * x + ox - xz, v_ = fy * y + oy - yz, w_ = w;
    uu_ = grown(xz * xz + dot(ax, ax) * inverse) + kGrowth * kGrowth * lost_x * lost_x * inverse;
    vv_ = grown(yz * yz + dot(ay, ay) * inverse) + kGrowth * kGrowth * lost_y * lost_y * inverse;
    ww_ = grown(far * far * inverse * inverse);
    uv_ = xz * yz + dot(ax, ay) * inverse, uw_ = -xz * w, vw_ = -yz * w;
    half_u_ = std::sqrt(uu_), half_v_ = std::sqrt(vv_), half_w_ = std::sqrt(ww_);
  }

  double left() const { return u_ - half_u_; }
  double right() const { return u_ + half_u_; }
  double top() const { return v_ - half_v_; }
  double bottom() const { return v_ + half_v_; }
  double nearest() const { return w_ + half_w_; }

  // Prepares `columns` and `highest`; not needed for a set within one pixel.
  void factor() {
    u_first_ = Factored(uu_, vv_, ww_, uv_, uw_, vw_);
    v_first_ = Factored(vv_, uu_, ww_, uv_, vw_, uw_);
    apex_u_ = uw_ / half_w_, apex_v_ = vw_ / half_w_;
  }

  struct Extent {
    double lower, upper;  // empty where lower > upper
  };
  // Of the set over a strip of rows.
  Extent columns(double lower, double upper) const {
    const Factored& f = v_first_;
    const double a = std::max(-1.0, (lower - v_ - kPixel) / f.l11), b = std::min(1.0, (upper - v_ + kPixel) / f.l11);
    if (a > b) return {1, -1};
    return {u_ - f.widest(-b, -a) - kPixel, u_ + f.widest(a, b) + kPixel};
  }

  // Largest 1 / z over a pixel; kMiss when the set does not reach it.
  double highest(double left, double top, double right, double bottom) const {
    const double a = left - u_ - kPixel, b = right - u_ + kPixel, c = top - v_ - kPixel, d = bottom - v_ + kPixel;
    const bool in_u = a <= apex_u_ && apex_u_ <= b, in_v = c <= apex_v_ && apex_v_ <= d;
    if (in_u && in_v) return w_ + half_w_;
    double best = -std::numeric_limits<double>::infinity();
    if (!in_u) best = u_first_.highest(a > apex_u_ ? a : b, c, d);
    if (!in_v) best = std::max(best, v_first_.highest(c > apex_v_ ? c : d, a, b));
    return std::isfinite(best) ? w_ + best : kMiss;
  }

 private:
  // Cholesky factor: first = l11 s1, second = l21 s1 + l22 s2, height = l31 s1 + l32 s2 + l33 s3 over the unit ball.
  struct Factored {
    double l11 = 0, l21 = 0, l22 = 0, l31 = 0, l32 = 0, l33 = 0, best = 0, wide = 0;

    Factored() = default;
    Factored(double aa, double bb, double cc, double ab, double ac, double bc) {
      l11 = std::sqrt(aa), l21 = ab / l11, l31 = ac / l11;
      l22 = std::sqrt(std::max(bb - l21 * l21, kGrowth * bb / 4)), l32 = (bc - l21 * l31) / l22;
      l33 = std::sqrt(std::max(cc - l31 * l31 - l32 * l32, kGrowth * cc / 4));
      best = l32 / std::hypot(l32, l33), wide = l21 / std::hypot(l21, l22);
    }

    // Largest second coordinate for s1 between a and b, within [-1, 1].
    double widest(double a, double b) const {
      const double s = std::clamp(wide, a, b);
      return l21 * s + l22 * std::sqrt(std::max(0.0, (1 - s) * (1 + s)));
    }

    // Largest height on first = at, second between lower and upper; -infinity when there is no point.
    double highest(double at, double lower, double upper) const {
      const double t = at / l11;
      if (!(std::abs(t) <= 1)) return -std::numeric_limits<double>::infinity();
      const double w = std::sqrt((1 - t) * (1 + t)), shift = l21 * t;
      const double a = std::max(-w, (lower - shift) / l22), b = std::min(w, (upper - shift) / l22);
      if (a > b) return -std::numeric_limits<double>::infinity();
      const double s = std::clamp(best * w, a, b);
      return l31 * t + l32 * s + l33 * std::sqrt(std::max(0.0, (w - s) * (w + s)));
    }
  };

  static double grown(double square) { return square * (1 + kGrowth); }

  double u_, v_, w_, uu_, vv_, ww_, uv_, uw_, vw_, half_u_, half_v_, half_w_, apex_u_ = 0, apex_v_ = 0;
  Factored u_first_, v_first_;
};

// An ellipsoid around the part of a body between two depths, with half of the lower depth to spare.
Body cut(const Body& body, double from, double to) {
  const double a = body.depth, t1 = std::max(-1.0, (from - body.centre[2]) / a);
  const double t2 = std::min(1.0, (to - body.centre[2]) / a);
  for (double q = 1;; q *= 2) {
    const double middle = q * (t1 + t2) / (2 * (1 + q));
    const double square = std::max(0.0, 1 - q * t1 * t2 + (1 + q) * middle * middle), around = std::sqrt(square);
    const double along = around / std::sqrt(1 + q);
    if (body.centre[2] + a * (middle - along) < from / 2 && q < 0x1p40) continue;
    Triple d;
    for (std::size_t j = 0; j < 3; ++j) d[j] = body.row[2][j] / a;
    Body part{body.centre, body.row, a * along};
    for (std::size_t i = 0; i < 3; ++i) {
      const double forward = dot(body.row[i], d);
      part.centre[i] += forward * middle;
      for (std::size_t j = 0; j < 3; ++j)
        part.row[i][j] = around * body.row[i][j] + (along - around) * forward * d[j];
    }
    return part;
  }
}

// Whether a body may touch the ball around the camera.
bool touches_origin(const Body& body, double radius) {
  double sum = 0;
  for (std::size_t j = 0; j < 3; ++j) {
    const Triple axis{body.row[0][j], body.row[1][j], body.row[2][j]};
    const double square = dot(axis, axis), along = dot(axis, body.centre);
    sum += along * along / square / (3 * square + 1.5 * radius * radius);  // Sum with p = 1/2, see ellipsoid.hpp
  }
  return !(sum > 1 + 1e-9);
}

class Painter {
 public:
  Painter(const Pinhole& camera, const SightLimits& limits, Depth& depth)
      : camera_(camera),
        depth_(depth),
        start_(kStart * limits.near),
        fx_(double(camera.columns) / (camera.right - camera.left)),
        fy_(double(camera.rows) / (camera.bottom - camera.top)),
        ox_(-camera.left * fx_),
        oy_(-camera.top * fy_) {
    const double u = std::max(std::abs(camera.left), std::abs(camera.right));
    const double v = std::max(std::abs(camera.top), std::abs(camera.bottom));
    ball_ = start_ * std::sqrt(1 + u * u + v * v);
    most_ = std::sqrt(1 + u * u), most_v_ = std::sqrt(1 + v * v), u_ = u, v_ = v;
  }

  Triple to_camera(const Triple& world) const {
    const Triple r{world[0] - camera_.centre[0], world[1] - camera_.centre[1], world[2] - camera_.centre[2]};
    return {dot(camera_.rotation[0], r), dot(camera_.rotation[1], r), dot(camera_.rotation[2], r)};
  }

  // Whether a ball lies outside of the pyramid around the image, or behind the camera.
  bool misses(const Triple& c, double reach) const {
    if (c[2] < -reach) return true;
    return std::abs(c[0]) - u_ * c[2] > reach * most_ * (1 + 1e-6) ||
           std::abs(c[1]) - v_ * c[2] > reach * most_v_ * (1 + 1e-6);
  }

  Body body(const Triple& c, const std::array<Triple, 3>& row) const {
    Body body{c, {}, 0};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 3; ++j)
        body.row[i][j] = camera_.rotation[i][0] * row[0][j] + camera_.rotation[i][1] * row[1][j] +
                         camera_.rotation[i][2] * row[2][j];
    body.depth = std::sqrt(dot(body.row[2], body.row[2]));
    return body;
  }

  // Paints the set of one body, or of the part that two have in common.
  void paint(const Body& first, const Body* second) {
    const double far = std::min(first.centre[2] + first.depth,
                                second ? second->centre[2] + second->depth : std::numeric_limits<double>::infinity());
    if (far <= 0) return;
    if (first.centre[2] - first.depth >= start_ && (!second || second->centre[2] - second->depth >= start_)) {
      draw(first, second, std::numeric_limits<double>::infinity());
      return;
    }
    if (touches_origin(first, ball_) && (!second || touches_origin(*second, ball_))) depth_.blind = true;
    for (double from = start_; from < far; from *= 2) {
      if (first.centre[2] - first.depth > 2 * from || (second && second->centre[2] - second->depth > 2 * from))
        continue;
      const Body part = cut(first, from, 2 * from);
      if (second) {
        const Body other = cut(*second, from, 2 * from);
        draw(part, &other, 1 / from);
      } else {
        draw(part, nullptr, 1 / from);
      }
    }
  }

 private:
  void draw(const Body& first, const Body* second, double most) {
    Projection one(first, fx_, fy_, ox_, oy_);
    std::optional<Projection> two;
    double left = one.left(), right = one.right(), top = one.top(), bottom = one.bottom();
    most = std::min(most, one.nearest());
    if (second) {
      two.emplace(*second, fx_, fy_, ox_, oy_);
      left = std::max(left, two->left()), right = std::min(right, two->right());
      top = std::max(top, two->top()), bottom = std::min(bottom, two->bottom());
      most = std::min(most, two->nearest());
    }
    const double columns = double(camera_.columns), rows = double(camera_.rows);
    if (!(left - kPixel < columns && right + kPixel >= 0 && top - kPixel < rows && bottom + kPixel >= 0)) return;
    const auto first_row = at(top, rows), last_row = at(bottom + 2 * kPixel, rows);
    const auto first_column = at(left, columns), last_column = at(right + 2 * kPixel, columns);
    if (first_row == last_row && first_column == last_column) {
      mark(first_row, first_column, most);
      return;
    }
    one.factor();
    if (two) two->factor();
    for (std::size_t y = first_row; y <= last_row; ++y) {
      const double upper = double(y), lower = upper + 1;
      Projection::Extent extent = one.columns(upper, lower);
      if (two) {
        const Projection::Extent other = two->columns(upper, lower);
        extent = {std::max(extent.lower, other.lower), std::min(extent.upper, other.upper)};
      }
      if (extent.lower > extent.upper || extent.upper < 0 || extent.lower > columns) continue;
      const auto begin = at(extent.lower, columns), end = at(extent.upper, columns);
      for (std::size_t x = begin; x <= end; ++x) {
        double w = one.highest(double(x), upper, double(x) + 1, lower);
        if (w < 0) continue;
        if (two) {
          const double other = two->highest(double(x), upper, double(x) + 1, lower);
          if (other < 0) continue;
          w = std::min(w, other);
        }
        mark(y, x, std::min(w, most));
      }
    }
  }

  static std::size_t at(double position, double count) {
    return static_cast<std::size_t>(std::clamp(std::floor(position - kPixel), 0.0, count - 1));
  }

  void mark(std::size_t y, std::size_t x, double w) {
    float& pixel = depth_.nearness[y * camera_.columns + x];
    const float up = rounded_up(w);
    pixel = std::max(pixel, up);
  }

  const Pinhole& camera_;
  Depth& depth_;
  double start_, fx_, fy_, ox_, oy_, ball_ = 0, most_ = 0, most_v_ = 0, u_ = 0, v_ = 0;
};

}  // namespace

Occluders::Occluders(const Splats& splats, const Level& level, double worth, unsigned jobs, Control& control) {
  check_splats(splats, level, std::max(worth, 1e-12));
  constexpr std::size_t kChunk = 4096;
  std::vector<std::vector<Solid>> part((splats.size() + kChunk - 1) / kChunk);
  parallel_chunks(splats.size(), kChunk, jobs, control, [&](std::size_t begin, std::size_t end) {
    std::vector<Solid>& mine = part[begin / kChunk];
    const auto add = [&](const Ellipsoid& e, bool is_pair) {
      mine.push_back({e.centre, e.row, std::nextafter(static_cast<float>(e.reach), 1e30F), is_pair});
    };
    for (std::size_t i = begin; i < end; ++i) {
      const Bounds set = bounds_of(splats, i, level);
      const bool both = set.second && set.excess > worth;
      add(set.first, both);
      if (both) add(*set.second, false);
    }
  });
  for (std::vector<Solid>& mine : part) {
    solid_.insert(solid_.end(), mine.begin(), mine.end());
    std::vector<Solid>().swap(mine);
  }
}

Depth Occluders::depth(const Pinhole& camera, const SightLimits& limits) const {
  Depth depth;
  depth.nearness.assign(camera.columns * camera.rows, 0);
  Painter painter(camera, limits, depth);
  for (std::size_t i = 0; i < solid_.size(); ++i) {
    const Solid& first = solid_[i];
    const Solid* second = first.is_pair ? &solid_[++i] : nullptr;
    const Triple c = painter.to_camera(first.centre);
    if (painter.misses(c, first.reach)) continue;
    const Body one = painter.body(c, first.row);
    if (second) {
      const Body two = painter.body(painter.to_camera(second->centre), second->row);
      painter.paint(one, &two);
    } else {
      painter.paint(one, nullptr);
    }
  }
  const float without = rounded_up(1 / limits.range);
  for (float& pixel : depth.nearness)
    if (pixel == 0) pixel = without;
  return depth;
}

namespace {

// Voxels of a box in front of one camera's depth image.
class Sweep {
 public:
  Sweep(const Pinhole& camera, const Depth& depth, const SightLimits& limits, const DenseBox& box, double margin)
      : camera_(camera),
        depth_(depth),
        limits_(limits),
        box_(box),
        margin_(margin),
        fx_(double(camera.columns) / (camera.right - camera.left)),
        fy_(double(camera.rows) / (camera.bottom - camera.top)),
        ox_(-camera.left * fx_),
        oy_(-camera.top * fy_) {
    for (std::size_t k = 0; k < 8; ++k) {
      const double half = 0.5 * box.g;
      const Triple corner{k & 1 ? half : -half, k & 2 ? half : -half, k & 4 ? half : -half};
      for (std::size_t i = 0; i < 3; ++i) corner_[k][i] = dot(camera.rotation[i], corner);
    }
    frame();
  }

  // Counts the voxels that are seen.
  std::uint64_t run(std::span<const std::uint8_t> blocked, std::vector<std::uint16_t>& count, const Stop& stop) {
    for (std::size_t a = 0; a < 3; ++a)
      if (lower_[a] > upper_[a]) return 0;
    std::array<std::vector<std::int64_t>, 3> order;
    for (std::size_t a = 0; a < 3; ++a) {
      const std::int64_t here =
          std::clamp(static_cast<std::int64_t>(std::clamp(std::floor(at_[a]), -1e15, 1e15)), lower_[a], upper_[a]);
      for (std::int64_t i = here; i <= upper_[a]; ++i) order[a].push_back(i);
      for (std::int64_t i = here - 1; i >= lower_[a]; --i) order[a].push_back(i);
    }
    const auto extent = [&](std::size_t a) { return static_cast<std::size_t>(upper_[a] - lower_[a] + 1); };
    const std::size_t ny = extent(1), nz = extent(2);
    clear_.assign(extent(0) * ny * nz, 0);
    const auto place = [&](std::int64_t x, std::int64_t y, std::int64_t z) {
      return (static_cast<std::size_t>(x - lower_[0]) * ny + static_cast<std::size_t>(y - lower_[1])) * nz +
             static_cast<std::size_t>(z - lower_[2]);
    };
    std::uint64_t seen = 0;
    for (const std::int64_t x : order[0]) {
      stop.check();
      const double ex = at_[0] - (double(x) + 0.5);
      for (const std::int64_t y : order[1]) {
        const double ey = at_[1] - (double(y) + 0.5);
        const std::size_t row =
            (static_cast<std::size_t>(x) * box_.size[1] + static_cast<std::size_t>(y)) * box_.size[2];
        for (const std::int64_t z : order[2]) {
          const double ez = at_[2] - (double(z) + 0.5);
          const double most = std::max({std::abs(ex), std::abs(ey), std::abs(ez)});
          const std::size_t voxel = row + static_cast<std::size_t>(z);
          bool clear = true;
          if (most > 0.5) {  // not the camera's own voxel, which is free because the camera was there
            if (blocked[voxel] != 0) continue;
            const std::int64_t px = x + step(ex / most), py = y + step(ey / most), pz = z + step(ez / most);
            if (px >= lower_[0] && px <= upper_[0] && py >= lower_[1] && py <= upper_[1] && pz >= lower_[2] &&
                pz <= upper_[2])
              clear = clear_[place(px, py, pz)] != 0;
          }
          if (!clear) continue;
          clear_[place(x, y, z)] = 1;
          if (blocked[voxel] != 0 || !sees(ex, ey, ez)) continue;
          ++seen;
          std::atomic_ref<std::uint16_t>(count[voxel]).fetch_add(1, std::memory_order_relaxed);
        }
      }
    }
    return seen;
  }

 private:
  static std::int64_t step(double ratio) { return ratio >= 0.5 ? 1 : ratio <= -0.5 ? -1 : 0; }

  // Bounds of what the camera can see, in voxels from the corner of the box, and the camera's place.
  void frame() {
    const float least = *std::min_element(depth_.nearness.begin(), depth_.nearness.end());
    const double far = 1 / double(least);
    Triple low = camera_.centre, high = camera_.centre;
    for (std::size_t k = 0; k < 4; ++k) {
      const double u = k & 1 ? camera_.right : camera_.left, v = k & 2 ? camera_.bottom : camera_.top;
      for (std::size_t i = 0; i < 3; ++i) {
        const double x = camera_.centre[i] +
                         far * (camera_.rotation[0][i] * u + camera_.rotation[1][i] * v + camera_.rotation[2][i]);
        low[i] = std::min(low[i], x), high[i] = std::max(high[i], x);
      }
    }
    for (std::size_t a = 0; a < 3; ++a) {
      const double first = double(box_.lower[a]), last = double(box_.size[a]) - 1;
      at_[a] = camera_.centre[a] / box_.g - first;
      lower_[a] = static_cast<std::int64_t>(std::clamp(std::floor(low[a] / box_.g - first) - 1, 0.0, last + 1));
      upper_[a] = static_cast<std::int64_t>(std::clamp(std::floor(high[a] / box_.g - first) + 1, -1.0, last));
    }
  }

  // Whether a voxel is in the image and in front of every surface; e: from its centre to the camera [voxels].
  bool sees(double ex, double ey, double ez) const {
    const Triple to{-ex * box_.g, -ey * box_.g, -ez * box_.g};
    const Triple c{dot(camera_.rotation[0], to), dot(camera_.rotation[1], to), dot(camera_.rotation[2], to)};
    if (c[2] < limits_.near) return false;
    View view;
    if (!project(c, 1, view)) return false;
    if (margin_ > 0) {
      View grown;
      if (!project(c, 1 + 2 * margin_ / box_.g, grown)) return false;
    }
    // The pixel of the centre is surely touched, and decides for most voxels behind a surface.
    const double inverse = 1 / c[2];
    if (!(view.far * nearness(fx_ * c[0] * inverse + ox_, fy_ * c[1] * inverse + oy_) < 1)) return false;
    const auto first = static_cast<std::size_t>(view.left), last = static_cast<std::size_t>(view.right);
    std::optional<Outline> outline;
    for (auto y = static_cast<std::size_t>(view.top), end = static_cast<std::size_t>(view.bottom); y <= end; ++y) {
      const float* row = &depth_.nearness[y * camera_.columns];
      for (std::size_t x = first; x <= last; ++x) {
        if (view.far * double(row[x]) < 1) continue;
        if (!outline) outline.emplace(view.corner);
        if (!outline->misses(double(x), double(y))) return false;
      }
    }
    return true;
  }

  double nearness(double u, double v) const {
    const auto at = [](double position, std::size_t count) {
      return static_cast<std::size_t>(std::clamp(std::floor(position), 0.0, double(count) - 1));
    };
    return double(depth_.nearness[at(v, camera_.rows) * camera_.columns + at(u, camera_.columns)]);
  }

  using Corners = std::array<std::array<double, 2>, 8>;

  // The image of a cube as the lines through its outermost edges.
  class Outline {
   public:
    explicit Outline(const Corners& corner) {
      for (std::size_t i = 0; i < 8; ++i)
        for (std::size_t bit = 1; bit < 8; bit *= 2) {
          if ((i & bit) != 0) continue;
          const auto &a = corner[i], &b = corner[i | bit];
          for (const double sign : {1.0, -1.0}) {
            const double nx = sign * (b[1] - a[1]), ny = sign * (a[0] - b[0]);
            double most = nx * a[0] + ny * a[1];  // all corners are behind the line at their maximum along the normal
            const double edge = most;
            for (const auto& p : corner) most = std::max(most, nx * p[0] + ny * p[1]);
            if (most > edge + kPixel * (std::abs(nx) + std::abs(ny))) continue;
            line_[count_++] = {nx, ny, most + kPixel * (std::abs(nx) + std::abs(ny))};
          }
        }
    }

    // Whether a line separates the cube from a pixel.
    bool misses(double x, double y) const {
      for (std::size_t k = 0; k < count_; ++k) {
        const Line& line = line_[k];
        if (line.nx * (line.nx > 0 ? x : x + 1) + line.ny * (line.ny > 0 ? y : y + 1) > line.most) return true;
      }
      return false;
    }

   private:
    struct Line {
      double nx, ny, most;
    };
    std::array<Line, 24> line_{};
    std::size_t count_ = 0;
  };

  struct View {
    double left, top, right, bottom, far;  // pixels; largest depth
    Corners corner;                        // pixels
  };
  // False where the cube, its edge times a scale, is not wholly in the image and beyond the near limit.
  bool project(const Triple& c, double scale, View& view) const {
    double left = 1e300, right = -1e300, top = 1e300, bottom = -1e300, far = 0;
    for (std::size_t k = 0; k < 8; ++k) {
      const Triple& corner = corner_[k];
      const double z = c[2] + scale * corner[2];
      if (!(z >= limits_.near)) return false;
      const double inverse = 1 / z;
      const double u = fx_ * (c[0] + scale * corner[0]) * inverse + ox_;
      const double v = fy_ * (c[1] + scale * corner[1]) * inverse + oy_;
      view.corner[k] = {u, v};
      left = std::min(left, u), right = std::max(right, u), top = std::min(top, v), bottom = std::max(bottom, v);
      far = std::max(far, z);
    }
    view.left = left - kPixel, view.top = top - kPixel, view.right = right + kPixel, view.bottom = bottom + kPixel;
    view.far = far * kNearer;
    return view.left >= 0 && view.top >= 0 && view.right < double(camera_.columns) &&
           view.bottom < double(camera_.rows);
  }

  const Pinhole& camera_;
  const Depth& depth_;
  const SightLimits& limits_;
  const DenseBox& box_;
  double margin_, fx_, fy_, ox_, oy_;
  std::array<Triple, 8> corner_{};
  std::array<std::int64_t, 3> lower_{}, upper_{};
  Triple at_{};
  std::vector<std::uint8_t> clear_;
};

}  // namespace

Views observe(const Occluders& occluders, std::span<const Pinhole> cameras, const SightLimits& limits,
              const DenseBox& box, std::span<const std::uint8_t> blocked, double margin, unsigned jobs,
              Control& control) {
  if (cameras.size() > std::numeric_limits<std::uint16_t>::max())
    throw std::invalid_argument("more than 65,535 cameras");
  if (!(limits.near > 0 && limits.range > limits.near && std::isfinite(limits.range)))
    throw std::invalid_argument("the limits of sight need 0 < near < range");
  if (!(margin >= 0 && box.g > 0)) throw std::invalid_argument("margin and voxel size must not be negative");
  const std::size_t voxels = box.size[0] * box.size[1] * box.size[2];
  if (blocked.size() != voxels) throw std::invalid_argument("blocked does not have the box's size");
  Views views{std::vector<std::uint16_t>(voxels), std::vector<std::uint64_t>(cameras.size()),
              std::vector<std::uint8_t>(cameras.size())};
  parallel_chunks(cameras.size(), 1, jobs, control, [&](std::size_t begin, std::size_t, const Stop& stop) {
    const Depth depth = occluders.depth(cameras[begin], limits);
    views.blind[begin] = depth.blind ? 1 : 0;
    stop.check();
    if (!depth.blind)
      views.seen[begin] = Sweep(cameras[begin], depth, limits, box, margin).run(blocked, views.count, stop);
  });
  return views;
}

}  // namespace alula
