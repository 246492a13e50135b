// The tree of `EllipsoidIndex`: it tests four boxes or eight balls together, in single precision.
//
// Boxes and balls are rounded outward, and the margin of every comparison exceeds its rounding error. So no near
// ellipsoid is missed; a few that are not near may be visited.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <vector>

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

#include "alula/geometry/bvh.hpp"

namespace alula::geometry {

class EllipsoidTree {
 public:
  struct Ball {
    Vec3 centre;
    double radius;           // bound on the distance of the ellipsoid's points from the centre
    double loss;             // the part of the radius that is the ball of its losses
    std::array<float, 6> s;  // xx, xy, xz, yy, yz, zz of Sigma: without losses it reaches sqrt(n^T Sigma n) along n
    std::array<float, 6> a;  // the same for A of the obstacle with the same centre
  };

  // Extremes over the obstacles of a node: the longest semi-axis, the sine of the largest angle between x and A x,
  // and the largest ball of their losses.
  struct Shape {
    float longest, skew, ball;
  };

  EllipsoidTree() = default;

  // Builds the same tree as `binary` with two levels in one, from the balls of slots and the shapes of the nodes of
  // `binary`. Leaves have at most 8 slots.
  EllipsoidTree(const Bvh& binary, const std::vector<Ball>& balls, const std::vector<Shape>& shapes);

  // A query region: within some reach of a segment a + t d, 0 <= t <= 1, and within `around` of a. If `ahead`, only
  // ellipsoids that a vehicle at a with velocity v approaches or is inside of.
  struct Sight {
    Vec3 a, d;
    double around;
    bool ahead = false;
    Vec3 v{};
  };

  struct Cost {
    std::uint32_t nodes = 0, items = 0;  // boxes and balls tested
  };

  // Calls visit(slot) for all slots with a box and a ball that may be nearer than `reach`; nearer boxes first.
  // `visit` may lower the reach.
  template <class Visit>
  Cost visit(const Sight& sight, const double& reach, Visit&& visit) const {
    return nodes_.empty() ? Cost{} : search(Look(sight), reach, visit);
  }

 private:
  using Floats = float __attribute__((vector_size(16)));
  using Bits = std::int32_t __attribute__((vector_size(16)));
  static constexpr std::uint32_t kNone = ~std::uint32_t{0}, kLeaf = std::uint32_t{1} << 31;
  static constexpr float kFar = 1e18F;          // coordinate of an empty lane
  static constexpr float kRelative = 0x1p-16F;  // exceeds the rounding error of a squared distance,
  static constexpr float kOfForms = 0x1p-18F;   // and that of a form r^T A v relative to tr A |r|_1 |v|_1

  struct Node {
    std::array<Floats, 3> lower, upper;
    Floats longest, skew;
    std::array<std::uint32_t, 4> child;  // kNone, a node, or kLeaf and a leaf
  };
  struct Leaf {
    std::array<Floats, 2> x, y, z, radius;
  };
  // Sigma, A and losses of a leaf.
  using Form = std::array<std::array<Floats, 2>, 6>;
  struct Forms {
    Form s, a;
    std::array<Floats, 2> loss;
  };
  // A child with the square of its bound in the high bits: non-negative floats order like their bits.
  using Entry = std::uint64_t;
  static Entry entry_of(float squared, std::uint32_t child) {
    return Entry{std::bit_cast<std::uint32_t>(std::max(0.0F, squared))} << 32 | child;
  }
  static float squared_of(Entry entry) { return std::bit_cast<float>(static_cast<std::uint32_t>(entry >> 32)); }
  static std::uint32_t child_of(Entry entry) { return static_cast<std::uint32_t>(entry); }

  static Floats all(double x) {
    const auto f = static_cast<float>(x);
    return Floats{f, f, f, f};
  }
  static Floats larger(Floats a, Floats b) { return a > b ? a : b; }
  static Floats smaller(Floats a, Floats b) { return a < b ? a : b; }
  static Floats square_root(Floats x) {
#if defined(__SSE2__)
    return std::bit_cast<Floats>(_mm_sqrt_ps(std::bit_cast<__m128>(x)));
#else
    return Floats{std::sqrt(x[0]), std::sqrt(x[1]), std::sqrt(x[2]), std::sqrt(x[3])};
#endif
  }
  static Floats clamped(Floats x, Floats low, Floats high) { return smaller(larger(x, low), high); }

  // The mask with bit i for lane i.
  static unsigned bits(Bits mask) {
#if defined(__SSE2__)
    return static_cast<unsigned>(_mm_movemask_ps(std::bit_cast<__m128>(mask)));
#else
    unsigned result = 0;
    for (unsigned i = 0; i < 4; ++i) result |= mask[i] != 0 ? 1U << i : 0;
    return result;
#endif
  }

