#include "alula/geometry/solid.hpp"

#include <algorithm>
#include <utility>

namespace alula::geometry {

void Solid::assign(const Box& box) {
  vertex_.resize(8);
  for (std::size_t i = 0; i < 8; ++i)
    vertex_[i] = {(i & 1) != 0 ? box.upper.x : box.lower.x, (i & 2) != 0 ? box.upper.y : box.lower.y,
                  (i & 4) != 0 ? box.upper.z : box.lower.z};
  loop_ = {0, 4, 6, 2, 1, 3, 7, 5, 0, 1, 5, 4, 2, 6, 7, 3, 0, 2, 3, 1, 4, 5, 7, 6};
  end_ = {4, 8, 12, 16, 20, 24};
  cuts_ = 0;
}

Solid::Side Solid::side(const HalfSpace& half_space, double tolerance) {
  beyond_.resize(vertex_.size());
  double least = 0, most = 0;
  bool is_inside = false;
  for (std::size_t v = 0; v < vertex_.size(); ++v) {
    const double beyond = dot(half_space.normal, vertex_[v]) - half_space.offset;
    most = std::max(most, beyond);
    least = std::min(least, beyond);
    beyond_[v] = beyond > tolerance ? beyond : std::min(beyond, 0.0);
    is_inside |= beyond < -tolerance;
  }
  if (!is_inside) return Side::kOutside;
  return most <= tolerance ? Side::kInside : Side::kCut;
}

// The vertex on the edge between two vertices of `whole`; both faces of the edge get the same one.
std::int32_t Solid::crossing(const Solid& whole, std::int32_t inside, std::int32_t outside) {
  const std::array<std::int32_t, 2> edge{inside, outside};
  const auto known = std::find(crossed_.begin(), crossed_.end(), edge);
  const std::int32_t number = kept_ + static_cast<std::int32_t>(known - crossed_.begin());
  if (known == crossed_.end()) {
    const std::size_t from = static_cast<std::size_t>(inside), to = static_cast<std::size_t>(outside);
    const double t = whole.beyond_[from] / (whole.beyond_[from] - whole.beyond_[to]);
    vertex_.push_back(whole.vertex_[from] + t * (whole.vertex_[to] - whole.vertex_[from]));
    crossed_.push_back(edge);
    next_.push_back(-1);
  }
  return number;
}

void Solid::assign_cut(const Solid& whole) {
  vertex_.clear(), loop_.clear(), end_.clear(), crossed_.clear(), next_.clear();
  cuts_ = whole.cuts_ + 1;
  number_.assign(whole.vertex_.size(), -1);
  for (std::size_t v = 0; v < whole.vertex_.size(); ++v) {
    if (whole.beyond_[v] > 0) continue;
    number_[v] = static_cast<std::int32_t>(vertex_.size());
    vertex_.push_back(whole.vertex_[v]);
  }
  kept_ = static_cast<std::int32_t>(vertex_.size());
  std::size_t begin = 0;
  for (const std::uint32_t end : whole.end_) {
    const std::int32_t* face = whole.loop_.data() + begin;
    const std::size_t size = end - begin;
    begin = end;
    // A face that rounding made non-planar may enter several times: each stretch inside becomes a face.
    std::size_t entry = size, inside = 0;
    for (std::size_t i = 0; i < size; ++i) {
      if (number_[static_cast<std::size_t>(face[i])] < 0) continue;
      ++inside;
      if (number_[static_cast<std::size_t>(face[i == 0 ? size - 1 : i - 1])] < 0) entry = i;
    }
    if (inside == 0) continue;
    if (inside == size) {
      for (std::size_t i = 0; i < size; ++i) loop_.push_back(number_[static_cast<std::size_t>(face[i])]);
      end_.push_back(static_cast<std::uint32_t>(loop_.size()));
      continue;
    }
    std::int32_t first = -1;
    for (std::size_t k = 0; k < size; ++k) {
      const std::size_t i = (entry + k) % size;
      const std::int32_t here = face[i], after = face[(i + 1) % size], before = face[(i + size - 1) % size];
      if (number_[static_cast<std::size_t>(here)] < 0) continue;
      if (number_[static_cast<std::size_t>(before)] < 0) loop_.push_back(first = crossing(whole, here, before));
      loop_.push_back(number_[static_cast<std::size_t>(here)]);
      if (number_[static_cast<std::size_t>(after)] < 0) {
        loop_.push_back(crossing(whole, here, after));
        end_.push_back(static_cast<std::uint32_t>(loop_.size()));
        next_[static_cast<std::size_t>(first - kept_)] = loop_.back();
      }
    }
  }
  close_cut();
}

// Adds the faces on the plane: each cut face runs from its exit to its entry along the plane; the new faces run back.
void Solid::close_cut() {
  for (std::int32_t& start : next_) {
    const std::size_t size = loop_.size();
    for (std::int32_t* at = &start; *at >= 0;) {
      loop_.push_back(*at);
      at = &next_[static_cast<std::size_t>(std::exchange(*at, -1) - kept_)];
    }
    if (loop_.size() - size > 2) {
      end_.push_back(static_cast<std::uint32_t>(loop_.size()));
    } else {
      loop_.resize(size);  // a degenerate face with two edges that coincide
    }
  }
}

double Solid::volume() const {
  double sum = 0;
  std::size_t begin = 0;
  for (const std::uint32_t end : end_) {
    const Vec3 origin = vertex_.front(), a = vertex_[static_cast<std::size_t>(loop_[begin])] - origin;
    Vec3 b = vertex_[static_cast<std::size_t>(loop_[begin + 1])] - origin;
    for (std::size_t i = begin + 2; i < end; ++i) {
      const Vec3 c = vertex_[static_cast<std::size_t>(loop_[i])] - origin;
      sum += a.x * (b.y * c.z - b.z * c.y) + a.y * (b.z * c.x - b.x * c.z) + a.z * (b.x * c.y - b.y * c.x);
      b = c;
    }
    begin = end;
  }
  return sum / 6;
}

}  // namespace alula::geometry
