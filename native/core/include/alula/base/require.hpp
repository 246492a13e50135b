// Checks of options and inputs.
#pragma once

#include <cmath>
#include <stdexcept>

namespace alula {

// Throws std::invalid_argument with the message unless the condition holds.
inline void require(bool holds, const char* message) {
  if (!holds) throw std::invalid_argument(message);
}

// True if a value is finite and not negative; false for NaN.
inline bool is_size(double value) { return value >= 0 && std::isfinite(value); }

}  // namespace alula
