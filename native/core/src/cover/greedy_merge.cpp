#include "alula/cover/greedy_merge.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <queue>

#include "alula/base/parallel.hpp"
#include "alula/cover/box_tree.hpp"
#include "alula/cover/lattice_hull.hpp"

// The greedy merging, one algorithm from top to bottom: elements, their links and the queue of candidate pairs, and
// the `Merger`.
namespace alula {

namespace {

constexpr std::size_t kAhead = 8;        // maximum number of volumes measured at once, per thread
constexpr std::size_t kStartShare = 80;  // of the time, in Share::kWhole, before the first merge

constexpr double kUnmeasured = std::numeric_limits<double>::quiet_NaN();

struct Link {
  std::uint32_t other;
  double key;  // of the pair in the queue: the expected key, exact once evaluated
};

// A union that is built ahead of its merge.
struct Ready {
  std::uint32_t left, right;
  HullMesh mesh;
  std::size_t planes;
};

struct Element {
  HullMesh mesh;
  double weight = 0;
  std::size_t planes = 0;  // facets of the hull
  bool alive = true;
  std::vector<Link> links;
  std::vector<Link> waiting;     // links to lower numbers that were not in the queue yet, the best one last
  std::unique_ptr<Ready> ready;  // union of this element, as the lower number, and another
};

struct Candidate {
  double key;
  double weight;                                  // W of the union, kUnmeasured when it was not measured yet
  std::uint32_t left, right;                      // left < right
  bool evaluated;                                 // `key` is computed from `weight`
  bool is_nearest;                                // paired because `left` or `right` touches nothing
  bool operator<(const Candidate& other) const {  // the best is the top of a heap
    if (key != other.key) return key > other.key;
    if (left != other.left) return left > other.left;
    return right > other.right;
  }
};

struct Gap {
  std::int64_t squared_distance;
  std::uint32_t item, nearest;
  bool operator<(const Gap& other) const {
    if (squared_distance != other.squared_distance) return squared_distance > other.squared_distance;
    if (item != other.item) return item > other.item;
    return nearest > other.nearest;
  }
};

class Merger {
 public:
  Merger(const Occupancy& occupancy, const VoxelSets& sets, std::span<const std::uint32_t> numbers,
         const MergeOptions& options, unsigned jobs, Control& control, EvaluationLog* log, std::uint32_t log_base)
      : occupancy_(occupancy), options_(options), log_(log), log_base_(log_base), team_(jobs) {
    while (bench_.size() < team_.size()) bench_.emplace_back(occupancy);
    element_.reserve(2 * numbers.size());
    element_.resize(numbers.size());
    const auto build = [&](Bench& bench, std::size_t i) {
      bench.voxels.clear();
      for (const std::uint32_t v : sets[numbers[i]]) bench.voxels.push_back(occupancy.voxels()[v]);
      std::sort(bench.voxels.begin(), bench.voxels.end());
      bench.hull.build_voxels(bench.voxels);
      element_[i].weight = bench.excess(bench.hull);
      Ready made = made_ready(bench.hull, 0, 0);
      element_[i].mesh = std::move(made.mesh);
      element_[i].planes = made.planes;
    };
    if (team_.size() == 1) {
      for (std::size_t i = 0; i < numbers.size(); ++i) {
        build(bench_[0], i);
        control.poll(0, 1);
      }
    } else {
      parallel_chunks(numbers.size(), 256, jobs, control, [&](std::size_t begin, std::size_t end) {
        Bench bench(occupancy);
        for (std::size_t i = begin; i < end; ++i) build(bench, i);
      });
    }
    for (const Element& e : element_) total_weight_ += e.weight, planes_ += written(e.planes);
    hulls_ = element_.size();
  }

  MergeSteps run(Control& control) {
    MergeSteps result{{hulls_, total_weight_, planes_}, {}, true};
    if (!is_done()) link_all();
    const std::size_t start = hulls_, goal = std::max<std::size_t>(options_.max_hulls, 1);
    while (!is_done()) {
      const std::optional<Candidate> best = hulls_ > 1 ? next() : std::nullopt;
      if (!best || !may_grow(*best)) {
        result.within_budget = !is_limited();
        break;
      }
      const double before = total_weight_;
      const std::size_t planes = planes_;
      join(*best);
      result.step.push_back({{best->left, best->right, best->weight},
                             best->key,
                             total_weight_ - before,
                             static_cast<std::ptrdiff_t>(planes_) - static_cast<std::ptrdiff_t>(planes)});
      control.poll(start - hulls_, start > goal ? start - goal : start - hulls_);
    }
    return result;
  }

 private:
  std::size_t written(std::size_t planes) const { return options_.budget.form.planes(planes); }

