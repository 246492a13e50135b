// One run of the dual active-set method of qp.hpp in one precision.
// Source: Goldfarb, Idnani 1983.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <type_traits>
#include <utility>

#include "alula/qp/qp_active.hpp"
#include "alula/qp/qp_certificate.hpp"
#include "alula/qp/qp_check.hpp"
#include "alula/qp/qp_columns.hpp"

namespace alula::qp {

enum class Outcome : std::uint8_t { optimal, infeasible, stuck };

// Real: double looks for violated rows in `columns`, a wider type in the input.
template <class Real, int N>
class DualPass : public ActiveRows<Real, N> {
  using Base = ActiveRows<Real, N>;

 public:
  using Base::kMax;
  static constexpr bool kNarrow = std::is_same_v<Real, double>;

  // `loose`: how many times the rounding that a proof bears.
  explicit DualPass(const QpProblem& problem, double loose = 1) : Base(problem), loose_(loose) {}

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
      // A row that only the input shows to be violated: go on with it.
      if (step != Step::added || worst == kNone || is_active(worst) || !load(worst, entry)) return Outcome::stuck;
      step = add(entry, gap_of(entry), result);
      if (step != Step::added) return step == Step::infeasible ? Outcome::infeasible : Outcome::stuck;
    }
    return Outcome::stuck;
  }

 private:
  using Base::active_, Base::count_, Base::inverse_, Base::l_, Base::p_, Base::q_, Base::u_, Base::x_, Base::z0_,
      Base::z_;
  using Base::append, Base::backward, Base::direction, Base::dot, Base::improve, Base::is_active, Base::load, Base::n,
      Base::refactor, Base::refine, Base::settle;
  using typename Base::Entry;
  using typename Base::Vector;

  enum class Step : std::uint8_t { added, infeasible, stuck };

  static constexpr int kRounds = 25;
  static constexpr int kGreedy = 300, kMost = 600;  // exchanges with the most and with the first violated row

  Real tolerance() const { return static_cast<Real>(kFeasible) * std::sqrt(dot(z_, z_)); }
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
    Base::erase(at);
  }

  // y = (1, -r), the positive part: does it prove that there is no feasible point? If not at once, then
  // balanced, without noise and with it.
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

  // z moves on; when it has come from so far that rounding would show, it is computed anew.
  void move(const Vector& way, Real step) {
    for (std::size_t j = 0; j < n(); ++j) z_[j] += step * way[j];
    farthest_ = std::max(farthest_, dot(z_, z_));
  }
  void renew() {
    if (!(farthest_ > 64 * dot(z_, z_)) && count_ < n()) return;
    settle();
    for (std::size_t k = 0; k < count_; ++k) u_[k] = std::max<Real>(0, u_[k]);
    farthest_ = dot(z_, z_);
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

  // How far the input says that a row is violated, at the x of the active rows.
  Real gap_of(const Entry& entry) const {
    Wide size = 0;
    return static_cast<Real>(-slack(p_, entry.row, x_.data(), size) / static_cast<Wide>(entry.norm));
  }

  // What is zero but for rounding, for the lack of anything to be compared with: x_j below that of the sums it
  // comes from, multipliers below that of z - z0.
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

  // Holds (x, u), rounded to double, against the input, and makes it the result if it is a proof; `clean`
  // replaces noise by zeros in x (1), in u (2) or both (3). `worst`: the row violated most beyond rounding.
  bool is_proved(QpResult& result, unsigned clean, std::uint32_t& worst) const {
    std::array<double, kMax> x{}, y{};
    std::array<std::uint32_t, kMax> rows{};
    std::size_t size = 0;
    Vector small{};
    if (clean & 1) small = noise_of_x();
    const Real least = clean & 2 ? noise_of_u() : 0;
    for (std::size_t j = 0; j < n(); ++j) {
      x[j] = !clean || std::fabs(x_[j]) > small[j] ? static_cast<double>(x_[j]) : 0;
    }
    for (std::size_t k = 0; k < count_; ++k) {
      if (!(u_[k] > least)) continue;
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

  // The answer of the active rows, refined and held against the input; the row violated most beyond
  // rounding, or kNone. Rows whose multiplier turns out negative are given up.
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

  const double loose_;
  Real farthest_ = 0;  // greatest |z|^2 that z carries the rounding of
  Columns columns_;
};

}  // namespace alula::qp
