// exp and the logistic function in double precision, the same bits on every machine.
//
// exp(x) = 2^k exp(r), k = rint(x / ln 2), r = x - k ln 2 by two parts of ln 2, |r| <= 0.3466. The first
// part has 32 bits and |k| < 2^9, so its product with k is exact, and so is the difference from x
// (Sterbenz). The two parts differ from ln 2 by less than 2^-86. With u = 2^-53 and Taylor's polynomial,
//   exp(r) = 1 + (r + r^2 q(r)),
// the error of the bracket is below 0.8 u: truncation |r|^14 / 14! < 0.06 u, the rounding of r 0.25 u, of
// r^2 q 3.3 u times 0.067, of the sum 0.25 u. The last addition adds 0.5 u below 1 and u from 1 on:
// together less than 2 u of the result and less than 1.3 units in the last place.
// Arguments beyond +-200 count as +-200: e^200 and e^-200 are infinite and zero in single precision, as are the
// results for larger arguments, so no result rounded to single precision changes. NaN stays NaN.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>

namespace alula {

constexpr double kExpRange = 200.0;

// exp(x) for an argument within +-kExpRange, or NaN.
inline double exp_in_range(double x) {
  constexpr double kPerLn2 = 0x1.71547652b82fep+0;
  constexpr double kLn2High = 0x1.62e42feep-1, kLn2Low = 0x1.a39ef35793c76p-33;
  constexpr double kShift = 0x1.8p52;  // added, it leaves the integer in the low bits
  const double shifted = x * kPerLn2 + kShift;
  const double k = shifted - kShift;
  const double r = (x - k * kLn2High) - k * kLn2Low;
  double q = 1.0 / 6227020800.0;
  q = q * r + 1.0 / 479001600.0;
  q = q * r + 1.0 / 39916800.0;
  q = q * r + 1.0 / 3628800.0;
  q = q * r + 1.0 / 362880.0;
  q = q * r + 1.0 / 40320.0;
  q = q * r + 1.0 / 5040.0;
  q = q * r + 1.0 / 720.0;
  q = q * r + 1.0 / 120.0;
  q = q * r + 1.0 / 24.0;
  q = q * r + 1.0 / 6.0;
  q = q * r + 0.5;
  const double fraction = 1.0 + (r + r * r * q);
  const std::uint64_t exponent = (std::bit_cast<std::uint64_t>(shifted) + 1023) << 52;
  return fraction * std::bit_cast<double>(exponent);
}

// exp(x) and 1 / (1 + exp(-x)) of many at a time; `out` may be `x`.
void portable_exp(const double* x, double* out, std::size_t count);
void portable_logistic(const double* x, double* out, std::size_t count);

}  // namespace alula
