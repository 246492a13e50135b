// Columns and rows of voxels that an ellipsoid reaches, in closed form (see voxelize.hpp).
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "alula/geometry/ellipsoid.hpp"

namespace alula::surfaces {

inline constexpr double kPad = 256 * kEps;       // q / E
inline constexpr double kRadius = 1 + 4 * kEps;  // of the ball: w is never rounded below the true one
inline constexpr double kMiss = -std::numeric_limits<double>::infinity();

inline double dot(const Triple& a, const Triple& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

struct Span {
  double lower, upper;  // extent of voxels along an axis, relative to the centre
};

// The shadow of an ellipsoid along axis k on the plane of the other two axes. It reaches a rectangle that does
// not hold the centre across one of the at most two edges that face the centre.
class Shadow {
 public:
  Shadow(const Ellipsoid& e, double pad, std::size_t i, std::size_t j, std::size_t k) : pad_(pad) {
    const double product = dot(e.row[i], e.row[j]);
    const Triple c{e.rotation[k][0] * e.axis[1] * e.axis[2], e.rotation[k][1] * e.axis[0] * e.axis[2],
                   e.rotation[k][2] * e.axis[0] * e.axis[1]};
    const double inverse_length = 1 / std::sqrt(dot(c, c));
    const auto side = [&](std::size_t a) {
      const double inverse = 1 / e.half[a];
      return Side{inverse, product * inverse, e.half[a] * inverse_length};
    };
    first_ = side(i), second_ = side(j);
  }

  // The chord of the shadow on the edge of a row of voxels that faces the centre.
  struct Chord {
    Span span;
    bool inside;  // the row holds the centre, so it has no such edge
    double middle, w;
  };
  Chord first(const Span& span) const { return chord(first_, span); }
  Chord second(const Span& span) const { return chord(second_, span); }

  bool reaches(const Chord& x, const Chord& y) const {
    return (x.inside && y.inside) || crosses(first_, x, y.span) || crosses(second_, y, x.span);
  }

 private:
  struct Side {
    double inverse_l11, l21, inverse_l22;
  };

  Chord chord(const Side& side, const Span& s) const {
    const bool right = s.lower > 2 * pad_, left = s.upper < -2 * pad_;
    const double t = (right ? s.lower - pad_ : s.upper + pad_) * side.inverse_l11;
    const double square = (kRadius - t) * (kRadius + t);
    return {s, !right && !left, side.l21 * t, square > 0 ? std::sqrt(square) : -1};
  }

  bool crosses(const Side& side, const Chord& c, const Span& s) const {
    const double a = (s.lower - 4 * pad_ - c.middle) * side.inverse_l22;
    const double b = (s.upper + 4 * pad_ - c.middle) * side.inverse_l22;
    return !c.inside & (c.w >= 0) & (a <= c.w) & (b >= -c.w);
  }

  double pad_;
  Side first_, second_;
};

// The plane over one edge of a column, first coordinate fixed: an arc of the upper surface.
struct Cut {
  bool inside;   // along this axis the apex is above the column: there is no edge
  double shift;  // second coordinate at u2 = 0
  double lift;   // height at u2 = 0, without the arc
  double w;      // radius of the arc in u; negative when the edge misses the ellipsoid
  double best;   // u2 of the arc's highest point
};

// One horizontal axis, for the upper or the lower surface mirrored upward.
class Side {
 public:
  struct Shape {
    double l11, l21, l31, l22, l32, l33, rise, slope, apex;  // rise = |(l32, l33)|, slope = l32 / rise
  };

  Side(const Shape& s, double sign, double pad) : s_(s), pad_(pad), inverse_l11_(1 / s.l11), inverse_l22_(1 / s.l22) {
    s_.l31 *= sign, s_.l32 *= sign, s_.slope *= sign, s_.apex *= sign;
  }

  // The edge that faces the apex, of the columns between lower and upper along this axis.
  Cut cut(double lower, double upper) const {
    if (lower > s_.apex + 2 * pad_) return edge(lower - pad_);
    if (upper < s_.apex - 2 * pad_) return edge(upper + pad_);
    return {true, 0, 0, 0, 0};
  }

  // Highest point of the surface above an edge, second coordinate between lower and upper.
  double highest(const Cut& cut, double lower, double upper) const {
    if (cut.w < 0) return kMiss;
    const double a = (lower - 4 * pad_ - cut.shift) * inverse_l22_;
    const double b = (upper + 4 * pad_ - cut.shift) * inverse_l22_;
    if (a > cut.w || b < -cut.w) return kMiss;
    if (cut.best >= a && cut.best <= b) return cut.lift + cut.w * s_.rise;
    const double u = cut.best < a ? a : b;
    return cut.lift + s_.l32 * u + s_.l33 * std::sqrt(std::max(0.0, (cut.w - u) * (cut.w + u)));
  }

 private:
  Cut edge(double at) const {
    const double t = at * inverse_l11_;
    if (!(std::abs(t) < kRadius)) return {false, 0, 0, -1, 0};
    const double w = std::sqrt((kRadius - t) * (kRadius + t));
    return {false, s_.l21 * t, s_.l31 * t, w, w * s_.slope};
  }

  Shape s_;
  double pad_, inverse_l11_, inverse_l22_;
};

// Both surfaces over the columns along the two horizontal axes.
class Surfaces {
 public:
  Surfaces(const Ellipsoid& e, double pad) : Surfaces(e, pad, Shapes(e)) {}

  struct Edge {
    Span span;
    Cut top, bottom;
  };
  Edge x_edge(const Span& s) const { return {s, x_up_.cut(s.lower, s.upper), x_down_.cut(s.lower, s.upper)}; }
  Edge y_edge(const Span& s) const { return {s, y_up_.cut(s.lower, s.upper), y_down_.cut(s.lower, s.upper)}; }

  // Highest and mirrored lowest point over a column; kMiss when the set does not reach it.
  double top(const Edge& x, const Edge& y) const { return height(x_up_, x.top, x.span, y_up_, y.top, y.span); }
  double bottom(const Edge& x, const Edge& y) const {
    return height(x_down_, x.bottom, x.span, y_down_, y.bottom, y.span);
  }

 private:
  struct Shapes {
    Side::Shape x, y;
    explicit Shapes(const Ellipsoid& e) {
      const Triple pair{e.axis[1] * e.axis[2], e.axis[0] * e.axis[2], e.axis[0] * e.axis[1]};
      std::array<Triple, 3> c;
      Triple length;
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t j = 0; j < 3; ++j) c[a][j] = e.rotation[a][j] * pair[j];
        length[a] = std::sqrt(dot(c[a], c[a]));
      }
      const double xy = dot(e.row[0], e.row[1]), l33 = pair[0] * e.axis[0] / length[2];
      const auto shape = [&](std::size_t i, std::size_t j) {
        const double inverse = 1 / e.half[i], third = dot(e.row[i], e.row[2]);
        const double rise = length[j] * inverse, slope = -dot(c[j], c[2]) / (length[j] * length[2]);
        return Side::Shape{e.half[i], xy * inverse, third * inverse, length[2] * inverse, slope * rise,
                           l33,       rise,         slope,           third / e.half[2]};
      };
      x = shape(0, 1), y = shape(1, 0);
    }
  };

  Surfaces(const Ellipsoid& e, double pad, const Shapes& s)
      : apex_(e.half[2]), x_up_(s.x, 1, pad), x_down_(s.x, -1, pad), y_up_(s.y, 1, pad), y_down_(s.y, -1, pad) {}

  double height(const Side& x_side, const Cut& x, const Span& x_span, const Side& y_side, const Cut& y,
                const Span& y_span) const {
    if (x.inside && y.inside) return apex_;
    double best = kMiss;
    if (!x.inside) best = x_side.highest(x, y_span.lower, y_span.upper);
    if (!y.inside) best = std::max(best, y_side.highest(y, x_span.lower, x_span.upper));
    return best;
  }

  double apex_;
  Side x_up_, x_down_, y_up_, y_down_;
};

}  // namespace alula::surfaces
