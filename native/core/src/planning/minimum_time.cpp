#include "alula/planning/minimum_time.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "alula/base/dual.hpp"
#include "alula/geometry/mat3.hpp"

namespace alula {
namespace {

using geometry::Mat3;
using geometry::Vec3;

constexpr std::size_t kPoints = 8;  // of a piece, de Boor's and Bernstein's
constexpr std::size_t kSpans = 5;   // durations that a piece depends on
constexpr std::size_t kOrders = 5;  // position to snap
constexpr int kFixed = -1;
constexpr double kLeastGain = 1e-3;  // of a step of Newton's method, in units of the number of constraints

template <class S>
using Basis = std::array<std::array<S, kPoints>, kPoints>;  // Bernstein point from de Boor points

// The weights of the Bernstein points of the piece with the durations span[2], of its neighbours span[0] .. span[4]
// (0 beyond the ends of the curve): blossoms at (0, .., 0, T, .., T), by de Boor's recursion.
template <class S>
Basis<S> bernstein_weights(const std::array<S, kSpans>& span) {
  // Knots 1 to 14 about the piece from 0 to T, with multiplicity 3 within the curve.
  const S zero(0.0), length = span[2];
  const S before = zero - span[1], far_before = before - span[0];
  const S after = length + span[3], far_after = after + span[4];
  const std::array<S, 15> knot{zero,   far_before, before, before, before, zero,  zero,     zero,
                               length, length,     length, after,  after,  after, far_after};
  Basis<S> result;
  for (std::size_t i = 0; i < kPoints; ++i) {
    // value[j] is the blossom of r arguments and knots j + r + 1 .. j + 7, as weights of de Boor points j .. j + r.
    std::array<std::array<S, kPoints>, kPoints> value{};
    for (std::size_t j = 0; j < kPoints; ++j) value[j][j] = S(1.0);
    for (std::size_t r = 1; r < kPoints; ++r) {
      const S& at = r <= i ? length : zero;
      for (std::size_t j = 0; j + r < kPoints; ++j) {
        const S& low = knot[j + r];
        const S& high = knot[j + 8];
        const S right = (at - low) / (high - low), left = (high - at) / (high - low);
        for (std::size_t d = j; d <= j + r; ++d) value[j][d] = left * value[j][d] + right * value[j + 1][d];
      }
    }
    result[i] = value[0];
  }
  return result;
}

// A vector of the curve as a function of the free variables of a piece, to first order.
struct Point {
  Vec3 value;
  std::array<double, kPoints> weight{};  // of de Boor points
  std::array<Vec3, kSpans> along{};      // per second of a duration

  friend Point operator-(const Point& a, const Point& b) {
    Point r{a.value - b.value, {}, {}};
    for (std::size_t i = 0; i < kPoints; ++i) r.weight[i] = a.weight[i] - b.weight[i];
    for (std::size_t m = 0; m < kSpans; ++m) r.along[m] = a.along[m] - b.along[m];
    return r;
  }
  friend Point operator+(const Point& a, const Point& b) { return a - (-1.0) * b; }
  friend Point operator*(double s, const Point& a) {
    Point r{s * a.value, {}, {}};
    for (std::size_t i = 0; i < kPoints; ++i) r.weight[i] = s * a.weight[i];
    for (std::size_t m = 0; m < kSpans; ++m) r.along[m] = s * a.along[m];
    return r;
  }
};

// Value, gradient and Hessian of a sum of barriers in a vector; `inside` is false outside of a set.
struct Barrier {
  double value = 0;
  Vec3 gradient;
  Mat3 hessian{};
  bool inside = true;

  void add_slack(double s, Vec3 ds) {  // -log s for a linear s
    if (!(s > 0)) {
      inside = false;
      return;
    }
    value -= std::log(s);
    gradient = gradient - (1 / s) * ds;
    hessian = hessian + (1 / (s * s)) * geometry::outer(ds, ds);
  }

  // -log(s) with s = |c|^2 k.x - ..., for a quadratic s with Hessian diag(2 q).
  void add_quadratic(double s, Vec3 ds, Vec3 q) {
    add_slack(s, ds);
    if (!inside) return;
    for (int i = 0; i < 3; ++i) hessian.m[i][i] -= 2 * q[i] / s;
  }

  void add_ball(Vec3 y, double radius) {
    if (!std::isfinite(radius)) return;
    add_quadratic(radius * radius - geometry::dot(y, y), -2.0 * y, {-1, -1, -1});
  }
};

// A symmetric band matrix by rows, and its Cholesky factorisation.
class Band {
 public:
  Band(std::size_t size, std::size_t width) : size_(size), width_(width), entry_(size * (width + 1)) {}

  void clear() { std::fill(entry_.begin(), entry_.end(), 0.0); }
  double& at(std::size_t row, std::size_t column) { return entry_[row * (width_ + 1) + width_ - (row - column)]; }
  double at(std::size_t row, std::size_t column) const {
    return entry_[row * (width_ + 1) + width_ - (row - column)];
  }

