// Rows of all ellipsoids of a map, or of those within a distance, measured only where an acceleration could violate
// them; also of the obstacles of a second map.
#pragma once

#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "alula/filters/distance_barrier.hpp"
#include "alula/filters/shield.hpp"

namespace alula::flight {

// Rows depend on the state alone, so a measured row serves all accelerations of a tick.
class DistanceRows {
 public:
  struct Row {
    AccelerationRow unit;  // normalised
    double length;         // length of the row before normalisation
    std::uint32_t item;    // of the index; from its size on, of the second map
    bool is_taken;         // returned by `worst`

    double slack(Vec3 u) const { return geometry::dot(unit.row, u) - unit.bound; }
  };

  DistanceRows(std::shared_ptr<const EllipsoidIndex> index, const DistanceLaw& law, Surroundings others = {});

  const EllipsoidIndex& index() const { return *index_; }
  const DistanceLaw& law() const { return law_; }

  // Starts a new state: measures the ellipsoids that may have the minimum h, or optionally all of them. Only
  // ellipsoids nearer than `reach` have rows. `more_m` is that of the law from now on.
  void start(Vec3 p, Vec3 v, bool all, double reach = std::numeric_limits<double>::infinity(), double more_m = 0);

  // Measures the ellipsoids whose rows `u` may violate and that were not measured in this tick, by the tree and in
  // the order of the bounds. It may stop after `enough` violated rows. Returns true if a new row is violated by more
  // than `tolerance`.
  bool search(Vec3 u, double tolerance, std::size_t enough);

  // Returns up to `count` measured rows that `u` violates most, by more than `tolerance`, and marks them as taken.
  // Rows that are already taken are skipped. Valid until the next call.
  std::span<const std::uint32_t> worst(Vec3 u, double tolerance, std::size_t count);

  // True if `u` satisfies the rows of all ellipsoids to the tolerance.
  bool hold(Vec3 u, double tolerance);

  const Row& operator[](std::size_t i) const { return row_[i]; }
  std::size_t size() const { return row_.size(); }      // rows of this tick, without those that hold for all inputs
  std::uint32_t measured() const { return measured_; }  // ellipsoids and contacts measured in this tick
  double least() const { return least_; }               // minimum h of the obstacles within reach [m^2]

 private:
  bool measure(std::uint32_t item);  // true if a row was stored
  bool store(const DistanceBarrier& barrier, std::uint32_t item);
  // Measures the contacts nearer than `reach` that were not measured in this tick. Returns true if `u` violates a new
  // row by more than `tolerance`.
  bool look(double reach, Vec3 u, double tolerance);
  bool is_beyond(const geometry::Box& box, double ball) const;  // true if no set in the box is within reach

  std::shared_ptr<const EllipsoidIndex> index_;
  DistanceLaw law_;
  Surroundings others_;
  MapMemory memory_;
  std::vector<Contact> contact_;
  double looked_ = 0;  // all contacts nearer than this were measured
  Vec3 p_, v_;
  double reach_ = std::numeric_limits<double>::infinity();
  bool has_all_ = false;
  double least_ = std::numeric_limits<double>::infinity();
  std::uint32_t tick_ = 0, measured_ = 0;
  std::vector<std::uint32_t> seen_;  // the last tick in which an item was measured
  std::vector<Row> row_;
  std::vector<geometry::Bvh::Pending> heap_;
  std::vector<double> value_;  // most violated rows before normalisation, as a heap
  std::vector<std::pair<double, std::uint32_t>> order_;
  std::vector<std::uint32_t> worst_;
};

}  // namespace alula::flight
