#include "alula/qp/qp.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include "alula/base/constants.hpp"
#include "proofs.hpp"

// The solver, one algorithm from top to bottom: the scaled rows (`Columns`), the dual active-set method
// (`DualActiveSet`) and the order in which `QpSolver` tries precisions. proofs.hpp checks every answer on the input.
//
// With H = L L^T and z = L^T x the program is the projection of z0 = -L^-1 g on {z : c_i . z >= d_i} with
// s_i = |L^-1 a_i|, c_i = L^-1 a_i / s_i of length 1, d_i = b_i / s_i. The active rows N = (c_k) are kept as
// N = Q R, so z = Q R^-T d + (1 - Q Q^T) z0 and z - z0 = N u. Source: Goldfarb, Idnani 1983, section 3-4.
namespace alula {
namespace {

using namespace qp;

// Two doubles in one vector register; the oldest supported x86-64 and every ARMv8 processor have such registers.
using Pair = double __attribute__((vector_size(16)));

inline Pair load_pair(const double* from) {
  Pair v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline void store_pair(double* to, Pair v) { std::memcpy(to, &v, sizeof v); }

enum class Prepared : std::uint8_t { good, extreme, not_finite, impossible };

// The scaled rows (c_i, d_i), transposed so that several are evaluated at once. A view of the solver's workspace.
class Columns {
 public:
  static std::size_t stride_for(std::size_t rows) {
    const std::size_t stride = (rows + 3) / 4 * 4;
    return stride % 512 == 0 ? stride + 4 : stride;  // columns a page apart share cache lines
  }
  static std::size_t size_for(std::size_t rows, std::size_t n) { return stride_for(rows) * (n + 1); }

  Columns() = default;
  Columns(double* memory, std::size_t rows) : d_(memory), stride_(stride_for(rows)), c_(memory + stride_) {}

  // Fills all rows; `lower` is L in rows of `pitch`. `extreme`: a row is too large or too small for double
  // precision; `impossible`: row `bad` is zero and has a positive bound.
  template <int N>
  Prepared fill(const QpProblem& p, const double* lower, const double* inverse, std::size_t pitch,
                std::uint32_t& bad) {
    const std::size_t n = N > 0 ? static_cast<std::size_t>(N) : p.n, m = p.bounds.size();
    Prepared prepared = Prepared::good;
    for (std::size_t i = 0; i < stride_; i += 2) {
      if (i >= m) {
        for (std::size_t j = 0; j < n; ++j) store_pair(c_ + j * stride_ + i, Pair{0, 0});
        store_pair(d_ + i, Pair{kNever, kNever});
        continue;
      }
      const std::size_t other = i + 1 < m ? i + 1 : i;
      const double *first = p.rows.data() + i * n, *second = p.rows.data() + other * n;
      std::array<Pair, (N > 0 ? static_cast<std::size_t>(N) : kQpMaxVariables)> c;
      Pair squares = {0, 0};
      for (std::size_t j = 0; j < n; ++j) {
        Pair sum = {first[j], second[j]};
        for (std::size_t k = 0; k < j; ++k) sum -= lower[j * pitch + k] * c[k];
        c[j] = sum * inverse[j];
        squares += c[j] * c[j];
      }
      const Pair norm = {std::sqrt(squares[0]), std::sqrt(squares[1])};
      const Pair scale = 1.0 / norm;
      const Pair d = Pair{p.bounds[i], p.bounds[other]} * scale;
      for (std::size_t j = 0; j < n; ++j) store_pair(c_ + j * stride_ + i, c[j] * scale);
      store_pair(d_ + i, d);
      for (std::size_t lane = 0; lane < 2 && i + lane < stride_; ++lane) {
        if (squares[lane] > 1e-280 && squares[lane] < 1e280 && std::fabs(d[lane]) < 1e280) continue;
        if (i + lane >= m) continue;
        for (std::size_t j = 0; j < n; ++j) c_[j * stride_ + i + lane] = 0;
        hide(static_cast<std::uint32_t>(i + lane));
        const Prepared found = judge(p, i + lane);
        if (found == Prepared::impossible && prepared != Prepared::impossible)
          bad = static_cast<std::uint32_t>(i + lane);
        if (found > prepared && prepared != Prepared::not_finite) prepared = found;
        if (found == Prepared::not_finite) prepared = found;
      }
      if (other == i) hide(static_cast<std::uint32_t>(i + 1));
    }
    return prepared;
  }

  // Excludes an active row from the search, and includes it again.
  void hide(std::uint32_t row) { d_[row] = kNever; }
  void restore(std::uint32_t row, double d) { d_[row] = d; }

  // Largest d_i - c_i . z above the tolerance, the lowest i among equals; kNone when there is none.
  template <int N>
  std::uint32_t most_violated(std::size_t variables, const double* z, double tolerance) const {
    const std::size_t n = N > 0 ? static_cast<std::size_t>(N) : variables;
    std::array<Pair, 2> best = {Pair{tolerance, tolerance}, Pair{tolerance, tolerance}};
    std::array<Pair, 2> at = {Pair{-1, -1}, Pair{-1, -1}}, index = {Pair{0, 1}, Pair{2, 3}};
    for (std::size_t i = 0; i < stride_; i += 4) {
      for (std::size_t half = 0; half < 2; ++half) {
        Pair v = load_pair(d_ + i + 2 * half);
        for (std::size_t j = 0; j < n; ++j) v -= load_pair(c_ + j * stride_ + i + 2 * half) * z[j];
        const auto better = v > best[half];
        best[half] = better ? v : best[half];
        at[half] = better ? index[half] : at[half];
        index[half] += 4.0;
      }
    }
    double greatest = tolerance, row = -1;
    for (std::size_t lane = 0; lane < 4; ++lane) {
      const double value = best[lane / 2][lane % 2], where = at[lane / 2][lane % 2];
      if (where >= 0 && (value > greatest || (value == greatest && where < row))) {
        greatest = value;
        row = where;
      }
    }
    return row >= 0 ? static_cast<std::uint32_t>(row) : kNone;
  }

  std::uint32_t first_violated(std::size_t n, const double* z, double tolerance) const {
    for (std::size_t i = 0; i < stride_; ++i) {
      double v = d_[i];
      for (std::size_t j = 0; j < n; ++j) v -= c_[j * stride_ + i] * z[j];
      if (v > tolerance) return static_cast<std::uint32_t>(i);
    }
    return kNone;
  }

  // The reason why a row has no scaled form; good: the row is zero and its bound holds for every x.
  static Prepared judge(const QpProblem& p, std::size_t i) {
    bool zero = true, finite = std::isfinite(p.bounds[i]);
    for (std::size_t j = 0; j < p.n; ++j) {
      zero = zero && p.rows[i * p.n + j] == 0;
      finite = finite && std::isfinite(p.rows[i * p.n + j]);
    }
    if (!finite) return Prepared::not_finite;
    if (!zero) return Prepared::extreme;
    return p.bounds[i] > 0 ? Prepared::impossible : Prepared::good;
  }

 private:
  static constexpr double kNever = -std::numeric_limits<double>::infinity();

  double* d_ = nullptr;
  std::size_t stride_ = 0;
  double* c_ = nullptr;  // column j starts at j * stride_
};

enum class Outcome : std::uint8_t { optimal, infeasible, stuck };

// One run of the method in one precision. N: the number of variables, 0 when it is known only at run time.
// Real: double searches violated rows in `Columns`, a wider type in the input.
template <class Real, int N>
class DualActiveSet {
 public:
  static constexpr std::size_t kMax = N > 0 ? static_cast<std::size_t>(N) : kQpMaxVariables;
  static constexpr bool kNarrow = std::is_same_v<Real, double>;
  using Vector = std::array<Real, kMax>;
  struct Entry {
    std::uint32_t row = kNone;
    Real norm = 0, d = 0;  // s_i, d_i
    Vector c;
  };

  // `loose`: factor on the rounding that a proof tolerates.
  explicit DualActiveSet(const QpProblem& problem, double loose = 1)
      : p_(problem), n_(N > 0 ? kMax : problem.n), loose_(loose) {}

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
    farthest_ = dot(z_, z_);
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
      // Only the input shows that row `worst` is violated: continue with it.
      if (step != Step::added || worst == kNone || is_active(worst) || !load(worst, entry)) return Outcome::stuck;
      step = add(entry, gap_of(entry), result);
      if (step != Step::added) return step == Step::infeasible ? Outcome::infeasible : Outcome::stuck;
    }
    return Outcome::stuck;
  }

