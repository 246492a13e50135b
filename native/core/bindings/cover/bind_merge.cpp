// Bindings of alula/cover/merge.hpp, alula/cover/fitting.hpp and alula/cover/lattice_hull.hpp.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include <algorithm>

#include "alula/cover/fitting.hpp"
#include "alula/cover/merge.hpp"
#include "alula/cover/refine.hpp"
#include "alula/cover/retighten.hpp"
#include "arrays.hpp"
#include "fields.hpp"
#include "python_control.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace alula {
namespace {

std::span<const Lattice> as_lattice(const InRows3<std::int32_t>& rows) {
  static_assert(sizeof(Lattice) == 3 * sizeof(std::int32_t));
  return {reinterpret_cast<const Lattice*>(rows.data()), rows.shape(0)};
}

using Result = nb::typed<nb::dict, nb::str, nb::any>;

struct Flat {
  std::vector<std::int32_t> vertex;
  std::vector<std::int64_t> vertex_start{0}, normal, offset, plane_start{0};

  explicit Flat(const std::vector<LatticePolytope>& hulls) {
    for (const LatticePolytope& hull : hulls) {
      for (const Lattice& v : hull.vertex) vertex.insert(vertex.end(), v.begin(), v.end());
      for (const LatticePlane& p : hull.plane) {
        normal.insert(normal.end(), p.normal.begin(), p.normal.end());
        offset.push_back(p.offset);
      }
      vertex_start.push_back(static_cast<std::int64_t>(vertex.size() / 3));
      plane_start.push_back(static_cast<std::int64_t>(offset.size()));
    }
  }

  void put(Result& result) {
    const std::size_t vertices = vertex.size() / 3, planes = offset.size(), starts = vertex_start.size();
    result["vertex"] = to_numpy(std::move(vertex), {vertices, 3});
    result["vertex_start"] = to_numpy(std::move(vertex_start), {starts});
    result["plane_normal"] = to_numpy(std::move(normal), {planes, 3});
    result["plane_offset"] = to_numpy(std::move(offset), {planes});
    result["plane_start"] = to_numpy(std::move(plane_start), {starts});
  }
};

Result lattice_hull(const InRows3<std::int32_t>& points) {
  std::vector<LatticePolytope> hulls;
  {
    const nb::gil_scoped_release release;
    HullBuilder builder;
    builder.build(as_lattice(points));
    hulls.push_back(builder.polytope());
  }
  Result result;
  Flat(hulls).put(result);
  return result;
}

// Options of a merge.
struct MergeArguments {
  int block = 1;
  bool is_paper = false;
  std::size_t max_hulls = 0, max_planes = 0, max_bytes = 0, facet_cap = 0, kdop = 0;
  bool is_fitted = false, is_final = true;
  double max_growth = 0;
};

}  // namespace

template <>
struct Fields<MergeArguments> {
  using Merge = MergeArguments;
  static constexpr Limits none{};
  static constexpr std::tuple all{
      Field{"block", &Merge::block, "edge of the blocks of the set cover [voxels]", none, true},
      Field{"is_paper", &Merge::is_paper, "merge by the rule of the paper", none, true},
      Field{"max_hulls", &Merge::max_hulls, "maximum number of hulls", none, true},
      Field{"max_planes", &Merge::max_planes, "maximum number of planes", none, true},
      Field{"max_bytes", &Merge::max_bytes, "maximum size of the onboard map", none, true},
      Field{"facet_cap", &Merge::facet_cap, "maximum number of facets of a hull", none, true},
      Field{"kdop", &Merge::kdop, "number of fixed directions", none, true},
      Field{"is_fitted", &Merge::is_fitted, "choose the number of hulls", none, true},
      Field{"is_final", &Merge::is_final, "refine the cover; else its sets will be merged further", none, true},
      Field{"max_growth", &Merge::max_growth, "limit of the growth in a merge", none, true}};
};

