// Inputs of the onboard filters from Python: options by name, tracks and walls as rows.
#pragma once

#include <cmath>
#include <cstddef>
#include <map>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "alula/base/fields.hpp"
#include "alula_avoidance.h"
#include "alula_fence.h"
#include "arrays.hpp"
#include "track_rows.hpp"

namespace alula {

using Numbers = std::map<std::string, double>;

// Sets the fields given by name; `what` has them. Throws std::invalid_argument for unknown names, values beyond their
// limits, and fractions where a whole number is needed.
template <class T>
void assign_numbers(T& object, const Numbers& given, const std::string& what) {
  std::map<std::string, double> left = given;
  each_field<T>(object, [&](const std::string& name, const auto& field, auto& value) {
    const auto found = left.find(name);
    if (found == left.end()) return;
    using M = std::remove_reference_t<decltype(value)>;
    if constexpr (!std::is_floating_point_v<M>) {
      if (!(found->second >= 0 && found->second < 1e6) || found->second != std::floor(found->second)) {
        throw std::invalid_argument(name + " must be a whole number");
      }
    }
    check_limits(name, field.limits, found->second);
    value = static_cast<M>(found->second);
    left.erase(found);
  });
  if (!left.empty()) throw std::invalid_argument(what + " has no such option: " + left.begin()->first);
}

inline std::vector<alula_wall> walls_of(const InRows4<double>& rows) {
  std::vector<alula_wall> walls(rows.shape(0));
  for (std::size_t i = 0; i < walls.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) walls[i].normal[k] = static_cast<float>(rows.data()[4 * i + k]);
    walls[i].distance_m = static_cast<float>(rows.data()[4 * i + 3]);
  }
  return walls;
}

// A fence as a microcontroller reads it: has_box, lower (3), upper (3), face_count, and the faces (4 each).
inline nanobind::bytes words_of(const alula_fence& fence) {
  return nanobind::bytes(&fence, offsetof(alula_fence, face) + fence.face_count * sizeof fence.face[0]);
}

}  // namespace alula
