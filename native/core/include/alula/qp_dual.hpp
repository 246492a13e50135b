// One run of the dual active-set method of qp.hpp in one precision.
//
// With H = L L^T and z = L^T x the program is the projection of z0 = -L^-1 g on {z : c_i . z >= d_i} with
// s_i = |L^-1 a_i|, c_i = L^-1 a_i / s_i of length 1, d_i = b_i / s_i. The active rows N = (c_k) are kept as
// N = Q R, so z = Q R^-T d + (1 - Q Q^T) z0 and z - z0 = N u. Source: Goldfarb, Idnani 1983, section 3-4.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <type_traits>
#include <utility>

#include "alula/qp_check.hpp"
#include "alula/qp_columns.hpp"

namespace alula::qp {

enum class Outcome : std::uint8_t { optimal, infeasible, stuck };

// N: the number of variables, 0 when known only at run time. Real: double looks for violated rows in
// `columns`, a wider type in the input.
template <class Real, int N>
class DualPass {
 public:
  static constexpr std::size_t kMax = N > 0 ? static_cast<std::size_t>(N) : kQpMaxVariables;
  static constexpr bool kNarrow = std::is_same_v<Real, double>;

  explicit DualPass(const QpProblem& problem) : p_(problem), n_(N > 0 ? kMax : problem.n) {}

  // Cholesky; false unless H is positive definite by more than its own rounding.
  bool factor() {
    for (std::size_t j = 0; j < n(); ++j) {
      const Real diagonal = p_.hessian[j * n() + j];
      for (std::size_t i = j; i < n(); ++i) {
        Real sum = static_cast<Real>(symmetric(p_, i, j));
        for (std::size_t k = 0; k < j; ++k) sum -= l_[i][k] * l_[j][k];
        if (i > j) {
          l_[i][j] = sum * inverse_[j];
        } else {
          if (!(sum > static_cast<Real>(2 * kUnit) * static_cast<Real>(n()) * diagonal)) return false;
          l_[j][j] = std::sqrt(sum);
          inverse_[j] = 1 / l_[j][j];
        }
        if (!std::isfinite(l_[i][j])) return false;
      }
    }
    std::array<Real, kMax> g;
    for (std::size_t j = 0; j < n(); ++j) g[j] = -static_cast<Real>(p_.gradient[j]);
    forward(g.data(), z0_.data());
    z_ = z0_;
    return std::all_of(z0_.begin(), z0_.begin() + static_cast<std::ptrdiff_t>(n()),
                       [](Real v) { return std::isfinite(v); });
  }

  const Real* lower() const { return l_[0].data(); }  // rows of kMax
  const Real* inverse_diagonal() const { return inverse_.data(); }

  Outcome run(Columns columns, std::span<const std::uint32_t> warm, QpResult& result) {
    columns_ = columns;
    for (const std::uint32_t row : warm) {
      if (row >= p_.bounds.size() || is_active(row)) continue;
      Entry entry;
      if (!load(row, entry)) continue;
      const Real gap = entry.d - dot(entry.c, z_);
      if (!(gap > tolerance())) continue;
      const Step step = add(entry, gap, result);
      if (step != Step::added) return step == Step::infeasible ? Outcome::infeasible : Outcome::stuck;
    }
    for (int round = 0; round < kRounds; ++round) {
      Step step = Step::added;
      Entry entry;
      Real gap = 0;
      while (step == Step::added && most_violated(entry, gap, result.iterations)) step = add(entry, gap, result);
      if (step == Step::infeasible) return Outcome::infeasible;
      const std::uint32_t worst = finish(result);
      if (result.status == QpStatus::optimal) return Outcome::optimal;
      // A row that only the input shows to be violated: go on with it.
      if (step != Step::added || worst == kNone || is_active(worst) || !load(worst, entry)) return Outcome::stuck;
      step = add(entry, gap_of(entry), result);
      if (step != Step::added) return step == Step::infeasible ? Outcome::infeasible : Outcome::stuck;
    }
    return Outcome::stuck;
  }

