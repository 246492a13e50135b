// Velocities that leave the collision cones ahead without losing speed.
#pragma once

#include <array>
#include <span>

#include "alula/filters/collision_cone.hpp"

namespace alula::flight {

struct EscapeOptions {
  double slack_rad = 0.05;  // angle added beyond the tangent
  double most_rad = 1.3;    // maximum turn
  double least_speed_m_s = 0.3;
};

inline constexpr std::size_t kEscapes = 8;
struct Escapes {
  std::array<Vec3, kEscapes> velocity;  // by the angle from v, smallest first
  std::array<double, kEscapes> turn;    // [rad]
  std::size_t count = 0;
};

// For eight directions about v (level left first, then by 45 degrees over the top): v turned by the smallest angle
// after which its ray meets no cone of `near`. Ellipsoids that contain the vehicle are left out, and numbers that are
// not of the index. In the plane of v
// and a direction, h is a quadratic form in (cos, sin) of the angle, so leaving a cone means solving a quadratic;
// passes repeat until no cone is met. The result is empty below `least_speed_m_s`.
Escapes escape_velocities(const EllipsoidIndex& index, std::span<const Found> near, Vec3 p, Vec3 v,
                          const EscapeOptions& options = {});

}  // namespace alula::flight
