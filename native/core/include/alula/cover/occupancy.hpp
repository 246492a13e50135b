// Occupied voxels as z-columns, and volumes of polytopes measured along those columns.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "alula/cover/lattice_hull.hpp"

namespace alula {

// A sorted, unique set of voxels; voxel v is the closed cube [v, v + 1]. Memory is linear in the
// number of voxels, independent of their extent. Voxels of one column have consecutive numbers.
class Occupancy {
 public:
  struct Column {
    std::int32_t x, y;
    std::uint32_t begin, end;   // its voxels
    std::int32_t first_word;    // z >> 6 of its first word
    std::uint32_t word, words;  // none when the column is sparse
  };

  // Throws std::invalid_argument when not sorted and unique by x, y, z, or out of range.
  explicit Occupancy(std::span<const Lattice> voxels);

  std::size_t size() const { return voxel_.size(); }
  std::span<const Lattice> voxels() const { return voxel_; }
  std::span<const Column> columns() const { return column_; }  // sorted by x, y

  // The column at (x, y), or nullptr.
  const Column* find(std::int32_t x, std::int32_t y) const;

  // The columns at (x, y), (x, y + 1), ...; nullptr where there is none.
  void find_row(std::int32_t x, std::int32_t y, std::span<const Column*> found) const;

  // Number of the column's first voxel with z >= the given one.
  std::uint32_t lower(const Column& column, std::int32_t z) const;

  // Number of voxels in a box of corners.
  std::size_t count(const LatticeBox& box) const;

  // Occupied length of the column below height z.
  double filled(const Column& column, double z) const {
    const double base = std::floor(z);
    const std::int32_t k = static_cast<std::int32_t>(base);
    if (column.words == 0) return filled_sparse(column, k, z - base);
    const std::int32_t w = (k >> 6) - column.first_word;
    if (w < 0) return 0;
    if (w >= static_cast<std::int32_t>(column.words)) return static_cast<double>(column.end - column.begin);
    const Word& word = word_[column.word + static_cast<std::uint32_t>(w)];
    const int bit = k & 63;
    const std::uint64_t below = (std::uint64_t{1} << bit) - 1;
    const double whole =
        static_cast<double>(word.before + static_cast<std::uint32_t>(std::popcount(word.bits & below)));
    return whole + static_cast<double>(word.bits >> bit & 1) * (z - base);
  }

 private:
  struct Word {
    std::uint64_t bits;
    std::uint32_t before;  // voxels of the column below this word
  };
  void index_columns();
  double filled_sparse(const Column& column, std::int32_t k, double fraction) const;

  std::vector<Lattice> voxel_;
  std::vector<Column> column_;
  std::vector<Word> word_;
  // Numbers of columns plus one: of each cell of the rectangle from (low_x_, low_y_), or in a hash table by open
  // addressing when most cells are empty.
  std::vector<std::uint32_t> table_;
  std::size_t rows_ = 0, width_ = 0;  // of the rectangle; none with a hash table
  std::int32_t low_x_ = 0, low_y_ = 0;
  std::vector<std::uint32_t> row_;  // beside a hash table: first column of each x from low_x_; none when sparse
};

// Lines per axis that sample a box of `extent` voxels: four per voxel up to 3 voxels, two up to 8,
// then one, at most `most`.
int sample_lines(std::int32_t extent, int most = 24);

// A polytope as lower and upper bounds on z over (x, y), in coordinates local to the lower corner of its box.
class ZBounds {
 public:
  void assign(std::span<const HullBuilder::LocalPlane> planes, const LatticeBox& box);
  void assign(const LatticePolytope& polytope, const LatticeBox& box);

  // Of the part of a polytope in `box`, local to its lower corner; the planes are local to that of `own`.
  void assign(std::span<const HullBuilder::LocalPlane> planes, const LatticeBox& own, const LatticeBox& box);

  // The intervals [low, high] of z over (x, y[k]); empty where low >= high.
  void row(double x, std::span<const double> y, double* low, double* high) const;

 private:
  struct Slope {
    double x, y, offset;
  };
  void add(double x, double y, double z, double offset);

  double height_ = 0;
  std::vector<Slope> upper_, lower_, upright_;
};

// Measures W = Vol(polytope \ occupied) [voxels], by exact z-intervals over a midpoint grid of the
// bounding box with sample_lines() per axis, at most `most_lines`.
// Boxes are counted exactly. Any other polytope measures zero only when its bounding box is full, and
// at least kLeast otherwise, so W = 0 always means no excess. W only ranks merges. One per thread.
class ExcessMeter {
 public:
  explicit ExcessMeter(const Occupancy& occupancy, int most_lines = 24)
      : occupancy_(&occupancy), most_lines_(most_lines) {}
  double operator()(const HullBuilder& hull, double limit = std::numeric_limits<double>::infinity());
  double operator()(const LatticePolytope& polytope);

  // Vol((polytope \ occupied) in a box), which has a volume; zero or small values have no meaning.
  double within(std::span<const HullBuilder::LocalPlane> planes, const LatticeBox& own, const LatticeBox& box);

 private:
  static constexpr double kLeast = 1e-6;  // [voxels]

  double measure(const LatticeBox& box, bool is_box, double limit);
  double sampled(const LatticeBox& box, double limit);

  const Occupancy* occupancy_;
  int most_lines_;
  ZBounds bounds_;
  std::vector<double> y_, low_, high_;
  std::vector<std::uint32_t> at_;                        // offset of the column at each y
  std::vector<const Occupancy::Column*> column_, line_;  // of each offset; of each y
};

}  // namespace alula
