// Hulls of a cover as the records of an onboard map; the layout is that of alula_map.h.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "alula/base/control.hpp"
#include "alula/cover/lattice_hull.hpp"

namespace alula {

// Views of the arrays of an alula/cover; `*_start` partition the rows.
struct HullView {
  std::span<const std::int32_t> vertex;  // (V, 3)
  std::span<const std::int64_t> vertex_start;
  std::span<const std::int64_t> plane_normal;  // (F, 3)
  std::span<const std::int64_t> plane_start;
};

struct MapRecords {
  std::vector<std::uint8_t> bytes;
  std::uint64_t planes = 0;  // oblique ones of all hulls
  bool is_kdop = false;      // all of them have normals in {-1, 0, 1}^3: 2 bytes each instead of 5
  std::int32_t largest_normal = 1;
  std::int32_t largest_shift = 0;
};

// Quantises each hull to its box and at most 255 oblique planes with |n_i| <= largest_normal.
//
// Guarantee: each quantised hull contains all vertices of its hull. A plane's depth is the exact
// integer support over the vertices, rounded outward where it needs a shift; its normal, the nearest
// in angle among those allowed, only affects tightness. Planes that cut nothing off beside the
// others are left out; beyond 255 planes, those with the smallest facets are left out too. With largest_normal = 1,
// a hull with normals that do not all fit chooses from all 20 oblique directions.
//
// Records are sorted by the Morton code of the centres of their boxes, then by their bytes.
// Deterministic for any number of threads. Time O(sum over hulls of planes^2 + planes * vertices).
//
// Throws std::invalid_argument when arrays do not fit together, a hull has no volume or
// largest_normal is not in [1, 127]; std::overflow_error when a vertex is beyond int16 of `origin`.
MapRecords encode_map_records(const HullView& hulls, const Lattice& origin, int largest_normal, unsigned jobs,
                              Control& control);

}  // namespace alula
