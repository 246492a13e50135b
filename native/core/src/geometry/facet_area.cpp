#include "alula/geometry/facet_area.hpp"

#include <cmath>
#include <utility>

namespace alula::geometry {

FacetArea::FacetArea(Vec3 extent) : reach_(norm(extent)), centre_(0.5 * extent) {
  for (int i = 0; i < 3; ++i) {
    Vec3 axis;
    axis[i] = 1;
    plane_.push_back({axis, extent[i]});
    plane_.push_back({-1.0 * axis, 0});
  }
}

void FacetArea::add(Vec3 normal, double offset) {
  const double length = norm(normal);
  plane_.push_back({(1 / length) * normal, offset / length});
}

double FacetArea::operator()(std::size_t plane) {
  const Plane& own = plane_[plane + kFaces];
  // Two directions along the plane, from the axis that is most perpendicular to its normal.
  int across = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(own.normal[i]) < std::abs(own.normal[across])) across = i;
  const auto cross = [](Vec3 a, Vec3 b) {
    return Vec3{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  };
  Vec3 axis;
  axis[across] = 1;
  Vec3 u = cross(own.normal, axis);
  u = (1 / norm(u)) * u;
  const Vec3 v = cross(own.normal, u);
  const Vec3 middle = centre_ + (own.offset - dot(own.normal, centre_)) * own.normal;

  polygon_ = {{-reach_, -reach_}, {reach_, -reach_}, {reach_, reach_}, {-reach_, reach_}};
  for (const Plane& other : plane_) {
    if (&other == &own || !other.is_there) continue;
    const double a = dot(other.normal, u), b = dot(other.normal, v), d = other.offset - dot(other.normal, middle);
    auto beyond = [&](const Corner& c) { return a * c[0] + b * c[1] - d; };
    clipped_.clear();
    for (std::size_t i = 0; i < polygon_.size(); ++i) {
      const Corner &p = polygon_[i], &q = polygon_[(i + 1) % polygon_.size()];
      const double at_p = beyond(p), at_q = beyond(q);
      if (at_p <= 0) clipped_.push_back(p);
      if ((at_p < 0 && at_q > 0) || (at_p > 0 && at_q < 0)) {
        const double t = at_p / (at_p - at_q);
        clipped_.push_back({p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])});
      }
    }
    std::swap(polygon_, clipped_);
    if (polygon_.size() < 3) return 0;
  }
  double twice = 0;
  for (std::size_t i = 0; i < polygon_.size(); ++i) {
    const Corner &p = polygon_[i], &q = polygon_[(i + 1) % polygon_.size()];
    twice += p[0] * q[1] - p[1] * q[0];
  }
  return 0.5 * std::abs(twice);
}

}  // namespace alula::geometry
