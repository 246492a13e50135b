// The widest passage between two points of a map, with bounds from both sides, and free points.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/geometry/obstacle_map.hpp"

namespace alula {

struct PassageOptions {
  double enough = 0;           // radius at which a passage is wide enough; wider ones are not distinguished [m]
  double tolerance = 0;        // difference of the two bounds at which the search ends [m]
  std::size_t most_cells = 0;  // the search ends once it has made so many cells
};

struct Passage {
  double lower = 0;                  // a ball of this radius passes along `path`, proven; 0 without a path [m]
  double upper = 0;                  // no ball of a larger radius passes within the box; at most `enough` [m]
  std::vector<geometry::Vec3> path;  // from start to goal; empty where lower is 0
  geometry::Vec3 narrowest;          // point of the path that is nearest to an obstacle
  std::size_t cells = 0;
};

// Widest passage from start to goal within a box that contains both.
//
// The box is divided into cells, recursively in eight. The clearance d of a cell's centre bounds that of all its
// points: d - rho <= clearance <= d + rho, rho half its diagonal, as distances are 1-Lipschitz. Every path leads
// through cells that touch, so the largest u for which cells with d + rho >= u join start and goal bounds the radius
// of all balls that pass (upper). The polyline through the centres of such cells, with the exact distances of its
// segments, is a passage (lower). Cells where the bounds of the best path differ are divided until the two meet
// within the tolerance, or the lower one reaches `enough`; while that is not decided, down to an eighth of the
// tolerance. Both are true whenever the search ends.
//
// It also ends where no passage was found and none is wider than a tenth of `enough`.
//
// Cells are taken in the order of a priority queue with ties broken by number: the result is unique.
Passage widest_passage(const ObstacleMap& map, geometry::Vec3 lower, geometry::Vec3 upper, geometry::Vec3 start,
                       geometry::Vec3 goal, const PassageOptions& options, Control& control);

// A point of the box with a distance of at least `radius`, at most `tolerance` farther from p than the nearest such
// point. Returns false without one, or once `most_cells` cells were made and none had been found.
bool nearest_free(const ObstacleMap& map, geometry::Vec3 lower, geometry::Vec3 upper, geometry::Vec3 p, double radius,
                  double tolerance, std::size_t most_cells, geometry::Vec3& found, Control& control);

}  // namespace alula
