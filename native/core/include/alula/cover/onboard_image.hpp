// An image of an onboard map, in memory of its own.
#pragma once

#include <cstdint>
#include <vector>

#include "alula_map.h"

namespace alula {

// Of exactly its size, so that a sanitizer sees any step outside. Throws std::invalid_argument with the
// reader's complaint.
class OnboardImage {
 public:
  explicit OnboardImage(std::vector<std::uint8_t> bytes);
  OnboardImage(const OnboardImage&) = delete;
  OnboardImage& operator=(const OnboardImage&) = delete;

  const alula_map& map() const { return map_; }

 private:
  std::vector<std::uint8_t> bytes_;
  alula_map map_{};
};

const char* status_text(alula_map_status status);

}  // namespace alula
