#include "alula/cover/refine.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <span>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/cover/box_tree.hpp"

namespace alula {

namespace {

constexpr std::size_t kBatch = 1024;  // exchanges that are measured between looks at the limit

// How thoroughly cuts are searched.
struct Effort {
  std::int32_t most_cuts;  // per axis of a hull
  int lines;               // per axis, to measure W while cuts are found
  double margin;           // fraction of an extent from its ends where no cut is tried
  double least_gain;       // fraction of W, below which an exchange is not worth its time
  double most_cost;        // of joining two hulls over their sum of W, to divide their voxels anew
  double evaluations;      // fraction of the limit
};
constexpr std::array kEfforts{Effort{6, 12, 0.2, 0.02, 2, 0.9}, Effort{10, 16, 0.1, 0.005, 4, 0.1}};

using Numbers = std::vector<std::uint32_t>;
using Points = std::vector<Lattice>;

// The voxels of one hull, and the hulls of its parts below and above planes across the axes. The coordinates of the
// planes are multiples of a power of two, so that two hulls have planes in common.
struct Piece {
  Numbers voxels;  // ascending
  double weight = 0;
  std::size_t planes = 0;
  LatticeBox box{};
  bool is_new = true;    // changed in the round before
  bool is_fresh = true;  // changed in the round before, or not looked at with the present effort
  Points vertex;
  std::array<std::int32_t, 3> step{};               // zero: not prepared
  std::array<std::vector<Points>, 3> below, above;  // vertices, for the multiples of step inside the box

  // The vertices of one side of a plane, which is a multiple of step[axis] or outside the box.
  std::span<const Lattice> side(std::size_t axis, std::int32_t plane, bool is_below) const {
    if (plane >= box.upper[axis]) return is_below ? std::span<const Lattice>(vertex) : std::span<const Lattice>();
    if (plane <= box.lower[axis]) return is_below ? std::span<const Lattice>() : std::span<const Lattice>(vertex);
    const std::size_t at = static_cast<std::size_t>(plane / step[axis] - first(axis) / step[axis]);
    return (is_below ? below : above)[axis][at];
  }

  // The first multiple of the step above the lower end.
  std::int32_t first(std::size_t axis) const {
    const std::int32_t lower = box.lower[axis], size = step[axis];
    return (lower - ((lower % size) + size) % size) + size;
  }
};

// A plane across an axis.
struct Cut {
  double weight = std::numeric_limits<double>::infinity();  // sum of W of both sides
  std::size_t axis = 0;
  std::int32_t plane = 0;
};

// Measures hulls of voxels and finds cuts. One per thread.
class Divider {
 public:
  Divider(const Occupancy& occupancy, const Effort& effort)
      : occupancy_(occupancy), effort_(effort), excess_(occupancy), rough_(occupancy, effort.lines) {}

  std::size_t evaluations = 0;

  void measure(Piece& piece) {
    all_.clear();
    for (const std::uint32_t v : piece.voxels) all_.push_back(occupancy_.voxels()[v]);
    ++evaluations;
    hull_.build_voxels(all_);
    piece.weight = excess_(hull_);
    piece.box = hull_.box();
    HullBuilder::Outline outline = hull_.outline();
    piece.planes = outline.planes;
    piece.vertex = std::move(outline.vertex);
  }

  // Finds the parts of a measured piece, unless it has those of the same planes from a lower effort.
  void prepare(Piece& piece) {
    all_.clear();
    for (const std::uint32_t v : piece.voxels) all_.push_back(occupancy_.voxels()[v]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::int32_t lower = piece.box.lower[axis], upper = piece.box.upper[axis];
      std::int32_t step = 1;
      while ((upper - lower) / step > effort_.most_cuts) step *= 2;
      if (step == piece.step[axis]) continue;
      piece.step[axis] = step;
      std::vector<std::int32_t> ends;
      for (std::int32_t plane = piece.first(axis); plane < upper; plane += piece.step[axis]) ends.push_back(plane);
      for (const bool is_below : {true, false}) {
        std::vector<Points>& parts = (is_below ? piece.below : piece.above)[axis];
        parts.assign(ends.size(), {});
        Points known;
        for (std::size_t k = 0; k < ends.size(); ++k) {
          const std::size_t at = is_below ? k : ends.size() - 1 - k;
          const std::int32_t from = is_below ? (k == 0 ? lower : ends[at - 1]) : ends[at];
          const std::int32_t to = is_below ? ends[at] : (k == 0 ? upper : ends[at + 1]);
          side_.clear();
          for (const Lattice& v : all_)
            if (v[axis] >= from && v[axis] < to) side_.push_back(v);
          if (!side_.empty()) known = hull_.build_more(known, side_);
          parts[at] = known;
        }
      }
    }
  }

