// What a filter of wrenches asks for while it holds a vehicle up, and until it has let go of it.
//
// The nominal input is that of a stiff attitude loop that knows nothing of the obstacles. While rows hold it back it
// pulls against them, and when they let go it makes up for everything at once: both are jerk. Instead, from the first
// tick at which the nominal input breaks a row, the filter wishes for the snap
//
//   s = share (c2 (a* - a) - (p1 + p2 + 2 q) a') + (1 - share) (p1 p2 (a_nom - a) - (p1 + p2) a'),
//
// a* is the acceleration nearest to a_r - (c1 e_v + c0 e_p) / c2 that holds first-order rows of the cones, so that
// the wish does not pull into what holds it. c0..c2 place the poles of the whole motion: two at -q of the position
// and two at -p1, -p2 of the acceleration. While the wish itself breaks a row p1 is `release_rad_s`; then it grows
// by e^{growth t} and the share falls from 1, at p1 = p2, to 0: the vehicle is back with the nominal input. A wish is
// only steering: what is returned holds the rows, and the shield certifies it like any other input.
#pragma once

#include <cstdint>
#include <limits>

#include "alula/filters/acceleration_program.hpp"

namespace alula::flight {

struct SmoothWishOptions {
  double release_rad_s = 2;          // p1 while held; 0: never, the wish is the nominal input
  double release_growth_1_s = 3;     // of p1 afterwards
  double wish_attitude_rad_s = 35;   // p2
  double wish_position_rad_s = 1.2;  // q
  double wish_catch_up_m_s = 0.7;    // how much faster than its reference the wish flies to make up for e_p,
  double wish_acceleration = 3;      // and the most that e_p and e_v ask for [m/s^2]
  double wish_speed_m_s = 2.2;       // of a reference; of one n times as fast these three are n^1.5 times as large
  double wish_cone_rate_1_s = 3;     // of the rows of a*: h' + rate h >= 0, and (d/dt + rate)^2 gamma >= 0
};

class SmoothWish {
 public:
  // Throws std::invalid_argument for options that mean nothing.
  SmoothWish(std::size_t rows, const SmoothWishOptions& options);

  void start(double dt);  // a tick
  void add(const Cone& cone, bool on_gamma, std::uint32_t item);
  bool is_on() const { return options_.release_rad_s > 0; }
  bool is_releasing() const;
  void hold() { since_ = 0; }  // the wish cannot be had
  void reset() { since_ = kLongAgo, top_speed_ = 0; }

  Vec3 snap(const SnapMap& map, Vec3 v, const Nominal& nominal);  // s

 private:
  static constexpr double kLongAgo = std::numeric_limits<double>::infinity();

  double pole() const;  // p1

  SmoothWishOptions options_;
  AccelerationProgram program_;
  double since_ = kLongAgo;  // it was held [s]
  double dt_ = 0;            // a tick [s]
  double top_speed_ = 0;     // of the reference while it was held
};

}  // namespace alula::flight
