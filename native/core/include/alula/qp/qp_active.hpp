// The active rows of the dual method of qp_dual.hpp, factored, and the points and multipliers they give.
//
// With H = L L^T and z = L^T x the program is the projection of z0 = -L^-1 g on {z : c_i . z >= d_i} with
// s_i = |L^-1 a_i|, c_i = L^-1 a_i / s_i of length 1, d_i = b_i / s_i. The active rows N = (c_k) are kept as
// N = Q R, so z = Q R^-T d + (1 - Q Q^T) z0 and z - z0 = N u. Source: Goldfarb, Idnani 1983, section 3-4.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "alula/qp/qp_check.hpp"

namespace alula::qp {

// N: the number of variables, 0 when known only at run time.
template <class Real, int N>
class ActiveRows {
 public:
  static constexpr std::size_t kMax = N > 0 ? static_cast<std::size_t>(N) : kQpMaxVariables;
  using Vector = std::array<Real, kMax>;
  struct Entry {
    std::uint32_t row = kNone;
    Real norm = 0, d = 0;  // s_i, d_i
    Vector c;
  };

  explicit ActiveRows(const QpProblem& problem) : p_(problem), n_(N > 0 ? kMax : problem.n) {}

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

 protected:
  std::size_t n() const {
    if constexpr (N > 0) return kMax;
    return n_;
  }
  Real dot(const Vector& a, const Vector& b) const {
    Real sum = 0;
    for (std::size_t j = 0; j < n(); ++j) sum += a[j] * b[j];
    return sum;
  }
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

  // c = N r + z with z orthogonal to N; h = Q^T c = R r. Twice is enough, and
  // once where little is taken away.
  void split(const Vector& c, std::size_t count, Vector& h, Vector& z) const {
    z = c;
    for (std::size_t k = 0; k < count; ++k) h[k] = 0;
    if (count == 0) return;
    const Real whole = dot(c, c);
    for (int pass = 0; pass < 2; ++pass) {
      if (pass == 1 && dot(z, z) > whole / 4) return;
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
  void erase(std::size_t at) {
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
    z_ = count_ < n() ? rest : Vector{};  // what is left of z0 when nothing is free is noise
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

  // The same with noise in r replaced by zeros, which it then becomes.
  bool cleaned(const Entry& entry, Vector& r, Vector& rest) const {
    Real largest = 1;
    for (std::size_t k = 0; k < count_; ++k) largest = std::max(largest, std::fabs(r[k]));
    Vector clean = r;
    bool any = false;
    for (std::size_t k = 0; k < count_; ++k) {
      if (r[k] == 0 || std::fabs(r[k]) > static_cast<Real>(kFeasible) * largest) continue;
      clean[k] = 0;
      any = true;
    }
    if (!any || !residual(entry, clean, rest)) return false;
    r = clean;
    return true;
  }

  // Improves r on the input: c - N r is small or orthogonal to N. Whether it is zero to rounding.
  bool refine(const Entry& entry, Vector& r, Vector& z) const {
    Vector h{}, rest{};
    for (int pass = 0; pass < 3; ++pass) {
      if (residual(entry, r, rest) && pass > 0) return true;
      Vector kept = rest;
      if (cleaned(entry, r, rest)) return true;
      forward(kept.data(), kept.data());
      split(kept, count_, h, z);
      solve_upper(h);
      for (std::size_t k = 0; k < count_; ++k) r[k] += h[k];
    }
    return residual(entry, r, rest) || cleaned(entry, r, rest);
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

  // One step of iterative refinement of (x, u) on the equations of the active rows.
  void improve() {
    Vector p{}, h{}, t{};
    for (std::size_t j = 0; j < n(); ++j) {
      Wide sum = -static_cast<Wide>(p_.gradient[j]);
      for (std::size_t k = 0; k < n(); ++k) sum -= symmetric(p_, j, k) * x_[k];
      for (std::size_t k = 0; k < count_; ++k) {
        sum += p_.rows[active_[k].row * n() + j] * (u_[k] / static_cast<Wide>(active_[k].norm));
      }
      p[j] = static_cast<Real>(sum);
    }
    forward(p.data(), p.data());
    Vector rest{};
    split(p, count_, h, rest);
    if (count_ == n()) rest = {};
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

  const QpProblem& p_;
  const std::size_t n_;
  std::array<Vector, kMax> l_{};  // of H
  Vector inverse_{}, z0_{}, z_{}, x_{}, u_{};
  std::array<Entry, kMax> active_{};
  std::array<Vector, kMax> q_{}, r_{};  // columns
  std::size_t count_ = 0;
};

}  // namespace alula::qp
