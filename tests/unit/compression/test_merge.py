"""The stage `merge`: exact hulls, and covers that contain every voxel at every number of hulls."""

import time
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.merge import DEFAULT_HULLS, MergeConfig
from alula.stages.compression.merge import merge
from support.effort import examples
from support.scenes.covers import (
    SIZE_M,
    assert_covers,
    cover_of,
    excess,
    furniture,
    holds_voxel,
    planes,
    rows,
    voxels_of,
)

coordinate = st.one_of(st.integers(-3, 3), st.integers(-(2**19), 2**19))
point_sets = st.one_of(
    st.lists(st.tuples(*3 * [st.integers(0, 3)]), min_size=4, max_size=40),
    st.lists(st.tuples(*3 * [st.integers(-50, 50)]), min_size=4, max_size=40),
    st.lists(st.tuples(*3 * [coordinate]), min_size=4, max_size=20),
)
voxel_sets = st.sets(st.tuples(*3 * [st.integers(-4, 4)]), min_size=1, max_size=60)
SCENE = voxels_of(furniture())


@given(point_sets)
@settings(deadline=None, max_examples=examples(200))
def test_the_hull_of_points_is_exact(points):
    from scipy.spatial import ConvexHull

    array = np.array(points, np.int32)
    span = (array - array[0]).astype(object)
    assume(any(np.linalg.det(span[[i, j, k]].astype(float)) for i, j, k in triples(span)))
    hull = _core.lattice_hull(array)
    normal, offset = hull["plane_normal"].astype(object), hull["plane_offset"].astype(object)
    reach = array.astype(object) @ normal.T
    assert (reach <= offset).all()
    on = hull["vertex"].astype(object) @ normal.T == offset
    assert (on.sum(axis=0) >= 3).all()
    assert (on.sum(axis=1) >= 3).all()
    assert {tuple(v) for v in hull["vertex"].tolist()} <= set(points)
    assert (np.gcd.reduce(hull["plane_normal"], axis=1) == 1).all()
    assert len(on) - on.sum() // 2 + len(offset) == 2  # Euler: each vertex-facet pair is half an edge twice
    qhull = ConvexHull(array.astype(float))
    assert ConvexHull(hull["vertex"].astype(float)).volume == pytest.approx(qhull.volume, rel=1e-9)


def triples(span):
    """A few index triples that span the space when any do: greedily by rank."""
    chosen = [next((i for i, p in enumerate(span) if any(p)), 0)]
    for i in range(len(span)):
        if np.linalg.matrix_rank(span[[*chosen, i]].astype(float)) > len(chosen):
            chosen.append(i)
    if len(chosen) == 3:
        yield chosen


@pytest.mark.parametrize(
    "points",
    [[(0, 0, 0)] * 5, [(i, 0, 0) for i in range(6)], [(i, j, i + j) for i, j in product(range(3), repeat=2)]],
)
def test_points_without_volume_are_refused(points):
    with pytest.raises(ValueError, match="no volume"):
        _core.lattice_hull(np.array(points, np.int32))


def test_points_beyond_the_exact_range_are_refused():
    with pytest.raises(ValueError, match="exact range"):
        _core.lattice_hull(np.array([(0, 0, 0), (2**20 + 1, 0, 0), (0, 1, 0), (0, 0, 1)], np.int32))


def test_the_hull_is_exact_at_the_end_of_its_range():
    low, high = -(2**19), 2**19
    points = [p for p in product((low, high), repeat=3) if sum(p) != 3 * high]
    points += [(high - 1, high, high), (high, high - 1, high), (high, high, high - 1)]
    hull = _core.lattice_hull(np.array(points, np.int32))
    normals = dict(zip(map(tuple, hull["plane_normal"].tolist()), hull["plane_offset"].tolist(), strict=True))
    assert normals[1, 1, 1] == 3 * high - 1
    assert len(normals) == 7
    assert len(hull["vertex"]) == 10


@given(voxel_sets, st.sampled_from(["default", "paper"]), st.integers(1, 12), st.integers(0, 2))
@settings(deadline=None, max_examples=examples(80))
def test_every_voxel_is_covered(index, method, hulls, block):
    voxels = voxels_of(sorted(index))
    cover = cover_of(voxels, method=method, hulls=hulls, cluster_radius=block)
    assert len(cover["plane_start"]) - 1 <= hulls
    assert_covers(cover, voxels)
    assert_hulls_are_those_of_their_members(cover)


