#include "alula/cover/touch_check.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <mutex>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "alula/base/parallel.hpp"
#include "alula/base/require.hpp"

namespace alula {

namespace {

using Piece = std::array<Triple, 3>;

constexpr double kRounding = std::numeric_limits<double>::epsilon() / 2;
constexpr double kGap = 64 * kRounding;
constexpr int kHalvings = 48;
constexpr double kSpan = 4;  // voxels that the box of a piece spans
constexpr std::size_t kMostMissing = std::size_t{1} << 25;

Triple difference(const Triple& a, const Triple& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
double product(const Triple& a, const Triple& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Triple normal_of(const Triple& a, const Triple& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// Point of the segment from a to b that is nearest to p.
Triple nearest_on_edge(const Triple& a, const Triple& b, const Triple& p) {
  const Triple along = difference(b, a);
  const double square = product(along, along);
  const double t = square > 0 ? std::clamp(product(difference(p, a), along) / square, 0.0, 1.0) : 0.0;
  return {a[0] + t * along[0], a[1] + t * along[1], a[2] + t * along[2]};
}

bool contains(const VoxelSet& set, const Index3& v) {
  const VoxelSet::Bits* bits = set.brick({v[0] >> 3, v[1] >> 3, v[2] >> 3});
  return bits != nullptr && ((*bits)[static_cast<std::size_t>(v[0] & 7)] >> (8 * (v[1] & 7) + (v[2] & 7)) & 1u);
}

// Proofs about one triangle and its ball.
class TouchProver {
 public:
  TouchProver(const double* corners, double radius, double g) : radius_(radius), g_(g) {
    double far = 0;
    for (std::size_t i = 0; i < 9; ++i) {
      whole_[i / 3][i % 3] = corners[i];
      far = std::max(far, std::abs(corners[i]));
    }
    gap_ = kGap * (far + radius + 2 * g);
  }

  // Calls missing(voxel) for each voxel of the range outside of the set that is not proven to be untouched; a voxel
  // may be named more than once.
  template <class Missing>
  void visit(const CropRange& range, const VoxelSet& set, const Stop& stop, Missing&& missing) const {
    visit_piece(whole_, 0, range, set, stop, missing);
  }

 private:
  template <class Missing>
  void visit_piece(const Piece& piece, int depth, const CropRange& range, const VoxelSet& set, const Stop& stop,
                   Missing&& missing) const {
    stop.check();
    Triple low = piece[0], high = piece[0];
    for (const Triple& corner : piece)
      for (std::size_t a = 0; a < 3; ++a)
        low[a] = std::min(low[a], corner[a]), high[a] = std::max(high[a], corner[a]);
    double span = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      span = std::max(span, high[a] - low[a]);
      low[a] = std::floor((low[a] - radius_ - gap_) / g_), high[a] = std::floor((high[a] + radius_ + gap_) / g_);
    }
    const Block near = clipped_block(low, high, range);
    if (near.empty()) return;
    if (span > kSpan * g_ && depth < kHalvings) {
      std::size_t longest = 0;
      double most = -1;
      for (std::size_t k = 0; k < 3; ++k) {
        const Triple edge = difference(piece[(k + 1) % 3], piece[k]);
        if (const double square = product(edge, edge); square > most) most = square, longest = k;
      }
      Triple middle;
      for (std::size_t a = 0; a < 3; ++a) middle[a] = std::midpoint(piece[longest][a], piece[(longest + 1) % 3][a]);
      Piece first = piece, second = piece;
      first[(longest + 1) % 3] = middle, second[longest] = middle;
      visit_piece(first, depth + 1, range, set, stop, missing);
      visit_piece(second, depth + 1, range, set, stop, missing);
      return;
    }
    Index3 v;
    for (v[0] = near.lower[0]; v[0] <= near.upper[0]; ++v[0]) {
      stop.check();
      for (v[1] = near.lower[1]; v[1] <= near.upper[1]; ++v[1])
        for (v[2] = near.lower[2]; v[2] <= near.upper[2]; ++v[2])
          if (!contains(set, v) && !proves(piece, v)) missing(v);
    }
  }

  bool proves(const Piece& piece, const Index3& v) const {
    Triple low, high;
    for (std::size_t a = 0; a < 3; ++a) low[a] = v[a] * g_, high[a] = (v[a] + 1.0) * g_;
    const std::array<Triple, 3> edge{difference(piece[1], piece[0]), difference(piece[2], piece[1]),
                                     difference(piece[0], piece[2])};
    if (parts(normal_of(edge[0], edge[1]), piece, low, high)) return true;
    for (std::size_t a = 0; a < 3; ++a) {
      Triple axis{};
      axis[a] = 1;
      if (parts(axis, piece, low, high)) return true;
      for (const Triple& e : edge)
        if (parts(normal_of(axis, e), piece, low, high)) return true;
    }
    if (radius_ == 0) return false;
    for (const Triple& corner : piece) {
      Triple inside;
      for (std::size_t a = 0; a < 3; ++a) inside[a] = std::clamp(corner[a], low[a], high[a]);
      if (parts(difference(inside, corner), piece, low, high)) return true;
    }
    for (unsigned c = 0; c < 8; ++c) {
      const Triple at{c & 1 ? high[0] : low[0], c & 2 ? high[1] : low[1], c & 4 ? high[2] : low[2]};
      for (std::size_t k = 0; k < 3; ++k)
        if (parts(difference(at, nearest_on_edge(piece[k], piece[(k + 1) % 3], at)), piece, low, high)) return true;
    }
    return false;
  }

  // True if planes with the normal n part the piece and its ball from the box; n may have any length and sign.
  bool parts(Triple n, const Piece& piece, const Triple& low, const Triple& high) const {
    const double largest = std::max({std::abs(n[0]), std::abs(n[1]), std::abs(n[2])});
    if (!(largest > 0) || !std::isfinite(largest)) return false;
    double length = 0;
    for (double& c : n) {
      c /= largest;
      if (std::abs(c) < 0x1p-100) c = 0;
      length += std::abs(c);
    }
    const double margin = radius_ * std::sqrt(product(n, n)) + gap_ * length;
    double least = 0, most = 0;  // of the box
    for (std::size_t a = 0; a < 3; ++a) {
      least += n[a] * (n[a] > 0 ? low[a] : high[a]);
      most += n[a] * (n[a] > 0 ? high[a] : low[a]);
    }
    const double p = product(n, piece[0]), q = product(n, piece[1]), r = product(n, piece[2]);
    return std::max({p, q, r}) + margin < least || most + margin < std::min({p, q, r});
  }

  Piece whole_;
  double radius_, g_, gap_ = 0;
};

void check(std::span<const double> corners, double radius, double g, std::span<const std::int32_t> index) {
  require(corners.size() % 9 == 0 && index.size() % 3 == 0, "corners and voxels must be rows of three");
  require(g > 0 && std::isfinite(g), "the voxel size must be positive and finite");
  require(radius >= 0 && std::isfinite(radius), "the radius must be finite and not negative");
  require(std::all_of(corners.begin(), corners.end(), [](double v) { return std::isfinite(v); }),
          "coordinates must be finite");
}

Unproven listed(VoxelCounts missing) {
  Unproven out;
  out.total = missing.count.size();
  missing.index.resize(3 * std::min(out.total, Unproven::kMaxListed));
  out.voxel = std::move(missing.index);
  out.ellipsoid.assign(out.voxel.size() / 3, -1);
  return out;
}

}  // namespace

Unproven unproven_triangles(std::span<const double> corners, double radius, double voxel_size,
                            const std::optional<Box6>& crop, std::uint32_t min_count,
                            std::span<const std::int32_t> index, unsigned jobs, Control& control) {
  check(corners, radius, voxel_size, index);
  const CropRange range = crop_range(crop, voxel_size);
  const VoxelSet set(index);
  OverlapGrid grid;
  std::atomic<std::size_t> found{0};
  const std::size_t most = kMostMissing + (std::max(min_count, 1u) - 1) * std::size_t{4} * OverlapGrid::kMaxVoxels;
  parallel_chunks(corners.size() / 9, 64, jobs, control, [&](std::size_t begin, std::size_t end, const Stop& stop) {
    OverlapGrid::Writer writer(grid);
    std::vector<Index3> mine;
    for (std::size_t i = begin; i < end; ++i) {
      mine.clear();
      TouchProver(&corners[9 * i], radius, voxel_size).visit(range, set, stop, [&](const Index3& v) {
        mine.push_back(v);
        if (mine.size() > 4 * kMostMissing) throw std::overflow_error("a triangle touches too many missing voxels");
      });
      std::sort(mine.begin(), mine.end());
      mine.erase(std::unique(mine.begin(), mine.end()), mine.end());
      for (const Index3& v : mine) writer.add({v[0], v[1], v[2], v[2]});
      if ((found += mine.size()) > most)
        throw std::overflow_error("the triangles touch more than " + std::to_string(most) +
                                  " times a voxel that is not there");
    }
    writer.finish();
  });
  Control quiet;
  Unproven out = listed(grid.collect(std::max(min_count, 1u), jobs, quiet));
  for (std::size_t v = 0; v < out.ellipsoid.size(); ++v) {
    Triple at;
    for (std::size_t a = 0; a < 3; ++a) at[a] = out.voxel[3 * v + a];
    const VoxelSet none(std::span<const std::int32_t>{});
    std::atomic<bool> never{false};
    for (std::size_t i = 0; i < corners.size() / 9 && out.ellipsoid[v] < 0; ++i)
      TouchProver(&corners[9 * i], radius, voxel_size).visit({at, at}, none, Stop(never), [&](const Index3&) {
        out.ellipsoid[v] = static_cast<std::int64_t>(i);
      });
  }
  return out;
}

namespace {

enum class Sign { kNegative, kPositive, kUnknown };

Sign sign_of(double value, double error) {
  return value > error ? Sign::kPositive : value < -error ? Sign::kNegative : Sign::kUnknown;
}

// Sign of the area of the triangle of p, a, b seen along x: differences have one rounding, products two more.
Sign side(const Triple& a, const Triple& b, double y, double z) {
  const double ay = a[1] - y, az = a[2] - z, by = b[1] - y, bz = b[2] - z;
  const double left = ay * bz, right = az * by;
  return sign_of(left - right, 8 * kRounding * (std::abs(left) + std::abs(right)));
}

// Crossing of the ray from p in the direction of x with a triangle: 0, 1 or -1; unknown is 2.
int crossing(const double* row, const Triple& p) {
  std::array<Triple, 3> t;
  double most = -std::numeric_limits<double>::infinity(), least = -most, far = 0;
  bool left = true, right = true, below = true, above = true;
  for (std::size_t k = 0; k < 3; ++k) {
    t[k] = {row[3 * k], row[3 * k + 1], row[3 * k + 2]};
    most = std::max(most, t[k][0]), least = std::min(least, t[k][0]);
    left &= t[k][1]<p[1], right &= t[k][1]> p[1], below &= t[k][2]<p[2], above &= t[k][2]> p[2];
    for (std::size_t a = 0; a < 3; ++a) far = std::max(far, std::abs(t[k][a] - p[a]));
  }
  if (most < p[0] || left || right || below || above) return 0;
  std::array<Sign, 3> sign;
  for (std::size_t k = 0; k < 3; ++k) sign[k] = side(t[k], t[(k + 1) % 3], p[1], p[2]);
  const auto any = [&](Sign s) { return sign[0] == s || sign[1] == s || sign[2] == s; };
  if (any(Sign::kNegative) && any(Sign::kPositive)) return 0;
  if (any(Sign::kUnknown)) return 2;
  const int turn = sign[0] == Sign::kPositive ? 1 : -1;
  if (least > p[0]) return turn;
  // The volume of p and the triangle, whose sign tells on which side of its plane p lies.
  const Triple a = difference(t[0], p), b = difference(t[1], p), c = difference(t[2], p);
  const double volume = product(a, normal_of(b, c));
  const Sign where = sign_of(volume, 64 * kRounding * far * far * far);
  if (where == Sign::kUnknown) return 2;
  return (where == Sign::kPositive) == (turn == 1) ? turn : 0;
}

// Triangles by the rows of voxels (y, z) that their boxes touch.
struct Rows {
  std::int32_t y0, z0, ny, nz;
  std::vector<std::size_t> start;
  std::vector<std::uint32_t> triangle;

  std::size_t at(std::int32_t y, std::int32_t z) const {
    return static_cast<std::size_t>(y - y0) * static_cast<std::size_t>(nz) + static_cast<std::size_t>(z - z0);
  }
};

Block box_of(const double* row, std::size_t count, double g) {
  std::array<double, 3> low, high;
  for (std::size_t a = 0; a < 3; ++a) {
    low[a] = high[a] = row[a];
    for (std::size_t k = 1; k < count; ++k)
      low[a] = std::min(low[a], row[3 * k + a]), high[a] = std::max(high[a], row[3 * k + a]);
    low[a] = std::floor(low[a] / g) - 1, high[a] = std::floor(high[a] / g) + 1;
  }
  return clipped_block(low, high, crop_range(std::nullopt, g));
}

Rows rows_of(std::span<const double> corners, const Block& all, double g) {
  Rows out{all.lower[1], all.lower[2], all.upper[1] - all.lower[1] + 1, all.upper[2] - all.lower[2] + 1, {}, {}};
  require(double(out.ny) * out.nz < 0x1p28, "the surface spans too many voxels");
  out.start.assign(static_cast<std::size_t>(out.ny) * static_cast<std::size_t>(out.nz) + 1, 0);
  const auto each = [&](auto&& visit) {
    for (std::size_t i = 0; i < corners.size() / 9; ++i) {
      const Block box = box_of(&corners[9 * i], 3, g);
      for (std::int32_t y = box.lower[1]; y <= box.upper[1]; ++y)
        for (std::int32_t z = box.lower[2]; z <= box.upper[2]; ++z) visit(out.at(y, z), i);
    }
  };
  each([&](std::size_t row, std::size_t) { ++out.start[row + 1]; });
  std::partial_sum(out.start.begin(), out.start.end(), out.start.begin());
  std::vector<std::size_t> next(out.start.begin(), out.start.end() - 1);
  out.triangle.resize(out.start.back());
  each([&](std::size_t row, std::size_t i) { out.triangle[next[row]++] = static_cast<std::uint32_t>(i); });
  return out;
}

}  // namespace

Unproven unproven_outside(std::span<const double> corners, double voxel_size, const std::optional<Box6>& crop,
                          std::span<const std::int32_t> index, unsigned jobs, Control& control) {
  check(corners, 0, voxel_size, index);
  if (corners.empty()) return {};
  const double g = voxel_size;
  const Block all = box_of(corners.data(), corners.size() / 3, g);
  const Rows rows = rows_of(corners, all, g);
  std::array<double, 3> low, high;
  for (std::size_t a = 0; a < 3; ++a) low[a] = all.lower[a], high[a] = all.upper[a];
  const Block within = clipped_block(low, high, crop_range(crop, g));
  if (within.empty()) return {};
  const VoxelSet set(index);
  OverlapGrid grid;

  // True if the winding number around some point of voxel v is proven to be 0.
  const auto is_outside = [&](const Index3& v) {
    const std::size_t row = rows.at(v[1], v[2]);
    constexpr std::array<double, 6> kPlace{0.5, 0.381966, 0.6442177, 0.29289, 0.7320508, 0.4567};
    for (std::size_t k = 0; k < kPlace.size(); ++k) {
      const Triple p{(v[0] + 0.5) * g, (v[1] + kPlace[k]) * g, (v[2] + kPlace[(k + 2) % kPlace.size()]) * g};
      int sum = 0;
      bool is_known = true;
      for (std::size_t i = rows.start[row]; is_known && i < rows.start[row + 1]; ++i) {
        const int found = crossing(&corners[9 * rows.triangle[i]], p);
        is_known = found != 2;
        sum += found;
      }
      if (is_known) return sum == 0;
    }
    return false;
  };
  const auto count = static_cast<std::size_t>(within.upper[1] - within.lower[1] + 1);
  parallel_chunks(count, 1, jobs, control, [&](std::size_t begin, std::size_t, const Stop& stop) {
    OverlapGrid::Writer writer(grid);
    const std::int32_t y = within.lower[1] + static_cast<std::int32_t>(begin);
    for (std::int32_t z = within.lower[2]; z <= within.upper[2]; ++z) {
      stop.check();
      for (std::int32_t x = within.lower[0]; x <= within.upper[0]; ++x) {
        if (contains(set, {x, y, z})) continue;
        std::int32_t last = x;
        while (last < within.upper[0] && !contains(set, {last + 1, y, z})) ++last;
        const bool is_beyond = x == all.lower[0] || last == all.upper[0];  // no triangle reaches these voxels
        if (!is_beyond && !is_outside({x, y, z}))
          for (std::int32_t i = x; i <= last; ++i) writer.add({i, y, z, z});
        x = last;
      }
    }
    writer.finish();
  });
  Control quiet;
  return listed(grid.collect(1, jobs, quiet));
}

}  // namespace alula