 private:
  using Vector = std::array<Real, kMax>;
  struct Entry {
    std::uint32_t row = kNone;
    Real norm = 0, d = 0;  // s_i, d_i
    Vector c;
  };
  enum class Step : std::uint8_t { added, infeasible, stuck };

  static constexpr int kRounds = 25;
  static constexpr int kGreedy = 300, kMost = 1200;  // exchanges with the most and with the first violated row

  std::size_t n() const {
    if constexpr (N > 0) return kMax;
    return n_;
  }
  Real dot(const Vector& a, const Vector& b) const {
    Real sum = 0;
    for (std::size_t j = 0; j < n(); ++j) sum += a[j] * b[j];
    return sum;
  }
  Real tolerance() const { return static_cast<Real>(kFeasible) * std::sqrt(dot(z_, z_)); }
  bool is_active(std::uint32_t row) const {
    return std::any_of(active_.begin(), active_.begin() + static_cast<std::ptrdiff_t>(count_),
                       [row](const Entry& entry) { return entry.row == row; });
  }

  // v = L^-1 a and x = L^-T v; both may be done in place.
  template <class From>
  void forward(const From* a, Real* v) const {
    for (std::size_t j = 0; j < n(); ++j) {
      Real sum = a[j];
      for (std::size_t k = 0; k < j; ++k) sum -= l_[j][k] * v[k];
      v[j] = sum * inverse_[j];
    }
  }
  void backward(const Real* v, Real* x) const {
    for (std::size_t j = n(); j-- > 0;) {
      Real sum = v[j];
      for (std::size_t k = j + 1; k < n(); ++k) sum -= l_[k][j] * x[k];
      x[j] = sum * inverse_[j];
    }
  }

  bool load(std::uint32_t row, Entry& entry) const {
    entry.row = row;
    forward(p_.rows.data() + row * n(), entry.c.data());
    entry.norm = std::sqrt(dot(entry.c, entry.c));
    const Real inverse = 1 / entry.norm;
    for (std::size_t j = 0; j < n(); ++j) entry.c[j] *= inverse;
    entry.d = static_cast<Real>(p_.bounds[row]) * inverse;
    return entry.norm > 0 && std::isfinite(entry.norm) && std::isfinite(inverse) && std::isfinite(entry.d);
  }

  // The row to add next and by how much it is violated; false when all hold up to rounding.
  bool most_violated(Entry& entry, Real& gap, int iterations) {
    const bool greedy = iterations < kGreedy;
    if constexpr (kNarrow) {
      const std::uint32_t row = greedy ? columns_.template most_violated<N>(n(), z_.data(), tolerance())
                                       : columns_.first_violated(n(), z_.data(), tolerance());
      if (row == kNone || !load(row, entry)) return false;
      gap = entry.d - dot(entry.c, z_);
      return gap > 0;
    } else {
      Vector x;
      backward(z_.data(), x.data());
      gap = 0;
      Entry candidate;
      for (std::uint32_t i = 0; i < p_.bounds.size() && (greedy || !(gap > 0)); ++i) {
        Wide size = 0;
        const Wide violation = -slack(p_, i, x.data(), size);
        if (!(violation > 2 * kUnit * size) || is_active(i) || !load(i, candidate)) continue;
        const Real distance = static_cast<Real>(violation) / candidate.norm;
        if (distance > gap) {
          gap = distance;
          entry = candidate;
        }
      }
      return gap > 0;
    }
  }

