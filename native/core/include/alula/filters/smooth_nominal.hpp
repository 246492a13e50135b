// Smooth nominal snap for a wrench filter, used while rows restrict the vehicle and during the return to the nominal.
//
// The nominal input comes from a stiff attitude loop without a model of the obstacles. While rows restrict the
// vehicle, the loop works against them; when the rows release it, the loop corrects the whole error in one step. Both
// cause jerk. So from the first tick in which the nominal input breaks a row, the filter uses as its nominal the snap
//
//   s = weight (c2 (a* - a) - (p1 + p2 + 2 q) a') + (1 - weight) (p1 p2 (a_nom - a) - (p1 + p2) a'),
//
// where a* is the acceleration nearest to a_r - (c1 e_v + c0 e_p) / c2 that satisfies first-order rows of the cones,
// so that s does not steer into the obstacle. c0..c2 place the poles of the whole motion: two at -q for the position
// and two at -p1, -p2 for the acceleration. While s itself breaks a row, p1 is `release_rad_s`. Then p1 grows by
// e^{growth t} and the weight falls from 1 to 0, at p1 = p2: the nominal input is restored. The snap only steers: the
// returned input satisfies the rows, and the shield certifies it like any other input.
#pragma once

#include <cstdint>
#include <limits>

#include "alula/filters/acceleration_program.hpp"
#include "alula/filters/options.hpp"

namespace alula::flight {

class SmoothNominal {
 public:
  // Throws std::invalid_argument for invalid options.
  SmoothNominal(std::size_t rows, const SmoothNominalOptions& options);

  void start(double dt);  // a tick
  void add(const Cone& cone, bool on_gamma, std::uint32_t item);
  bool is_on() const { return options_.release_rad_s > 0; }
  bool is_releasing() const;
  void hold() { since_ = 0; }  // the snap breaks a row
  void reset() { since_ = kLongAgo, top_speed_ = 0; }

  Vec3 snap(const SnapMap& map, Vec3 v, const Nominal& nominal);  // s

 private:
  static constexpr double kLongAgo = std::numeric_limits<double>::infinity();

  double pole() const;  // p1

  SmoothNominalOptions options_;
  AccelerationProgram program_;
  double since_ = kLongAgo;  // time since a row last held it [s]
  double dt_ = 0;            // a tick [s]
  double top_speed_ = 0;     // maximum speed of the reference while held [m/s]
};

}  // namespace alula::flight