  struct Look {
    std::array<Floats, 3> a, d, v;
    std::array<Floats, 3> ahead_least, ahead_most;  // minimum and maximum of d and 0
    Floats per_length2, room, length1, drift, speed1, speed2, cut;
    double around, room_;
    bool is_point, ahead;

    explicit Look(const Sight& s) : around(s.around), is_point(dot(s.d, s.d) == 0), ahead(s.ahead) {
      double size = 0;
      for (int i = 0; i < 3; ++i) {
        a[static_cast<std::size_t>(i)] = all(s.a[i]), d[static_cast<std::size_t>(i)] = all(s.d[i]);
        v[static_cast<std::size_t>(i)] = all(s.v[i]);
        size += std::abs(s.a[i]) + std::abs(s.d[i]);
      }
      room_ = 0x1p-20 * size;  // margin of a distance: rounding of a and d and of differences of coordinates
      room = all(room_), drift = all(room_ * norm(s.v));
      length1 = all((std::abs(s.d.x) + std::abs(s.d.y) + std::abs(s.d.z)) * (1 + 1e-6));
      speed1 = all((std::abs(s.v.x) + std::abs(s.v.y) + std::abs(s.v.z)) * (1 + 1e-6)),
      speed2 = all(dot(s.v, s.v) * (1 + 1e-6));
      per_length2 = all(1 / dot(s.d, s.d)), cut = all(limit(around));
      for (std::size_t i = 0; i < 3; ++i)
        ahead_least[i] = smaller(d[i], all(0)), ahead_most[i] = larger(d[i], all(0));
    }

    float limit(double reach) const {
      const double within = std::max(0.0, reach) + room_;
      return static_cast<float>(within * within * (1 + 0x1p-15));
    }

    struct Tangent {
      Floats value, slope;
    };
    Tangent tangent(Floats t, const std::array<Floats, 3>& low, const std::array<Floats, 3>& high) const {
      Tangent result{all(0), all(0)};
      for (std::size_t i = 0; i < 3; ++i) {
        const Floats p = t * d[i], out = smaller(p - low[i], all(0)) + larger(p - high[i], all(0));
        result.value += out * out, result.slope += out * d[i];
      }
      result.slope += result.slope;
      return result;
    }

    // Lower bounds on the squared distances of four boxes to the segment. Boxes that cannot hold a match, or are
    // beyond `most2`, are marked; a marked box has no bound.
    Floats bounds(const Node& node, float most2, unsigned& marked) const {
      std::array<Floats, 3> low, high;
      Floats apart = all(0);  // squared distance of a box to the box of the segment
      for (std::size_t i = 0; i < 3; ++i) {
        low[i] = node.lower[i] - a[i], high[i] = node.upper[i] - a[i];
        const Floats gap = larger(larger(low[i] - ahead_most[i], ahead_least[i] - high[i]), all(0));
        apart += gap * gap;
      }
      const Floats most = all(most2);
      Bits without = apart > most;
      if ((marked = bits(without)) == 15) return apart;
      const Tangent first = tangent(all(0), low, high);
      without |= first.value > cut;
      if (ahead) {
        // All centres are farther than any semi-axis, so no ellipsoid contains a. They are also so far behind that
        // A x, which is within the skew's angle of x, points backward for all of them.
        Floats far2 = all(0), onward = drift;
        for (std::size_t i = 0; i < 3; ++i) {
          const Floats far = larger(high[i], -low[i]);
          far2 += far * far;
          onward += larger(low[i] * v[i], high[i] * v[i]);
        }
        const Floats longest = node.longest + room;
        without |= (onward < all(0)) & (first.value > longest * longest) &
                   (onward * onward > node.skew * node.skew * far2 * speed2);
      }
      if (is_point) {
        marked = bits(without | (first.value > most));
        return first.value;
      }
      if ((marked = bits(without)) == 15) return apart;
      // A convex function: tangents bound it from below where they meet. Tangents are taken at the ends and where the
      // segment passes the middle of the box; one more secant step costs more than the nodes that it saves.
      const Tangent last = tangent(all(1), low, high);
      Floats t = all(0);
      for (std::size_t i = 0; i < 3; ++i) t += (low[i] + high[i]) * d[i];
      t = clamped(all(0.5) * t * per_length2, all(0), all(1));
      const Tangent middle = tangent(t, low, high);
      const Bits falls = middle.slope < all(0);
      const Floats at_left = falls ? t : all(0), at_right = falls ? all(1) : t;
      const Tangent left{falls ? middle.value : first.value, falls ? middle.slope : first.slope};
      const Tangent right{falls ? last.value : middle.value, falls ? last.slope : middle.slope};
      const Floats meet =
          (right.value - left.value + left.slope * at_left - right.slope * at_right) / (left.slope - right.slope);
      // For either sign of the error of `meet`, one of them is below the point where they meet.
      const Floats between =
          smaller(left.value + left.slope * (meet - at_left), right.value + right.slope * (meet - at_right)) -
          all(kRelative) * (first.value + last.value);
      const Floats inner = larger(between, all(0));
      const Floats bound = first.slope >= all(0) ? first.value : last.slope <= all(0) ? last.value : inner;
      marked |= bits(bound > most);
      return bound;
    }

