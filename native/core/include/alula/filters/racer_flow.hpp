// Flow of a racing drone under the geofence's backup controller, for doubles and for numbers with derivatives.
//
// The formulas and the steps are those of native/onboard (alula_racer.h), in double precision; a test compares the
// two.
#pragma once

#include <algorithm>
#include <array>

#include "alula/base/dual.hpp"
#include "alula/filters/geofence.hpp"

namespace alula::flight {

template <class S>
struct RacerFlow {
  std::array<S, 3> p, v;
  std::array<S, 4> q;
  std::array<S, 3> w;
};

struct BackupHold {
  double height, half_c, half_s;
};

template <class S>
struct FlowCommand {
  S throttle;
  std::array<S, 3> rates;
};

class BackupController {
 public:
  BackupController(const Fence& fence, const alula_geofence_config& config, double hover)
      : fence_(fence), c_(config), hover_(hover) {}

  BackupHold hold(const RacerState& x) const {
    const double square = x.q[0] * x.q[0] + x.q[3] * x.q[3], inverse = square > 1e-6 ? 1 / std::sqrt(square) : 0;
    const std::array<double, 3> push = this->push<double>({x.p.x, x.p.y, x.p.z});
    return {x.p.z + push[2], square > 1e-6 ? x.q[0] * inverse : 1, x.q[3] * inverse};
  }

  // Equation (17) for the box and the faces.
  template <class S>
  std::array<S, 3> push(const std::array<S, 3>& p) const {
    std::array<S, 3> up{S(0), S(0), S(0)}, down = up;
    const double kept = static_cast<double>(c_.radius_m) + c_.reserve_m;
    const auto add = [&](const S& distance, const std::array<double, 3>& inward) {
      const S wanted = S(c_.push_gain) * (S(c_.push_distance_m) - distance);
      if (!(wanted > S(0))) return;
      const S size = cut<S>(wanted, 0, c_.push_speed_m_s);
      for (std::size_t i = 0; i < 3; ++i) {
        const S one = S(inward[i]) * size;
        if (one > up[i]) up[i] = one;
        if (one < down[i]) down[i] = one;
      }
    };
    for (std::size_t i = 0; fence_.box && i < 3; ++i) {
      const int axis = static_cast<int>(i);
      std::array<double, 3> unit{};
      unit[i] = 1, add(p[i] - S(fence_.box->lower[axis] + kept), unit);
      unit[i] = -1, add(S(fence_.box->upper[axis] - kept) - p[i], unit);
    }
    for (const auto& n : fence_.faces) {
      add(S(n[3] - kept) - (S(n[0]) * p[0] + S(n[1]) * p[1] + S(n[2]) * p[2]), {-n[0], -n[1], -n[2]});
    }
    return {up[0] + down[0], up[1] + down[1], up[2] + down[2]};
  }

  template <class S>
  FlowCommand<S> command(const BackupHold& hold, const RacerFlow<S>& x) const {
    const std::array<S, 3> vd = push(x.p);
    const double hc = hold.half_c, hs = hold.half_s, yc = hc * hc - hs * hs, ys = 2 * hc * hs;
    const S zeta = S(1) - S(2) * (x.q[1] * x.q[1] + x.q[2] * x.q[2]);
    const S ex = vd[0] - x.v[0], ey = vd[1] - x.v[1];
    S tx = S(c_.backup.tilt_gain) * (S(yc) * ex + S(ys) * ey),
      ty = S(c_.backup.tilt_gain) * (S(yc) * ey - S(ys) * ex);
    S square = tx * tx + ty * ty, scale = cut<S>(S(1) + S(4) * zeta, 0, 1);
    const double most = c_.backup.max_tilt;
    if (square > S(most * most)) scale = scale * S(most) / root(square);
    tx = scale * tx, ty = scale * ty, square = scale * scale * square;
    S c(1), s(0.5);  // cos of half the angle; sine of half the angle over the angle
    if (square > S(1e-12)) {
      const S size = root(square);
      c = cosine(S(0.5) * size), s = sine(S(0.5) * size) / size;
    }
    const S dw = S(hc) * c, dz = S(hs) * c, dx = -s * (S(hc) * ty + S(hs) * tx), dy = s * (S(hc) * tx - S(hs) * ty);
    const auto& q = x.q;
    S w = dw * q[0] + dx * q[1] + dy * q[2] + dz * q[3];
    if (w < S(std::sqrt(0.5)) && w > S(-std::sqrt(0.5))) w = w < S(0) ? S(-std::sqrt(0.5)) : S(std::sqrt(0.5));
    const S gain = S(-2 * static_cast<double>(c_.backup.attitude_gain)) * w;
    const S steep = zeta > S(0.5) ? S(1) / zeta : cut<S>(S(2) + S(20.0 / 3) * zeta, 1.0 / 3, 2);
    const double cap = c_.backup.most_throttle;
    FlowCommand<S> u{S(hover_) * steep + cut<S>(S(c_.backup.height_gain) * (S(hold.height) - x.p[2]), -cap, cap) +
                         cut<S>(S(c_.backup.climb_gain) * (vd[2] - x.v[2]), -cap, cap),
                     {gain * (dw * q[1] - dx * q[0] - dy * q[3] + dz * q[2]),
                      gain * (dw * q[2] - dy * q[0] - dz * q[1] + dx * q[3]),
                      gain * (dw * q[3] - dz * q[0] - dx * q[2] + dy * q[1])}};
    limit(u);
    return u;
  }

