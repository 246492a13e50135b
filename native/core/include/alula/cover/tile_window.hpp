// A map in tiles for host programs, selected and checked by the C code that runs on a microcontroller.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "alula_tiles.h"

namespace alula {

using Bytes = std::vector<std::uint8_t>;

// Index and images of all tiles, as they are stored; immutable, shared by threads.
class TileSet {
 public:
  // With a key the signature must match. Throws std::invalid_argument with the reader's status text for an index that
  // it rejects, and for images whose number or lengths are not those of the index.
  TileSet(Bytes index, std::vector<Bytes> images, const std::optional<Bytes>& key = {}, const Bytes& signature = {});
  TileSet(const TileSet&) = delete;
  TileSet& operator=(const TileSet&) = delete;

  // A reader of the index without resident tiles.
  alula_tiles open() const { return tiles_; }
  const Bytes& image(std::size_t tile) const { return images_[tile]; }
  std::size_t size() const { return images_.size(); }

 private:
  Bytes index_;
  std::vector<Bytes> images_;
  alula_tiles tiles_{};
};

// The two resident tiles of a flight. The first tile is loaded before the flight, a later one `load_calls` calls of
// `at` after its request. Copies share the set.
class TileWindow {
 public:
  // Throws std::invalid_argument without a set.
  TileWindow(std::shared_ptr<const TileSet> set, std::uint32_t load_calls);

  // The map for a position on the way to another, null if no tile is resident; see alula_tiles_select. Throws
  // std::invalid_argument with the reader's status text for an image that is not the one of the index.
  const alula_map* at(const std::array<float, 3>& position, const std::array<float, 3>& towards);

  // Row in the index of the tile of the last map, and whether the position was in its region.
  std::optional<std::uint32_t> tile() const;
  alula_tiles_place place() const { return place_; }
  const TileSet& set() const { return *set_; }
  const alula_tiles& tiles() const { return tiles_; }
  // To before the first call.
  void reset();

 private:
  std::shared_ptr<const TileSet> set_;
  std::uint32_t load_calls_, waited_ = 0;
  bool has_begun_ = false;
  alula_tiles tiles_;
  alula_tiles_place place_ = ALULA_TILES_NOT_LOADED;
};

const char* status_text(alula_tiles_status status);

}  // namespace alula