  bool is_limited() const { return options_.max_hulls > 0 || options_.budget.is_limit(); }

  bool is_done() const {
    return is_limited() && (options_.max_hulls == 0 || hulls_ <= options_.max_hulls) &&
           options_.budget.holds(hulls_, planes_);
  }

  bool may_grow(const Candidate& best) const {
    if (options_.max_growth <= 0) return true;
    const double total = total_weight_ - element_[best.left].weight - element_[best.right].weight + best.weight;
    return 1 + total / static_cast<double>(occupancy_.size()) <= options_.max_growth;
  }

  // Hull builder and excess meter of one thread.
  struct Bench {
    HullBuilder hull;
    ExcessMeter excess;
    std::vector<Lattice> voxels;
    explicit Bench(const Occupancy& occupancy) : excess(occupancy) {}
  };

  void build(HullBuilder& hull, std::uint32_t left, std::uint32_t right) const {
    const bool swap = element_[left].mesh.facet.size() < element_[right].mesh.facet.size();
    const Element &base = element_[swap ? right : left], &more = element_[swap ? left : right];
    hull.build_union(base.mesh, more.mesh.point);
  }

  // Stores the hull that was built last.
  static Ready made_ready(HullBuilder& hull, std::uint32_t left, std::uint32_t right) {
    const HullBuilder::Outline outline = hull.outline();
    Ready ready{left, right, hull.mesh(), outline.planes};
    if (ready.mesh.point.size() > outline.vertex.size() + outline.vertex.size() / 4) {
      hull.build(outline.vertex);  // the mesh has too many points that are not extreme
      ready.mesh = hull.mesh();
    }
    return ready;
  }

  bool is_ready(std::uint32_t left) const {
    return element_[left].ready != nullptr && element_[element_[left].ready->right].alive;
  }

  // Number of candidates to measure at once; it falls with the fraction of recent measurements that were not used.
  std::size_t reach() {
    if (guessed_ > 1024) guessed_ /= 2, right_guesses_ /= 2;
    const std::size_t useful = kAhead * std::min(right_guesses_ + 8, guessed_ + 8) / (guessed_ + 8);
    return team_.size() * (2 * useful > kAhead ? 2 * useful - kAhead : 1);
  }

  // Measures a candidate and, on the other threads, those that will probably be next. A weight measured
  // ahead has no effect until its candidate is at the top, so results do not depend on the number of threads.
  void measure_ahead(Candidate& first) {
    ahead_.assign(1, first);
    passed_.clear();
    const std::size_t limit = team_.size() > 1 ? reach() : 1;
    while (ahead_.size() < limit && passed_.size() < limit && !queue_.empty()) {
      const Candidate c = queue_.top();
      const bool is_alive = element_[c.left].alive && element_[c.right].alive;
      if (!is_alive && c.is_nearest) break;
      queue_.pop();
      if (!is_alive) {
        drop(c);
        continue;
      }
      const bool is_known = !std::isnan(c.weight) || known(c).has_value();
      (is_known ? passed_ : ahead_).push_back(c);
    }
    // Unions with a better key than all unexamined candidates will merge soon.
    const double soon = queue_.empty() ? std::numeric_limits<double>::infinity() : queue_.top().key;
    const std::size_t guesses = ahead_.size() - 1;
    for (const Candidate& c : passed_)
      if (c.evaluated && !is_ready(c.left)) ahead_.push_back(c);
    ready_.clear();
    ready_.resize(ahead_.size());
    team_.run(ahead_.size(), [&](std::size_t worker, std::size_t i) {
      Bench& bench = bench_[worker];
      Candidate& c = ahead_[i];
      build(bench.hull, c.left, c.right);
      if (!c.evaluated) c.weight = bench.excess(bench.hull);
      if (c.evaluated || (key(c.left, c.right, c.weight) < soon && !is_ready(c.left)))
        ready_[i] = std::make_unique<Ready>(made_ready(bench.hull, c.left, c.right));
    });
    first = ahead_[0];
    guessed_ += guesses;
    for (std::size_t i = 1; i <= guesses; ++i) queue_.push(ahead_[i]);
    for (const Candidate& c : passed_) queue_.push(c);
    for (auto& ready : ready_)
      if (ready != nullptr && !is_ready(ready->left)) element_[ready->left].ready = std::move(ready);
  }

  // Computes W of a candidate's union and the key from it.
  void evaluate(Candidate& c) {
    const std::optional<double> logged = known(c);
    if (logged) {
      c.weight = *logged;
    } else if (std::isnan(c.weight)) {
      measure_ahead(c);
    } else {
      ++right_guesses_;
    }
    c.weight = std::max({c.weight, element_[c.left].weight, element_[c.right].weight});
    if (options_.rule == MergeRule::kPaper) c.weight = std::max(c.weight, c.key);  // so far the key was a lower bound
    c.key = key(c.left, c.right, c.weight);
    c.evaluated = true;
    if (logged) {
      log_->count_reuse(1);
    } else if (log_ != nullptr) {
      log_->add(std::array{EvaluationLog::Entry{log_base_ + c.left, log_base_ + c.right, c.weight}});
    }
  }

