// The exact volume of a union of convex polytopes, and the volume of its intersection with given voxels.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/occupancy.hpp"
#include "alula/geometry/solid.hpp"

namespace alula {

// Convex polytopes in units of voxel edges. Polytope h is the intersection of its half-spaces; box[h] contains it.
struct ConvexSets {
  std::vector<geometry::HalfSpace> plane;
  std::vector<std::uint32_t> start{0};  // first half-space of each polytope, and the end
  std::vector<geometry::Box> box;

  void close(const geometry::Box& bounds) {
    start.push_back(static_cast<std::uint32_t>(plane.size()));
    box.push_back(bounds);
  }
};

struct UnionMeasure {
  double volume = 0;        // of the union
  double intersection = 0;  // of the union and the voxels
  std::size_t whole = 0;    // voxels filled up to `sliver`
  double error = 0;         // bound on the rounding error of either volume
  std::size_t cuts = 0;     // cuts of solids by planes: the work
  bool is_complete = true;  // false: the budget was exhausted, and the numbers are invalid
};

struct MeasureOptions {
  double sliver = 1e-9;                  // voxels that lack no more than this volume count as whole
  std::size_t cuts_per_part = SIZE_MAX;  // limit of each of the up to 1023 parts; 64 planes looked at count as one
};

// Space is halved into boxes until few polytopes reach into each box. There, starting with S as the box,
// U(S; P, rest) = V(S n P) + U(S; rest) - U(S n P; rest), where each S n P is a convex solid cut by the
// planes of P. Polytopes that miss S drop out, and a polytope that contains S ends the recursion.
//
// Exact up to rounding: moving the planes of a convex piece by d changes its volume inside a box by at
// most d times the area of the box. `error` sums that over all pieces with d = (48 + 8 cuts) u E, where
// E is the largest coordinate and u = 2^-53: the tolerance 16 u E, the planes and their values 16 u E,
// each cut 4 u E and the sum over the piece's triangles; then it adds the rounding of the total.
//
// With `voxels`, boxes that contain voxels are halved down to single voxels unless one polytope contains the box.
// Deterministic for any number of threads.
UnionMeasure union_measure(const ConvexSets& sets, const Occupancy* voxels, const MeasureOptions& options,
                           unsigned jobs, Control& control);

}  // namespace alula
