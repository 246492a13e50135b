// Path search for a ball in an obstacle map, on a lattice with edges that are proven collision-free.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula {

// Points origin + spacing * (i, j, k), 0 <= i < count[0] and so on; at most kMaxCells of them.
struct Lattice {
  static constexpr std::size_t kMaxCells = std::size_t{1} << 25;

  geometry::Vec3 origin;
  double spacing;
  std::int64_t count[3];
};

enum class SearchStatus : std::uint8_t {
  found,
  no_path,         // every lattice point that the start can reach was visited
  start_isolated,  // no lattice point near the start can be reached in a straight line
  goal_isolated,
};

struct SearchResult {
  SearchStatus status;
  std::vector<geometry::Vec3> path;  // from start to goal when found
  std::size_t expanded;
};

// Shortest path of a ball of the given radius on the 26-connected lattice, by A*.
//
// A lattice point is free when its clearance is >= radius. An edge from p to q is taken only when it is proven free:
// clearance is 1-Lipschitz, so on the edge it is at least (clearance(p) + clearance(q) - |p - q|) / 2; when that is
// < radius the exact distance of the segment decides. Clearances are computed once a point is about to be visited.
// Start and goal are joined to the lattice points around them by proven segments. An edge costs its length times 1 +
// (the fraction of `comfort` that the clearance of its ends lacks above radius), so paths keep radius + comfort where
// the detour is worth it. The length of the shortest lattice path to the goal in free space is then a consistent
// heuristic. Ties are broken by depth, then by number: the result is unique. Memory is 20 bytes per lattice point
// near those that were visited.
SearchResult find_path(const ObstacleMap& map, const Lattice& lattice, geometry::Vec3 start, geometry::Vec3 goal,
                       double radius, double comfort, Control& control);

// Shortens a path: returns the path of straight, proven segments from the first to the last point of `path` with
// the minimum cost of `find_path`, with the distance of the segment as its clearance, among paths with corners that
// are a subsequence of points taken from `path` at most `spacing` apart and that skip at most 128 of them; repeated
// `rounds` times. Each segment of `path` must itself be free.
std::vector<geometry::Vec3> tighten_path(const ObstacleMap& map, const std::vector<geometry::Vec3>& path,
                                         double radius, double comfort, double spacing, int rounds, Control& control);

}  // namespace alula
