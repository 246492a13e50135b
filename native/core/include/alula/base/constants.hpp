// Constants that several files name.
#pragma once

#include <limits>

namespace alula {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();
inline constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
inline constexpr double kSameTime = 1e-9;   // tolerance between two sums of the same steps [s]
inline constexpr double kSamePlace = 1e-9;  // [m]

}  // namespace alula
