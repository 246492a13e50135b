// States, wrenches, vectors and references of alula::flight as rows of NumPy arrays.
#pragma once

#include <nanobind/stl/array.h>

#include <array>
#include <stdexcept>
#include <vector>

#include "alula/filters/safety_filter.hpp"
#include "alula/planning/reference_curve.hpp"
#include "arrays.hpp"

namespace alula::flight {

using Triple = std::array<double, 3>;
using InStates = In<double, nanobind::shape<-1, 12>>;  // p, sigma, v, omega
using InState = In<double, nanobind::shape<12>>;
using InReference = In<double, nanobind::shape<18>>;       // as a row of InReferences
using InWrenches = In<double, nanobind::shape<-1, 4>>;     // T, tau
using InReferences = In<double, nanobind::shape<-1, 18>>;  // p, v, a, j, s, yaw, yaw', yaw''
using Doubles = nanobind::ndarray<nanobind::numpy, double>;

inline Vec3 vector_of(const Triple& t) { return {t[0], t[1], t[2]}; }
inline Triple triple_of(Vec3 v) { return {v.x, v.y, v.z}; }

inline State state_at(const double* row) {
  using geometry::from_rows;
  return {from_rows(row), from_rows(row + 3), from_rows(row + 6), from_rows(row + 9)};
}
inline Wrench wrench_at(const double* row) { return {row[0], geometry::from_rows(row + 1)}; }
inline ReferencePoint reference_at(const double* row) {
  using geometry::from_rows;
  return {from_rows(row),
          from_rows(row + 3),
          from_rows(row + 6),
          from_rows(row + 9),
          from_rows(row + 12),
          row[15],
          row[16],
          row[17]};
}

// Rows of numbers that become one array.
class Rows {
 public:
  explicit Rows(std::size_t count) { values_.reserve(12 * count); }

  Rows& add(double value) { return values_.push_back(value), *this; }
  Rows& add(Vec3 v) { return add(v.x).add(v.y).add(v.z); }
  Rows& add(const State& x) { return add(x.p).add(x.sigma).add(x.v).add(x.omega); }
  Rows& add(const Wrench& u) { return add(u.thrust).add(u.torque); }
  Rows& add(const ReferencePoint& r) {
    return add(r.p).add(r.v).add(r.a).add(r.j).add(r.s).add(r.yaw).add(r.yaw_rate).add(r.yaw_acceleration);
  }
  Rows& add(const Mat3& m) { return add(m.row(0)).add(m.row(1)).add(m.row(2)); }

  Doubles array(std::initializer_list<std::size_t> shape) { return to_numpy(std::move(values_), shape); }

 private:
  std::vector<double> values_;
};

inline Doubles to_array(const State& x) { return Rows(1).add(x).array({12}); }
inline Doubles to_array(const Wrench& u) { return Rows(1).add(u).array({4}); }

inline void require_rows(std::size_t count, std::size_t expected) {
  if (count != expected) throw std::invalid_argument("the arrays have different numbers of rows");
}

}  // namespace alula::flight
