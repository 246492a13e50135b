// Exact corners and facets of polytopes that are given by integer planes alone.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/cover/lattice_hull.hpp"

namespace alula {

// The boundary of {x : normal . x <= offset}: corners in double precision and outward triangles
// (counter-clockwise from outside) that close over them.
struct OuterSolid {
  std::vector<double> point;           // (P, 3)
  std::vector<std::int64_t> triangle;  // (T, 3), rows of point
  bool is_lattice = true;              // every corner is integer
};

// Enumerates in integers: along the line of each pair of planes, the other planes leave a segment. Its
// ends are corners p = N / D by Cramer's rule. The sign of n . N - d D says whether a plane cuts an end.
// With |n_i| < 2^15, and offsets below 2^37 relative to the box of the six axis planes,
// |N| < 2^70 and |D| < 2^48, so every sign is exact in 128 bits. Corners are rounded only at
// the end, to within 2^-51 of the box's largest coordinate or extent; integer corners are exact.
// Planes that only touch the solid in an edge or a corner have no triangles.
//
// Throws std::invalid_argument when the axis planes do not bound a box within kLatticeLimit, a normal
// is longer, or the planes leave no volume. Time O(F^3) for F planes.
OuterSolid outer_solid(std::span<const LatticePlane> planes);

}  // namespace alula