  // Advances by dt with the command, extrapolated to the middle of the step from the previous one, `last`, unless
  // `is_first`.
  template <class S>
  void advance(double dt, const BackupHold& hold, RacerFlow<S>& x, FlowCommand<S>& last, bool is_first) const {
    const FlowCommand<S> now = command(hold, x);
    FlowCommand<S> u = now;
    if (!is_first) {
      u.throttle = S(1.5) * now.throttle - S(0.5) * last.throttle;
      for (std::size_t i = 0; i < 3; ++i) u.rates[i] = S(1.5) * now.rates[i] - S(0.5) * last.rates[i];
      limit(u);
    }
    last = now;
    const double gain = 1 - std::exp(-c_.model.rate_gain * dt), mean = gain / (c_.model.rate_gain * dt);
    const std::array<S, 3> before = axis(x.q);
    std::array<S, 3> half{S(0), S(0), S(0)};
    for (std::size_t i = 0; i < 3; ++i) {
      const S away = x.w[i] - u.rates[i];
      half[i] = S(0.5 * dt) * (u.rates[i] + S(mean) * away);
      x.w[i] = x.w[i] - S(gain) * away;
    }
    const S square = half[0] * half[0] + half[1] * half[1] + half[2] * half[2];
    S c(1), s(1);
    if (square > S(1e-12)) {
      const S size = root(square);
      c = cosine(size), s = sine(size) / size;
    }
    const S a = s * half[0], b = s * half[1], d = s * half[2];
    const auto q = x.q;
    x.q = {q[0] * c - q[1] * a - q[2] * b - q[3] * d, q[0] * a + q[1] * c + q[2] * d - q[3] * b,
           q[0] * b - q[1] * d + q[2] * c + q[3] * a, q[0] * d + q[1] * b - q[2] * a + q[3] * c};
    const std::array<S, 3> after = axis(x.q);
    const auto& t = c_.model.thrust;
    const S thrust = S(t[0]) + u.throttle * (S(t[1]) + u.throttle * S(t[2]));
    for (std::size_t i = 0; i < 3; ++i) {
      const S acceleration = S(0.5) * thrust * (before[i] + after[i]) - S(i == 2 ? c_.model.gravity : 0);
      x.p[i] = x.p[i] + S(dt) * (x.v[i] + S(0.5 * dt) * acceleration);
      x.v[i] = x.v[i] + S(dt) * acceleration;
    }
  }

  template <class S>
  static std::array<S, 3> axis(const std::array<S, 4>& q) {
    return {S(2) * (q[1] * q[3] + q[0] * q[2]), S(2) * (q[2] * q[3] - q[0] * q[1]),
            S(1) - S(2) * (q[1] * q[1] + q[2] * q[2])};
  }

 private:
  template <class S>
  void limit(FlowCommand<S>& u) const {
    u.throttle = cut<S>(u.throttle, 0, 1);
    for (std::size_t i = 0; i < 3; ++i) {
      u.rates[i] = cut<S>(u.rates[i], -double{c_.model.max_rate[i]}, c_.model.max_rate[i]);
    }
  }

  Fence fence_;
  alula_geofence_config c_;
  double hover_;
};

}  // namespace alula::flight
