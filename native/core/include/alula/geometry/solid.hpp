// A convex solid that is cut by half-spaces.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "alula/geometry/vec3.hpp"

namespace alula::geometry {

// {x : normal . x <= offset} with a unit normal.
struct HalfSpace {
  Vec3 normal;
  double offset;
};

// The boundary as loops of vertices, counter-clockwise from outside.
//
// Guarantee: the loops always close, also in degenerate cases. A cut decides once per vertex on which
// side it is and makes one vertex per edge that it crosses, so every edge keeps two faces that
// run along it in opposite directions. With coordinates up to E and rounding errors of u E, a vertex lies
// within `tolerance` + 8 u E of the plane that made it, and each later cut moves it by at most 4 u E more off the
// other planes.
class Solid {
 public:
  enum class Side { kInside, kOutside, kCut };

  void assign(const Box& box);

  // The side of the plane on which the solid lies; parts within `tolerance` of the plane are ignored.
  Side side(const HalfSpace& half_space, double tolerance);

  // Makes this the part of `whole` inside the plane for which whole.side() last returned kCut.
  void assign_cut(const Solid& whole);

  double volume() const;
  int cuts() const { return cuts_; }

 private:
  std::int32_t crossing(const Solid& whole, std::int32_t inside, std::int32_t outside);
  void close_cut();

  std::vector<Vec3> vertex_;
  std::vector<std::int32_t> loop_;  // vertices of all faces
  std::vector<std::uint32_t> end_;  // of each face in loop_
  std::vector<double> beyond_;      // distance of each vertex beyond the plane of side(); at most 0 if inside

  std::vector<std::int32_t> number_, next_;
  std::vector<std::array<std::int32_t, 2>> crossed_;
  std::int32_t kept_ = 0;
  int cuts_ = 0;
};

}  // namespace alula::geometry
