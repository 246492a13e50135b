// States and wrenches of flight as NumPy rows: x = (p, sigma, v, omega), u = (T, tau).
#pragma once

#include "alula/quadrotor.hpp"
#include "arrays.hpp"

namespace alula {

using InState = In<double, nanobind::shape<12>>;
using InWrench = In<double, nanobind::shape<4>>;
using InPoint = In<double, nanobind::shape<3>>;

inline geometry::Vec3 to_point(const InPoint& a) { return geometry::from_rows(a.data()); }
inline flight::State to_state(const InState& a) {
  const double* x = a.data();
  return {geometry::from_rows(x), geometry::from_rows(x + 3), geometry::from_rows(x + 6), geometry::from_rows(x + 9)};
}
inline flight::Wrench to_wrench(const InWrench& a) { return {a.data()[0], geometry::from_rows(a.data() + 1)}; }

inline void append(std::vector<double>& out, geometry::Vec3 v) { out.insert(out.end(), {v.x, v.y, v.z}); }
inline void append(std::vector<double>& out, const flight::State& x) {
  append(out, x.p), append(out, x.sigma), append(out, x.v), append(out, x.omega);
}
inline void append(std::vector<double>& out, const flight::Wrench& u) {
  out.push_back(u.thrust), append(out, u.torque);
}

// Any of the above as one row.
template <class T>
nanobind::ndarray<nanobind::numpy, double> to_row(const T& value) {
  std::vector<double> row;
  append(row, value);
  const std::size_t size = row.size();
  return to_numpy(std::move(row), {size});
}

}  // namespace alula