  // W of the hull of two sets of points, of which one may be empty.
  double weight(std::span<const Lattice> a, std::span<const Lattice> b, bool is_rough) {
    ++evaluations;
    side_.assign(a.begin(), a.end());
    side_.insert(side_.end(), b.begin(), b.end());
    hull_.build(side_);
    return is_rough ? rough_(hull_) : excess_(hull_);
  }

  // The best cut of two pieces, or of one that is given twice, with a weight below `limit`.
  Cut best(const Piece& a, const Piece& b, double limit) {
    Cut found;
    found.weight = limit;
    const std::span<const Lattice> none;
    const bool is_one = &a == &b;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::int32_t lower = std::min(a.box.lower[axis], b.box.lower[axis]);
      const std::int32_t upper = std::max(a.box.upper[axis], b.box.upper[axis]);
      const std::int32_t step = std::max(a.step[axis], b.step[axis]);
      const std::int32_t margin = static_cast<std::int32_t>(effort_.margin * (upper - lower));
      const auto sum = [&](std::int32_t plane) {
        const double below = weight(a.side(axis, plane, true), is_one ? none : b.side(axis, plane, true), true);
        if (below >= found.weight) return below;
        return below + weight(a.side(axis, plane, false), is_one ? none : b.side(axis, plane, false), true);
      };
      // From the middle outward; a side that is too heavy stays so.
      const std::int32_t middle = (lower + (upper - lower) / 2) / step * step;
      for (std::int32_t plane = middle; plane > lower + margin; plane -= step) try_plane(found, axis, plane, sum);
      for (std::int32_t plane = middle + step; plane < upper - margin; plane += step)
        try_plane(found, axis, plane, sum);
    }
    if (found.weight >= limit) found.weight = std::numeric_limits<double>::infinity();
    return found;
  }

  // Measures a cut finely and moves its plane by less than its step where that is better.
  void adjust(Cut& cut, const Numbers& voxels, std::int32_t step) {
    all_.clear();
    for (const std::uint32_t v : voxels) all_.push_back(occupancy_.voxels()[v]);
    cut.weight = std::numeric_limits<double>::infinity();
    const auto try_fine = [&](std::int32_t plane) {
      const double sum = fine(cut.axis, plane, cut.weight);
      if (sum < cut.weight) cut.weight = sum, cut.plane = plane;
    };
    try_fine(cut.plane);
    for (step /= 2; step > 0; step /= 2) {
      const std::int32_t middle = cut.plane;
      for (const std::int32_t plane : {middle - step, middle + step}) try_fine(plane);
    }
  }

 private:
  template <class Sum>
  static void try_plane(Cut& found, std::size_t axis, std::int32_t plane, Sum&& sum) {
    const double weight = sum(plane);
    if (weight < found.weight) found = {weight, axis, plane};
  }

  // Sum of W of the sides of a plane through the listed voxels, or something above `limit` if it is above.
  double fine(std::size_t axis, std::int32_t plane, double limit) {
    double sum = 0;
    for (const bool is_below : {true, false}) {
      side_.clear();
      for (const Lattice& v : all_)
        if ((v[axis] < plane) == is_below) side_.push_back(v);
      if (side_.empty()) return std::numeric_limits<double>::infinity();
      ++evaluations;
      hull_.build_voxels(side_);
      sum += excess_(hull_);
      if (sum > limit) break;
    }
    return sum;
  }

  const Occupancy& occupancy_;
  const Effort& effort_;
  HullBuilder hull_;
  ExcessMeter excess_, rough_;
  Points all_, side_;
};

// Two hulls, or one and itself, and what an exchange of them gives.
struct Exchange {
  std::uint32_t left, right;  // equal: one hull to divide
  Cut cut;
  double union_weight = std::numeric_limits<double>::infinity();
};

class Refiner {
 public:
  Refiner(const Occupancy& occupancy, const Cover& cover, const Budget& budget, std::size_t max_evaluations,
          unsigned jobs, Control& control)
      : occupancy_(occupancy),
        budget_(budget),
        most_(max_evaluations),
        left_(max_evaluations),
        jobs_(jobs),
        control_(control) {
    piece_.resize(cover.members.size());
    InterruptOnly quiet(control_);
    parallel_chunks(piece_.size(), 64, jobs_, quiet, [&](std::size_t begin, std::size_t end) {
      Divider divider(occupancy_, *effort_);
      for (std::size_t i = begin; i < end; ++i) {
        piece_[i].voxels.assign(cover.members[i].begin(), cover.members[i].end());
        divider.measure(piece_[i]);
      }
    });
    for (const Piece& piece : piece_) planes_ += piece.planes;
  }

