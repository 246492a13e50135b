// States and commands of a racing drone as rows of NumPy arrays.
#pragma once

#include "alula/dynamics/racer.hpp"
#include "flight_arrays.hpp"

namespace alula::flight {

inline constexpr std::size_t kRacerNumbers = 13;
using InRacer = In<double, nanobind::shape<13>>;  // p, v, q wxyz, omega
using InRacers = In<double, nanobind::shape<-1, 13>>;
using InCommand = In<double, nanobind::shape<4>>;  // throttle, rates

inline RacerState racer_at(const double* row) {
  using geometry::from_rows;
  return {from_rows(row), from_rows(row + 3), {row[6], row[7], row[8], row[9]}, from_rows(row + 10)};
}
inline RacerCommand command_at(const double* row) { return {row[0], geometry::from_rows(row + 1)}; }

inline Doubles to_array(const RacerState& x) {
  Rows rows(2);
  rows.add(x.p).add(x.v);
  for (const double c : x.q) rows.add(c);
  return rows.add(x.omega).array({kRacerNumbers});
}
inline Doubles to_array(const RacerCommand& u) { return Rows(1).add(u.throttle).add(u.rates).array({4}); }

}  // namespace alula::flight