 private:
  enum class Step : std::uint8_t { added, infeasible, stuck };

  static constexpr int kRounds = 25;
  static constexpr int kGreedy = 300, kMost = 600;  // exchanges with the most and with the first violated row

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

  // c = N r + z with z orthogonal to N; h = Q^T c = R r. Gram-Schmidt: two passes are enough, and one where it
  // removes little of c.
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

  // Computes z and u, with the active rows as equations.
  void settle() {
    Vector h, rest, t;
    split(z0_, count_, h, rest);
    for (std::size_t k = 0; k < count_; ++k) t[k] = active_[k].d;
    solve_lower(t);
    z_ = count_ < n() ? rest : Vector{};  // with n active rows no direction is free: the rest of z0 is rounding
    for (std::size_t k = 0; k < count_; ++k) {
      for (std::size_t j = 0; j < n(); ++j) z_[j] += t[k] * q_[k][j];
      u_[k] = t[k] - h[k];
    }
    solve_upper(u_);
  }

  // c / s of the input minus its combination r of the active rows, in extended precision. True if it is zero to
  // rounding: then the row depends on the active rows.
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

  // The same with rounding noise in r replaced by zeros; r is replaced if the residual then is zero.
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

  // Improves r on the input: c - N r is small or orthogonal to N. True if it is zero to rounding.
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

