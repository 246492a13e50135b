// Changes of a cover that keep its number of hulls, and what they save. Used by refine().
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <set>
#include <span>
#include <utility>
#include <vector>

#include "alula/cover/box_tree.hpp"
#include "alula/cover/lattice_hull.hpp"
#include "alula/cover/occupancy.hpp"

namespace alula {

// The voxels of one hull, and the hull.
struct Piece {
  std::vector<std::uint32_t> voxels;  // numbers, ascending
  double weight = 0;                  // W [voxels]
  std::size_t planes = 0;
  LatticeBox box{};
  HullMesh mesh;                                // of the extreme points
  std::vector<HullBuilder::LocalPlane> facets;  // local to box.lower
  std::set<Lattice> tried;                      // extreme points where no transfer was found
};

// Divides voxels v by v[axis] < limit.
struct Cut {
  double weight = std::numeric_limits<double>::infinity();  // sum of W of both sides
  std::size_t axis = 0;
  std::int32_t limit = 0;
  std::int32_t step = 0;  // cuts at this distance were measured too; zero: none was found
  bool is_below(const Lattice& v) const { return v[axis] < limit; }
};

// Voxels of one piece that go to another: its cap, with the centres beyond a plane.
struct Transfer {
  double gain = 0;  // the sum of W decreases by this [voxels]
  std::uint32_t from = 0, to = 0;
  std::array<double, 3> normal{};
  double limit = 0;
  double support(const Lattice& v) const {
    return normal[0] * (v[0] + 0.5) + normal[1] * (v[1] + 0.5) + normal[2] * (v[2] + 0.5);
  }
  bool takes(const Lattice& v) const { return support(v) >= limit; }
};

// Measures pieces and finds changes. One per thread.
class HullMoves {
 public:
  explicit HullMoves(const Occupancy& occupancy);

  std::size_t work = 0;  // in units of about 20 us

  // About the work of the functions of the same names.
  static std::size_t best_cut_work(const Piece& piece);
  static std::size_t transfers_work(const Piece& piece);

  // Finds the hull of the voxels of a piece and measures it.
  void measure(Piece& piece);

  // W of the hull of two pieces.
  double union_weight(const Piece& a, const Piece& b);

  // The best cut of some voxels across an axis with a sum of W below `limit`, if there is one.
  Cut best_cut(std::span<const std::uint32_t> voxels, double limit);

  // Moves a cut by less than its step where that is better, and measures it finely.
  void adjust(Cut& cut, std::span<const std::uint32_t> voxels);

  // The best transfers from a piece that save more than `least`, the best first: at each extreme point of its
  // hull at most one, of a cap in the direction of the mean normal there. Points without any become `tried`.
  // `tree` has the boxes of all pieces.
  std::vector<Transfer> transfers(std::vector<Piece>& pieces, std::uint32_t from, const BoxTree& tree, double least);

 private:
  using Receivers = std::vector<std::pair<double, std::uint32_t>>;  // what its box grows by, and the piece

  void list(std::span<const std::uint32_t> voxels);
  double fine(const Cut& cut, double limit);
  void find_normals(const HullMesh& mesh);
  LatticeBox cut_off(const Piece& piece, const Transfer& cap);
  Receivers receivers(std::span<const Piece> pieces, const BoxTree& tree, std::uint32_t from);
  double try_cap(std::span<const Piece> pieces, const BoxTree& tree, double limit, double least, Transfer& best);

  const Occupancy& occupancy_;
  HullBuilder hull_;
  ExcessMeter excess_, rough_;
  std::vector<Lattice> all_, side_;
  std::vector<std::vector<Lattice>> slab_;  // of best_cut(): voxels between neighbouring planes
  std::vector<double> below_;               // W of the hull below each plane
  // Of transfers(): at each extreme point the normal and the voxel; of each voxel its support.
  std::vector<std::array<double, 3>> normal_;
  std::vector<Lattice> corner_voxel_;
  std::vector<double> support_;
  // Of a cap: its voxels, the others near it, and the extreme points outside it.
  std::vector<Lattice> cap_, near_, kept_;
  std::vector<bool> is_taken_;
  std::vector<std::uint32_t> touching_;
};

}  // namespace alula