def assert_hulls_are_those_of_their_members(cover):
    from scipy.spatial import ConvexHull

    for hull in range(len(cover["plane_start"]) - 1):
        members = np.array(rows(cover, hull, "member_index"))
        corners = (members[:, None] + np.array(list(product((0, 1), repeat=3)))).reshape(-1, 3)
        qhull = ConvexHull(corners)
        assert {tuple(v) for v in corners[qhull.vertices]} >= set(rows(cover, hull, "vertex"))
        volume = ConvexHull(np.array(rows(cover, hull, "vertex"))).volume
        assert volume == pytest.approx(qhull.volume, rel=1e-9)


@pytest.mark.every(3)
@pytest.mark.parametrize("method", ["default", "paper"])
@pytest.mark.parametrize("hulls", [1, 2, 7, 40, 10000])
def test_a_scene_is_covered_at_every_number_of_hulls(method, hulls):
    cover = cover_of(SCENE, method=method, hulls=hulls)
    assert_covers(cover, SCENE)
    made = len(cover["plane_start"]) - 1
    assert made <= hulls
    assert cover.manifest.summary["hulls"] == made
    assert cover.manifest.summary["half_planes"] == len(cover["plane_offset"])


def test_one_voxel_is_a_cube():
    cover = cover_of(voxels_of([(-7, 0, 3)]))
    assert len(cover["vertex"]) == 8
    assert len(cover["plane_offset"]) == 6
    assert cover.manifest.conservativeness == 1
    assert len(cover["history"]) == 0


def test_a_box_of_voxels_becomes_one_exact_hull():
    voxels = voxels_of(list(product(range(5), range(-2, 7), range(3))))
    for method in ("default", "paper"):
        cover = cover_of(voxels, method=method, max_growth=1.0)
        assert len(cover["plane_start"]) == 2
        assert len(cover["plane_offset"]) == 6
        assert cover.manifest.conservativeness == 1


def test_conservativeness_is_the_volume_of_the_union():
    voxels = voxels_of(furniture(3, 16)[:-5])
    cover = cover_of(voxels, hulls=25)
    points = np.random.default_rng(0).uniform(-9, 9, (200_000, 3))
    inside = np.zeros(len(points), bool)
    for hull in range(len(cover["plane_start"]) - 1):
        normal, offset = zip(*planes(cover, hull), strict=True)
        inside |= (points @ np.array(normal).T <= np.array(offset)).all(axis=1)
    occupied = {tuple(v) for v in voxels["index"].tolist()}
    held = np.array([tuple(v) in occupied for v in np.floor(points).astype(int).tolist()])
    assert inside[held].all()
    sampled = (inside & ~held).sum() / len(points) * 18**3 / len(occupied)
    assert excess(cover) == pytest.approx(sampled, rel=0.05)


def test_far_parts_are_joined_only_when_they_must():
    parts = np.concatenate([np.array(list(product(range(3), repeat=3))) + 100 * k for k in range(6)])
    voxels = voxels_of(parts)
    for method in ("default", "paper"):
        apart = cover_of(voxels, method=method, hulls=6)
        assert apart.manifest.conservativeness == 1
        for hulls in (5, 2, 1):
            cover = cover_of(voxels, method=method, hulls=hulls)
            assert len(cover["plane_start"]) - 1 == hulls
            assert_covers(cover, voxels)


@pytest.mark.parametrize("place", [300, 400_000])
def test_a_far_voxel_changes_no_other_hull(place):
    """Columns are found in a dense grid, and in a hash table where a far voxel makes it too large."""
    near = furniture()[:-5]
    alone = cover_of(voxels_of(near), hulls=20)
    both = cover_of(voxels_of(np.vstack([near, 3 * [place]])), hulls=21)
    for name in ("plane_normal", "plane_offset", "vertex", "member_index", "member_start"):
        assert np.array_equal(both[name][: len(alone[name])], alone[name])
    assert both["vertex"][-1].tolist() == 3 * [place + 1]


