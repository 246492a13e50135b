#include "alula/planning/reference_curve.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

namespace alula::flight {
namespace {

constexpr std::size_t kComponents = 4, kCoefficients = 8, kDerivatives = 5;
constexpr std::size_t kPiece = kComponents * kCoefficients;

// Value and four derivatives of sum_j c_j t^j.
std::array<double, kDerivatives> evaluate(const double* c, double t) {
  std::array<double, kDerivatives> result{};
  for (std::size_t order = 0; order < kDerivatives; ++order) {
    double value = 0;
    for (std::size_t j = kCoefficients; j-- > order;) {
      double factor = 1;
      for (std::size_t i = 0; i < order; ++i) factor *= static_cast<double>(j - i);
      value = value * t + factor * c[j];
    }
    result[order] = value;
  }
  return result;
}

bool all_finite(std::span<const double> values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

}  // namespace

ReferenceCurve::ReferenceCurve(std::span<const double> time, std::span<const double> coefficient)
    : time_(time.begin(), time.end()), coefficient_(coefficient.begin(), coefficient.end()) {
  if (time.size() < 2 || coefficient.size() != (time.size() - 1) * kPiece)
    throw std::invalid_argument("a reference has K + 1 knots and K pieces of 4 x 8 coefficients");
  if (!all_finite(time) || !all_finite(coefficient)) throw std::invalid_argument("a reference must be finite");
  for (std::size_t k = 1; k < time.size(); ++k)
    if (!(time[k - 1] < time[k])) throw std::invalid_argument("the knots of a reference must increase");
}

ReferencePoint ReferenceCurve::at(double t) const {
  const bool flying = t >= start() && t < end();
  const double clamped = t < start() ? start() : flying ? t : end();
  const auto knot = std::upper_bound(time_.begin(), time_.end() - 1, clamped);
  const auto piece = std::max<std::ptrdiff_t>(0, knot - time_.begin() - 1);
  const double local = clamped - time_[static_cast<std::size_t>(piece)];
  std::array<std::array<double, kDerivatives>, kComponents> of{};
  for (std::size_t d = 0; d < kComponents; ++d) {
    of[d] = evaluate(coefficient_.data() + static_cast<std::size_t>(piece) * kPiece + d * kCoefficients, local);
    if (!flying) std::fill(of[d].begin() + 1, of[d].end(), 0.0);
  }
  const auto place = [&](std::size_t order) { return geometry::Vec3{of[0][order], of[1][order], of[2][order]}; };
  return {place(0), place(1), place(2), place(3), place(4), of[3][0], of[3][1], of[3][2]};
}

}  // namespace alula::flight