  // Replaces this by its factor; false if it is not positive definite.
  bool factorise() {
    for (std::size_t i = 0; i < size_; ++i) {
      const std::size_t first = i > width_ ? i - width_ : 0;
      for (std::size_t j = first; j <= i; ++j) {
        const std::size_t low = std::max(first, j > width_ ? j - width_ : 0);
        const double* a = &at(i, low);
        const double* b = &at(j, low);
        double sum = at(i, j);
        for (std::size_t k = 0; k < j - low; ++k) sum -= a[k] * b[k];
        if (j < i) {
          at(i, j) = sum / at(j, j);
        } else {
          if (!(sum > 0)) return false;
          at(i, i) = std::sqrt(sum);
        }
      }
    }
    return true;
  }

  void solve(std::vector<double>& x) const {
    for (std::size_t i = 0; i < size_; ++i) {
      for (std::size_t j = i > width_ ? i - width_ : 0; j < i; ++j) x[i] -= at(i, j) * x[j];
      x[i] /= at(i, i);
    }
    for (std::size_t i = size_; i-- > 0;) {
      x[i] /= at(i, i);
      for (std::size_t j = i > width_ ? i - width_ : 0; j < i; ++j) x[j] -= at(i, j) * x[i];
    }
  }

 private:
  std::size_t size_, width_;
  std::vector<double> entry_;
};

// Cholesky factor of the Gram matrix of cubic Bernstein polynomials: integral of |sum_i s_i B_i|^2 over [0, 1] is
// |L^T s|^2.
std::array<std::array<double, 4>, 4> snap_factor() {
  constexpr double choose3[4] = {1, 3, 3, 1}, choose6[7] = {1, 6, 15, 20, 15, 6, 1};
  std::array<std::array<double, 4>, 4> l{};
  for (std::size_t i = 0; i < 4; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = choose3[i] * choose3[j] / choose6[i + j] / 7;
      for (std::size_t k = 0; k < j; ++k) sum -= l[i][k] * l[j][k];
      l[i][j] = i == j ? std::sqrt(sum) : sum / l[j][j];
    }
  }
  return l;
}

struct Iterate {
  std::vector<Vec3> control;  // de Boor points, fixed ones and those of vias included
  std::vector<Vec3> knot;     // where the curve passes each via, K - 1
  std::vector<double> log_duration;
};

// How much wider than given the sets are, while a first curve is looked for.
struct Slackened {
  double widen = 0;    // of the cells [m]
  double stretch = 1;  // of the limits
};

class Program {
 public:
  explicit Program(const TimeProblem& problem)
      : problem_(problem), pieces_(problem.cell.size()), factor_(snap_factor()) {
    check();
    const std::size_t count = 3 * pieces_ + 5;
    control_variable_.assign(count, kFixed);
    duration_variable_.assign(pieces_, kFixed);
    number_variables(true);
  }

  // Rest to rest along straight lines between the joints, slowly; from a state of motion into the first of them.
  Iterate first() const {
    Iterate x;
    x.control.assign(3 * pieces_ + 5, problem_.goal);
    x.log_duration.assign(pieces_, 0.0);
    x.knot.assign(problem_.joint.begin(), problem_.joint.end());
    std::size_t begin = 0;
    Vec3 from = problem_.start.p;
    for (std::size_t end = 1; end <= pieces_; ++end) {
      if (end < pieces_ && !stops(end)) continue;
      const Vec3 to = end < pieces_ ? problem_.joint[end - 1] : problem_.goal;
      const std::size_t low = 3 * begin + 4, high = 3 * end;  // de Boor points at rest at both ends
      for (std::size_t i = 3 * begin; i <= 3 * end + 4 && i < x.control.size(); ++i) {
        const double f = std::clamp((double(i) - double(low)) / (double(high) - double(low)), 0.0, 1.0);
        x.control[i] = (1 - f) * from + f * to;
      }
      const double length = geometry::norm(to - from), count = double(end - begin);
      for (std::size_t k = begin; k < end; ++k) {
        const double limit = speed_of(k), speed = std::isfinite(limit) ? limit : 1.0;
        x.log_duration[k] = std::log(std::max(4 * problem_.least_duration, 2 * length / (count * speed)));
      }
      begin = end, from = to;
    }
    for (std::size_t k = 1; k < pieces_; ++k) {
      if (const Opening* o = opening(k); o && is_disc(*o)) cross(x, k, o->normal);
    }
    settle(x);
    return x;
  }

  // True where the first curve stops at the end of piece k - 1: where the cell changes.
  bool stops(std::size_t k) const { return problem_.cell[k - 1] != problem_.cell[k] || problem_.is_via[k - 1] != 0; }

  double total(const Iterate& x) const {
    double sum = 0;
    for (const double l : x.log_duration) sum += std::exp(l);
    return sum;
  }

  std::size_t size() const { return variables_; }
  double constraints() const { return constraints_; }

  // With `timed` the durations are variables.
  void number_variables(bool timed) {
    const std::size_t count = 3 * pieces_ + 5;
    const std::size_t fixed = problem_.start.moving ? 4 : 5;
    int next = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const bool is_free = i >= fixed && i + 5 < count && (!is_via_point(i) || opening((i - 2) / 3));
      if (is_free) {
        control_variable_[i] = next;
        next += 3;
      } else {
        control_variable_[i] = kFixed;
      }
      if (i >= 3 && (i - 3) % 3 == 0 && (i - 3) / 3 < pieces_) {
        duration_variable_[(i - 3) / 3] = timed ? next++ : kFixed;
      }
    }
    variables_ = static_cast<std::size_t>(next);
    std::size_t width = 0;
    for (std::size_t k = 0; k < pieces_; ++k) {
      int low = next, high = 0;
      each_variable(k, [&](int v, int size) { low = std::min(low, v), high = std::max(high, v + size - 1); });
      if (high > low) width = std::max(width, static_cast<std::size_t>(high - low));
    }
    width_ = width;
  }

