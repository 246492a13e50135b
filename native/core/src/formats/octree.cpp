#include "alula/formats/octree.hpp"

#include <array>
#include <bit>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace alula {

namespace {

constexpr std::int32_t kHalf = 1 << 15;

class Reader {
 public:
  Reader(std::span<const std::uint8_t> body, bool is_binary, std::size_t payload)
      : body_(body), is_binary_(is_binary), payload_(payload) {}

  OctreeLeaves read() {
    constexpr std::array<std::int32_t, 3> all{-kHalf, -kHalf, -kHalf};
    if (body_.empty()) {
      add(all, 2 * kHalf, LeafState::kUnknown);
      return std::move(out_);
    }
    node(all, 2 * kHalf);
    if (at_ != body_.size())
      throw std::invalid_argument(std::to_string(body_.size() - at_) + " bytes follow the last node");
    return std::move(out_);
  }

 private:
  void node(const std::array<std::int32_t, 3>& lower, std::int32_t edge) {
    ++out_.nodes;
    if (is_binary_) {
      const unsigned low = byte(), bits = low | byte() << 8;
      if (edge == 1) throw std::invalid_argument("an inner node is deeper than 16 levels");
      for (unsigned child = 0; child < 8; ++child) {
        const unsigned kind = bits >> (2 * child) & 3u;
        const auto place = child_of(lower, edge, child);
        if (kind == 3) {
          node(place, edge / 2);
          continue;
        }
        out_.nodes += kind != 0;
        add(place, edge / 2, static_cast<LeafState>(kind));
      }
      return;
    }
    std::uint32_t word = 0;
    for (unsigned i = 0; i < 4; ++i) word |= std::uint32_t{byte()} << (8 * i);
    const float log_odds = std::bit_cast<float>(word);
    for (std::size_t i = 0; i < payload_; ++i) byte();
    const unsigned children = byte();
    if (std::isnan(log_odds)) throw std::invalid_argument("a node's occupancy is not a number");
    if (children == 0) return add(lower, edge, log_odds >= 0 ? LeafState::kOccupied : LeafState::kFree);
    if (edge == 1) throw std::invalid_argument("an inner node is deeper than 16 levels");
    for (unsigned child = 0; child < 8; ++child) {
      const auto place = child_of(lower, edge, child);
      if (children >> child & 1u)
        node(place, edge / 2);
      else
        add(place, edge / 2, LeafState::kUnknown);
    }
  }

  static std::array<std::int32_t, 3> child_of(std::array<std::int32_t, 3> lower, std::int32_t edge, unsigned child) {
    for (unsigned a = 0; a < 3; ++a)
      if (child >> a & 1u) lower[a] += edge / 2;
    return lower;
  }

  void add(const std::array<std::int32_t, 3>& lower, std::int32_t edge, LeafState state) {
    out_.lower.insert(out_.lower.end(), lower.begin(), lower.end());
    out_.edge.push_back(edge);
    out_.state.push_back(static_cast<std::uint8_t>(state));
  }

  unsigned byte() {
    if (at_ == body_.size()) throw std::invalid_argument("the tree ends in the middle of a node");
    return body_[at_++];
  }

  std::span<const std::uint8_t> body_;
  bool is_binary_;
  std::size_t payload_, at_ = 0;
  OctreeLeaves out_;
};

}  // namespace

OctreeLeaves octree_leaves(std::span<const std::uint8_t> body, bool is_binary, std::size_t payload) {
  return Reader(body, is_binary, payload).read();
}

}  // namespace alula