  // The step direction z to the row's boundary along the active rows, and the rates r at which their multipliers
  // decrease; false when the row depends on them. A nearly dependent row is split again from the input.
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

  Real tolerance() const { return static_cast<Real>(kFeasible) * std::sqrt(dot(z_, z_)); }
  // Finds the row to add next and its violation; false when all rows hold up to rounding.
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
        if (!(violation > 2 * loose_ * kUnit * size) || is_active(i) || !load(i, candidate)) continue;
        const Real distance = static_cast<Real>(violation) / candidate.norm;
        if (distance > gap) {
          gap = distance;
          entry = candidate;
        }
      }
      return gap > 0;
    }
  }

  void remove(std::size_t at) {
    if constexpr (kNarrow) columns_.restore(active_[at].row, active_[at].d);
    erase(at);
  }

  // Tries to prove with y = (1, -r), the positive part, that there is no feasible point: as it is, then balanced
  // without the rows of negligible weight, then balanced with them.
  bool prove_infeasible(const Entry& entry, Vector r, QpResult& result) const {
    Vector z;
    refine(entry, r, z);
    Certificate all;
    all.append(p_, entry.row, 1 / static_cast<Wide>(entry.norm));
    for (std::size_t k = 0; k < count_; ++k) {
      if (r[k] < 0) all.append(p_, active_[k].row, -static_cast<Wide>(r[k]) / active_[k].norm);
    }
    if (all.prove(p_, result)) return true;
    Certificate few = all.without_noise();
    few.balance(p_);
    if (few.prove(p_, result)) return true;
    all.balance(p_);
    return all.prove(p_, result);
  }

  // Moves z. `renew` computes it again when it was once so large that its rounding would be visible now.
  void move(const Vector& along, Real step) {
    for (std::size_t j = 0; j < n(); ++j) z_[j] += step * along[j];
    farthest_ = std::max(farthest_, dot(z_, z_));
  }
  void renew() {
    if (!(farthest_ > 64 * dot(z_, z_)) && count_ < n()) return;
    settle();
    for (std::size_t k = 0; k < count_; ++k) u_[k] = std::max<Real>(0, u_[k]);
    farthest_ = dot(z_, z_);
  }

  // Makes the row active: moves z to its boundary and drops the rows whose multipliers would become negative.
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
        move(z, step);
        renew();
        return Step::added;
      }
      if (independent) {
        move(z, step);
        gap -= step * zz;
      }
      remove(drop);
    }
  }

  // Violation of a row by the input's numbers, at the x of the active rows.
  Real gap_of(const Entry& entry) const {
    Wide size = 0;
    return static_cast<Real>(-slack(p_, entry.row, x_.data(), size) / static_cast<Wide>(entry.norm));
  }

  // Thresholds below which a value is rounding noise: for x_j that of the sums it is computed from, for
  // multipliers that of z - z0.
  Vector noise_of_x() const {
    Vector size;
    const Real length = std::sqrt(dot(z_, z_));
    for (std::size_t j = n(); j-- > 0;) {
      size[j] = length;
      for (std::size_t k = j + 1; k < n(); ++k) size[j] += std::fabs(l_[k][j]) * size[k];
      size[j] *= inverse_[j];
    }
    for (std::size_t j = 0; j < n(); ++j) size[j] *= static_cast<Real>(kFeasible);
    return size;
  }
  Real noise_of_u() const {
    Real sum = 0;
    for (std::size_t j = 0; j < n(); ++j) sum += (z_[j] - z0_[j]) * (z_[j] - z0_[j]);
    return static_cast<Real>(kFeasible) * std::sqrt(sum);
  }

  // Checks (x, u), rounded to double, on the input and stores it as the result if it is a proof; `clean`
  // replaces noise by zeros in x (1), in u (2) or both (3). `worst`: the row violated most beyond rounding.
  bool is_proved(QpResult& result, unsigned clean, std::uint32_t& worst) const {
    std::array<double, kMax> x{}, y{};
    std::array<std::uint32_t, kMax> rows{};
    std::size_t size = 0;
    Vector small{};
    if (clean & 1) small = noise_of_x();
    const Real negligible = clean & 2 ? noise_of_u() : 0;
    for (std::size_t j = 0; j < n(); ++j) {
      x[j] = !clean || std::fabs(x_[j]) > small[j] ? static_cast<double>(x_[j]) : 0;
    }
    for (std::size_t k = 0; k < count_; ++k) {
      if (!(u_[k] > negligible)) continue;
      rows[size] = active_[k].row;
      y[size] = static_cast<double>(u_[k] / active_[k].norm);
      if (y[size] > 0) ++size;
    }
    if (!is_stationary(p_, x.data(), {rows.data(), size}, y.data(), loose_)) return false;
    const Violations found = violations<N>(p_, x.data(), loose_);
    if (found.worst != kNone) {
      if (!clean) worst = found.worst;
      return false;
    }
    result.status = QpStatus::optimal;
    result.active_count = size;
    std::copy_n(x.begin(), n(), result.x.begin());
    std::copy_n(rows.begin(), size, result.active.begin());
    std::copy_n(y.begin(), size, result.multiplier.begin());
    result.violation = found.greatest;
    return true;
  }

  // Computes the solution of the active rows, refines it and checks it on the input. Returns the row violated most
  // beyond rounding, or kNone. Rows with a negative multiplier are removed.
  std::uint32_t finish(QpResult& result) {
    std::sort(active_.begin(), active_.begin() + static_cast<std::ptrdiff_t>(count_),
              [](const Entry& a, const Entry& b) { return a.row < b.row; });
    refactor(0);
    for (;;) {
      settle();
      backward(z_.data(), x_.data());
      std::uint32_t worst = kNone;
      for (int pass = 0; pass < 4 && (worst == kNone || is_active(worst)); ++pass) {
        improve();
        worst = kNone;
        if (is_proved(result, 0, worst)) return kNone;
      }
      for (const unsigned clean : {3u, 1u, 2u}) {
        if (is_proved(result, clean, worst)) return kNone;
      }
      std::size_t negative = kMax;
      for (std::size_t k = 0; k < count_; ++k) {
        if (u_[k] < 0 && (negative == kMax || u_[k] < u_[negative])) negative = k;
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
  std::array<Vector, kMax> l_{};  // of H
  Vector inverse_{}, z0_{}, z_{}, x_{}, u_{};
  std::array<Entry, kMax> active_{};
  std::array<Vector, kMax> q_{}, r_{};  // columns
  std::size_t count_ = 0;
  const double loose_;
  Real farthest_ = 0;  // greatest |z|^2 since z was computed: z carries its rounding
  Columns columns_;
};

void check_sizes(const QpProblem& p) {
  const std::size_t m = p.bounds.size();
  if (p.n < 1 || p.n > kQpMaxVariables) throw std::invalid_argument("a quadratic program has 1 to 10 variables");
  if (m >= kNone) throw std::invalid_argument("too many rows");
  if (p.hessian.size() != p.n * p.n || p.gradient.size() != p.n || p.rows.size() != m * p.n) {
    throw std::invalid_argument("the arrays of a quadratic program do not fit together");
  }
}

QpResult failed(int iterations) {
  QpResult result;
  result.violation = kInfinity;
  result.iterations = iterations;
  return result;
}

bool all_finite(std::span<const double> values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

// Solves in extended precision what double precision cannot decide. A program that is infeasible by less than a
// certificate can show, and feasible to within the looser tolerance of a proof, counts as feasible.
QpResult solve_wide(const QpProblem& problem, int iterations) {
  for (const double loose : {1.0, kLoose}) {
    DualActiveSet<Wide, 0> pass(problem, loose);
    QpResult result;
    if (!pass.factor()) break;
    const Outcome outcome = pass.run({}, {}, result);
    result.iterations += iterations;
    if (outcome != Outcome::stuck) return result;
    iterations = result.iterations;
  }
  return failed(iterations);
}

}  // namespace

QpSolver QpSolver::with_backend(QpBackend backend) {
  QpSolver solver;
  solver.backend_ = std::move(backend);
  return solver;
}

void QpSolver::reserve(std::size_t rows) {
  const std::size_t size = Columns::size_for(rows, kQpMaxVariables);
  if (columns_.size() < size) columns_.resize(size);
}

template <int N>
QpResult QpSolver::solve_with(const QpProblem& problem, std::span<const std::uint32_t> warm) {
  int iterations = 0;
  for (const bool cold : {false, true}) {
    if (cold && warm.empty()) break;
    DualActiveSet<double, N> pass(problem);
    const bool factored = pass.factor();
    Columns columns(columns_.data(), problem.bounds.size());
    std::uint32_t bad = kNone;
    const Prepared prepared =
        columns.fill<N>(problem, pass.lower(), pass.inverse_diagonal(), DualActiveSet<double, N>::kMax, bad);
    if (prepared == Prepared::not_finite) return failed(0);
    QpResult result;
    if (prepared == Prepared::impossible) {
      result.status = QpStatus::infeasible;
      result.active_count = 1;
      result.active[0] = bad;
      result.multiplier[0] = 1;
      result.violation = problem.bounds[bad];
      return result;
    }
    if (!factored || prepared == Prepared::extreme) break;
    const Outcome outcome = pass.run(columns, cold ? std::span<const std::uint32_t>{} : warm, result);
    result.iterations += iterations;
    if (outcome != Outcome::stuck) return result;
    iterations = result.iterations;
  }
  return solve_wide(problem, iterations);
}

QpResult QpSolver::solve(const QpProblem& problem, std::span<const std::uint32_t> warm) {
  check_sizes(problem);
  if (!all_finite(problem.hessian) || !all_finite(problem.gradient)) return failed(0);
  if (backend_) {
    if (!all_finite(problem.rows) || !all_finite(problem.bounds)) return failed(0);
    QpResult result = backend_(problem);
    if (result.status == QpStatus::failed || !all_finite(result.x)) return failed(result.iterations);
    if (result.status == QpStatus::optimal) {
      result.violation = violations<0>(problem, result.x.data()).greatest;
    } else {
      result.violation = 0;
      for (std::size_t k = 0; k < result.active_count; ++k) {
        result.violation += result.multiplier[k] * problem.bounds[result.active[k]];
      }
    }
    return result;
  }
  const std::size_t size = Columns::size_for(problem.bounds.size(), problem.n);
  if (columns_.size() < size) columns_.resize(size);
  switch (problem.n) {
    case 3:
      return solve_with<3>(problem, warm);
    case 4:
      return solve_with<4>(problem, warm);
    case 5:
      return solve_with<5>(problem, warm);
    case 8:
      return solve_with<8>(problem, warm);
    case 10:
      return solve_with<10>(problem, warm);
    default:
      return solve_with<0>(problem, warm);
  }
}

}  // namespace alula
