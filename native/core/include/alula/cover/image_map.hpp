// The image of an onboard map as an obstacle map, read in place.
#pragma once

#include <memory>

#include "alula/cover/onboard_image.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula {

// Distances are the psi of `alula_map_evaluate`: never above the distance to the hulls of the cover, and 1-Lipschitz
// but for a margin of 2^-18 of the coordinates, by which the computed value is too small. psi is the largest distance
// to a plane of a hull, so it is less than the Euclidean distance beyond an edge. The image's hulls are those of the
// cover rounded outward: a map of its own, whose certificates also hold for the cover.
//
// The image is one obstacle: `near` returns the hull that decides psi alone. `segment_distance` is up to 1 mm, or
// 1/4096 of the segment, too small. A query reads all hulls at O(hulls) per evaluated point.
class ImageMap final : public ObstacleMap {
 public:
  // Throws std::invalid_argument without an image.
  explicit ImageMap(std::shared_ptr<const OnboardImage> image);

  MapMemory memory() const override { return {}; }
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  alula_map_value value(geometry::Vec3 p) const;

  std::shared_ptr<const OnboardImage> image_;
};

}  // namespace alula