def test_the_default_leaves_less_excess_than_the_paper():
    for hulls in (10, 30, 60):
        ours, theirs = (cover_of(SCENE, method=m, hulls=hulls) for m in ("default", "paper"))
        assert excess(ours) < excess(theirs)


class Interrupted(Exception):
    """Raised by a progress callback."""


@pytest.mark.parametrize("hulls", [10, 20, 40])
def test_the_default_encloses_at_most_85_percent_of_the_excess_of_the_paper(hulls):
    ours, theirs = (cover_of(SCENE, method=m, hulls=hulls) for m in ("default", "paper"))
    assert excess(ours) <= 0.85 * excess(theirs)


def test_the_voxels_of_two_hulls_are_divided_anew():
    """Two bars in a T: greedy merging of uneven clusters is repaired, so that two boxes remain."""
    bars = {*product(range(12), range(3), range(3)), *product(range(5, 8), range(3, 15), range(3))}
    cover = cover_of(voxels_of(sorted(bars)), hulls=2)
    assert excess(cover) == 0


def hills(side):
    """Uneven ground of `side` by `side` voxels."""
    x, y = np.mgrid[0:side, 0:side]
    z = np.rint(8 * np.sin(x / 17) + 6 * np.cos(y / 11) + 3 * np.sin(x / 5 + y / 7))
    z += np.random.default_rng(0).integers(0, 2, z.shape)
    return voxels_of(np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(int).tolist())


def test_merging_in_tiles_depends_neither_on_threads_nor_on_a_journal():
    ground = hills(66)
    config = MergeConfig(hulls=40, cluster_radius=0)  # each voxel is a cluster
    journal = _core.MergeJournal()
    kept = []

    def stop(done, total):
        if done > 0.4 * total:
            kept.append(journal.snapshot())
            raise Interrupted

    with pytest.raises(Interrupted):
        merge(config, ground, jobs=2, progress=stop, journal=journal)
    again = _core.MergeJournal(journal.snapshot())
    one, many = merge(config, ground, jobs=1), merge(config, ground, jobs=3, journal=again)
    assert one.manifest.summary["start_hulls"] > 4096  # of one tile
    assert again.reused >= len(_core.MergeJournal(kept[0])) > 1000
    assert_same(one, many)
    covered = []
    for hull in range(len(one["plane_start"]) - 1):
        member = np.array(rows(one, hull, "member_index"), np.int64)
        normal = np.array(rows(one, hull, "plane_normal"), np.int64)
        offset = np.array(rows(one, hull, "plane_offset"), np.int64).ravel()
        assert (member @ normal.T + np.maximum(normal, 0).sum(axis=1) <= offset).all()
        covered.append(member)
    assert np.array_equal(np.unique(np.vstack(covered), axis=0), ground["index"])
    history = one["history"][:, :2].astype(int)
    start = one.manifest.summary["start_hulls"]
    assert len(np.unique(history)) == history.size
    assert (history.max(axis=1) < start + np.arange(len(history))).all()


@pytest.mark.slow
def test_the_reported_fraction_is_within_a_factor_of_two_of_the_time():
    ground = hills(400)
    start, reports = time.process_time(), []

    def note(done, total):
        reports.append((time.process_time() - start, done / total if total > 1 else 0.0))

    merge(MergeConfig(hulls=300), ground, jobs=1, progress=note)
    whole = time.process_time() - start
    taken, fraction = (np.array(column) for column in zip(*reports, strict=True))
    assert (np.diff(fraction) >= 0).all()
    late = taken > 0.2 * whole
    ratio = fraction[late] / (taken[late] / whole)
    assert 0.5 <= ratio.min() <= ratio.max() <= 2


def test_the_paper_rule_takes_the_least_weight_first():
    """On a scene small enough to try all pairs: the first merge is one of least measured weight."""
    voxels = voxels_of([(0, 0, 0), (1, 1, 0), (2, 0, 0), (2, 0, 1), (4, 4, 4), (5, 4, 4)])
    cover = cover_of(voxels, method="paper", hulls=1, cluster_radius=0)
    history = cover["history"]
    assert len(history) == 5
    assert history[0, 2] == 0  # two face neighbours fill their hull
    assert history[1, 2] == 0
    assert (np.diff(history[:3, 2]) >= 0).all()
    ids = set(history[:, :2].astype(int).ravel())
    assert ids == set(range(10))


