// Single-precision map of native/onboard, made from double-precision polytopes.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula_polytope_cbf.h"

namespace alula {

// Convex polytopes {x : n . x <= d} with unit outward normals, world frame, metres.
struct Polytopes {
  std::span<const double> normal;             // (F, 3)
  std::span<const double> offset;             // (F)
  std::span<const std::int64_t> plane_start;  // (n + 1)
};

// Owns the arrays that an alula_polytope_map points to.
struct PolytopeMap {
  std::vector<float> plane;                // (F, 4): normal, offset
  std::vector<std::uint32_t> plane_start;  // (n + 1)
  std::vector<float> lower, upper;         // (n, 3)
  float extent_m = 0;
  float slack_m = 0;

  alula_polytope_map view() const;
};

// Rounds planes outward: for every p with |p_i| <= extent_m, the value that the onboard code computes
// at p rounded to float, or at a float sum within three roundings of p, is at most n . p - d.
//
// With u = 2^-24, s = |n_1| + |n_2| + |n_3| <= sqrt 3 and E = extent: rounding the normal costs
// u s E, three roundings of the position 3 u s E, the products and sums 3 u s E + u (s E + |d|),
// so 8 u s E + u |d|; the offset is moved by 10 u s E + 2 u |d| and then rounded up.
//
// O(F). Throws std::invalid_argument when arrays do not fit together, a value is not finite, a normal
// is not a unit vector, or a hull has no plane.
PolytopeMap make_polytope_map(const Polytopes& polytopes, double extent_m);

// Rounds a double to a float that is not below (above) it.
float round_up(double value);
float round_down(double value);

}  // namespace alula
