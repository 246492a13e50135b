// The exact volume of a union of convex polytopes, and how much of given voxels it fills.
#pragma once

#include <cstdint>
#include <vector>

#include "alula/control.hpp"
#include "alula/occupancy.hpp"
#include "alula/solid.hpp"

namespace alula {

// Convex polytopes in voxel edges: polytope h is box[h] cut by its half-spaces.
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
  double sliver = 1e-9;                 // voxels missing no more than this count as whole
  std::size_t cuts_per_part = SIZE_MAX;  // of the box that holds everything, in up to 1023 parts
};

// Space is halved into boxes until few polytopes reach into one. There the union is
// U(S; P, rest) = V(S n P) + U(S; rest) - U(S n P; rest), with S first the box and each S n P a convex
// solid cut by P's planes; polytopes that miss S drop out and one that contains it ends the recursion.
// Every volume is that of a closed polyhedron, so the result is exact up to rounding: moving the planes
// of a convex piece within a box of area A by d changes its volume by at most d A, and `error` sums that
// with d = (32 + 4 cuts) u E, E the largest coordinate, u = 2^-53, for all pieces.
//
// With `voxels`, boxes that hold any are halved down to single voxels unless one polytope holds the box.
// Deterministic for any number of threads.
UnionMeasure union_measure(const ConvexSets& sets, const Occupancy* voxels, const MeasureOptions& options,
                           unsigned jobs, Control& control);

}  // namespace alula
