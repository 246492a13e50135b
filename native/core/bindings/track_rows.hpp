// Tracks of moving obstacles as rows of NumPy arrays: id, position, velocity, covariance, radius, and acceleration
// where there are 32 columns.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "alula_avoidance.h"
#include "arrays.hpp"
#include "fields.hpp"

namespace alula {

using Tracks = In<double, nanobind::shape<-1, -1>>;

inline std::vector<alula_track> tracks_of(const Tracks& rows) {
  const std::size_t columns = rows.shape(1);
  if (columns != 29 && columns != 32) throw std::invalid_argument("tracks have 29 columns, or 32 with acceleration");
  std::vector<alula_track> tracks(rows.shape(0));
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    const double* row = rows.data() + columns * i;
    alula_track& t = tracks[i];
    if (!(row[0] >= 0 && row[0] < 4294967295.0)) throw std::invalid_argument("ids are from 0 to 2^32 - 2");
    t.id = static_cast<std::uint32_t>(row[0]);
    for (std::size_t k = 0; k < 3; ++k) {
      t.position[k] = static_cast<float>(row[1 + k]);
      t.velocity[k] = static_cast<float>(row[4 + k]);
    }
    for (std::size_t k = 0; k < 21; ++k) t.covariance[k] = static_cast<float>(row[7 + k]);
    t.radius_m = static_cast<float>(row[28]);
    for (std::size_t k = 0; columns == 32 && k < 3; ++k) t.acceleration[k] = static_cast<float>(row[29 + k]);
  }
  return tracks;
}

// A field of tracks.
struct TrackRows {
  std::vector<alula_track> all;
};

template <>
struct fields::Python<TrackRows> {
  static std::string type() { return "numpy.typing.NDArray[numpy.float64]"; }
  static TrackRows from(nanobind::handle value) { return {tracks_of(nanobind::cast<Tracks>(value))}; }
  static std::size_t out(const TrackRows& value) { return value.all.size(); }
};

}  // namespace alula