  std::size_t width() const { return width_; }

  // Makes the dependent de Boor points agree with the variables: those at the start of a moving vehicle, and the
  // middle one of each via.
  void settle(Iterate& x) const {
    if (problem_.start.moving) {
      const double t = std::exp(x.log_duration[0]);
      for (std::size_t i = 0; i < 4; ++i) x.control[i] = start_point(i, t);
    }
    for (std::size_t k = 1; k < pieces_; ++k) {
      if (!problem_.is_via[k - 1]) continue;
      const auto m = bernstein_weights(durations<double>(x, k));
      Vec3 others{};
      for (std::size_t i = 0; i < 5; ++i) {
        if (i != 2) others = others + m[0][i] * x.control[3 * k + i];
      }
      x.control[3 * k + 2] = (1 / m[0][2]) * (x.knot[k - 1] - others);
    }
  }

  // t times the objective and the barrier; infinite outside. With `gradient`, its derivatives too.
  double evaluate(const Iterate& x, double t, const Slackened& slack, double snap_weight,
                  std::vector<double>* gradient, Band* hessian) const {
    double sum = 0;
    if (gradient) {
      std::fill(gradient->begin(), gradient->end(), 0.0);
      hessian->clear();
    }
    for (std::size_t k = 0; k < pieces_; ++k) {
      const double value = gradient ? piece<Dual<kSpans>>(x, k, t, slack, snap_weight, gradient, hessian)
                                    : piece<double>(x, k, t, slack, snap_weight, gradient, hessian);
      if (!std::isfinite(value)) return kUnlimited;
      sum += value;
    }
    return sum;
  }

  // The least widening of cells and stretch of limits with which x is inside, barely.
  Slackened needed(const Iterate& x) const {
    Slackened result;
    for (std::size_t k = 0; k < pieces_; ++k) {
      Basis<double> m = bernstein_weights(durations<double>(x, k));
      std::array<Vec3, kPoints> p{};
      for (std::size_t i = 0; i < kPoints; ++i) {
        for (std::size_t j = 0; j < kPoints; ++j) p[i] = p[i] + m[i][j] * x.control[3 * k + j];
        if (is_constant(k, i)) continue;
        each_row(k, [&](Vec3 n, double d) { result.widen = std::max(result.widen, geometry::dot(n, p[i]) - d); });
        each_side(k, i, [&](Vec3 n, Vec3 c) { result.widen = std::max(result.widen, geometry::dot(n, p[i] - c)); });
        if (const Opening* o = i == 0 && k > 0 ? opening(k) : nullptr) {
          result.widen = std::max(result.widen, geometry::norm(p[i] - o->centre) - o->radius);
        }
      }
      const double duration = std::exp(x.log_duration[k]);
      for (std::size_t order = 1; order < kOrders; ++order) {
        for (std::size_t i = 0; i + order < kPoints; ++i) {
          p[i] = (double(kPoints - order) / duration) * (p[i + 1] - p[i]);
          if (is_given(k, order, i)) continue;
          result.stretch = std::max(result.stretch, stretch_of(k, order, p[i]));
        }
      }
    }
    return result;
  }

  // x + step * direction.
  Iterate moved(const Iterate& x, const std::vector<double>& direction, double step) const {
    Iterate y = x;
    for (std::size_t i = 0; i < y.control.size(); ++i) {
      if (control_variable_[i] == kFixed) continue;
      const Vec3 way = geometry::from_rows(&direction[static_cast<std::size_t>(control_variable_[i])]);
      if (!is_via_point(i)) {
        y.control[i] = y.control[i] + step * way;
        continue;
      }
      const Vec3 n = opening((i - 2) / 3)->normal;  // 0 for a ball
      Vec3& knot = y.knot[(i - 2) / 3 - 1];
      knot = knot + step * (way - geometry::dot(n, way) * n);
    }
    for (std::size_t k = 0; k < pieces_; ++k) {
      if (duration_variable_[k] == kFixed) continue;
      y.log_duration[k] += step * direction[static_cast<std::size_t>(duration_variable_[k])];
    }
    settle(y);
    return y;
  }

  double longest_log_step(const std::vector<double>& direction) const {
    double most = 0;
    for (const int v : duration_variable_) {
      if (v != kFixed) most = std::max(most, std::abs(direction[static_cast<std::size_t>(v)]));
    }
    return most;
  }

  std::vector<Vec3> bernstein_points(const Iterate& x) const {
    std::vector<Vec3> result;
    for (std::size_t k = 0; k < pieces_; ++k) {
      const auto m = bernstein_weights(durations<double>(x, k));
      for (std::size_t i = 0; i < kPoints; ++i) {
        Vec3 p{};
        for (std::size_t j = 0; j < kPoints; ++j) p = p + m[i][j] * x.control[3 * k + j];
        result.push_back(p);
      }
    }
    return result;
  }