  void run() {
    for (const Effort& effort : kEfforts) {
      effort_ = &effort;
      left_ = static_cast<std::size_t>(effort.evaluations * static_cast<double>(most_));
      for (Piece& piece : piece_) piece.is_fresh = true;
      while (round()) continue;
    }
  }

  VoxelSets members() const {
    VoxelSets sets;
    for (const Piece& piece : piece_) {
      sets.member.insert(sets.member.end(), piece.voxels.begin(), piece.voxels.end());
      sets.close();
    }
    return sets;
  }

 private:
  double sum(const Exchange& e) const {
    return e.left == e.right ? piece_[e.left].weight : piece_[e.left].weight + piece_[e.right].weight;
  }

  Numbers joined(std::uint32_t a, std::uint32_t b) const {
    if (a == b) return piece_[a].voxels;
    Numbers both(piece_[a].voxels.size() + piece_[b].voxels.size());
    std::merge(piece_[a].voxels.begin(), piece_[a].voxels.end(), piece_[b].voxels.begin(), piece_[b].voxels.end(),
               both.begin());
    return both;
  }

  // The exchanges of hulls that changed, those first whose union encloses least beyond what both enclose.
  std::vector<Exchange> candidates() {
    BoxTree tree;
    for (const std::uint32_t i : scattered(piece_.size())) tree.insert(i, piece_[i].box);
    std::vector<Exchange> list;
    std::vector<std::uint32_t> touching;
    for (std::uint32_t i = 0; i < piece_.size(); ++i) {
      tree.touching(piece_[i].box, touching);
      for (const std::uint32_t j : touching)
        if (j >= i && (piece_[i].is_fresh || piece_[j].is_fresh)) list.push_back({i, j, {}});
    }
    InterruptOnly quiet(control_);
    parallel_chunks(list.size(), 64, jobs_, quiet, [&](std::size_t from, std::size_t to) {
      Divider divider(occupancy_, *effort_);
      for (std::size_t i = from; i < to; ++i) {
        Exchange& e = list[i];
        if (e.left == e.right) continue;
        const Piece &a = piece_[e.left], &b = piece_[e.right];
        e.union_weight = a.is_new || b.is_new ? divider.weight(a.vertex, b.vertex, false)
                                              : union_weight_.at(std::pair(e.left, e.right));
      }
    });
    for (const Exchange& e : list)
      if (piece_[e.left].is_new || piece_[e.right].is_new)
        union_weight_.insert_or_assign(std::pair(e.left, e.right), e.union_weight);
    const auto cost = [&](const Exchange& e) { return e.left == e.right ? 0 : e.union_weight - sum(e); };
    std::sort(list.begin(), list.end(), [&](const Exchange& a, const Exchange& b) {
      const double x = cost(a), y = cost(b);
      if (x != y) return x < y;
      return a.left != b.left ? a.left < b.left : a.right < b.right;
    });
    for (Piece& piece : piece_) piece.is_new = piece.is_fresh = false;
    std::erase_if(list, [&](const Exchange& e) { return cost(e) > effort_->most_cost * sum(e); });
    return list;
  }

  // Finds the parts of the pieces of some exchanges.
  void prepare(std::span<const Exchange> some) {
    Numbers wanted;
    for (const Exchange& e : some) wanted.push_back(e.left), wanted.push_back(e.right);
    std::sort(wanted.begin(), wanted.end());
    wanted.erase(std::unique(wanted.begin(), wanted.end()), wanted.end());
    InterruptOnly quiet(control_);
    parallel_chunks(wanted.size(), 16, jobs_, quiet, [&](std::size_t from, std::size_t to) {
      Divider divider(occupancy_, *effort_);
      for (std::size_t i = from; i < to; ++i) divider.prepare(piece_[wanted[i]]);
    });
  }

  // Measures the exchanges in order until the limit of evaluations; drops the others.
  void measure(std::vector<Exchange>& list) {
    InterruptOnly quiet(control_);
    std::size_t done = 0;
    while (done < list.size() && left_ > 0) {
      const std::size_t end = std::min(list.size(), done + kBatch), chunks = (end - done + 15) / 16;
      prepare(std::span(list).subspan(done, end - done));
      std::vector<std::size_t> spent(chunks, 0);
      parallel_chunks(end - done, 16, jobs_, quiet, [&](std::size_t from, std::size_t to) {
        Divider divider(occupancy_, *effort_);
        for (std::size_t i = done + from; i < done + to; ++i) {
          Exchange& e = list[i];
          e.cut = divider.best(piece_[e.left], piece_[e.right], (1 - effort_->least_gain) * sum(e));
          if (e.cut.weight < sum(e)) {
            const auto& a = piece_[e.left].step;
            const auto& b = piece_[e.right].step;
            divider.adjust(e.cut, joined(e.left, e.right), std::max(a[e.cut.axis], b[e.cut.axis]));
            if (e.cut.weight > (1 - effort_->least_gain) * sum(e)) e.cut = {};
          }
        }
        spent[from / 16] = divider.evaluations;
      });
      for (const std::size_t s : spent) left_ -= std::min(left_, s);
      control_.poll(most_ - left_, most_);
      done = end;
    }
    list.resize(done);
  }

