// Areas of the facets that half-spaces cut into a box.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "alula/geometry/vec3.hpp"

namespace alula::geometry {

// The solid {0 <= x <= extent, n_l . x <= d_l for all l}. Areas are rounded: they only rank planes and prove
// nothing.
class FacetArea {
 public:
  explicit FacetArea(Vec3 extent);

  void add(Vec3 normal, double offset);
  void remove(std::size_t plane) { plane_[plane + kFaces].is_there = false; }

  // Area of the facet on the plane with this number, in the order of `add`. O(planes).
  double operator()(std::size_t plane);

 private:
  static constexpr std::size_t kFaces = 6;
  struct Plane {
    Vec3 normal;  // of unit length
    double offset;
    bool is_there = true;
  };
  using Corner = std::array<double, 2>;

  std::vector<Plane> plane_;
  double reach_;  // half the length of a square on a plane that covers the box
  Vec3 centre_;
  std::vector<Corner> polygon_, clipped_;
};

}  // namespace alula::geometry
