#include "alula/filters/polytope_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace alula {

namespace {

constexpr double kUnit = 0x1p-24;  // half a unit in the last place of a float in [1, 2)
constexpr float kBeyond = std::numeric_limits<float>::infinity();

void check(const Polytopes& polytopes, double extent_m) {
  const std::size_t planes = polytopes.offset.size();
  const auto& start = polytopes.plane_start;
  if (polytopes.normal.size() != 3 * planes) throw std::invalid_argument("normal and offset differ in length");
  if (planes > ALULA_MAX_PLANES) throw std::invalid_argument("more than 2^24 planes");
  if (start.empty() || start.front() != 0 || start.back() != static_cast<std::int64_t>(planes))
    throw std::invalid_argument("plane_start does not partition the planes");
  for (std::size_t k = 0; k + 1 < start.size(); ++k)
    if (start[k + 1] <= start[k]) throw std::invalid_argument("a hull without planes");
  if (!(extent_m > 0 && extent_m < 1e12)) throw std::invalid_argument("extent must be positive and below 1e12 m");
  for (std::size_t l = 0; l < planes; ++l) {
    const double* n = &polytopes.normal[3 * l];
    const double length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (!(std::abs(length - 1) <= 1e-9)) throw std::invalid_argument("a normal is not a unit vector");
    if (!(std::abs(polytopes.offset[l]) <= 2 * extent_m))
      throw std::invalid_argument("a plane lies farther from the origin than twice the extent");
  }
}

}  // namespace

float round_up(double value) {
  const float nearest = static_cast<float>(value);
  return static_cast<double>(nearest) < value ? std::nextafterf(nearest, kBeyond) : nearest;
}

float round_down(double value) { return -round_up(-value); }

PolytopeMap make_polytope_map(const Polytopes& polytopes, double extent_m) {
  check(polytopes, extent_m);
  PolytopeMap map;
  const std::size_t hulls = polytopes.plane_start.size() - 1;
  map.extent_m = round_up(extent_m);
  map.plane.reserve(4 * polytopes.offset.size());
  map.plane_start.assign(polytopes.plane_start.begin(), polytopes.plane_start.end());
  map.lower.assign(3 * hulls, -std::numeric_limits<float>::max());
  map.upper.assign(3 * hulls, std::numeric_limits<float>::max());
  double slack = 0;
  for (std::size_t k = 0; k < hulls; ++k) {
    for (std::size_t l = map.plane_start[k]; l < map.plane_start[k + 1]; ++l) {
      const double* n = &polytopes.normal[3 * l];
      const double sum = (std::abs(n[0]) + std::abs(n[1]) + std::abs(n[2])) * map.extent_m;
      const double d = polytopes.offset[l];
      const float offset = round_up(d + kUnit * (10 * sum + 2 * std::abs(d)));
      const std::array<float, 3> normal{static_cast<float>(n[0]), static_cast<float>(n[1]), static_cast<float>(n[2])};
      map.plane.insert(map.plane.end(), {normal[0], normal[1], normal[2], offset});
      slack = std::max(slack, kUnit * (12 * sum + 4 * std::abs(d)));
      for (std::size_t i = 0; i < 3; ++i) {
        if (normal[(i + 1) % 3] != 0 || normal[(i + 2) % 3] != 0) continue;
        float& lower = map.lower[3 * k + i];
        float& upper = map.upper[3 * k + i];
        if (normal[i] == 1) upper = std::min(upper, offset);
        if (normal[i] == -1) lower = std::max(lower, -offset);
      }
    }
  }
  map.slack_m = round_up(slack);
  return map;
}

alula_polytope_map PolytopeMap::view() const {
  return {.plane = plane.data(),
          .plane_start = plane_start.data(),
          .lower = lower.data(),
          .upper = upper.data(),
          .hull_count = static_cast<std::uint32_t>(plane_start.size() - 1),
          .extent_m = extent_m,
          .slack_m = slack_m};
}

}  // namespace alula