  std::optional<double> known(const Candidate& c) const {
    return log_ == nullptr ? std::nullopt : log_->find(log_base_ + c.left, log_base_ + c.right);
  }

  double key(std::uint32_t left, std::uint32_t right, double weight) const {
    if (options_.rule == MergeRule::kPaper) return weight;
    return weight - element_[left].weight - element_[right].weight;
  }

  // Expected key of two elements with these boxes: a lower bound, as they share free volume only where the boxes
  // overlap, and the expected growth.
  double expected_key(std::uint32_t a, std::uint32_t b, const LatticeBox& box_a, const LatticeBox& box_b) const {
    const double u = element_[a].weight, v = element_[b].weight;
    if (options_.rule == MergeRule::kPaper) return std::max(u, v);
    double common = 1;
    for (int i = 0; i < 3; ++i)
      common *= std::max(0, std::min(box_a.upper[i], box_b.upper[i]) - std::max(box_a.lower[i], box_b.lower[i]));
    LatticeBox both = box_a;
    both.add(box_b);
    const double growth = std::max(0.0, volume(both) - volume(box_a) - volume(box_b));
    return options_.expected_growth * growth - std::min({u, v, common});
  }

  void link(std::uint32_t a, std::uint32_t b, double key) {
    element_[a].links.push_back({b, key});
    element_[b].links.push_back({a, key});
  }

  // Links an element to elements with lower numbers. Only the best of these pairs goes to the queue; when it leaves
  // the queue, the next one enters.
  void link_lower(std::uint32_t made, std::vector<Link>& lower) {
    for (const Link& l : lower) link(made, l.other, l.key);
    std::sort(lower.begin(), lower.end(),
              [](const Link& a, const Link& b) { return a.key != b.key ? a.key > b.key : a.other > b.other; });
    element_[made].waiting = lower;
    put_next(made);
  }

  void put_next(std::uint32_t right) {
    std::vector<Link>& waiting = element_[right].waiting;
    while (!waiting.empty()) {
      const Link best = waiting.back();
      waiting.pop_back();
      if (!element_[best.other].alive) continue;
      queue_.push({best.key, kUnmeasured, best.other, right, false, false});
      return;
    }
  }

  // Drops a candidate that can no longer merge.
  void drop(const Candidate& c) {
    if (!c.evaluated && !c.is_nearest) put_next(c.right);
  }

  void set_key(std::uint32_t a, std::uint32_t b, double key) {
    for (Link& link : element_[a].links)
      if (link.other == b) link.key = key;
  }

  void link_all() {
    for (const std::uint32_t i : scattered(element_.size())) tree_.insert(i, bounds(element_[i].mesh.point));
    std::vector<Link> lower;
    for (std::uint32_t i = 0; i < element_.size(); ++i) {
      tree_.touching(tree_.box(i), touching_);
      lower.clear();
      for (const std::uint32_t j : touching_)
        if (j < i) lower.push_back({j, expected_key(i, j, tree_.box(i), tree_.box(j))});
      link_lower(i, lower);
      if (touching_.size() == 1) pair_with_nearest(i);
    }
  }

  // Pairs an element that touches no other with the nearest one.
  void pair_with_nearest(std::uint32_t i) {
    const BoxTree::Neighbour near = tree_.nearest(i);
    if (near.item == BoxTree::kNone) return;
    if (options_.rule == MergeRule::kPaper) {
      gaps_.push({near.squared_distance, i, near.item});
    } else if (!is_linked(i, near.item)) {
      const double key = expected_key(i, near.item, tree_.box(i), tree_.box(near.item));
      link(i, near.item, key);
      queue_.push({key, kUnmeasured, std::min(i, near.item), std::max(i, near.item), false, true});
    }
  }

  bool is_linked(std::uint32_t a, std::uint32_t b) const {
    for (const Link& link : element_[a].links)
      if (link.other == b) return true;
    return false;
  }