 private:
  void check() {
    const TimeProblem& q = problem_;
    const std::size_t cells = q.row_start.empty() ? 0 : q.row_start.size() - 1;
    bool good = pieces_ >= 2 && q.joint.size() + 1 == pieces_ && q.is_via.size() + 1 == pieces_ &&
                q.normals.size() == 3 * q.offsets.size() && cells > 0 && q.row_start.front() == 0 &&
                q.row_start.back() == static_cast<std::int64_t>(q.offsets.size()) && q.least_duration > 0;
    for (std::size_t i = 0; good && i < cells; ++i) good = q.row_start[i] <= q.row_start[i + 1];
    for (std::size_t k = 0; good && k < pieces_; ++k) {
      good = q.cell[k] < cells && (k == 0 || q.cell[k] == q.cell[k - 1] || q.cell[k] == q.cell[k - 1] + 1);
    }
    std::size_t begin = 0;
    for (std::size_t end = 1; good && end <= pieces_; ++end) {
      if (end < pieces_ && !stops(end)) continue;
      good = end - begin >= 2;  // a piece alone cannot go from rest to rest with zero snap
      begin = end;
    }
    good = good && (q.opening.empty() || q.opening.size() + 1 == pieces_) &&
           (q.speed.empty() || q.speed.size() == pieces_);
    for (std::size_t i = 0; good && i < q.opening.size(); ++i) {
      const double n = geometry::norm(q.opening[i].normal);
      good = q.opening[i].radius >= 0 && (n == 0 || std::abs(n - 1) < 1e-9);
    }
    for (std::size_t k = 0; good && k < q.speed.size(); ++k) good = q.speed[k] > 0;
    if (!good) throw std::invalid_argument("the cells, pieces and joints of the curve do not fit together");
    for (std::size_t k = 0; k < pieces_; ++k) {
      const auto c = static_cast<std::size_t>(q.cell[k]);
      constraints_ += 8 * double(q.row_start[c + 1] - q.row_start[c]) + 7 + 6 * 5 + 5 + 4 + 1;
      if (const Opening* o = k > 0 ? opening(k) : nullptr) constraints_ += is_disc(*o) ? 15 : 1;
    }
  }

  bool is_via_point(std::size_t i) const {
    return i >= 5 && (i - 2) % 3 == 0 && (i - 2) / 3 < pieces_ && problem_.is_via[(i - 2) / 3 - 1] != 0;
  }

  // Where the curve may pass the via at the beginning of piece k; none if that is a point.
  const Opening* opening(std::size_t k) const {
    if (problem_.opening.empty() || k == 0 || k >= pieces_ || !problem_.is_via[k - 1]) return nullptr;
    const Opening& o = problem_.opening[k - 1];
    return o.radius > 0 ? &o : nullptr;
  }
  static bool is_disc(const Opening& o) { return geometry::dot(o.normal, o.normal) > 0; }
  bool is_fixed_via(std::size_t k) const { return problem_.is_via[k - 1] != 0 && !opening(k); }

  double speed_of(std::size_t k) const {
    return problem_.speed.empty() ? problem_.limits.speed : std::min(problem_.limits.speed, problem_.speed[k]);
  }

  // A piece before a disc stays on the side that it comes from, one behind it on the other side: f(n, c) for
  // n . (y - c) <= 0, which the other Bernstein points of these pieces keep.
  template <class F>
  void each_side(std::size_t k, std::size_t i, F&& f) const {
    if (const Opening* o = i < 7 ? opening(k + 1) : nullptr; o && is_disc(*o)) f(o->normal, o->centre);
    if (const Opening* o = i > 0 ? opening(k) : nullptr; o && is_disc(*o)) f(-o->normal, o->centre);
  }

  // Lets the first curve cross the plane of a disc along its normal, at the joint: five de Boor points lie on a
  // straight line at their Greville abscissae, so that it has a constant velocity there.
  void cross(Iterate& x, std::size_t k, Vec3 normal) const {
    const auto t = durations<double>(x, k);
    const double before = -t[1], far_before = before - t[0], after = t[2] + t[3];
    const std::array<double, 5> at{(far_before + 3 * before) / 7, (3 * before + t[2]) / 7,
                                   (2 * before + 2 * t[2]) / 7, (before + 3 * t[2]) / 7, (3 * t[2] + after) / 7};
    const Vec3 joint = problem_.joint[k - 1];
    double room = 1;
    for (const std::size_t piece : {k - 1, k}) {
      each_row(piece, [&](Vec3 n, double d) { room = std::min(room, d - geometry::dot(n, joint)); });
    }
    for (const std::size_t i : {3 * k - 1, 3 * k + 5}) {  // the first and last point that the joint does not have
      room = std::min(room, std::abs(geometry::dot(normal, x.control[i] - joint)));
    }
    const double speed = 0.5 * room / std::max(-at[0], at[4]);
    for (std::size_t i = 0; i < 5; ++i) x.control[3 * k + i] = joint + (speed * at[i]) * normal;
  }

  // The position points that do not depend on a variable.
  bool is_constant(std::size_t k, std::size_t i) const {
    if (k == 0 && i < (problem_.start.moving ? 1u : 5u)) return true;
    if (k + 1 == pieces_ && i >= 3) return true;
    return (k > 0 && i == 0 && is_fixed_via(k)) || (k + 1 < pieces_ && i == 7 && is_fixed_via(k + 1));
  }

