// Four doubles in one vector, with operations that also exist for one double: formulas are written once for both.
//
// Each lane gives the same bits as the same computation with one double.
#pragma once

#include <cmath>
#include <cstdint>

namespace alula {

class Mask {
 public:
  using Pair = std::int64_t __attribute__((vector_size(16)));
  Mask() = default;
  Mask(Pair low, Pair high) : low_(low), high_(high) {}
  bool operator[](int i) const { return (i < 2 ? low_[i] : high_[i - 2]) != 0; }
  Pair low() const { return low_; }
  Pair high() const { return high_; }

 private:
  Pair low_{}, high_{};
};

inline Mask operator|(Mask a, Mask b) { return {a.low() | b.low(), a.high() | b.high()}; }
inline Mask operator&(Mask a, Mask b) { return {a.low() & b.low(), a.high() & b.high()}; }
inline Mask operator!(Mask a) { return {~a.low(), ~a.high()}; }
inline bool any(Mask a) {
  const Mask::Pair either = a.low() | a.high();
  return (either[0] | either[1]) != 0;
}
inline bool all(Mask a) {
  const Mask::Pair both = a.low() & a.high();
  return (both[0] & both[1]) != 0;
}

class Lanes {
 public:
  using Pair = double __attribute__((vector_size(16)));
  Lanes() = default;
  Lanes(double all) : low_{all, all}, high_{all, all} {}
  Lanes(double a, double b, double c, double d) : low_{a, b}, high_{c, d} {}
  Lanes(Pair low, Pair high) : low_(low), high_(high) {}
  double operator[](int i) const { return i < 2 ? low_[i] : high_[i - 2]; }
  Pair low() const { return low_; }
  Pair high() const { return high_; }
  Lanes& operator+=(Lanes b) { return low_ += b.low_, high_ += b.high_, *this; }

 private:
  Pair low_{}, high_{};
};

inline Lanes operator+(Lanes a, Lanes b) { return {a.low() + b.low(), a.high() + b.high()}; }
inline Lanes operator-(Lanes a, Lanes b) { return {a.low() - b.low(), a.high() - b.high()}; }
inline Lanes operator*(Lanes a, Lanes b) { return {a.low() * b.low(), a.high() * b.high()}; }
inline Lanes operator/(Lanes a, Lanes b) { return {a.low() / b.low(), a.high() / b.high()}; }
inline Lanes operator-(Lanes a) { return {-a.low(), -a.high()}; }
inline Mask operator<(Lanes a, Lanes b) { return {a.low() < b.low(), a.high() < b.high()}; }
inline Mask operator>(Lanes a, Lanes b) { return b < a; }
inline Mask operator<=(Lanes a, Lanes b) { return {a.low() <= b.low(), a.high() <= b.high()}; }
inline Mask operator>=(Lanes a, Lanes b) { return b <= a; }
inline Mask operator==(Lanes a, Lanes b) { return {a.low() == b.low(), a.high() == b.high()}; }
inline Lanes select(Mask which, Lanes yes, Lanes no) {
  return {which.low() ? yes.low() : no.low(), which.high() ? yes.high() : no.high()};
}
inline Lanes sqrt(Lanes a) { return {std::sqrt(a[0]), std::sqrt(a[1]), std::sqrt(a[2]), std::sqrt(a[3])}; }
inline Lanes abs(Lanes a) { return select(a < 0, -a, a); }

// The same for one number.
inline bool any(bool a) { return a; }
inline bool all(bool a) { return a; }
inline double select(bool which, double yes, double no) { return which ? yes : no; }

// The larger and the smaller, chosen as std::max and std::min do.
template <class Real>
Real larger(Real a, Real b) {
  return select(a < b, b, a);
}
template <class Real>
Real smaller(Real a, Real b) {
  return select(b < a, b, a);
}

}  // namespace alula