  // The two sides of a cut.
  std::array<Piece, 2> divided(const Exchange& e) {
    std::array<Piece, 2> side;
    for (const std::uint32_t v : joined(e.left, e.right))
      side[occupancy_.voxels()[v][e.cut.axis] < e.cut.plane ? 0 : 1].voxels.push_back(v);
    for (Piece& piece : side) divider_.measure(piece);
    return side;
  }

  bool is_within(std::size_t before, std::size_t after) const {
    return after <= before || budget_.holds(piece_.size(), planes_ - before + after);
  }

  bool round() {
    std::vector<Exchange> list = candidates();
    measure(list);
    std::vector<bool> is_used(piece_.size(), false);
    const auto set = [&](std::uint32_t i, Piece&& piece) {
      piece_[i] = std::move(piece);
      is_used[i] = true;
    };
    std::vector<Exchange> divided_anew, division, merger;
    for (const Exchange& e : list) {
      const bool has_cut = e.cut.weight < sum(e);
      if (has_cut) (e.left == e.right ? division : divided_anew).push_back(e);
      if (e.left != e.right) merger.push_back(e);
    }
    const auto by = [&](std::vector<Exchange>& some, auto&& value) {
      std::sort(some.begin(), some.end(), [&](const Exchange& a, const Exchange& b) {
        const double x = value(a), y = value(b);
        if (x != y) return x < y;
        return a.left != b.left ? a.left < b.left : a.right < b.right;
      });
    };
    const auto loss = [&](const Exchange& e) { return e.cut.weight - sum(e); };
    const auto cost = [&](const Exchange& e) { return e.union_weight - sum(e); };
    by(divided_anew, loss), by(division, loss), by(merger, cost);
    std::size_t made = 0;
    for (const Exchange& e : divided_anew) {
      if (is_used[e.left] || is_used[e.right]) continue;
      std::array<Piece, 2> side = divided(e);
      const std::size_t before = piece_[e.left].planes + piece_[e.right].planes,
                        after = side[0].planes + side[1].planes;
      if (!is_within(before, after)) continue;
      planes_ = planes_ - before + after;
      set(e.left, std::move(side[0])), set(e.right, std::move(side[1]));
      ++made;
    }
    std::size_t next = 0;
    for (const Exchange& m : merger) {
      if (is_used[m.left] || is_used[m.right]) continue;
      while (next < division.size() &&
             (is_used[division[next].left] || division[next].left == m.left || division[next].left == m.right))
        ++next;
      if (next == division.size() || cost(m) + loss(division[next]) >= 0) break;
      const Exchange& d = division[next];
      std::array<Piece, 2> side = divided(d);
      Piece whole;
      whole.voxels = joined(m.left, m.right);
      divider_.measure(whole);
      const std::size_t before = piece_[m.left].planes + piece_[m.right].planes + piece_[d.left].planes,
                        after = whole.planes + side[0].planes + side[1].planes;
      if (!is_within(before, after)) continue;
      planes_ = planes_ - before + after;
      set(m.left, std::move(whole)), set(m.right, std::move(side[0])), set(d.left, std::move(side[1]));
      ++made;
    }
    return made > 0 && left_ > 0;
  }

  const Occupancy& occupancy_;
  Budget budget_;
  std::size_t most_, left_, planes_ = 0;
  unsigned jobs_;
  Control& control_;
  std::vector<Piece> piece_;
  std::map<std::pair<std::uint32_t, std::uint32_t>, double> union_weight_;  // of pairs of pieces that are not new
  const Effort* effort_ = kEfforts.data();
  Divider divider_{occupancy_, *effort_};
};

}  // namespace

std::size_t refine_evaluations(std::size_t voxels) {
  constexpr std::size_t most = 100'000, many_voxels = 100'000;
  return voxels <= many_voxels ? most : most * many_voxels / voxels;
}

void refine(const Occupancy& occupancy, Cover& cover, const Budget& budget, std::size_t max_evaluations,
            unsigned jobs, Control& control) {
  if (cover.members.member.size() > occupancy.size()) return;
  Refiner refiner(occupancy, cover, budget, max_evaluations, jobs, control);
  refiner.run();
  cover.members = refiner.members();
  cover.hull = hulls_of(occupancy, cover.members, jobs, control);
}

}  // namespace alula