  // The derivatives of the start, which no variable changes.
  bool is_given(std::size_t k, std::size_t order, std::size_t i) const { return k == 0 && i == 0 && order < 4; }

  template <class F>
  void each_row(std::size_t k, F&& f) const {
    const auto c = static_cast<std::size_t>(problem_.cell[k]);
    for (auto r = static_cast<std::size_t>(problem_.row_start[c]);
         r < static_cast<std::size_t>(problem_.row_start[c + 1]); ++r) {
      f(geometry::from_rows(&problem_.normals[3 * r]), problem_.offsets[r]);
    }
  }

  template <class F>
  void each_variable(std::size_t k, F&& f) const {
    for (std::size_t j = 0; j < kPoints; ++j) {
      if (const int v = control_variable_[3 * k + j]; v != kFixed) f(v, 3);
    }
    for (std::size_t m = 0; m < kSpans; ++m) {
      if (const int v = duration_of(k, m); v != kFixed) f(v, 1);
    }
  }

  int duration_of(std::size_t k, std::size_t m) const {
    const std::size_t i = k + m;
    return i < 2 || i - 2 >= pieces_ ? kFixed : duration_variable_[i - 2];
  }

  template <class S>
  std::array<S, kSpans> durations(const Iterate& x, std::size_t k) const {
    std::array<S, kSpans> span{};
    for (std::size_t m = 0; m < kSpans; ++m) {
      const std::size_t i = k + m;
      const double t = i < 2 || i - 2 >= pieces_ ? 0.0 : std::exp(x.log_duration[i - 2]);
      span[m] = S(t);
      if constexpr (!std::is_same_v<S, double>) span[m].d[m] = t > 0 ? 1.0 : 0.0;
    }
    return span;
  }

  Vec3 start_point(std::size_t i, double t) const {
    const StartState& s = problem_.start;
    const double f = double(i), u = t / 7;
    return s.p + (f * u) * s.v + (f * (f - 1) / 2 * t * t / 42) * s.a +
           (f * (f - 1) * (f - 2) / 6 * t * t * t / 210) * s.j;
  }
  Vec3 start_slope(std::size_t i, double t) const {
    const StartState& s = problem_.start;
    const double f = double(i);
    return (f / 7) * s.v + (f * (f - 1) * t / 42) * s.a + (f * (f - 1) * (f - 2) / 2 * t * t / 210) * s.j;
  }

  double stretch_of(std::size_t k, std::size_t order, Vec3 y) const {
    const MotionLimits& l = problem_.limits;
    const double size = geometry::norm(y);
    switch (order) {
      case 1:
        return size / speed_of(k);
      case 3:
        return size / l.jerk;
      case 4:
        return size / l.snap;
      default:
        break;
    }
    double low = size / l.acceleration, high = 1e12;
    const auto inside = [&](double s) { return thrust_barrier((1 / s) * y, Barrier{}).inside; };
    if (low > 0 && inside(low)) return low;
    low = std::max(low, 1e-9);
    while (high > low * (1 + 1e-6)) {
      const double middle = std::sqrt(low * high);
      (inside(middle) ? high : low) = middle;
    }
    return high;
  }

  Barrier thrust_barrier(Vec3 a, Barrier b) const {
    const MotionLimits& l = problem_.limits;
    const Vec3 f = a + Vec3{0, 0, l.gravity};
    b.add_ball(f, l.most_thrust);
    if (std::isfinite(l.least_thrust)) b.add_slack(f.z - l.least_thrust, {0, 0, 1});
    if (std::isfinite(l.tilt)) {
      const double t2 = l.tilt * l.tilt;
      if (!(f.z > 0)) b.inside = false;
      b.add_quadratic(t2 * f.z * f.z - f.x * f.x - f.y * f.y, {-2 * f.x, -2 * f.y, 2 * t2 * f.z}, {-1, -1, t2});
    }
    return b;
  }

  Barrier barrier(std::size_t k, std::size_t order, std::size_t i, Vec3 y, const Slackened& slack) const {
    const MotionLimits& l = problem_.limits;
    Barrier b;
    if (order == 0) {
      if (is_constant(k, i)) return b;
      each_row(k, [&](Vec3 n, double d) { b.add_slack(d + slack.widen - geometry::dot(n, y), -n); });
      each_side(k, i, [&](Vec3 n, Vec3 c) { b.add_slack(slack.widen - geometry::dot(n, y - c), -n); });
      if (const Opening* o = i == 0 ? opening(k) : nullptr) b.add_ball(y - o->centre, o->radius + slack.widen);
      return b;
    }
    if (is_given(k, order, i)) return b;
    const double s = 1 / slack.stretch;
    y = s * y;
    if (order == 1) b.add_ball(y, speed_of(k));
    if (order == 2) {
      b.add_ball(y, l.acceleration);
      b = thrust_barrier(y, b);
    }
    if (order == 3) b.add_ball(y, l.jerk);
    if (order == 4) b.add_ball(y, l.snap);
    b.gradient = s * b.gradient;
    b.hessian = (s * s) * b.hessian;
    return b;
  }

