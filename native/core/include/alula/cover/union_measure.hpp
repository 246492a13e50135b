// The exact volume of a union of convex polytopes, and how much of given voxels it fills.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/occupancy.hpp"
#include "alula/geometry/solid.hpp"

namespace alula {

// Convex polytopes in voxel edges. Polytope h is what its half-spaces bound; box[h] holds it.
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
  std::size_t whole = 0;    // voxels filled but for `sliver`
  double error = 0;         // bound on how far rounding moved either volume
  std::size_t cuts = 0;     // planes that solids were cut by: the work
  bool is_complete = true;  // false: the budget was spent, and the numbers mean nothing
};

struct MeasureOptions {
  double sliver = 1e-9;                  // voxels missing no more than this count as whole
  std::size_t cuts_per_part = SIZE_MAX;  // of the up to 1023 parts
};

// Space is halved into boxes until few polytopes reach into one. There, with S first the box,
// U(S; P, rest) = V(S n P) + U(S; rest) - U(S n P; rest), where each S n P is a convex solid cut by the
// planes of P; polytopes that miss S drop out, and one that contains it ends the recursion.
//
// Exact up to rounding: moving the planes of a convex piece by d changes its volume inside a box by at
// most d times the area of the box. `error` sums that over all pieces with d = (48 + 8 cuts) u E, where
// E is the largest coordinate and u = 2^-53: the tolerance 16 u E, the planes and their values 16 u E,
// each cut 4 u E and the sum over the piece's triangles; then it adds the roundings of the total.
//
// With `voxels`, boxes that hold any are halved down to single voxels unless one polytope holds the box.
// Deterministic for any number of threads.
UnionMeasure union_measure(const ConvexSets& sets, const Occupancy* voxels, const MeasureOptions& options,
                           unsigned jobs, Control& control);

}  // namespace alula
