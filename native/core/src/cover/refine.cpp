#include "alula/cover/refine.hpp"

#include <algorithm>
#include <array>
#include <iterator>
#include <map>
#include <span>
#include <utility>

#include "alula/base/parallel.hpp"
#include "alula/cover/box_tree.hpp"
#include "alula/cover/hull_moves.hpp"

namespace alula {

namespace {

constexpr std::size_t kBatch = 256;         // at most so many pieces or pairs between two looks at the limit
constexpr std::size_t kDueShare = 2;        // pairs take at most this part of the work that is left
constexpr std::size_t kPiecesPerRecut = 2;  // as many of the cheapest pairs are divided anew in a round
constexpr double kLeastRecut = 0.01;        // of the sum of W of two pieces
constexpr double kLeastTransfer = 0.007;    // of the mean W of a piece
constexpr int kPasses = 2;

using Numbers = std::vector<std::uint32_t>;

// Two pieces with touching boxes.
struct Pair {
  std::uint32_t left, right;
  double cost;  // what the sum of W increases by when they are joined, or an estimate
  bool operator<(const Pair& other) const {
    if (cost != other.cost) return cost < other.cost;
    return left != other.left ? left < other.left : right < other.right;
  }
};

class Refiner {
 public:
  Refiner(const Occupancy& occupancy, const Cover& cover, const Budget& budget, std::size_t work, unsigned jobs,
          Control& control)
      : occupancy_(occupancy),
        budget_(budget),
        limit_(work),
        jobs_(jobs),
        control_(control),
        piece_(cover.members.size()),
        cut_(piece_.size()),
        needs_cut_(piece_.size(), true),
        needs_pairs_(piece_.size(), true),
        needs_transfers_(piece_.size(), true) {
    each(piece_.size(), [&](HullMoves& moves, std::size_t i) {
      piece_[i].voxels.assign(cover.members[i].begin(), cover.members[i].end());
      moves.measure(piece_[i]);
    });
    spent_ = 0;
    for (const std::uint32_t i : scattered(piece_.size())) tree_.insert(i, piece_[i].box);
    for (const Piece& piece : piece_) planes_ += piece.planes;
  }