  // A Bernstein point as a function of the variables: dependent de Boor points are replaced.
  template <class S>
  void replace_dependent(const Iterate& x, std::size_t k, const Basis<S>& m,
                         std::array<Point, kPoints>& point) const {
    const auto via = [&](std::size_t joint, std::size_t row, std::size_t middle) {
      if (joint == 0 || joint >= pieces_ || !problem_.is_via[joint - 1]) return;
      std::array<double, kPoints> weight{};
      std::array<Vec3, kSpans> along{};
      const double scale = -1 / value_of(m[row][middle]);
      if (opening(joint)) weight[middle] = -scale;  // of the knot, which is the variable there
      for (std::size_t j = 0; j < kPoints; ++j) {
        if (j != middle) weight[j] = scale * value_of(m[row][j]);
        for (std::size_t s = 0; s < kSpans; ++s) {
          along[s] = along[s] + (scale * slope_of(m[row][j], s)) * x.control[3 * k + j];
        }
      }
      for (Point& p : point) {
        const double w = p.weight[middle];
        p.weight[middle] = 0;
        for (std::size_t j = 0; j < kPoints; ++j) p.weight[j] += w * weight[j];
        for (std::size_t s = 0; s < kSpans; ++s) p.along[s] = p.along[s] + w * along[s];
      }
    };
    via(k, 0, 2);
    via(k + 1, 7, 5);
    if (problem_.start.moving && k < 2) {
      const double t = std::exp(x.log_duration[0]);
      for (Point& p : point) {
        for (std::size_t i = 3 * k; i < 4; ++i) {
          p.along[2 - k] = p.along[2 - k] + p.weight[i - 3 * k] * start_slope(i, t);
          p.weight[i - 3 * k] = 0;
        }
      }
    }
  }

  static double value_of(double a) { return a; }
  static double value_of(const Dual<kSpans>& a) { return a.value; }
  static double slope_of(double, std::size_t) { return 0; }
  static double slope_of(const Dual<kSpans>& a, std::size_t i) { return a.d[i]; }

  // The share of one piece in the objective, the barrier and their derivatives.
  template <class S>
  double piece(const Iterate& x, std::size_t k, double t, const Slackened& slack, double snap_weight,
               std::vector<double>* gradient, Band* hessian) const {
    constexpr bool kDerived = !std::is_same_v<S, double>;
    const double duration = std::exp(x.log_duration[k]);
    const Basis<S> m = bernstein_weights(durations<S>(x, k));
    std::array<Point, kPoints> point{};
    for (std::size_t i = 0; i < kPoints; ++i) {
      for (std::size_t j = 0; j < kPoints; ++j) {
        const Vec3 d = x.control[3 * k + j];
        point[i].value = point[i].value + value_of(m[i][j]) * d;
        if constexpr (kDerived) {
          point[i].weight[j] = m[i][j].value;
          for (std::size_t s = 0; s < kSpans; ++s) point[i].along[s] = point[i].along[s] + m[i][j].d[s] * d;
        }
      }
    }
    if constexpr (kDerived) replace_dependent(x, k, m, point);

    Local local(x, *this, k);
    double sum = 0;
    const double room = duration - problem_.least_duration;
    if (!(room > 0)) return kUnlimited;
    sum += t * (1 - (snap_weight > 0)) * duration - std::log(room);
    if constexpr (kDerived) {
      const double slope = duration / room;  // of log(room) in the logarithm of the duration
      local.gradient[24 + 2] += t * (1 - (snap_weight > 0)) * duration - slope;
      local.hessian[24 + 2][24 + 2] += t * (1 - (snap_weight > 0)) * duration + slope * slope;
    }
    for (std::size_t order = 0; order < kOrders; ++order) {
      if (order > 0) differentiate<kDerived>(point, order, duration);
      for (std::size_t i = 0; i + order < kPoints; ++i) {
        const Barrier b = barrier(k, order, i, point[i].value, slack);
        if (!b.inside) return kUnlimited;
        sum += b.value;
        if constexpr (kDerived) local.add(point[i], b.gradient, b.hessian);
      }
    }
    if (snap_weight > 0) {
      const double weight = t * snap_weight * duration;
      for (std::size_t l = 0; l < 4; ++l) {
        Point z{};
        for (std::size_t i = l; i < 4; ++i) z = z + factor_[i][l] * point[i];
        sum += weight * geometry::dot(z.value, z.value);
        if constexpr (kDerived) local.add(z, (2 * weight) * z.value, (2 * weight) * geometry::identity());
      }
    }
    if constexpr (kDerived) {
      if (const Opening* o = opening(k); o && is_disc(*o)) local.keep_in_plane(2, o->normal, true);
      if (const Opening* o = opening(k + 1); o && is_disc(*o)) local.keep_in_plane(5, o->normal, false);
      local.scatter(*gradient, *hessian);
    }
    return sum;
  }

  template <bool kDerived>
  static void differentiate(std::array<Point, kPoints>& point, std::size_t order, double duration) {
    const double scale = double(kPoints - order) / duration;
    for (std::size_t i = 0; i + order < kPoints; ++i) {
      if constexpr (kDerived) {
        point[i] = scale * (point[i + 1] - point[i]);
        point[i].along[2] = point[i].along[2] - (1 / duration) * point[i].value;
      } else {
        point[i].value = scale * (point[i + 1].value - point[i].value);
      }
    }
  }

