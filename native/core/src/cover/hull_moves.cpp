#include "alula/cover/hull_moves.hpp"

#include <algorithm>
#include <cmath>

namespace alula {

namespace {

constexpr double kInfinite = std::numeric_limits<double>::infinity();

constexpr int kRoughLines = 12;        // per axis, to measure W while cuts are found
constexpr std::int32_t kCuts = 6;      // at most, along each axis
constexpr double kMargin = 0.2;        // fraction of an extent from its ends where no cut is tried
constexpr std::size_t kReceivers = 2;  // pieces that a cap is offered to, those first whose boxes grow least
constexpr double kMostGrowth = 12;     // of such a box, times what the cap saves
constexpr std::size_t kTransfers = 6;  // that are listed of one piece
constexpr double kDepth = 0.06;        // of the first cap, as a fraction of the extent along the normal
constexpr double kLeastDepth = 0.015, kMostDepth = 0.4;  // of others, each half or twice as deep
constexpr double kHope = 3;  // times the least gain: a first cap that loses more is not varied

std::size_t work_of(std::size_t voxels) { return 1 + voxels / 300; }

std::array<double, 3> scaled(const std::array<double, 3>& v, double factor) {
  return {v[0] * factor, v[1] * factor, v[2] * factor};
}

double length(const std::array<double, 3>& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

}  // namespace

HullMoves::HullMoves(const Occupancy& occupancy)
    : occupancy_(occupancy), excess_(occupancy), rough_(occupancy, kRoughLines) {}

std::size_t HullMoves::best_cut_work(const Piece& piece) { return 6 * work_of(piece.voxels.size()); }

std::size_t HullMoves::transfers_work(const Piece& piece) {
  return piece.mesh.point.size() * work_of(piece.voxels.size());
}

void HullMoves::list(std::span<const std::uint32_t> voxels) {
  all_.clear();
  for (const std::uint32_t v : voxels) all_.push_back(occupancy_.voxels()[v]);
}

void HullMoves::measure(Piece& piece) {
  list(piece.voxels);
  work += work_of(all_.size());
  hull_.build_voxels(all_);
  piece.weight = excess_(hull_);
  piece.box = hull_.box();
  const HullBuilder::Outline outline = hull_.outline();
  piece.planes = outline.planes;
  hull_.build(outline.vertex);
  piece.mesh = hull_.mesh();
  piece.facets.assign(hull_.local_planes().begin(), hull_.local_planes().end());
}

double HullMoves::union_weight(const Piece& a, const Piece& b) {
  const bool swap = a.mesh.facet.size() < b.mesh.facet.size();
  hull_.build_union((swap ? b : a).mesh, (swap ? a : b).mesh.point);
  ++work;
  return excess_(hull_);
}

Cut HullMoves::best_cut(std::span<const std::uint32_t> voxels, double limit) {
  list(voxels);
  LatticeBox box = bounds(all_);
  for (std::int32_t& end : box.upper) ++end;
  Cut best;
  best.weight = limit;
  std::vector<Lattice> known;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::int32_t extent = box.upper[axis] - box.lower[axis];
    std::int32_t step = 1;
    while (extent / step > kCuts) step *= 2;
    // Planes at first, first + step, ...: multiples of the step from the lower end, between the margins.
    const std::int32_t margin = static_cast<std::int32_t>(kMargin * extent);
    const std::int32_t first = box.lower[axis] + std::max(1, (margin + step) / step) * step;
    const std::int32_t room = box.upper[axis] - margin - first;
    if (room <= 0) continue;
    const std::size_t planes = static_cast<std::size_t>((room + step - 1) / step);
    work += 2 * work_of(all_.size());
    slab_.resize(std::max(slab_.size(), planes + 1));
    for (std::size_t k = 0; k <= planes; ++k) slab_[k].clear();
    for (const Lattice& v : all_) {
      const std::size_t k = v[axis] < first ? 0 : static_cast<std::size_t>((v[axis] - first) / step) + 1;
      slab_[std::min(k, planes)].push_back(v);
    }
    // The sides grow slab by slab; one that is too heavy stays so.
    below_.assign(planes, kInfinite);
    known.clear();
    for (std::size_t k = 0; k < planes; ++k) {
      if (slab_[k].empty()) {
        if (k > 0) below_[k] = below_[k - 1];
        continue;
      }
      hull_.build_mixed(known, slab_[k]);
      below_[k] = rough_(hull_, best.weight);
      if (below_[k] >= best.weight) break;
      if (k + 1 < planes) known = hull_.outline().vertex;
    }
    known.clear();
    for (std::size_t k = planes; k-- > 0;) {
      if (slab_[k + 1].empty()) continue;
      hull_.build_mixed(known, slab_[k + 1]);
      const double above = rough_(hull_, best.weight);
      if (above >= best.weight) break;
      if (below_[k] + above < best.weight)
        best = {below_[k] + above, axis, first + static_cast<std::int32_t>(k) * step, step};
      if (k > 0) known = hull_.outline().vertex;
    }
  }
  return best.step > 0 ? best : Cut{};
}

// Sum of W of the sides of a cut through the listed voxels, or something above `limit` if it is above.
double HullMoves::fine(const Cut& cut, double limit) {
  double sum = 0;
  for (const bool is_below : {true, false}) {
    side_.clear();
    for (const Lattice& v : all_)
      if (cut.is_below(v) == is_below) side_.push_back(v);
    if (side_.empty()) return kInfinite;
    work += work_of(side_.size());
    hull_.build_voxels(side_);
    sum += excess_(hull_);
    if (sum > limit) break;
  }
  return sum;
}

void HullMoves::adjust(Cut& cut, std::span<const std::uint32_t> voxels) {
  list(voxels);
  cut.weight = fine(cut, kInfinite);
  for (std::int32_t step = cut.step / 2; step > 0; step /= 2) {
    const std::int32_t middle = cut.limit;
    for (const std::int32_t limit : {middle - step, middle + step}) {
      Cut moved = cut;
      moved.limit = limit;
      moved.weight = fine(moved, cut.weight);
      if (moved.weight < cut.weight) cut = moved;
    }
  }
}

// Finds the mean normal of the facets at each extreme point, and the voxel there: since such a point is no point
// between two others of the hull, it is a corner of only one voxel, and no component of the normal is zero.
void HullMoves::find_normals(const HullMesh& mesh) {
  normal_.assign(mesh.point.size(), {0, 0, 0});
  for (const HullFacet& facet : mesh.facet) {
    const auto at = [&](std::size_t k) { return mesh.point[static_cast<std::size_t>(facet.vertex[k])]; };
    std::array<double, 3> u, v;
    for (std::size_t i = 0; i < 3; ++i) u[i] = at(1)[i] - at(0)[i], v[i] = at(2)[i] - at(0)[i];
    std::array<double, 3> n{u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    n = scaled(n, 1 / length(n));
    for (const std::int32_t p : facet.vertex)
      for (std::size_t i = 0; i < 3; ++i) normal_[static_cast<std::size_t>(p)][i] += n[i];
  }
  corner_voxel_ = mesh.point;
  for (std::size_t p = 0; p < normal_.size(); ++p) {
    normal_[p] = scaled(normal_[p], 1 / length(normal_[p]));
    for (std::size_t i = 0; i < 3; ++i)
      if (normal_[p][i] > 0) --corner_voxel_[p][i];
  }
}

std::vector<Transfer> HullMoves::transfers(std::vector<Piece>& pieces, std::uint32_t from, const BoxTree& tree,
                                           double least) {
  Piece& piece = pieces[from];
  list(piece.voxels);
  find_normals(piece.mesh);
  support_.resize(all_.size());
  std::vector<Transfer> found;
  for (std::size_t p = 0; p < normal_.size(); ++p) {
    if (piece.tried.contains(piece.mesh.point[p])) continue;
    Transfer best{least, from, from, normal_[p], 0};
    double low = kInfinite, high = -kInfinite;
    for (std::size_t i = 0; i < all_.size(); ++i) {
      support_[i] = best.support(all_[i]);
      low = std::min(low, support_[i]), high = std::max(high, support_[i]);
    }
    const auto gain_of = [&](double depth) {
      return try_cap(pieces, tree, high - depth * (high - low), least, best);
    };
    const double first = gain_of(kDepth);
    if (first > -kHope * least) {
      double gain = first, depth = kDepth;
      const auto is_better = [&](double other) {
        const double now = gain_of(other);
        const bool better = now > gain;
        if (better) gain = now, depth = other;
        return better;
      };
      while (2 * depth < kMostDepth && is_better(2 * depth)) continue;
      if (depth == kDepth)
        while (depth / 2 > kLeastDepth && is_better(depth / 2)) continue;
    }
    if (best.to != from)
      found.push_back(best);
    else
      piece.tried.insert(piece.mesh.point[p]);
  }
  std::stable_sort(found.begin(), found.end(), [](const Transfer& a, const Transfer& b) { return a.gain > b.gain; });
  if (found.size() > kTransfers) found.resize(kTransfers);
  return found;
}

// Divides the voxels and the extreme points of a piece into the cap and the rest. Returns the box of the extreme
// points of the cap and of their neighbours, where all is that the rest's hull lacks.
LatticeBox HullMoves::cut_off(const Piece& piece, const Transfer& cap) {
  const std::vector<Lattice>& point = piece.mesh.point;
  is_taken_.assign(point.size(), false);
  kept_.clear();
  for (std::size_t p = 0; p < point.size(); ++p) {
    is_taken_[p] = cap.takes(corner_voxel_[p]);
    if (!is_taken_[p]) kept_.push_back(point[p]);
  }
  LatticeBox box = LatticeBox::empty();
  for (const HullFacet& facet : piece.mesh.facet) {
    const auto at = [](std::int32_t p) { return static_cast<std::size_t>(p); };
    const auto& v = facet.vertex;
    if (is_taken_[at(v[0])] || is_taken_[at(v[1])] || is_taken_[at(v[2])])
      for (const std::int32_t p : v) box.add(point[at(p)]);
  }
  cap_.clear(), near_.clear();
  for (std::size_t i = 0; i < all_.size(); ++i) {
    const Lattice& v = all_[i];
    if (support_[i] >= cap.limit)
      cap_.push_back(v);
    else if (box.touches({v, {v[0] + 1, v[1] + 1, v[2] + 1}}))
      near_.push_back(v);
  }
  return box;
}

HullMoves::Receivers HullMoves::receivers(std::span<const Piece> pieces, const BoxTree& tree, std::uint32_t from) {
  LatticeBox cap = bounds(cap_);
  for (std::int32_t& end : cap.upper) ++end;
  tree.touching(cap, touching_);
  Receivers found;
  for (const std::uint32_t p : touching_) {
    if (p == from) continue;
    LatticeBox both = pieces[p].box;
    both.add(cap);
    found.emplace_back(volume(both) - volume(pieces[p].box), p);
  }
  std::sort(found.begin(), found.end());
  if (found.size() > kReceivers) found.resize(kReceivers);
  return found;
}

// Tries the cap of the listed voxels whose support is at least `limit`, and keeps the transfer if it is the best.
// Returns its gain; minus infinity where it cannot be worth it.
double HullMoves::try_cap(std::span<const Piece> pieces, const BoxTree& tree, double limit, double least,
                          Transfer& best) {
  const Piece& piece = pieces[best.from];
  Transfer made = best;
  made.limit = limit;
  const LatticeBox box = cut_off(piece, made);
  if (cap_.size() == all_.size()) return -kInfinite;
  ++work;
  const double before = excess_.within(piece.facets, piece.box, box);
  const Receivers receiver = receivers(pieces, tree, best.from);
  if (before <= least || receiver.empty() || receiver[0].first > kMostGrowth * before) return -kInfinite;
  work += work_of(all_.size());
  hull_.build_mixed(kept_, near_);
  const double saved = before - excess_.within(hull_.local_planes(), hull_.box(), box);
  if (saved <= least) return -kInfinite;
  const std::span<const Lattice> corners = hull_.corners(cap_);
  double most = -kInfinite;
  for (const auto& [growth, p] : receiver) {
    if (growth > kMostGrowth * saved) continue;
    const Piece& other = pieces[p];
    hull_.build_union(other.mesh, corners);
    made.gain = saved - (excess_(hull_, other.weight + saved + least) - other.weight);
    made.to = p;
    most = std::max(most, made.gain);
    if (made.gain > best.gain) best = made;
  }
  return most;
}

}  // namespace alula
