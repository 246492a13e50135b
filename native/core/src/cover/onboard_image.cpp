#include "alula/cover/onboard_image.hpp"

#include <stdexcept>
#include <utility>

namespace alula {

OnboardImage::OnboardImage(std::vector<std::uint8_t> bytes) : bytes_(std::move(bytes)) {
  if (bytes_.size() > UINT32_MAX) throw std::invalid_argument("more than 2^32 bytes");
  const auto status = alula_map_open(&map_, bytes_.data(), static_cast<std::uint32_t>(bytes_.size()));
  if (status != ALULA_MAP_READY) throw std::invalid_argument(status_text(status));
}

const char* status_text(alula_map_status status) {
  switch (status) {
    case ALULA_MAP_READY:
      return "ready";
    case ALULA_MAP_BAD_POINTER:
      return "no bytes";
    case ALULA_MAP_FOREIGN:
      return "not an onboard map";
    case ALULA_MAP_NEWER:
      return "of a newer layout";
    case ALULA_MAP_TRUNCATED:
      return "truncated";
    case ALULA_MAP_DAMAGED:
      return "damaged";
    case ALULA_MAP_MALFORMED:
      return "malformed";
    case ALULA_MAP_BAD_POSITION:
      return "position not finite or too far away";
  }
  return "unknown status";
}

}  // namespace alula
