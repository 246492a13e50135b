// An image of an onboard map that owns its memory.
#pragma once

#include <cstdint>
#include <vector>

#include "alula_map.h"

namespace alula {

// Allocates exactly the image's size, so a sanitizer detects every access outside. Throws std::invalid_argument with
// the reader's status text.
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
