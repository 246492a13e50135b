// Size of a written cover, computed from its numbers of hulls and half-planes alone.
//
// Every polytope here has the six planes of its bounding box; all other planes are oblique.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace alula {

inline constexpr std::size_t kBoxPlanes = 6;

// Layout for microcontrollers: header, then per hull a box of int16 and a count, then per oblique
// plane int8 x 3 and int16, or the offset alone where the normals are fixed.
inline constexpr std::size_t kHeaderBytes = 64;
inline constexpr std::size_t kHullBytes = 14;
inline constexpr std::size_t kObliqueBytes = 5;
inline constexpr std::size_t kFixedObliqueBytes = 2;

// How hulls are written: as they are, with at most `facet_cap` planes, or as k-DOPs.
struct Form {
  std::size_t facet_cap = 0;  // 0: no cap
  std::size_t kdop = 0;       // 0: normals are free

  bool is_outer() const { return facet_cap > 0 || kdop > 0; }

  // At most this many planes are written for a hull.
  std::size_t planes(std::size_t facets) const {
    if (kdop > 0) return kdop;
    return facet_cap > 0 ? std::min(facets, facet_cap) : facets;
  }

  std::size_t bytes(std::size_t hulls, std::size_t planes) const {
    const std::size_t oblique = planes - std::min(planes, kBoxPlanes * hulls);
    return kHeaderBytes + kHullBytes * hulls + oblique_bytes() * oblique;
  }

  std::size_t oblique_bytes() const { return kdop > 0 ? kFixedObliqueBytes : kObliqueBytes; }
};

// Limits of the written cover; 0: no limit.
struct Budget {
  std::size_t max_planes = 0, max_bytes = 0;
  Form form;

  bool is_limit() const { return max_planes > 0 || max_bytes > 0; }
  bool holds(std::size_t hulls, std::size_t planes) const {
    return (max_planes == 0 || planes <= max_planes) && (max_bytes == 0 || form.bytes(hulls, planes) <= max_bytes);
  }
  // Maximum total number of half-planes for a number of hulls; fewer than six per hull: too many hulls.
  std::size_t planes_for(std::size_t hulls) const {
    std::size_t most = max_planes > 0 ? max_planes : SIZE_MAX;
    if (max_bytes == 0) return most;
    const std::size_t fixed = kHeaderBytes + kHullBytes * hulls;
    if (max_bytes < fixed) return 0;
    return std::min(most, kBoxPlanes * hulls + (max_bytes - fixed) / form.oblique_bytes());
  }
};

}  // namespace alula
