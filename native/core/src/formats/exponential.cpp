#include "alula/formats/exponential.hpp"

#include "alula/base/wide.hpp"

namespace alula {

// Each element on its own without contraction, so wider vectors give the same bits. One loop limits and the
// next computes: in one, compilers make a branch of it and use no vectors.
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