  // Gradient and Hessian in the 8 de Boor points and 5 logarithms of durations of a piece.
  struct Local {
    static constexpr std::size_t kSize = 3 * kPoints + kSpans;

    Local(const Iterate& x, const Program& program, std::size_t k) {
      for (std::size_t j = 0; j < kPoints; ++j) {
        const int v = program.control_variable_[3 * k + j];
        for (int a = 0; a < 3; ++a) variable[3 * j + std::size_t(a)] = v == kFixed ? kFixed : v + a;
      }
      for (std::size_t s = 0; s < kSpans; ++s) {
        variable[24 + s] = program.duration_of(k, s);
        const std::size_t i = k + s;
        duration[s] = variable[24 + s] == kFixed ? 0.0 : std::exp(x.log_duration[i - 2]);
      }
    }

    void add(const Point& p, Vec3 g, const Mat3& h) {
      std::array<Vec3, kSpans> u{}, hu{};
      for (std::size_t s = 0; s < kSpans; ++s) {
        u[s] = duration[s] * p.along[s];
        hu[s] = h * u[s];
        gradient[24 + s] += geometry::dot(g, u[s]);
        for (std::size_t r = 0; r <= s; ++r) hessian[24 + s][24 + r] += geometry::dot(u[r], hu[s]);
      }
      for (std::size_t i = 0; i < kPoints; ++i) {
        const double w = p.weight[i];
        if (w == 0) continue;
        for (std::size_t a = 0; a < 3; ++a) gradient[3 * i + a] += w * g[int(a)];
        for (std::size_t j = 0; j <= i; ++j) {
          const double ww = w * p.weight[j];
          if (ww == 0) continue;
          for (std::size_t a = 0; a < 3; ++a) {
            for (std::size_t b = 0; b < 3; ++b) hessian[3 * i + a][3 * j + b] += ww * h.m[a][b];
          }
        }
        for (std::size_t s = 0; s < kSpans; ++s) {
          for (std::size_t a = 0; a < 3; ++a) hessian[24 + s][3 * i + a] += w * hu[s][int(a)];
        }
      }
    }

    // Removes the derivatives of a knot, the variable of de Boor point i, along a normal; where it `stands`, a number
    // takes their place in the Hessian.
    void keep_in_plane(std::size_t i, Vec3 n, bool stands) {
      const std::size_t first = 3 * i;
      const auto project = [&](auto&& entry) {
        double along = 0;
        for (std::size_t a = 0; a < 3; ++a) along += n[int(a)] * entry(first + a);
        for (std::size_t a = 0; a < 3; ++a) entry(first + a) -= along * n[int(a)];
      };
      project([&](std::size_t v) -> double& { return gradient[v]; });
      for (std::size_t a = 0; a < 3; ++a) {  // the upper half of the block, for a symmetric projection of its rows
        for (std::size_t b = 0; b < a; ++b) hessian[first + b][first + a] = hessian[first + a][first + b];
      }
      for (std::size_t r = 0; r < kSize; ++r) {
        const bool inside = r >= first && r < first + 3;
        project([&](std::size_t v) -> double& { return inside || r > v ? hessian[r][v] : hessian[v][r]; });
      }
      for (std::size_t a = 0; a < 3; ++a) project([&](std::size_t v) -> double& { return hessian[v][first + a]; });
      double size = 0;
      for (std::size_t a = 0; a < 3; ++a) size += hessian[first + a][first + a];
      const double stiffness = stands ? std::max(size, 1.0) : 0;
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b <= a; ++b) hessian[first + a][first + b] += stiffness * n[int(a)] * n[int(b)];
        for (std::size_t b = a + 1; b < 3; ++b) hessian[first + a][first + b] = 0;
      }
    }

    void scatter(std::vector<double>& full_gradient, Band& full) const {
      for (std::size_t i = 0; i < kSize; ++i) {
        if (variable[i] == kFixed) continue;
        const auto row = static_cast<std::size_t>(variable[i]);
        full_gradient[row] += gradient[i];
        for (std::size_t j = 0; j <= i; ++j) {
          if (variable[j] == kFixed) continue;
          const auto column = static_cast<std::size_t>(variable[j]);
          full.at(std::max(row, column), std::min(row, column)) += hessian[i][j];
        }
      }
    }

    std::array<int, kSize> variable{};
    std::array<double, kSpans> duration{};
    std::array<double, kSize> gradient{};
    std::array<std::array<double, kSize>, kSize> hessian{};  // its lower triangle
  };

  const TimeProblem problem_;
  std::size_t pieces_, variables_ = 0, width_ = 0;
  double constraints_ = 0;
  std::array<std::array<double, 4>, 4> factor_;
  std::vector<int> control_variable_, duration_variable_;
};

// Newton's method on t f + barrier from a strictly feasible x, which it replaces. Ends at a decrement below `enough`.
class Newton {
 public:
  explicit Newton(const Program& program)
      : program_(program), gradient_(program.size()), hessian_(program.size(), program.width()) {}

