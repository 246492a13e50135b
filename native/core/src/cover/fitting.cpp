#include "alula/cover/fitting.hpp"

#include <algorithm>
#include <array>
#include <limits>

#include "alula/base/parallel.hpp"
#include "alula/cover/facet_cap.hpp"
#include "alula/cover/refine.hpp"

namespace alula {

namespace {

constexpr std::size_t kNoLimit = std::numeric_limits<std::size_t>::max() / 2;

// Planes per hull to try, in tenths: the numbers of hulls differ by about a sixth.
constexpr std::array<std::size_t, 11> kTenths{63, 67, 72, 80, 90, 100, 115, 135, 160, 190, 240};
constexpr std::size_t kFirst = 3;
constexpr std::size_t kMergingShare = 700;  // of the time, in Share::kWhole, before covers are measured
constexpr std::size_t kTighteningShare = 150, kOutlinedShare = 700;  // of the time of a trial

void shape(const Occupancy& occupancy, std::vector<LatticePolytope>& hulls, const Budget& budget, unsigned jobs,
           Control& control) {
  const Form& form = budget.form;
  const std::size_t planes = std::min(budget.planes_for(hulls.size()), kNoLimit);
  if (form.kdop == 0) {
    cap_facets(occupancy, hulls, form.facet_cap > 0 ? form.facet_cap : kNoLimit, planes, jobs, control);
  } else {
    for (LatticePolytope& hull : hulls) hull = kdop(hull, form.kdop);
  }
}

// Shrinks outer polytopes to the voxels that no other one contains; afterwards `cover` has hulls again.
void tighten_outer(const Occupancy& occupancy, Cover& cover, const Form& form, unsigned jobs, Control& control) {
  InterruptOnly quiet(control);
  auto [holders, excess, held, order] = containment(occupancy, cover.hull, jobs, quiet);
  std::vector<std::uint32_t> inside;
  ExcessMeter meter(occupancy);
  HullBuilder builder;
  FacetRanker rank(occupancy);
  std::vector<Lattice> needed;
  for (const std::size_t h : order) {
    inside.swap(held[h]);
    needed.clear();
    for (const std::uint32_t v : inside)
      if (holders[v] == 1) needed.push_back(occupancy.voxels()[v]);
    LatticePolytope tight;
    if (!needed.empty()) {
      builder.build_voxels(needed);
      tight = form.kdop > 0 ? kdop(builder.polytope(), form.kdop)
                            : capped(rank, builder.polytope(), cover.hull[h].plane.size());
      if (meter(tight) > excess[h]) continue;
    }
    for (const std::uint32_t v : inside) --holders[v];
    if (!needed.empty()) {
      voxels_inside(occupancy, tight, inside);
      for (const std::uint32_t v : inside) ++holders[v];
    }
    cover.hull[h] = std::move(tight);
    quiet.poll(0, 1);
  }

  // Each voxel is in at least one polytope; the first takes it.
  std::vector<bool> is_taken(occupancy.size(), false);
  VoxelSets members;
  for (const LatticePolytope& polytope : cover.hull) {
    if (polytope.plane.empty()) continue;
    const std::size_t before = members.member.size();
    voxels_inside(occupancy, polytope, inside);
    for (const std::uint32_t v : inside) {
      if (!is_taken[v]) members.member.push_back(v);
      is_taken[v] = true;
    }
    if (members.member.size() > before) members.close();
  }
  cover.hull = hulls_of(occupancy, members, jobs, control);
  cover.members = std::move(members);
}

std::size_t hulls_of_tenths(const Budget& budget, std::size_t tenths, std::size_t most) {
  std::size_t hulls = most;
  if (budget.max_planes > 0) hulls = std::min(hulls, 10 * budget.max_planes / tenths);
  if (budget.max_bytes > 0) {
    const std::size_t room = budget.max_bytes - std::min(budget.max_bytes, kHeaderBytes);
    hulls = std::min(hulls, 10 * room / (10 * kHullBytes + kObliqueBytes * (tenths - 10 * kBoxPlanes)));
  }
  return std::max<std::size_t>(hulls, 1);
}

}  // namespace

std::size_t planes_of(const std::vector<LatticePolytope>& hulls) {
  std::size_t planes = 0;
  for (const LatticePolytope& hull : hulls) planes += hull.plane.size();
  return planes;
}

Cover replay(const Occupancy& occupancy, const VoxelSets& sets, const Cover& whole, std::size_t merges, unsigned jobs,
             Control& control) {
  Cover cover;
  cover.members = merged_sets(sets, std::span(whole.history).first(merges));
  cover.hull = hulls_of(occupancy, cover.members, jobs, control);
  return cover;
}

void make_outer(const Occupancy& occupancy, Cover& cover, const Budget& budget, bool tighten, unsigned jobs,
                Control& control) {
  shape(occupancy, cover.hull, budget, jobs, control);
  if (!tighten) return;
  tighten_outer(occupancy, cover, budget.form, jobs, control);
  shape(occupancy, cover.hull, budget, jobs, control);
}

Cover fit(const Occupancy& occupancy, const VoxelSets& sets, MergeOptions options, unsigned jobs, Control& control,
          std::vector<Measured>& measured, EvaluationLog* journal) {
  Share merging(control, 0, kMergingShare), all_trials(control, kMergingShare, Share::kWhole);
  const Budget budget = options.budget;
  const std::size_t most = options.max_hulls > 0 ? std::min(options.max_hulls, sets.size()) : sets.size();
  std::vector<std::size_t> trial;  // numbers of hulls, descending
  std::size_t first = 0;
  for (std::size_t i = 0; i < kTenths.size(); ++i) {
    const std::size_t hulls = hulls_of_tenths(budget, kTenths[i], most);
    if (budget.planes_for(hulls) < kBoxPlanes * hulls || (!trial.empty() && hulls == trial.back())) continue;
    trial.push_back(hulls);
    if (i <= kFirst) first = trial.size() - 1;
  }
  if (trial.empty()) {
    Cover none;
    none.curve.push_back({sets.size(), 0, 0});
    none.within_budget = false;
    return none;
  }
  options.max_hulls = trial.back(), options.finest_hulls = trial.front();
  options.budget = {};
  Cover whole = merge(occupancy, sets, options, jobs, merging, journal);
  while (!trial.empty() && sets.size() - trial.back() > whole.history.size()) trial.pop_back();
  whole.within_budget = !trial.empty();
  if (trial.empty()) return whole;
  first = std::min(first, trial.size() - 1);

  Cover best;
  std::size_t merges = 0;
  double smallest = std::numeric_limits<double>::infinity();
  std::size_t begun = 0;  // of the trials' time, in Share::kWhole; their number is unknown, so each takes a part
  const auto improves = [&](std::size_t i) {
    const std::size_t end = begun + (Share::kWhole - begun) * 2 / 5;
    Share trying(all_trials, begun, end), tightening(trying, 0, kTighteningShare),
        outlining(trying, kTighteningShare, kOutlinedShare), measuring(trying, kOutlinedShare, Share::kWhole);
    begun = end;
    Cover one = replay(occupancy, sets, whole, sets.size() - trial[i], jobs, trying);
    if (options.rule != MergeRule::kPaper) {
      InterruptOnly quiet(tightening);
      refine(occupancy, one, {}, refine_work(occupancy.size()), jobs, tightening);
      retighten(occupancy, one, {}, jobs, quiet);
    }
    make_outer(occupancy, one, budget, options.rule != MergeRule::kPaper, jobs, outlining);
    const UnionVolume volume = union_excess(occupancy, one.hull, jobs, measuring);
    measured.push_back({one.hull.size(), planes_of(one.hull), volume});
    if (!(volume.excess < smallest)) return false;
    smallest = volume.excess;
    best = std::move(one);
    merges = sets.size() - trial[i];
    return true;
  };
  improves(first);
  bool is_more = false;
  for (std::size_t i = first; i > 0 && improves(i - 1); --i) is_more = true;
  for (std::size_t i = first + 1; !is_more && i < trial.size() && improves(i); ++i) continue;
  whole.history.resize(merges);
  whole.hull = std::move(best.hull), whole.members = std::move(best.members);
  return whole;
}

}  // namespace alula