namespace {

// Fraction of the time, in Share::kWhole, after each part of merge_cover(). Clusters with a block of one are
// few different ones, larger ones are hulls to build one by one. By the rule of the paper nothing is tightened.
constexpr std::size_t kClustered = 150, kClusteredLarge = 550, kTight = 950;
constexpr std::size_t merged_share(std::size_t clustered, bool is_paper) {
  return is_paper ? kTight : clustered + (kTight - clustered) * 3 / 5;
}

Result merge_cover(const InRows3<std::int32_t>& voxels, const InVector<std::uint32_t>& member,
                   const InVector<std::int64_t>& member_start, unsigned jobs, EvaluationLog* journal,
                   nb::object progress, const nb::kwargs& others) {
  MergeArguments given;
  fields::assign(given, others, "merge_cover");
  PythonControl whole(std::move(progress));
  const std::size_t clustered = member_start.size() > 1 ? 0 : given.block > 1 ? kClusteredLarge : kClustered;
  const std::size_t merged = merged_share(clustered, given.is_paper);
  Share cluster(whole, 0, clustered), rest(whole, clustered, Share::kWhole), loop(whole, clustered, merged),
      tight(whole, merged, kTight), last(whole, kTight, Share::kWhole);
  Cover cover;
  UnionVolume volume{};
  std::vector<Measured> measured;
  std::vector<std::int32_t> member_index;
  {
    const nb::gil_scoped_release release;
    const Occupancy occupancy(as_lattice(voxels));
    VoxelSets sets;
    if (member_start.size() > 1) {
      sets.member.assign(member.data(), member.data() + member.size());
      sets.start.assign(member_start.data(), member_start.data() + member_start.size());
    } else {
      sets = subcover(occupancy, given.block, !given.is_paper, jobs, cluster);
    }
    const Form form{given.facet_cap, given.kdop};
    const MergeOptions options{given.is_paper ? MergeRule::kPaper : MergeRule::kIncrease, given.max_hulls,
                               Budget{given.max_planes, given.max_bytes, form}, given.max_growth};
    if (given.is_fitted) {
      cover = fit(occupancy, sets, options, jobs, rest, measured, journal);
    } else {
      cover = merge(occupancy, sets, options, jobs, loop, journal);
      if (cover.within_budget && !given.is_paper) {
        const Budget budget = form.is_outer() ? Budget{} : options.budget;
        InterruptOnly quiet(tight);
        if (given.is_final) refine(occupancy, cover, budget, refine_work(occupancy.size()), jobs, tight);
        retighten(occupancy, cover, budget, jobs, quiet);
      }
      if (cover.within_budget && form.is_outer())
        make_outer(occupancy, cover, options.budget, !given.is_paper, jobs, tight);
    }
    if (cover.within_budget) {
      sort_hulls(cover);
      if (!given.is_fitted) {
        volume = union_excess(occupancy, cover.hull, jobs, last);
        measured.push_back({cover.hull.size(), planes_of(cover.hull), volume});
      } else {
        const auto less = [](const Measured& a, const Measured& b) { return a.volume.excess < b.volume.excess; };
        volume = std::min_element(measured.begin(), measured.end(), less)->volume;
      }
      member_index.reserve(3 * cover.members.member.size());
      for (const std::uint32_t v : cover.members.member) {
        const Lattice& voxel = occupancy.voxels()[v];
        member_index.insert(member_index.end(), voxel.begin(), voxel.end());
      }
    }
  }
  whole.poll(Share::kWhole, Share::kWhole);
  Result result;
  Flat(cover.hull).put(result);
  const std::size_t members = member_index.size() / 3, merges = cover.history.size(), points = cover.curve.size();
  result["member_index"] = to_numpy(std::move(member_index), {members, 3});
  std::vector<std::int64_t> start(cover.members.start.begin(), cover.members.start.end());
  const std::size_t starts = start.size();
  result["member_start"] = to_numpy(std::move(start), {starts});
  std::vector<double> history, curve, measure;
  for (const Merge& m : cover.history)
    history.insert(history.end(), {static_cast<double>(m.left), static_cast<double>(m.right), m.weight});
  const Form written{given.facet_cap, given.kdop};
  for (const CurvePoint& c : cover.curve)
    curve.insert(curve.end(), {static_cast<double>(c.hulls), c.excess, static_cast<double>(c.planes),
                               static_cast<double>(written.bytes(c.hulls, c.planes))});
  for (const Measured& m : measured)
    measure.insert(measure.end(), {static_cast<double>(m.hulls), static_cast<double>(m.planes),
                                   static_cast<double>(written.bytes(m.hulls, m.planes)), m.volume.excess});
  result["history"] = to_numpy(std::move(history), {merges, 3});
  result["curve"] = to_numpy(std::move(curve), {points, 4});
  result["measured"] = to_numpy(std::move(measure), {measured.size(), 4});
  result["onboard_bytes"] = written.bytes(cover.hull.size(), planes_of(cover.hull));
  result["within_budget"] = cover.within_budget;
  result["union_excess"] = volume.excess;
  result["union_error"] = volume.error;
  result["lines"] = volume.lines;
  result["stride"] = volume.stride;
  return result;
}

double cover_excess(const InRows3<std::int32_t>& voxels, const InRows3<std::int32_t>& vertex,
                    const InVector<std::int64_t>& vertex_start, const InRows3<std::int64_t>& normal,
                    const InVector<std::int64_t>& offset, const InVector<std::int64_t>& plane_start, unsigned jobs,
                    nb::object progress) {
  if (vertex_start.size() == 0 || vertex_start.size() != plane_start.size() || normal.shape(0) != offset.size())
    throw std::invalid_argument("arrays of a cover do not fit together");
  PythonControl control(std::move(progress));
  const nb::gil_scoped_release release;
  std::vector<LatticePolytope> hulls(vertex_start.size() - 1);
  const std::span<const Lattice> vertices = as_lattice(vertex);
  for (std::size_t h = 0; h < hulls.size(); ++h) {
    const auto begin = [&](const auto& start) { return static_cast<std::size_t>(start.data()[h]); };
    const auto end = [&](const auto& start) { return static_cast<std::size_t>(start.data()[h + 1]); };
    if (begin(vertex_start) > end(vertex_start) || end(vertex_start) > vertices.size() ||
        begin(plane_start) > end(plane_start) || end(plane_start) > offset.size())
      throw std::invalid_argument("starts do not partition the rows");
    hulls[h].vertex.assign(vertices.begin() + begin(vertex_start), vertices.begin() + end(vertex_start));
    for (std::size_t i = begin(plane_start); i < end(plane_start); ++i) {
      const std::int64_t* n = normal.data() + 3 * i;
      hulls[h].plane.push_back({{n[0], n[1], n[2]}, offset.data()[i]});
    }
  }
  return union_excess(Occupancy(as_lattice(voxels)), hulls, jobs, control).excess;
}

}  // namespace
}  // namespace alula