  // Number of steps; `most` bounds it.
  int run(Iterate& x, double t, const Slackened& slack, double snap_weight, double enough, int most) {
    const double least_gain = kLeastGain * program_.constraints();
    double value = program_.evaluate(x, t, slack, snap_weight, nullptr, nullptr);
    for (int step = 0; step < most; ++step) {
      program_.evaluate(x, t, slack, snap_weight, &gradient_, &hessian_);
      std::vector<double> direction = newton_direction();
      if (direction.empty()) return step;
      double slope = 0;
      for (std::size_t i = 0; i < direction.size(); ++i) slope += gradient_[i] * direction[i];
      if (!(-slope > 2 * enough)) return step + 1;
      double length = std::min(1.0, 1.0 / std::max(program_.longest_log_step(direction), 1e-300));
      bool moved = false;
      for (int halving = 0; halving < 40 && !moved; ++halving, length *= 0.5) {
        Iterate y = program_.moved(x, direction, length);
        const double there = program_.evaluate(y, t, slack, snap_weight, nullptr, nullptr);
        if (!(there <= value + 0.05 * length * slope)) continue;
        x = std::move(y), moved = true;
        if (value - there < least_gain) return step + 1;
        value = there;
      }
      if (!moved) return step + 1;
    }
    return most;
  }

 private:
  std::vector<double> newton_direction() {
    double ridge = 1e-12;
    for (int attempt = 0; attempt < 8; ++attempt, ridge *= 100) {
      Band factor = hessian_;
      for (std::size_t i = 0; i < program_.size(); ++i) factor.at(i, i) *= 1 + ridge;
      if (!factor.factorise()) continue;
      std::vector<double> direction(gradient_.size());
      for (std::size_t i = 0; i < direction.size(); ++i) direction[i] = -gradient_[i];
      factor.solve(direction);
      return direction;
    }
    return {};
  }

  const Program& program_;
  std::vector<double> gradient_;
  Band hessian_;
};

constexpr double kSlowing = 0.2;  // of the logarithm of durations
constexpr int kMostSlowings = 60;
constexpr double kGrowth = 12;  // of t between two runs of Newton's method

// A strictly feasible curve: slow enough from rest; from a state of motion by narrowing widened sets.
bool make_feasible(const Program& program, Iterate& x, bool moving, int most, int& steps) {
  const auto is_inside = [&] { return std::isfinite(program.evaluate(x, 1, {}, 0, nullptr, nullptr)); };
  if (!moving) {
    for (int i = 0; i < kMostSlowings && !is_inside(); ++i) {
      for (double& l : x.log_duration) l += kSlowing;
    }
    return is_inside();
  }
  Newton newton(program);
  Slackened need = program.needed(x);
  while (steps < most) {
    if (is_inside()) return true;
    const Slackened slack{need.widen > 0 ? 1.1 * need.widen + 1e-4 : 0.0,
                          need.stretch > 1 ? 1.1 * need.stretch + 1e-4 : 1.0};
    const double t = 0.01 * program.constraints() / program.total(x);
    steps += newton.run(x, t, slack, 0, 0.5, std::min(20, most - steps));
    const Slackened now = program.needed(x);
    if (!(now.widen < 0.98 * need.widen || now.stretch < 1 + 0.98 * (need.stretch - 1))) {
      return is_inside();
    }
    need = now;
  }
  return false;
}

}  // namespace

TimeCurve minimum_time(const TimeProblem& problem, const TimeOptions& options) {
  Program program(problem);
  Iterate x = program.first();
  TimeCurve result;
  if (!make_feasible(program, x, problem.start.moving, options.most_steps, result.steps)) return result;
  result.status = TimeStatus::solved;
  const double nu = program.constraints();
  {
    Newton newton(program);
    double t = nu / program.total(x);
    for (bool last = false; !last;) {
      const double final_t = nu / (options.gap * program.total(x));
      last = t >= final_t;
      const int left = options.most_steps - result.steps;
      const int used = newton.run(x, std::min(t, final_t), {}, 0, last ? 0.05 : 1.0, left);
      result.steps += used;
      if (used >= left) {
        result.status = TimeStatus::stopped_early;
        break;
      }
      t *= kGrowth;
    }
  }
  if (options.stretch > 1) {
    for (double& l : x.log_duration) l += std::log(options.stretch);
    program.settle(x);
    program.number_variables(false);
    // From a state of motion the stretched curve may leave the sets; then the fastest one remains.
    Iterate fastest = x;
    for (double& l : fastest.log_duration) l -= std::log(options.stretch);
    program.settle(fastest);
    if (std::isfinite(program.evaluate(x, 0, {}, 0, nullptr, nullptr))) {
      Newton newton(program);
      const double scale =
          program.evaluate(x, 1, {}, 1, nullptr, nullptr) - program.evaluate(x, 0, {}, 1, nullptr, nullptr);
      double t = 0.1 * nu / scale;
      for (int round = 0; round < 6 && result.steps < options.most_steps; ++round, t *= kGrowth) {
        result.steps += newton.run(x, t, {}, 1, round < 5 ? 1.0 : 0.01, options.most_steps - result.steps);
      }
    } else {
      x = std::move(fastest);
    }
  }
  result.point = program.bernstein_points(x);
  for (const double l : x.log_duration) result.duration.push_back(std::exp(l));
  return result;
}

}  // namespace alula