    // Mask of the balls that may be within `reach`.
    Bits near(const Leaf& leaf, std::size_t half, Floats reach) const {
      const Floats x = leaf.x[half] - a[0], y = leaf.y[half] - a[1], z = leaf.z[half] - a[2];
      const Floats t = is_point ? all(0) : clamped((x * d[0] + y * d[1] + z * d[2]) * per_length2, all(0), all(1));
      const Floats gx = x - t * d[0], gy = y - t * d[1], gz = z - t * d[2];
      const Floats within = reach + leaf.radius[half];
      return ~(gx * gx + gy * gy + gz * gz > within * within);
    }

    // Mask of the ellipsoids that a plane across the line from the segment to the centre separates from the segment
    // by `reach`, rounding included. The bound holds for every direction g, so errors of g are harmless.
    Bits apart(const Leaf& leaf, const Forms& forms, std::size_t half, Floats reach) const {
      const Floats x = leaf.x[half] - a[0], y = leaf.y[half] - a[1], z = leaf.z[half] - a[2];
      const Floats t = is_point ? all(0) : clamped((x * d[0] + y * d[1] + z * d[2]) * per_length2, all(0), all(1));
      const Floats gx = x - t * d[0], gy = y - t * d[1], gz = z - t * d[2], square = gx * gx + gy * gy + gz * gz;
      const Floats start = gx * x + gy * y + gz * z, end = start - (gx * d[0] + gy * d[1] + gz * d[2]);
      const Form& s = forms.s;
      const Floats sx = s[0][half] * gx + s[1][half] * gy + s[2][half] * gz,
                   sy = s[1][half] * gx + s[3][half] * gy + s[4][half] * gz,
                   sz = s[2][half] * gx + s[4][half] * gy + s[5][half] * gz;
      const Floats wide = gx * sx + gy * sy + gz * sz, trace = all(kOfForms) * (s[0][half] + s[3][half] + s[5][half]);
      const Floats size = larger(x, -x) + larger(y, -y) + larger(z, -z) + length1;
      const Floats length = square_root(square);
      const Floats left = smaller(start, end) - (reach + forms.loss[half] + all(kRelative) * size + room) * length;
      return (left > all(0)) & (left * left > wide + trace * square);
    }

    // Mask of the obstacles that are behind, r^T A v < 0, and do not contain a, r^T A r > 1, rounding included.
    Bits behind(const Leaf& leaf, const Forms& forms, std::size_t half) const {
      const Floats x = leaf.x[half] - a[0], y = leaf.y[half] - a[1], z = leaf.z[half] - a[2];
      const Form& f = forms.a;
      const Floats xx = f[0][half], xy = f[1][half], xz = f[2][half], yy = f[3][half], yz = f[4][half],
                   zz = f[5][half];
      const Floats ax = xx * x + xy * y + xz * z, ay = xy * x + yy * y + yz * z, az = xz * x + yz * y + zz * z;
      const Floats length = larger(x, -x) + larger(y, -y) + larger(z, -z);
      const Floats slack = (xx + yy + zz) * (all(kOfForms) * length + room);  // bounds the rounding error of A r
      return (ax * v[0] + ay * v[1] + az * v[2] < -slack * speed1) &
             (ax * x + ay * y + az * z > all(1) + all(2) * slack * (length + room));
    }
  };

  // Pending nodes, roughly ordered by distance: one list for every factor of 2^(1/8). The order only saves time.
  class Queue {
   public:
    explicit Queue(float limit) : top_(std::min(key(limit), key(16.0F))) { list_.fill(kEnd); }
    bool has_room(std::uint32_t more) const { return size_ + more <= kRoom; }
    void push(Entry entry) {
      ++size_;
      std::uint32_t at = free_;
      if (at != kEnd) {
        free_ = next_[at];
      } else {
        at = used_++;
      }
      const auto list = static_cast<std::size_t>(std::clamp(key(squared_of(entry)) - top_ + 63, 0, 63));
      entry_[at] = entry, next_[at] = list_[list], list_[list] = at;
      filled_ |= std::uint64_t{1} << list;
    }
    bool pop(Entry& entry) {
      if (filled_ == 0) return false;
      --size_;
      const auto list = static_cast<std::size_t>(std::countr_zero(filled_));
      const std::uint32_t at = list_[list];
      entry = entry_[at], list_[list] = next_[at];
      if (list_[list] == kEnd) filled_ &= filled_ - 1;
      next_[at] = free_, free_ = at;
      return true;
    }