  // The best pair, evaluated; nothing when one element remains.
  std::optional<Candidate> next() {
    while (!queue_.empty()) {
      Candidate top = queue_.top();
      queue_.pop();
      const bool left = element_[top.left].alive, right = element_[top.right].alive;
      if (!left || !right) {
        drop(top);
        if (top.is_nearest && left) repair(top.left);
        if (top.is_nearest && right) repair(top.right);
        continue;
      }
      if (top.evaluated) return top;
      if (!top.is_nearest) put_next(top.right);
      evaluate(top);
      set_key(top.left, top.right, top.key), set_key(top.right, top.left, top.key);
      queue_.push(top);
    }
    while (!gaps_.empty()) {
      const Gap gap = gaps_.top();
      gaps_.pop();
      if (!element_[gap.item].alive) continue;
      if (!element_[gap.nearest].alive) {
        pair_with_nearest(gap.item);
        continue;
      }
      const auto [left, right] = std::minmax(gap.item, gap.nearest);
      Candidate pair{0, kUnmeasured, left, right, false, false};
      evaluate(pair);
      return pair;
    }
    return std::nullopt;
  }

  // Finds a new nearest element after the old one was merged, unless another element touches this one now.
  void repair(std::uint32_t i) {
    tree_.touching(tree_.box(i), touching_);
    if (touching_.size() == 1) pair_with_nearest(i);
  }

  // Replaces two elements by their union.
  void join(const Candidate& pair) {
    const std::uint32_t made = static_cast<std::uint32_t>(element_.size());
    std::unique_ptr<Ready> ready = std::move(element_[pair.left].ready);
    if (ready == nullptr || ready->right != pair.right) {
      build(bench_[0].hull, pair.left, pair.right);
      ready = std::make_unique<Ready>(made_ready(bench_[0].hull, pair.left, pair.right));
    }
    Element merged;
    merged.mesh = std::move(ready->mesh);
    merged.planes = ready->planes;
    merged.weight = pair.weight;
    merged_links_.clear();
    for (const std::uint32_t old : {pair.left, pair.right}) {
      tree_.remove(old);
      for (const Link& link : element_[old].links)
        if (link.other != pair.left && link.other != pair.right && element_[link.other].alive)
          merged_links_.push_back(link);
      total_weight_ -= element_[old].weight;
      planes_ -= written(element_[old].planes);
      element_[old] = Element{};
      element_[old].alive = false;
    }
    total_weight_ += pair.weight;
    planes_ += written(merged.planes);
    --hulls_;
    const LatticeBox box = bounds(merged.mesh.point);
    const std::size_t inherited = merged_links_.size();
    for (std::size_t i = 0; i < inherited; ++i) {
      const std::uint32_t other = merged_links_[i].other;
      std::erase_if(element_[other].links,
                    [&](const Link& x) { return x.other == pair.left || x.other == pair.right; });
    }
    // By the rule of the paper all elements that touch the union are its neighbours, else those of its parts.
    std::erase_if(merged_links_, [&](const Link& link) { return !tree_.box(link.other).touches(box); });
    touching_.clear();
    if (options_.rule == MergeRule::kPaper || merged_links_.empty()) {
      tree_.touching(box, touching_);
    } else {
      for (const Link& link : merged_links_) touching_.push_back(link.other);
    }
    tree_.insert(made, box);
    element_.push_back(std::move(merged));
    for (const std::uint32_t other : touching_)
      merged_links_.push_back({other, expected_key(made, other, box, tree_.box(other))});
    std::sort(merged_links_.begin(), merged_links_.end(),
              [](const Link& a, const Link& b) { return a.other != b.other ? a.other < b.other : a.key > b.key; });
    merged_links_.erase(std::unique(merged_links_.begin(), merged_links_.end(),
                                    [](const Link& a, const Link& b) { return a.other == b.other; }),
                        merged_links_.end());
    link_lower(made, merged_links_);
    if (merged_links_.empty()) pair_with_nearest(made);
  }

  const Occupancy& occupancy_;
  MergeOptions options_;
  std::vector<Element> element_;
  double total_weight_ = 0;
  std::size_t planes_ = 0, hulls_ = 0, guessed_ = 0, right_guesses_ = 0;
  std::priority_queue<Candidate> queue_;
  std::priority_queue<Gap> gaps_;
  BoxTree tree_;
  EvaluationLog* log_;
  std::uint32_t log_base_;
  WorkerTeam team_;
  std::vector<Bench> bench_;  // one per thread of the team
  std::vector<Candidate> ahead_, passed_;
  std::vector<std::unique_ptr<Ready>> ready_;  // unions of the candidates in ahead_
  std::vector<std::uint32_t> touching_;
  std::vector<Link> merged_links_;
};

}  // namespace

MergeSteps greedy_merge(const Occupancy& occupancy, const VoxelSets& sets, std::span<const std::uint32_t> numbers,
                        const MergeOptions& options, unsigned jobs, Control& control, EvaluationLog* log,
                        std::uint32_t log_base) {
  Share start(control, 0, kStartShare), loop(control, kStartShare, Share::kWhole);
  return Merger(occupancy, sets, numbers, options, jobs, start, log, log_base).run(loop);
}

}  // namespace alula