  // c = N r + z with z orthogonal to N; h = Q^T c = R r. Twice is enough.
  void split(const Vector& c, std::size_t count, Vector& h, Vector& z) const {
    z = c;
    for (std::size_t k = 0; k < count; ++k) h[k] = 0;
    for (int pass = 0; pass < 2; ++pass) {
      for (std::size_t k = 0; k < count; ++k) {
        const Real part = dot(q_[k], z);
        h[k] += part;
        for (std::size_t j = 0; j < n(); ++j) z[j] -= part * q_[k][j];
      }
    }
  }
  // R r = h, and R^T t = h; in place.
  void solve_upper(Vector& h) const {
    for (std::size_t k = count_; k-- > 0;) {
      for (std::size_t l = k + 1; l < count_; ++l) h[k] -= r_[l][k] * h[l];
      h[k] /= r_[k][k];
    }
  }
  void solve_lower(Vector& h) const {
    for (std::size_t k = 0; k < count_; ++k) {
      for (std::size_t l = 0; l < k; ++l) h[k] -= r_[k][l] * h[l];
      h[k] /= r_[k][k];
    }
  }

  // Column `at` of Q and R, from h = Q^T c and the rest z of c.
  void append(std::size_t at, const Vector& h, const Vector& z) {
    const Real length = std::sqrt(dot(z, z));
    for (std::size_t k = 0; k < at; ++k) r_[at][k] = h[k];
    r_[at][at] = length;
    for (std::size_t j = 0; j < n(); ++j) q_[at][j] = z[j] / length;
  }
  void refactor(std::size_t from) {
    Vector h, z;
    for (std::size_t at = from; at < count_; ++at) {
      split(active_[at].c, at, h, z);
      append(at, h, z);
    }
  }
  void remove(std::size_t at) {
    if constexpr (kNarrow) columns_.restore(active_[at].row, active_[at].d);
    for (std::size_t k = at; k + 1 < count_; ++k) {
      active_[k] = active_[k + 1];
      u_[k] = u_[k + 1];
    }
    --count_;
    refactor(at);
  }

  // z and u of the active rows taken as equations.
  void settle() {
    Vector h, rest, t;
    split(z0_, count_, h, rest);
    for (std::size_t k = 0; k < count_; ++k) t[k] = active_[k].d;
    solve_lower(t);
    z_ = rest;
    for (std::size_t k = 0; k < count_; ++k) {
      for (std::size_t j = 0; j < n(); ++j) z_[j] += t[k] * q_[k][j];
      u_[k] = t[k] - h[k];
    }
    solve_upper(u_);
  }

  // c / s of the input less its combination r of the active rows, in extended precision; whether it is zero to
  // rounding, so that the row depends on them.
  bool residual(const Entry& entry, const Vector& r, Vector& rest) const {
    bool zero = true;
    for (std::size_t j = 0; j < n(); ++j) {
      Wide sum = p_.rows[entry.row * n() + j] / static_cast<Wide>(entry.norm), size = std::fabs(sum);
      for (std::size_t k = 0; k < count_; ++k) {
        const Wide term = p_.rows[active_[k].row * n() + j] / static_cast<Wide>(active_[k].norm) * r[k];
        sum -= term;
        size += std::fabs(term);
      }
      rest[j] = static_cast<Real>(sum);
      zero = zero && std::fabs(sum) <= kCertain / 2 * size;
    }
    return zero;
  }

  // Improves r on the input: c - N r is small or orthogonal to N. Whether it is zero to rounding.
  bool refine(const Entry& entry, Vector& r, Vector& z) const {
    Vector h, rest;
    for (int pass = 0; pass < 3; ++pass) {
      const bool zero = residual(entry, r, rest);
      if (zero && pass > 0) return true;
      forward(rest.data(), rest.data());
      split(rest, count_, h, z);
      solve_upper(h);
      for (std::size_t k = 0; k < count_; ++k) r[k] += h[k];
    }
    return residual(entry, r, rest);
  }

  // The way z to the row's boundary along the active rows, and how their multipliers yield; false when
  // the row depends on them. A row that nearly does is split anew from the input.
  bool direction(const Entry& entry, Vector& h, Vector& r, Vector& z) const {
    split(entry.c, count_, h, z);
    r = h;
    solve_upper(r);
    if (count_ == n()) return false;
    if (count_ == 0 || dot(z, z) > static_cast<Real>(1e-6)) return true;
    return !refine(entry, r, z) && dot(z, z) > 0;
  }