def test_results_do_not_depend_on_threads():
    one, many = (merge(MergeConfig(hulls=30), SCENE, jobs=jobs) for jobs in (1, 5))
    assert one.manifest == many.manifest
    for name in one.arrays:
        assert np.array_equal(one[name], many[name])


def test_merging_resumes_from_a_cover():
    for method in ("default", "paper"):
        first = cover_of(SCENE, method=method, hulls=50)
        second = cover_of(first, method=method, hulls=12)
        assert_covers(second, SCENE)
        assert len(second["plane_start"]) - 1 <= 12
        assert second.manifest.voxel_size_m == SIZE_M
        assert second.manifest.guarantee.statement.count("exactly") == 1
    same = cover_of(cover_of(SCENE, method="paper", hulls=40), method="paper", hulls=40)
    assert excess(same) == pytest.approx(excess(cover_of(SCENE, method="paper", hulls=40)))


def test_budgets_hold():
    for method in ("default", "paper"):
        cover = cover_of(SCENE, method=method, max_planes=150)
        assert 6 <= len(cover["plane_offset"]) <= 150
        assert_covers(cover, SCENE)
        grown = cover_of(SCENE, method=method, max_growth=1.3)
        assert 1 < grown.manifest.conservativeness <= 1.3
        tighter = cover_of(SCENE, method=method, max_growth=1.12)
        assert len(tighter["plane_start"]) > len(grown["plane_start"])


def test_growth_of_one_encloses_no_free_space():
    cover = cover_of(SCENE, max_growth=1.0, cluster_radius=0)
    assert cover.manifest.conservativeness == 1
    assert_covers(cover, SCENE)
    occupied = {tuple(v) for v in SCENE["index"].tolist()}
    rng = np.random.default_rng(0)
    for hull in range(len(cover["plane_start"]) - 1):
        vertex = np.array(rows(cover, hull, "vertex"), float)
        inside = rng.dirichlet(np.full(len(vertex), 0.3), 200) @ vertex
        assert {tuple(p) for p in np.floor(inside).astype(int).tolist()} <= occupied


@pytest.mark.parametrize(
    "config",
    [
        {"max_planes": 3},
        {"hulls": 2, "max_growth": 1.01},
        {"max_planes": 7, "facet_cap": "none"},
    ],
)
def test_contradicting_limits_are_infeasible(config):
    with pytest.raises(InfeasibleError):
        cover_of(SCENE, **config)


def test_hulls_that_fill_only_voxels_are_found_where_clusters_overlap():
    cover = cover_of(SCENE, max_growth=1.0)
    assert cover.manifest.conservativeness == 1
    assert_covers(cover, SCENE)


@pytest.mark.parametrize(
    "config",
    [
        {"hulls": 0},
        {"max_planes": 0},
        {"max_growth": 0.9},
        {"cluster_radius": -1},
        {"max_growth": float("nan")},
    ],
)
def test_meaningless_limits_are_refused(config):
    with pytest.raises(UsageError):
        MergeConfig(**config)


def test_the_default_limit_is_recorded():
    assert MergeConfig().hulls == DEFAULT_HULLS
    assert MergeConfig(max_planes=9).hulls is None


def test_nothing_and_too_much_are_refused():
    with pytest.raises(InputError, match="no occupied voxel"):
        cover_of(voxels_of(np.empty((0, 3))))
    with pytest.raises(InputError, match="crop"):
        cover_of(voxels_of([(0, 0, 0), (2**20, 0, 0)]))
    with pytest.raises(InputError, match="crop"):
        cover_of(voxels_of([(-(2**20), 0, 0), (2**20 - 1, 0, 0)]))


def test_the_far_corners_of_the_range_are_covered():
    voxels = voxels_of([(2**19 - 1, 5, 5), (-(2**19), 0, 0), (0, -(2**19), 7)])
    cover = cover_of(voxels, hulls=1)
    assert_covers(cover, voxels)
    assert holds_voxel(planes(cover, 0), (0, -(2**19), 7))