   private:
    static constexpr std::uint32_t kRoom = 1024, kEnd = kRoom;
    static int key(float squared) { return static_cast<int>(std::bit_cast<std::uint32_t>(squared) >> 21); }

    int top_;
    std::uint64_t filled_ = 0;
    std::uint32_t size_ = 0, used_ = 0, free_ = kEnd;
    std::array<std::uint32_t, 64> list_;
    std::array<std::uint32_t, kRoom> next_;
    std::array<Entry, kRoom> entry_;
  };

  template <class Visit>
  Cost search(const Look& look, const double& reach, Visit&& visit) const {
    Queue queue(look.limit(reach));
    Cost cost;
    queue.push(entry_of(0, 0));
    double known = reach;
    float limit = look.limit(known);
    for (Entry entry; queue.pop(entry);) {
      if (reach != known) known = reach, limit = look.limit(known);
      if (squared_of(entry) > limit) continue;
      const std::uint32_t child = child_of(entry);
      if (child >= kLeaf) {
        look_into(child & ~kLeaf, look, reach, visit, cost);
      } else if (!queue.has_room(4)) {
        descend(entry, look, reach, visit, cost);
      } else {
        std::array<Entry, 4> near;
        std::size_t count = 0;
        for_children(child, look, reach, cost, [&](Entry each) {
          std::size_t at = count++;
          for (; at > 0 && near[at - 1] < each; --at) near[at] = near[at - 1];
          near[at] = each;
        });
        for (std::size_t i = 0; i < count; ++i) queue.push(near[i]);
      }
    }
    return cost;
  }

  template <class Visit>
  void descend(Entry root, const Look& look, const double& reach, Visit&& visit, Cost& cost) const {
    std::array<Entry, 256> stack;  // each level leaves at most three
    std::size_t top = 0;
    stack[top++] = root;
    while (top > 0) {
      const Entry entry = stack[--top];
      if (squared_of(entry) > look.limit(reach)) continue;
      if (child_of(entry) >= kLeaf) {
        look_into(child_of(entry) & ~kLeaf, look, reach, visit, cost);
        continue;
      }
      const std::size_t begin = top;
      for_children(child_of(entry), look, reach, cost, [&](Entry each) {
        std::size_t at = top++;
        for (; at > begin && stack[at - 1] < each; --at) stack[at] = stack[at - 1];
        stack[at] = each;
      });
    }
  }

  template <class Each>
  void for_children(std::uint32_t index, const Look& look, double reach, Cost& cost, Each&& each) const {
    const Node& node = nodes_[index];
    unsigned marked;
    const auto squared = std::bit_cast<std::array<float, 4>>(look.bounds(node, look.limit(reach), marked));
    for (std::size_t i = 0; i < 4 && node.child[i] != kNone; ++i) {
      ++cost.nodes;
      if ((marked >> i & 1) == 0) each(entry_of(squared[i], node.child[i]));
    }
  }

  template <class Visit>
  void look_into(std::uint32_t index, const Look& look, double reach, Visit&& visit, Cost& cost) const {
    const std::uint32_t first = first_[index], count = first_[index + 1] - first;
    const Leaf& leaf = leaves_[index];
    const Floats within = all((std::max(0.0, reach) + look.room_) * (1 + 0x1p-15));
    cost.items += count;
    unsigned near = bits(look.near(leaf, 0, within)) | bits(look.near(leaf, 1, within)) << 4;
    near &= (1U << count) - 1;
    if (near == 0) return;
    const Forms& forms = forms_[index];
    if (look.ahead) near &= ~(bits(look.behind(leaf, forms, 0)) | bits(look.behind(leaf, forms, 1)) << 4);
    if (near == 0) return;
    near &= ~(bits(look.apart(leaf, forms, 0, within)) | bits(look.apart(leaf, forms, 1, within)) << 4);
    for (; near != 0; near &= near - 1) visit(first + static_cast<std::uint32_t>(std::countr_zero(near)));
  }

  std::uint32_t build(const Bvh& binary, std::uint32_t at, const std::vector<Ball>& balls,
                      const std::vector<Shape>& shapes);

  std::vector<Node> nodes_;
  std::vector<Leaf> leaves_;
  std::vector<Forms> forms_;          // per leaf
  std::vector<std::uint32_t> first_;  // first slot of each leaf, and one past the last
};

}  // namespace alula::geometry