  // y = (1, -r) with noise cut off: does it prove that there is no feasible point?
  bool prove_infeasible(const Entry& entry, Vector r, QpResult& result) const {
    Vector z;
    refine(entry, r, z);
    std::array<std::pair<std::uint32_t, Wide>, kMax + 1> y;
    std::size_t size = 0;
    y[size++] = {entry.row, 1 / static_cast<Wide>(entry.norm)};
    for (std::size_t k = 0; k < count_; ++k) {
      if (r[k] < 0) y[size++] = {active_[k].row, -static_cast<Wide>(r[k]) / active_[k].norm};
    }
    std::sort(y.begin(), y.begin() + static_cast<std::ptrdiff_t>(size));
    Wide total = 0;
    for (std::size_t k = 0; k < size; ++k) total += y[k].second * row_norm(p_, y[k].first);
    std::array<std::uint32_t, kMax + 1> rows;
    std::array<double, kMax + 1> multiplier;
    for (std::size_t k = 0; k < size; ++k) {
      rows[k] = y[k].first;
      multiplier[k] = static_cast<double>(y[k].second / total);
    }
    double gain = 0;
    if (!is_certificate(p_, {rows.data(), size}, multiplier.data(), gain)) return false;
    result.status = QpStatus::infeasible;
    result.active_count = size;
    std::copy_n(rows.begin(), size, result.active.begin());
    std::copy_n(multiplier.begin(), size, result.multiplier.begin());
    result.violation = gain;
    return true;
  }

  // Makes the row active: moves z on to it, drops the rows whose multipliers would turn negative.
  Step add(const Entry& entry, Real gap, QpResult& result) {
    Vector h, r, z;
    Real own = 0;
    for (;;) {
      if (++result.iterations > kMost) return Step::stuck;
      const bool independent = direction(entry, h, r, z);
      Real dual = std::numeric_limits<Real>::infinity(), largest = 1, positive = 0;
      std::size_t drop = kMax;
      for (std::size_t k = 0; k < count_; ++k) {
        largest = std::max(largest, std::fabs(r[k]));
        positive = std::max(positive, r[k]);
        if (!(r[k] > 0)) continue;
        const Real ratio = u_[k] / r[k];
        if (ratio < dual || (ratio == dual && active_[k].row < active_[drop].row)) {
          dual = ratio;
          drop = k;
        }
      }
      if (!independent && positive <= static_cast<Real>(1e-9) * largest && prove_infeasible(entry, r, result)) {
        return Step::infeasible;
      }
      const Real zz = independent ? dot(z, z) : 0;
      const Real primal = independent ? gap / zz : std::numeric_limits<Real>::infinity();
      if (!independent && drop == kMax) return Step::stuck;
      const Real step = std::min(dual, primal);
      if (!std::isfinite(step)) return Step::stuck;
      for (std::size_t k = 0; k < count_; ++k) u_[k] = std::max<Real>(0, u_[k] - step * r[k]);
      own += step;
      if (primal <= dual) {
        for (std::size_t k = 0; k < count_; ++k) h[k] = dot(q_[k], entry.c);
        append(count_, h, z);
        active_[count_] = entry;
        u_[count_++] = own;
        if constexpr (kNarrow) columns_.hide(entry.row);
        settle();
        for (std::size_t k = 0; k < count_; ++k) u_[k] = std::max<Real>(0, u_[k]);
        return Step::added;
      }
      if (independent) {
        for (std::size_t j = 0; j < n(); ++j) z_[j] += step * z[j];
        gap -= step * zz;
      }
      remove(drop);
    }
  }

  // How far the input says that a row is violated, at the x of the active rows.
  Real gap_of(const Entry& entry) const {
    Wide size = 0;
    return static_cast<Real>(-slack(p_, entry.row, x_.data(), size) / static_cast<Wide>(entry.norm));
  }

