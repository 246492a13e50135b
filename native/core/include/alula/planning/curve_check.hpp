// Proof that polynomial curves keep a distance from polytopes, for the continuous parameter.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/clearance.hpp"

namespace alula {

// Result for one piece of a curve.
struct CurveProof {
  bool proven = false;
  double clearance = 0;     // proven lower bound, at most twice the radius; when not proven, the
                            // distance of a point of the curve or of its control hull that fell short
  std::uint32_t pairs = 0;  // pairs of a sub-piece and a polytope that were decided
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

}  // namespace alula