def test_the_curve_and_history_describe_the_run():
    cover = cover_of(SCENE, hulls=10)
    curve = cover.manifest.certificate["curve"]
    start = cover.manifest.summary["start_hulls"]
    assert curve["hulls"][0] == start
    assert curve["hulls"] == sorted(curve["hulls"], reverse=True)
    assert curve["hulls"][-1] == 10
    assert len(curve["excess_sum_voxels"]) == len(curve["half_planes"]) == len(curve["hulls"]) <= 60
    assert len(cover["history"]) == start - 10
    used = cover["history"][:, :2].astype(int).ravel()
    assert len(set(used)) == len(used)
    assert (cover["history"][:, :2].max(axis=1) < start + np.arange(len(cover["history"]))).all()


def test_an_interrupted_merge_resumes_from_its_journal():
    config = MergeConfig(hulls=12)
    whole = merge(config, SCENE, jobs=1)
    for moment in (0.3, 0.6, 0.9):
        journal = _core.MergeJournal()
        kept = []

        def stop(done, total, journal=journal, kept=kept, moment=moment):
            kept.append(journal.snapshot())
            if done >= moment * total:
                raise Interrupted

        with pytest.raises(Interrupted):
            merge(config, SCENE, jobs=1, progress=stop, journal=journal)
        assert len(journal) >= len(_core.MergeJournal(kept[-1])) > 0 or moment < 0.5
        again = _core.MergeJournal(journal.snapshot())
        resumed = merge(config, SCENE, jobs=3, journal=again)
        assert again.reused == len(journal)
        assert len(again) > 0
        assert_same(resumed, whole)


def test_a_full_journal_leaves_nothing_to_measure():
    for method in ("default", "paper"):
        journal = _core.MergeJournal()
        first = merge(MergeConfig(hulls=20, method=method), SCENE, jobs=2, journal=journal)
        count = len(journal)
        assert journal.reused == 0
        again = _core.MergeJournal(journal.snapshot())
        assert_same(merge(MergeConfig(hulls=20, method=method), SCENE, jobs=1, journal=again), first)
        assert len(again) == again.reused == count
        deeper = merge(MergeConfig(hulls=5, method=method), SCENE, jobs=1, journal=again)
        assert again.reused == 2 * count < len(again) + count
        assert_same(deeper, merge(MergeConfig(hulls=5, method=method), SCENE, jobs=1))


def test_the_journal_of_another_merge_is_not_used():
    journal = _core.MergeJournal()
    merge(MergeConfig(hulls=20, method="paper"), SCENE, jobs=1, journal=journal)
    assert_same(
        merge(MergeConfig(hulls=20), SCENE, jobs=1, journal=journal), merge(MergeConfig(hulls=20), SCENE)
    )
    assert journal.reused == 0


def test_a_damaged_journal_is_refused():
    journal = _core.MergeJournal()
    merge(MergeConfig(hulls=20), SCENE, jobs=1, journal=journal)
    data = journal.snapshot()
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 1
    for bad in (data[:-1], data[:20], b"x" * len(data), bytes(flipped)):
        with pytest.raises(ValueError, match="journal"):
            _core.MergeJournal(bad)


@pytest.mark.parametrize("limits", [{"hulls": 5}, {"max_growth": 1.2}, {"hulls": 5, "method": "paper"}])
def test_progress_never_goes_back_and_ends(limits):
    seen = []
    merge(MergeConfig(**limits), SCENE, jobs=2, progress=lambda done, total: seen.append(done / total))
    assert seen == sorted(seen)
    assert seen[-1] == 1
    assert all(0 <= share <= 1 for share in seen)


@given(voxel_sets, st.sampled_from(["default", "paper"]), st.integers(1, 12), st.integers(2, 7))
@settings(deadline=None, max_examples=examples(25))
def test_any_number_of_threads_gives_the_same_cover(index, method, hulls, jobs):
    voxels = voxels_of(sorted(index))
    config = MergeConfig(hulls=hulls, method=method)
    assert_same(merge(config, voxels, jobs=jobs), merge(config, voxels, jobs=1))


def assert_same(one, other):
    assert one.manifest == other.manifest
    for name in one.arrays:
        assert np.array_equal(one[name], other[name])
