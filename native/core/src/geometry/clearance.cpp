#include "alula/geometry/clearance.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/geometry/ellipsoid.hpp"

namespace alula {
namespace {

using geometry::Box;
using geometry::Bvh;
using geometry::from_rows;

constexpr std::uint32_t kNone = 0xffffffffu;
constexpr std::size_t kChunk = 256;  // segments that share a guess of the nearest obstacle

void check_starts(std::span<const std::int64_t> start, std::size_t rows, std::int64_t least, const char* what) {
  bool good = !start.empty() && start.front() == 0 && start.back() == static_cast<std::int64_t>(rows);
  for (std::size_t i = 0; good && i + 1 < start.size(); ++i) good = start[i + 1] - start[i] >= least;
  if (!good) throw std::invalid_argument(std::string(what) + " does not partition the rows");
}

// Bound on the depth of a point inside a polytope or ellipsoid: half the smallest width of its box.
double half_width(const Box& box) {
  const geometry::Vec3 size = box.upper - box.lower;
  return 0.5 * (1 + 1e-12) * std::min({size.x, size.y, size.z});
}

template <class BoxOf>
Bvh tree_over(std::size_t size, const BoxOf& box_of) {
  if (size >= kNone) throw std::invalid_argument("too many obstacles");
  return Bvh(static_cast<std::uint32_t>(size), box_of, half_width);
}

template <class Set>
std::vector<double> clearance_of_all(const Set& obstacles, std::span<const double> start, std::span<const double> end,
                                     double cap, unsigned jobs, Control& control) {
  if (start.size() != end.size()) throw std::invalid_argument("start and end differ in length");
  std::vector<double> result(start.size() / 3);
  const auto chunk = [&](std::size_t first, std::size_t last) {
    std::uint32_t nearest = kNone;
    std::vector<double> scratch;
    for (std::size_t i = first; i < last; ++i) {
      result[i] = obstacles.clearance(from_rows(&start[3 * i]), from_rows(&end[3 * i]), cap, nearest, scratch);
    }
  };
  if (result.size() <= kChunk) {
    chunk(0, result.size());  // too little work for a thread
  } else {
    parallel_chunks(result.size(), kChunk, jobs, control, chunk);
  }
  return result;
}

}  // namespace

PolytopeSet::PolytopeSet(std::span<const double> normals, std::span<const double> offsets,
                         std::span<const std::int64_t> plane_start, std::span<const double> vertices,
                         std::span<const std::int64_t> vertex_start)
    : normals_(normals.begin(), normals.end()),
      offsets_(offsets.begin(), offsets.end()),
      plane_start_(plane_start.begin(), plane_start.end()),
      vertex_start_(vertex_start.begin(), vertex_start.end()) {
  if (normals.size() != 3 * offsets.size() || plane_start.size() != vertex_start.size()) {
    throw std::invalid_argument("the arrays of the polytopes do not fit together");
  }
  check_starts(plane_start, offsets.size(), 4, "plane_start");
  check_starts(vertex_start, vertices.size() / 3, 1, "vertex_start");
  for (std::size_t i = 0; i + 2 < vertices.size(); i += 3) vertices_.push_back(from_rows(&vertices[i]));
  boxes_.resize(size());
  for (std::size_t k = 0; k < size(); ++k) {
    for (const geometry::Vec3 vertex : polytope(k).vertices) boxes_[k].include(vertex);
  }
  tree_ = tree_over(size(), [&](std::uint32_t k) { return boxes_[k]; });
}

geometry::PolytopeView PolytopeSet::polytope(std::size_t k) const {
  const auto plane = static_cast<std::size_t>(plane_start_[k]);
  const auto planes = static_cast<std::size_t>(plane_start_[k + 1]) - plane;
  const auto vertex = static_cast<std::size_t>(vertex_start_[k]);
  const auto vertices = static_cast<std::size_t>(vertex_start_[k + 1]) - vertex;
  return {{normals_.data() + 3 * plane, 3 * planes},
          {offsets_.data() + plane, planes},
          {vertices_.data() + vertex, vertices}};
}

double PolytopeSet::clearance(geometry::Vec3 a, geometry::Vec3 b, double cap, std::uint32_t& nearest,
                              std::vector<double>& scratch) const {
  return tree_.minimum(a, b - a, cap, nearest, [&](std::uint32_t k, double best) {
    return geometry::signed_distance(polytope(k), a, b, best, scratch);
  });
}

EllipsoidSet::EllipsoidSet(std::span<const float> mean, std::span<const float> scale,
                           std::span<const float> quat_wxyz, std::span<const float> loss, double k,
                           std::shared_ptr<const void> owner)
    : mean_(mean), scale_(scale), quat_(quat_wxyz), loss_(loss), k_(k), owner_(std::move(owner)) {
  if (mean.size() != scale.size() || 4 * mean.size() != 3 * quat_wxyz.size() ||
      (!loss.empty() && loss.size() != mean.size())) {
    throw std::invalid_argument("the arrays of the ellipsoids do not fit together");
  }
  tree_ = tree_over(size(), [&](std::uint32_t i) {
    const Level level = this->level(i);
    Box box = bounds(ellipsoid(i, level.sigma));
    const geometry::Vec3 ball{level.inflation, level.inflation, level.inflation};
    box.lower = box.lower - ball;
    box.upper = box.upper + ball;
    return box;
  });
}

Level EllipsoidSet::level(std::size_t i) const {
  return level_of({mean_, scale_, quat_, loss_}, i, {.sigma = k_, .inflation = 0});
}

geometry::Ellipsoid EllipsoidSet::ellipsoid(std::size_t i, double k) const {
  return geometry::gaussian_ellipsoid(&mean_[3 * i], &scale_[3 * i], &quat_[4 * i], k);
}

EllipsoidSet::Grown EllipsoidSet::grown(std::size_t i) const {
  const Level level = this->level(i);
  return {ellipsoid(i, level.sigma), level.inflation};
}

double EllipsoidSet::clearance(geometry::Vec3 a, geometry::Vec3 b, double cap, std::uint32_t& nearest,
                               std::vector<double>& scratch) const {
  (void)scratch;
  return tree_.minimum(a, b - a, cap, nearest, [&](std::uint32_t i, double best) {
    const Level level = this->level(i);
    return geometry::signed_distance(ellipsoid(i, level.sigma), a, b, best + level.inflation) - level.inflation;
  });
}

std::vector<double> segment_clearance(const PolytopeSet& obstacles, std::span<const double> start,
                                      std::span<const double> end, double cap, unsigned jobs, Control& control) {
  return clearance_of_all(obstacles, start, end, cap, jobs, control);
}

std::vector<double> segment_clearance(const EllipsoidSet& obstacles, std::span<const double> start,
                                      std::span<const double> end, double cap, unsigned jobs, Control& control) {
  return clearance_of_all(obstacles, start, end, cap, jobs, control);
}

}  // namespace alula
