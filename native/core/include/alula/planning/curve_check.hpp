// Proof that polynomial curves keep a distance from obstacles, for the continuous parameter.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/clearance.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula {

// Result for one piece of a curve.
struct CurveProof {
  bool proven = false;
  double clearance = 0;     // proven lower bound, at most twice the radius; when not proven, the
                            // distance of a point of the curve or of its control hull that fell short
  std::uint32_t pairs = 0;  // pairs of a sub-piece and a polytope, or sub-pieces in a map, that were decided
  std::uint32_t depth = 0;  // of the deepest subdivision
};

// Checks curves given by the control points of their Bernstein form, 8 points (24 numbers) each.
//
// A curve lies in the convex hull of its control points. A sub-piece is proven clear of a polytope
// when a plane separates that hull from the polytope's vertices with a gap >= radius + slack; the
// plane is found as the one between the closest points of the two. Otherwise the sub-piece is
// halved by de Casteljau's construction, at most max_depth times, unless one of its ends is a
// point of the curve closer than radius. Polytopes whose boxes are farther than 2 (radius + slack)
// from the box of the piece are clear. `slack[i]` bounds all errors of the control points of
// curve i and of the arithmetic here; the caller derives it.
std::vector<CurveProof> check_curves(const PolytopeSet& obstacles, std::span<const double> control_points,
                                     std::span<const double> slack, double radius, std::uint32_t max_depth,
                                     unsigned jobs, Control& control);

// The same among the obstacles of any map, by its distances.
//
// Control points, and so the curve, are no farther from the chord between a sub-piece's ends than delta, their
// largest distance from it. A sub-piece is proven clear when the distance of the chord less delta is >= radius +
// slack, less the error that maps allow themselves (1e-9 of the reach, for which 1e-8 is taken). Delta falls with the
// square of the length, so a straight piece is decided at once.
std::vector<CurveProof> check_curves(const ObstacleMap& map, std::span<const double> control_points,
                                     std::span<const double> slack, double radius, std::uint32_t max_depth,
                                     unsigned jobs, Control& control);

}  // namespace alula
