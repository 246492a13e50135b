#include "alula/cover/tile_window.hpp"

#include <stdexcept>
#include <utility>

#include "alula/base/require.hpp"

namespace alula {

TileSet::TileSet(Bytes index, std::vector<Bytes> images, const std::optional<Bytes>& key, const Bytes& signature)
    : index_(std::move(index)), images_(std::move(images)) {
  require(index_.size() <= UINT32_MAX, "an index of tiles has more than 2^32 bytes");
  require(!key || signature.size() == ALULA_SHA256_BYTES, status_text(ALULA_TILES_FORGED));
  const alula_tiles_status status =
      alula_tiles_open(&tiles_, index_.data(), static_cast<std::uint32_t>(index_.size()), key ? key->data() : nullptr,
                       key ? static_cast<std::uint32_t>(key->size()) : 0U, key ? signature.data() : nullptr);
  require(status == ALULA_TILES_READY, status_text(status));
  const std::int64_t across = std::int64_t{tiles_.last[1]} - tiles_.first[1] + 1;
  require(static_cast<std::int64_t>(images_.size()) == across * tiles_.along_x,
          "the images are not those of the index");
  for (const Bytes& image : images_)
    require(image.size() <= tiles_.largest_bytes, "the images are not those of the index");
}

TileWindow::TileWindow(std::shared_ptr<const TileSet> set, std::uint32_t load_calls)
    : set_(std::move(set)), load_calls_(load_calls) {
  require(set_ != nullptr, "a window needs a set of tiles");
  reset();
}

void TileWindow::reset() {
  tiles_ = set_->open();
  waited_ = 0;
  has_begun_ = false;
  place_ = ALULA_TILES_NOT_LOADED;
}

const alula_map* TileWindow::at(const std::array<float, 3>& position, const std::array<float, 3>& towards) {
  const alula_map* map = nullptr;
  place_ = alula_tiles_select(&tiles_, position.data(), towards.data(), &map);
  alula_tiles_request_data request;
  if (!alula_tiles_request(&tiles_, &request) || (has_begun_ && waited_++ < load_calls_)) return map;
  waited_ = 0;
  const Bytes& image = set_->image(request.tile);
  require(image.size() == request.bytes, "the images are not those of the index");
  const alula_tiles_status status = alula_tiles_loaded(&tiles_, image.data());
  require(status == ALULA_TILES_READY, status_text(status));
  has_begun_ = true;
  place_ = alula_tiles_select(&tiles_, position.data(), towards.data(), &map);
  return map;
}

std::optional<std::uint32_t> TileWindow::tile() const {
  if (place_ == ALULA_TILES_NOT_LOADED) return {};
  return tiles_.slot[tiles_.active].tile;
}

const char* status_text(alula_tiles_status status) {
  switch (status) {
    case ALULA_TILES_READY:
      return "ready";
    case ALULA_TILES_BAD_POINTER:
      return "no bytes";
    case ALULA_TILES_FOREIGN:
      return "not an index of tiles";
    case ALULA_TILES_NEWER:
      return "of a newer layout";
    case ALULA_TILES_TRUNCATED:
      return "truncated";
    case ALULA_TILES_DAMAGED:
      return "damaged";
    case ALULA_TILES_MALFORMED:
      return "malformed";
    case ALULA_TILES_FORGED:
      return "the signature does not match the key";
    case ALULA_TILES_NO_REQUEST:
      return "no tile is to be loaded";
  }
  return "unknown status";
}

}  // namespace alula
