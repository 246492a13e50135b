#include "alula/formats/exponential.hpp"

#include "alula/base/wide.hpp"

namespace alula {

// Elements are independent and nothing is contracted, so wider vectors give the same bits. One loop clamps and the
// next computes: a single loop compiles to branches and is not vectorised.
ALULA_WIDE void portable_exp(const double* x, double* out, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    const double above = x[i] < -kExpRange ? -kExpRange : x[i];
    out[i] = above > kExpRange ? kExpRange : above;
  }
  for (std::size_t i = 0; i < count; ++i) out[i] = exp_in_range(out[i]);
}

ALULA_WIDE void portable_logistic(const double* x, double* out, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) out[i] = -x[i];
  portable_exp(out, out, count);
  for (std::size_t i = 0; i < count; ++i) out[i] = 1.0 / (1.0 + out[i]);
}

}  // namespace alula
