// Chains of convex cells that are free of obstacles at a radius, around the segments of a path.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/clearance.hpp"
#include "alula/geometry/solid.hpp"

namespace alula {

// Obstacles of several sets, in one frame [m].
struct CorridorMap {
  std::vector<const PolytopeSet*> hulls;
  std::vector<const EllipsoidSet*> ellipsoids;
};

// Cells {x : normal . x <= offset}, row-compressed. The first six rows of a cell are the planes of a box.
struct Corridor {
  std::vector<double> normals;        // unit vectors, 3 numbers a row
  std::vector<double> offsets;        // [m]
  std::vector<std::int64_t> start;    // first row of each cell, and the end
  std::vector<std::uint8_t> is_free;  // 1 where the segment, too, keeps the radius
};

// A cell for each segment from[i] .. to[i].
//
// It begins as the box around the segment grown by `reach` and cut by `bounds`. Obstacles, nearest first, that no
// plane of the cell keeps at the radius add one: n along the shortest line from the segment to the obstacle O, and
//   offset = min over O of n . y - radius - slack,
// where the slack exceeds all rounding, so that n . x <= offset proves |x - y| >= radius for every y of O. Points of
// the segment that keep the radius satisfy it up to the slack, 1e-11 times the size of the numbers. Groups of
// ellipsoids whose box is kept away are skipped as a whole.
//
// `is_free` is 0 where an obstacle is nearer to the segment than the radius, as far as distances are exact: such a
// cell does not contain its segment. O(near obstacles x planes) each. Results do not depend on `jobs`. Source: Liu et
// al. 2017 (seed and nearest first); Deits and Tedrake 2015 (skipping what is separated).
Corridor corridor_cells(const CorridorMap& map, std::span<const double> from, std::span<const double> to,
                        double radius, double reach, const geometry::Box& bounds, unsigned jobs, Control& control);

// Result for one cell.
struct CellProof {
  bool proven = false;
  double clearance = 0;     // proven lower bound on the distance to all obstacles, at most twice the radius [m]
  std::uint32_t pairs = 0;  // obstacles that were decided
};

// Proves that every point of each cell is at least `radius` from every obstacle, from the rows alone; they may come
// from anywhere, with normals of any length. A cell that is not bounded, or empty, is not proven.
//
// For each obstacle O near the vertices of a cell C, w = the direction between the closest points of C and O, by the
// algorithm of Gilbert, Johnson and Keerthi or by alternating projections. The bound is
//   dist(C, O) >= min over O of w . y - max over C of w . x,  |w| = 1,
// where the maximum is bounded by duality: for rows B, three at a vertex, and multipliers y >= 0,
//   w . x = y . (B x) + (w - B^T y) . x <= y . b + |w - B^T y|_1 max |x|_inf.
// All of it is rounded to the safe side, so vertices and w may be inexact. Independent of how cells are made.
std::vector<CellProof> check_cells(const CorridorMap& map, std::span<const double> normals,
                                   std::span<const double> offsets, std::span<const std::int64_t> start,
                                   double radius, unsigned jobs, Control& control);

}  // namespace alula