void bind_merge(nb::module_& m) {
  using alula::EvaluationLog;
  nb::class_<EvaluationLog>(m, "MergeJournal",
                            "Log of the volumes that a merge has measured. The same merge run again reads them from\n"
                            "the journal and finishes sooner with the same result; another merge discards them.")
      .def(
          "__init__",
          [](EvaluationLog* that, const nb::bytes& data) {
            new (that) EvaluationLog(std::string_view(data.c_str(), data.size()));
          },
          "data"_a = nb::bytes("", 0), "Restore an earlier snapshot; ValueError when it is damaged.")
      .def(
          "snapshot",
          [](const EvaluationLog& that) {
            std::string data;
            {
              const nb::gil_scoped_release release;
              data = that.snapshot();
            }
            return nb::bytes(data.data(), data.size());
          },
          "All entries so far; may be called from any thread while merging.")
      .def("__len__", &EvaluationLog::size)
      .def_prop_ro("reused", &EvaluationLog::reused,
                   "Number of measurements read from the journal since it was created.");
  m.def("lattice_hull", &alula::lattice_hull, "points"_a,
        "Exact hull of integer points (N, 3): sorted vertices and primitive planes, as a cover of one hull.");
  m.def("cover_excess", &alula::cover_excess, "voxels"_a, "vertex"_a, "vertex_start"_a, "plane_normal"_a,
        "plane_offset"_a, "plane_start"_a, "jobs"_a, "progress"_a.none(),
        "Volume [voxels] of the union of polytopes outside sorted voxels (M, 3); the union contains every voxel.");
  m.def("merge_cover", &alula::merge_cover, "voxels"_a, "member"_a, "member_start"_a, nb::kw_only(), "jobs"_a,
        "journal"_a.none(), "progress"_a.none(), "others"_a,
        nb::sig(alula::fields::signature(
                    alula::MergeArguments{},
                    "voxels: NDArray[numpy.int32], member: NDArray[numpy.uint32], member_start: NDArray[numpy.int64]",
                    "merge_cover", "dict[str, typing.Any]",
                    "jobs: int, journal: MergeJournal | None, progress: object | None")
                    .c_str()),
        "Cover sorted voxels (M, 3) by merged hulls. `member` holds voxel numbers of the start sets; with an\n"
        "empty `member_start` the set cover by clusters is computed. A limit of 0 means no limit. `facet_cap` and "
        "`kdop`\n"
        "give outer polytopes; with `is_fitted` the number of hulls minimises the excess within the budget.\n"
        "Returns the arrays of an alula/cover, the curve (hulls, sum of W, planes, bytes), the measurements\n"
        "(hulls, planes, bytes, excess [voxels]), the excess of the union [voxels] and its grid.");
}