  void run() {
    while (recut()) continue;
    for (int pass = 0; pass < kPasses; ++pass) {
      while (exchange()) continue;
      while (transfer()) continue;
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
  bool is_spent() const { return spent_ >= limit_; }

  // Calls body(moves, i) for each i below `count`, in threads, and adds up the work.
  template <class Body>
  void each(std::size_t count, Body&& body) {
    constexpr std::size_t chunk = 4;
    std::vector<std::size_t> spent((count + chunk - 1) / chunk, 0);
    InterruptOnly quiet(control_);
    parallel_chunks(count, chunk, jobs_, quiet, [&](std::size_t begin, std::size_t end) {
      HullMoves moves(occupancy_);
      for (std::size_t i = begin; i < end; ++i) body(moves, i);
      spent[begin / chunk] = moves.work;
    });
    for (const std::size_t s : spent) spent_ += s;
  }

  // Looks at the marked pieces, the heaviest first, until the limit of the work, and removes their marks;
  // `expected` is about the work for one of them.
  template <class Expected, class Body>
  void each_heaviest(std::vector<bool>& mark, Expected&& expected, Body&& body) {
    Numbers due;
    for (std::uint32_t i = 0; i < piece_.size(); ++i)
      if (mark[i]) due.push_back(i);
    sort_by(due, [&](std::uint32_t i) { return -piece_[i].weight; });
    for (std::size_t done = 0; done < due.size() && !is_spent();) {
      std::size_t end = done;
      for (std::size_t soon = spent_; end < due.size() && end < done + kBatch && soon < limit_; ++end)
        soon += expected(piece_[due[end]]);
      each(end - done, [&](HullMoves& moves, std::size_t i) { body(moves, due[done + i]); });
      for (; done < end; ++done) mark[due[done]] = false;
      control_.poll(std::min(spent_, limit_), limit_);
    }
  }

  // Sorts numbers by a value, and equal ones among themselves.
  template <class Value>
  static void sort_by(Numbers& numbers, Value&& value) {
    std::sort(numbers.begin(), numbers.end(), [&](std::uint32_t a, std::uint32_t b) {
      const double x = value(a), y = value(b);
      return x != y ? x < y : a < b;
    });
  }

  double sum(const Pair& p) const { return piece_[p.left].weight + piece_[p.right].weight; }

  Numbers joined(std::uint32_t a, std::uint32_t b) const {
    Numbers both;
    std::merge(piece_[a].voxels.begin(), piece_[a].voxels.end(), piece_[b].voxels.begin(), piece_[b].voxels.end(),
               std::back_inserter(both));
    return both;
  }

  // The measured sides of a cut, which is adjusted before.
  std::array<Piece, 2> divided(Cut& cut, std::span<const std::uint32_t> voxels) {
    moves_.adjust(cut, voxels);
    std::array<Piece, 2> side;
    for (const std::uint32_t v : voxels) side[cut.is_below(occupancy_.voxels()[v]) ? 0 : 1].voxels.push_back(v);
    for (Piece& piece : side) moves_.measure(piece);
    return side;
  }

  // Replaces pieces where that decreases the sum of W by more than `least` and holds the budget; whether it did.
  template <std::size_t Count>
  bool replace(const std::array<std::uint32_t, Count>& old, std::array<Piece, Count>&& made, double least) {
    double weight = -least;
    std::size_t before = 0, after = 0;
    for (std::size_t i = 0; i < Count; ++i) {
      weight += piece_[old[i]].weight - made[i].weight;
      before += piece_[old[i]].planes, after += made[i].planes;
    }
    const bool is_within = after <= before || budget_.holds(piece_.size(), planes_ - before + after);
    if (weight <= 0 || !is_within) return false;
    planes_ = planes_ - before + after;
    for (std::size_t i = 0; i < Count; ++i) {
      const std::uint32_t p = old[i];
      tree_.remove(p);
      piece_[p] = std::move(made[i]);
      tree_.insert(p, piece_[p].box);
      cut_[p] = {};
      needs_cut_[p] = needs_pairs_[p] = needs_transfers_[p] = true;
    }
    return true;
  }

  // The pairs with a known cost, the cheapest first. Pairs of pieces that changed are measured, those first whose
  // common box adds least.
  std::vector<Pair> pairs() {
    std::vector<Pair> list, due;
    Numbers touching;
    for (std::uint32_t i = 0; i < piece_.size(); ++i) {
      tree_.touching(piece_[i].box, touching);
      for (const std::uint32_t j : touching) {
        if (j <= i) continue;
        LatticeBox both = piece_[i].box;
        both.add(piece_[j].box);
        const Pair pair{i, j, volume(both) - volume(piece_[i].box) - volume(piece_[j].box)};
        (needs_pairs_[i] || needs_pairs_[j] ? due : list).push_back(pair);
      }
    }
    for (const Pair& p : due) union_.erase({p.left, p.right});
    std::sort(due.begin(), due.end());
    due.resize(std::min(due.size(), (limit_ - spent_) / kDueShare));
    std::vector<double> weight(due.size());
    each(due.size(), [&](HullMoves& moves, std::size_t k) {
      weight[k] = moves.union_weight(piece_[due[k].left], piece_[due[k].right]);
    });
    for (std::size_t k = 0; k < due.size(); ++k) union_[{due[k].left, due[k].right}] = {weight[k]};
    needs_pairs_.assign(piece_.size(), false);
    list.insert(list.end(), due.begin(), due.end());
    std::erase_if(list, [&](const Pair& p) { return !union_.contains({p.left, p.right}); });
    for (Pair& p : list) p.cost = union_.at({p.left, p.right}).weight - sum(p);
    std::sort(list.begin(), list.end());
    return list;
  }

  // Divides the voxels of pairs anew; whether there was any.
  bool recut() {
    if (is_spent()) return false;
    std::vector<Pair> list = pairs();
    list.resize(std::min(list.size(), piece_.size() / kPiecesPerRecut));
    std::erase_if(list, [&](const Pair& p) { return std::exchange(union_.at({p.left, p.right}).is_recut, true); });
    std::vector<Cut> cut(list.size());
    for (std::size_t begin = 0; begin < list.size() && !is_spent(); begin += kBatch)
      each(std::min(kBatch, list.size() - begin), [&](HullMoves& moves, std::size_t i) {
        const Pair& p = list[begin + i];
        cut[begin + i] = moves.best_cut(joined(p.left, p.right), (1 - kLeastRecut) * sum(p));
      });
    Numbers order;
    std::vector<double> change(list.size());
    for (std::uint32_t k = 0; k < list.size(); ++k) {
      change[k] = cut[k].weight - sum(list[k]);
      if (cut[k].step > 0) order.push_back(k);
    }
    sort_by(order, [&](std::uint32_t k) { return change[k]; });
    std::vector<bool> is_used(piece_.size(), false);
    bool is_changed = false;
    for (const std::uint32_t k : order) {
      const auto [left, right, cost] = list[k];
      if (is_used[left] || is_used[right]) continue;
      is_used[left] = is_used[right] = true;
      if (replace(std::array{left, right}, divided(cut[k], joined(left, right)), 0)) is_changed = true;
    }
    return is_changed;
  }

  // Divides pieces and joins others; whether there was any.
  bool exchange() {
    if (is_spent()) return false;
    const std::vector<Pair> join = pairs();
    each_heaviest(
        needs_cut_, [](const Piece& piece) { return HullMoves::best_cut_work(piece); },
        [&](HullMoves& moves, std::uint32_t i) { cut_[i] = moves.best_cut(piece_[i].voxels, piece_[i].weight); });
    Numbers division;
    for (std::uint32_t i = 0; i < piece_.size(); ++i)
      if (cut_[i].step > 0) division.push_back(i);
    const auto change = [&](std::uint32_t i) { return cut_[i].weight - piece_[i].weight; };
    sort_by(division, change);
    std::vector<bool> is_used(piece_.size(), false);
    bool is_changed = false;
    std::size_t next = 0;
    for (const auto& [left, right, cost] : join) {
      if (is_used[left] || is_used[right]) continue;
      while (next < division.size() && (is_used[division[next]] || division[next] == left || division[next] == right))
        ++next;
      if (next == division.size() || cost + change(division[next]) >= 0) break;
      const std::uint32_t d = division[next];
      std::array<Piece, 2> side = divided(cut_[d], piece_[d].voxels);
      Piece whole;
      whole.voxels = joined(left, right);
      moves_.measure(whole);
      is_used[d] = true;
      if (!replace(std::array{left, right, d}, std::array{std::move(whole), std::move(side[0]), std::move(side[1])},
                   0))
        continue;
      is_used[left] = is_used[right] = is_changed = true;
    }
    return is_changed;
  }

  // Moves voxels at extreme points to other pieces; whether there was any.
  bool transfer() {
    if (is_spent()) return false;
    double total = 0;
    for (const Piece& piece : piece_) total += piece.weight;
    const double least = kLeastTransfer * total / static_cast<double>(piece_.size());
    std::vector<std::vector<Transfer>> found(piece_.size());
    each_heaviest(
        needs_transfers_, [](const Piece& piece) { return HullMoves::transfers_work(piece); },
        [&](HullMoves& moves, std::uint32_t i) { found[i] = moves.transfers(piece_, i, tree_, least); });
    std::vector<Transfer> list;
    for (const auto& some : found) list.insert(list.end(), some.begin(), some.end());
    std::stable_sort(list.begin(), list.end(), [](const Transfer& a, const Transfer& b) { return a.gain > b.gain; });
    bool is_changed = false;
    for (const Transfer& t : list) {
      Piece &from = piece_[t.from], &to = piece_[t.to];
      Piece less, more;
      Numbers given;
      for (const std::uint32_t v : from.voxels) (t.takes(occupancy_.voxels()[v]) ? given : less.voxels).push_back(v);
      if (given.empty() || less.voxels.empty()) continue;
      std::merge(to.voxels.begin(), to.voxels.end(), given.begin(), given.end(), std::back_inserter(more.voxels));
      moves_.measure(less);
      if (less.weight >= from.weight) continue;
      moves_.measure(more);
      less.tried = from.tried, more.tried = to.tried;
      if (replace(std::array{t.from, t.to}, std::array{std::move(less), std::move(more)}, least / 2))
        is_changed = true;
    }
    return is_changed;
  }

  // The union of a pair.
  struct Union {
    double weight;
    bool is_recut = false;  // its voxels were to be divided anew
  };

  const Occupancy& occupancy_;
  Budget budget_;
  std::size_t limit_, spent_ = 0, planes_ = 0;
  unsigned jobs_;
  Control& control_;
  std::vector<Piece> piece_;
  BoxTree tree_;
  std::vector<Cut> cut_;  // the best one of each piece, if known
  std::vector<bool> needs_cut_, needs_pairs_, needs_transfers_;
  std::map<std::pair<std::uint32_t, std::uint32_t>, Union> union_;
  HullMoves moves_{occupancy_};
};

}  // namespace

std::size_t refine_work(std::size_t voxels) {
  constexpr double most = 200'000, few_voxels = 100'000, voxels_per_unit = 16;
  const double many = std::max(1.0, static_cast<double>(voxels) / few_voxels);
  return static_cast<std::size_t>(std::max(most / (many * many), static_cast<double>(voxels) / voxels_per_unit));
}

void refine(const Occupancy& occupancy, Cover& cover, const Budget& budget, std::size_t work, unsigned jobs,
            Control& control) {
  if (cover.members.member.size() > occupancy.size()) return;
  Refiner refiner(occupancy, cover, budget, work, jobs, control);
  refiner.run();
  cover.members = refiner.members();
  cover.hull = hulls_of(occupancy, cover.members, jobs, control);
}

}  // namespace alula
