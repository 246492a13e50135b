#include "alula/cover/image_map.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <utility>

#include "alula/base/constants.hpp"
#include "alula/base/require.hpp"

namespace alula {
namespace {

constexpr double kPiece = 2e-3;       // length of the pieces of a segment [m], of which there are
constexpr double kMostPieces = 4096;  // at most so many
constexpr int kMostBalls = 256;       // that a sweep is covered by

double psi_of(const alula_map_value& value) { return value.psi_m < FLT_MAX ? double{value.psi_m} : kInfinity; }

}  // namespace

ImageMap::ImageMap(std::shared_ptr<const OnboardImage> image) : image_(std::move(image)) {
  require(image_ != nullptr, "a map of an image needs an image");
}

alula_map_value ImageMap::value(geometry::Vec3 p) const {
  const float x[3] = {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
  alula_map_value found{};
  if (alula_map_evaluate(&image_->map(), x, &found) != ALULA_MAP_READY) found.psi_m = -FLT_MAX;
  return found;
}

double ImageMap::distance(geometry::Vec3 p, double, MapMemory&) const { return psi_of(value(p)); }

double ImageMap::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory&) const {
  const double length = norm(b - a), pieces = std::clamp(std::ceil(length / kPiece), 1.0, kMostPieces);
  const double half = length / pieces / 2;
  double least = upto;
  for (double i = 0; i < pieces; ++i) {
    const double psi = psi_of(value(a + (i + 0.5) / pieces * (b - a)));
    least = std::min(least, psi - half);
    if (half > 0 && psi - half > least)
      i += std::floor((psi - least - half) / (2 * half));  // not below `least` there
  }
  return std::max(0.0, least);
}

void ImageMap::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found, MapMemory&) const {
  const alula_map_value at = value(p);
  const double psi = psi_of(at);
  found.clear();
  if (most == 0 || !(psi < reach) || at.hull == ALULA_MAP_NO_HULL) return;
  geometry::Vec3 normal{double{at.normal[0]}, double{at.normal[1]}, double{at.normal[2]}};
  normal = 1 / norm(normal) * normal;
  found.push_back({ObstacleKind::hull, at.hull, psi, normal, p - psi * normal});
}

bool ImageMap::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory&) const {
  if (!is_finite(a) || !is_finite(b) || !is_size(d)) return false;
  const double length = norm(b - a), needed = (1 + 1e-8) * d + 1e-9;
  double along = 0;
  for (int ball = 0; ball < kMostBalls; ++ball) {
    const double free = psi_of(value(length > 0 ? a + along / length * (b - a) : a)) - needed;
    if (!(free > 0)) return false;
    along += (1 - 1e-9) * free;
    if (along >= length) return true;
  }
  return false;
}

}  // namespace alula