  // One step of iterative refinement of (x, u) on the equations of the active rows.
  void improve() {
    Vector p, h, t;
    for (std::size_t j = 0; j < n(); ++j) {
      Wide sum = -static_cast<Wide>(p_.gradient[j]);
      for (std::size_t k = 0; k < n(); ++k) sum -= symmetric(p_, j, k) * x_[k];
      for (std::size_t k = 0; k < count_; ++k) {
        sum += p_.rows[active_[k].row * n() + j] * (u_[k] / static_cast<Wide>(active_[k].norm));
      }
      p[j] = static_cast<Real>(sum);
    }
    forward(p.data(), p.data());
    Vector rest;
    split(p, count_, h, rest);
    for (std::size_t k = 0; k < count_; ++k) {
      Wide size = 0;
      t[k] = static_cast<Real>(-slack(p_, active_[k].row, x_.data(), size) / static_cast<Wide>(active_[k].norm));
    }
    solve_lower(t);
    for (std::size_t k = 0; k < count_; ++k) {
      for (std::size_t j = 0; j < n(); ++j) rest[j] += t[k] * q_[k][j];
      t[k] -= h[k];
    }
    solve_upper(t);
    for (std::size_t k = 0; k < count_; ++k) u_[k] += t[k];
    backward(rest.data(), rest.data());
    for (std::size_t j = 0; j < n(); ++j) x_[j] += rest[j];
  }

  // The answer of the active rows, refined and held against the input; the row violated most beyond
  // rounding, or kNone. Rows whose multiplier turns out negative are given up.
  std::uint32_t finish(QpResult& result) {
    std::sort(active_.begin(), active_.begin() + static_cast<std::ptrdiff_t>(count_),
              [](const Entry& a, const Entry& b) { return a.row < b.row; });
    refactor(0);
    for (;;) {
      settle();
      backward(z_.data(), x_.data());
      std::size_t negative = kMax;
      std::uint32_t worst = kNone;
      for (int pass = 0; pass < 4; ++pass) {
        improve();
        negative = kMax;
        std::array<double, kMax> x{}, y{};
        for (std::size_t j = 0; j < n(); ++j) x[j] = static_cast<double>(x_[j]);
        std::array<std::uint32_t, kMax> rows{};
        std::size_t size = 0;
        for (std::size_t k = 0; k < count_; ++k) {
          if (u_[k] < 0 && (negative == kMax || u_[k] < u_[negative])) negative = k;
          if (!(u_[k] > 0)) continue;
          rows[size] = active_[k].row;
          y[size++] = static_cast<double>(u_[k] / active_[k].norm);
        }
        if (!is_stationary(p_, x.data(), {rows.data(), size}, y.data())) continue;
        const Violations found = violations<N>(p_, x.data());
        worst = found.worst;
        if (worst != kNone) {
          if (is_active(worst)) continue;
          break;
        }
        result.status = QpStatus::optimal;
        result.active_count = size;
        std::copy_n(x.begin(), n(), result.x.begin());
        std::copy_n(rows.begin(), size, result.active.begin());
        std::copy_n(y.begin(), size, result.multiplier.begin());
        result.violation = found.greatest;
        return kNone;
      }
      if (worst != kNone || negative == kMax) {
        for (std::size_t k = 0; k < count_; ++k) u_[k] = std::max<Real>(0, u_[k]);
        return worst;
      }
      remove(negative);
    }
  }

  const QpProblem& p_;
  const std::size_t n_;
  Columns columns_;
  std::array<Vector, kMax> l_{};  // of H
  Vector inverse_{}, z0_{}, z_{}, x_{}, u_{};
  std::array<Entry, kMax> active_{};
  std::array<Vector, kMax> q_{}, r_{};  // columns
  std::size_t count_ = 0;
};

}  // namespace alula::qp
