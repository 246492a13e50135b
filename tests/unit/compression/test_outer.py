"""Outer polytopes contain their hulls exactly and keep to budgets; readers use their true corners."""

import dataclasses
from fractions import Fraction
from itertools import combinations, product
from math import gcd

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import ArtifactError, InfeasibleError, UsageError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.hulls import Hulls, outer_solids
from alula.stages.compression.merge import merge
from alula.stages.compression.verify import verify
from support.effort import examples
from support.scenes.covers import assert_covers, cover_of, excess, furniture, planes, rows, voxels_of

SCENE = voxels_of(furniture(2, 22))
AXES = {tuple(s * int(i == j) for j in range(3)) for i in range(3) for s in (-1, 1)}
CORNERS = set(product((-1, 1), repeat=3))
EDGES = {n for n in product((-1, 0, 1), repeat=3) if sum(map(abs, n)) == 2}
FAMILY = {6: AXES, 14: AXES | CORNERS, 18: AXES | EDGES, 26: AXES | CORNERS | EDGES}

voxel_sets = st.sets(st.tuples(*[st.integers(-5, 5)] * 3), min_size=1, max_size=50)
shapes = st.one_of(
    st.sampled_from([{"kdop": k} for k in FAMILY]),
    st.builds(lambda cap: {"facet_cap": cap}, st.integers(6, 14)),
    st.builds(lambda p: {"max_planes": p, "hulls": None}, st.integers(40, 200)),
)


def corner_set(member):
    return {tuple(np.add(voxel, c).tolist()) for voxel in member for c in product((0, 1), repeat=3)}


def assert_outer(cover):
    """Each polytope has its box, and all planes support the vertices and the members exactly."""
    assert cover.manifest.polytopes == "outer"
    assert cover.manifest.requires == ["outer-polytopes"]
    for hull in range(len(cover["plane_start"]) - 1):
        half_spaces = planes(cover, hull)
        vertices, members = rows(cover, hull, "vertex"), corner_set(rows(cover, hull, "member_index"))
        assert {normal for normal, _ in half_spaces} >= AXES
        assert len({normal for normal, _ in half_spaces}) == len(half_spaces)
        assert set(vertices) <= members
        for normal, offset in half_spaces:
            assert gcd(*normal) == 1
            assert max(map(abs, normal)) < 2**15
            for points in (vertices, members):
                assert max(sum(n * x for n, x in zip(normal, p, strict=True)) for p in points) == offset


@given(voxel_sets, shapes, st.sampled_from(["default", "paper"]), st.integers(1, 8))
@settings(deadline=None, max_examples=examples(80))
def test_outer_polytopes_contain_their_hulls(index, shape, method, hulls):
    if "max_planes" in shape:
        method = "default"
    voxels = voxels_of(sorted(index))
    cover = cover_of(voxels, method=method, **({"hulls": hulls} | shape))
    assert_covers(cover, voxels)
    assert_outer(cover)
    assert verify(cover, voxels=voxels).covered
    count = np.diff(cover["plane_start"])
    if "facet_cap" in shape:
        assert count.max() <= shape["facet_cap"]
    if "max_planes" in shape:
        assert count.sum() <= shape["max_planes"]
    if "kdop" in shape:
        for hull in range(len(count)):
            assert {normal for normal, _ in planes(cover, hull)} == FAMILY[shape["kdop"]]


def onboard_bytes(cover, per_plane=5):
    count = np.diff(cover["plane_start"])
    return 64 + 14 * len(count) + per_plane * int((count - 6).sum())


@pytest.mark.every(7)
@pytest.mark.parametrize(
    ("method", "cap"),
    [
        ("default", "auto"),
        *((method, cap) for method in ("default", "paper") for cap in ("none", 6, 8, 13)),
    ],
)
@pytest.mark.parametrize(
    "limit", [{"max_planes": 120}, {"max_planes": 700}, {"max_bytes": 900}, {"max_bytes": 4000}]
)
def test_budgets_count_what_is_written(method, cap, limit):
    cover = cover_of(SCENE, method=method, facet_cap=cap, **limit)
    assert_covers(cover, SCENE)
    summary = cover.manifest.summary
    assert summary["half_planes"] == len(cover["plane_offset"])
    assert summary["onboard_bytes"] == onboard_bytes(cover)
    assert summary["half_planes"] <= limit.get("max_planes", 10**9)
    assert summary["onboard_bytes"] <= limit.get("max_bytes", 10**9)
    assert verify(cover, voxels=SCENE).covered


@pytest.mark.every(2)
@pytest.mark.parametrize("k", FAMILY)
def test_budgets_of_kdops_count_their_planes(k):
    cover = cover_of(SCENE, kdop=k, max_planes=400)
    assert len(cover["plane_offset"]) == k * (len(cover["plane_start"]) - 1) <= 400
    small = cover_of(SCENE, kdop=k, max_bytes=1000)
    assert small.manifest.summary["onboard_bytes"] == onboard_bytes(small, 2) <= 1000
    assert_covers(small, SCENE)


@pytest.mark.parametrize("limit", [{"max_planes": 200}, {"max_planes": 900}, {"max_bytes": 1500}])
def test_sharing_planes_out_beats_whole_hulls_and_even_caps(limit):
    shared = cover_of(SCENE, **limit)
    assert shared.manifest.parameters["facet_cap"] == "auto"
    for cap in ("none", 8, 12):
        assert excess(shared) <= excess(cover_of(SCENE, facet_cap=cap, **limit))
    assert excess(shared) < 0.6 * excess(cover_of(SCENE, method="paper", **limit))


def test_more_planes_leave_less_excess():
    growth = [excess(cover_of(SCENE, hulls=12, facet_cap=cap)) for cap in (6, 8, 12, 40)]
    assert growth == sorted(growth, reverse=True)
    assert growth[0] > growth[-1]


def test_a_hull_within_the_cap_stays_as_it_is():
    plain, capped = (
        cover_of(SCENE, hulls=20, method="paper"),
        cover_of(SCENE, hulls=20, method="paper", facet_cap=200),
    )
    for name in plain.arrays:
        assert np.array_equal(plain[name], capped[name])
    solid = outer_solids(capped)
    assert solid["is_lattice"].all()
    assert np.array_equal(solid["point_start"], plain["vertex_start"])
    for hull in range(20):
        corners = solid["point"][slice(*solid["point_start"][hull : hull + 2])]
        assert sorted(map(tuple, corners.tolist())) == rows(plain, hull, "vertex")


def test_long_normals_are_shortened():
    """A hull of four far voxels has normals in the millions, which an outer polytope must not."""
    voxels = voxels_of([(0, 0, 0), (1 << 19, 3, 1), (5, (1 << 19) - 7, 2), (11, 13, (1 << 18) + 1)])
    plain = cover_of(voxels, hulls=1, cluster_radius=0)
    assert np.abs(plain["plane_normal"]).max() > 2**15
    for shape in ({"facet_cap": 400}, {"facet_cap": 9}, {"kdop": 26}):
        cover = cover_of(voxels, hulls=1, cluster_radius=0, **shape)
        assert_outer(cover)
        assert verify(cover, voxels=voxels).covered
        assert len(Hulls.from_cover(cover).vertices_world) >= 8


def exact_corners(half_spaces):
    """Corners of a polytope by Cramer's rule over all triples of planes, in fractions."""
    found = set()
    for (a, p), (b, q), (c, r) in combinations(half_spaces, 3):
        cross = lambda u, v: (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])  # noqa: E731
        bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
        det = sum(x * y for x, y in zip(a, bc, strict=True))
        if det == 0:
            continue
        corner = tuple(Fraction(p * bc[i] + q * ca[i] + r * ab[i], det) for i in range(3))
        if all(
            sum(n * x for n, x in zip(normal, corner, strict=True)) <= offset
            for normal, offset in half_spaces
        ):
            found.add(corner)
    return found


@given(
    st.lists(st.tuples(*[st.integers(-6, 6)] * 3), min_size=4, max_size=12),
    st.lists(
        st.tuples(*[st.one_of(st.integers(-3, 3), st.integers(-(2**15) + 1, 2**15 - 1))] * 3), max_size=5
    ),
    st.sampled_from([0, 2**19, -(2**20) + 6]),
)
@settings(deadline=None, max_examples=examples(60))
def test_corners_are_those_of_fractions(points, directions, shift):
    points = np.array(points, object) + shift
    half_spaces = {}
    for normal in [*AXES, *directions]:
        divisor = gcd(*normal)
        if divisor:
            normal = tuple(n // divisor for n in normal)
            half_spaces[normal] = max(int(p @ np.array(normal, object)) for p in points)
    half_spaces = sorted(half_spaces.items())
    normal, offset = (np.array(x, np.int64) for x in zip(*half_spaces, strict=True))
    if (np.ptp(points.astype(np.int64), axis=0) == 0).any():
        with pytest.raises(ValueError, match="hull 0"):
            _core.outer_solids(normal, offset, np.array([0, len(offset)]), 1)
        return
    solid = _core.outer_solids(normal, offset, np.array([0, len(offset)]), 1)
    exact = exact_corners(half_spaces)
    expected = np.array(sorted([[float(x) for x in corner] for corner in exact]))
    scale = np.abs(expected).max()
    apart = np.abs(solid["point"][:, None] - expected[None]).max(axis=2)
    assert len(expected) == len(solid["point"])
    assert (apart.min(axis=0) <= 4 * np.finfo(float).eps * scale).all()
    assert (apart.min(axis=1) <= 4 * np.finfo(float).eps * scale).all()
    assert bool(solid["is_lattice"][0]) == all(x.denominator == 1 for corner in exact for x in corner)
    edges = {(int(t[i]), int(t[(i + 1) % 3])) for t in solid["triangle"] for i in range(3)}
    assert len(edges) == 3 * len(solid["triangle"])
    assert edges == {(b, a) for a, b in edges}
    assert len(solid["triangle"]) == 2 * len(expected) - 4


def test_corners_agree_with_qhull_on_a_cover():
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    cover = cover_of(SCENE, max_planes=500)
    solid, hulls = outer_solids(cover), Hulls.from_cover(cover)
    for hull in range(len(hulls)):
        normal, offset = (np.array(x, float) for x in zip(*planes(cover, hull), strict=True))
        inside = np.array(rows(cover, hull, "vertex"), float).mean(axis=0)
        qhull = ConvexHull(HalfspaceIntersection(np.column_stack([normal, -offset]), inside).intersections)
        part = solid["triangle"][slice(*solid["triangle_start"][hull : hull + 2])]
        p = solid["point"][part]
        volume = np.einsum("ij,ij->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6
        assert volume == pytest.approx(qhull.volume, rel=1e-9)
        corners = hulls.vertices_world[slice(*hulls.vertex_start[hull : hull + 2])]
        rows_of = slice(*hulls.plane_start[hull : hull + 2])
        assert (corners @ hulls.normal_world[rows_of].T <= hulls.offset_m[rows_of] + 1e-12).all()


def test_conservativeness_is_of_the_outer_polytopes():
    voxels = voxels_of(furniture(3, 16)[:-5])
    cover = cover_of(voxels, hulls=20, facet_cap=7)
    points = np.random.default_rng(0).uniform(-9, 9, (200_000, 3))
    inside = np.zeros(len(points), bool)
    for hull in range(len(cover["plane_start"]) - 1):
        normal, offset = zip(*planes(cover, hull), strict=True)
        inside |= (points @ np.array(normal).T <= np.array(offset)).all(axis=1)
    occupied = {tuple(v) for v in voxels["index"].tolist()}
    held = np.array([tuple(v) in occupied for v in np.floor(points).astype(int).tolist()])
    sampled = (inside & ~held).sum() / len(points) * 18**3 / len(occupied)
    assert excess(cover) == pytest.approx(sampled, rel=0.05)


def test_results_do_not_depend_on_threads():
    for config in (MergeConfig(max_planes=300), MergeConfig(hulls=30, facet_cap=8)):
        one, many = (merge(config, SCENE, jobs=jobs) for jobs in (1, 5))
        assert one.manifest == many.manifest


def test_merging_resumes_from_outer_polytopes():
    second = cover_of(cover_of(SCENE, max_planes=400), max_bytes=700)
    assert_covers(second, SCENE)
    assert_outer(second)
    assert cover_of(second, hulls=5).manifest.polytopes == "hull"


def test_the_curve_says_what_covers_cost():
    cover = cover_of(SCENE, max_planes=400)
    curve = cover.manifest.certificate["curve"]
    assert curve["bytes"] == [
        64 + 14 * n + 5 * (p - 6 * n) for n, p in zip(curve["hulls"], curve["half_planes"], strict=True)
    ]
    measured = curve["measured"]
    best = int(np.argmin(measured["conservativeness"]))
    summary = cover.manifest.summary
    assert measured["conservativeness"][best] == cover.manifest.conservativeness
    assert measured["hulls"][best] == summary["hulls"]
    assert measured["half_planes"][best] == summary["half_planes"]
    assert measured["bytes"][best] == summary["onboard_bytes"]
    assert len(cover["history"]) <= summary["start_hulls"] - summary["hulls"]


@pytest.mark.parametrize(
    "config",
    [
        {"facet_cap": 5},
        {"facet_cap": "5"},
        {"facet_cap": "few"},
        {"facet_cap": "-8"},
        {"facet_cap": 10**9},
        {"facet_cap": "auto", "max_growth": 1.5},
        {"facet_cap": "auto", "max_growth": 1.5, "hulls": 10},
        {"facet_cap": "auto", "max_planes": 100, "method": "paper"},
        {"facet_cap": 9, "kdop": 14},
        {"facet_cap": "auto", "kdop": 14, "max_planes": 100},
        {"kdop": 8},
        {"max_bytes": 0},
    ],
)
def test_meaningless_shapes_are_refused(config):
    with pytest.raises(UsageError):
        MergeConfig(**config)


def test_defaults_are_resolved_and_recorded():
    assert MergeConfig().facet_cap == "auto"
    assert MergeConfig().hulls == 300
    assert MergeConfig().saves_planes
    assert MergeConfig(hulls=300).facet_cap == "none"
    assert MergeConfig(hulls=300, facet_cap="auto").saves_planes
    assert MergeConfig(method="paper").facet_cap == MergeConfig(kdop=14).facet_cap == "none"
    assert not MergeConfig(max_planes=100).saves_planes
    assert MergeConfig(max_planes=100).facet_cap == "auto"
    assert MergeConfig(max_bytes=100).facet_cap == "auto"
    assert MergeConfig(max_planes=100, method="paper").facet_cap == "none"
    assert MergeConfig(max_planes=100, kdop=6).facet_cap == "none"
    assert MergeConfig(facet_cap="12").facet_cap == 12


@pytest.mark.parametrize(
    "config",
    [
        {"max_bytes": 77},
        {"max_planes": 5},
        {"max_bytes": 90, "facet_cap": "none"},
        {"max_planes": 20, "kdop": 26},
        {"max_planes": 12, "max_growth": 1.01},
    ],
)
def test_contradicting_limits_are_infeasible(config):
    with pytest.raises(InfeasibleError):
        cover_of(SCENE, **config)


def test_the_least_budgets_are_boxes():
    for config in ({"max_planes": 6}, {"max_bytes": 78}, {"max_planes": 6, "hulls": 9}):
        cover = cover_of(SCENE, **config)
        assert len(cover["plane_offset"]) == 6
        assert_covers(cover, SCENE)


def test_a_box_that_is_not_bounded_is_refused():
    cover = cover_of(SCENE, hulls=4, facet_cap=8)
    axis = np.flatnonzero(np.abs(cover["plane_normal"]).sum(axis=1) == 1)[3]
    start = cover["plane_start"].copy()
    start[np.searchsorted(start, axis, "right") :] -= 1
    bad = dataclasses.replace(
        cover,
        arrays={
            **cover.arrays,
            "plane_normal": np.delete(cover["plane_normal"], axis, axis=0),
            "plane_offset": np.delete(cover["plane_offset"], axis),
            "plane_start": start,
        },
    )
    with pytest.raises(ArtifactError, match="hull 0: a plane of the bounding box is missing"):
        Hulls.from_cover(bad)
    assert "a plane of the bounding box is missing, hull 0" in verify(bad, voxels=SCENE).complaint()


def test_a_manifest_cannot_hide_what_its_polytopes_are():
    for cover, other in (
        (cover_of(SCENE, hulls=4), "outer"),
        (cover_of(SCENE, hulls=4, facet_cap=8), "hull"),
    ):
        fields = msgspec.to_builtins(cover.manifest) | {"polytopes": other}
        with pytest.raises(msgspec.ValidationError, match="polytopes"):
            msgspec.convert(fields, type=type(cover.manifest))


@pytest.mark.parametrize("hulls", [8, 20, 60])
def test_saved_planes_cost_no_volume_and_leave_every_voxel_covered(hulls):
    plain = cover_of(SCENE, hulls=hulls)
    saved = cover_of(SCENE, hulls=hulls, facet_cap="auto")
    assert_covers(saved, SCENE)
    assert saved.manifest.conservativeness <= plain.manifest.conservativeness
    assert len(saved["plane_start"]) - 1 <= hulls
    assert saved.manifest.summary["onboard_bytes"] <= plain.manifest.summary["onboard_bytes"]
    assert saved.manifest.polytopes == ("outer" if saved.manifest.requires else "hull")


@pytest.mark.slow
def test_the_default_map_is_smaller_than_that_of_as_many_hulls_at_the_same_volume():
    """A default of 300 hulls took 114 kB where a budget of bytes gave the same volume in 60 kB."""
    voxels = voxels_of(furniture(seed=1, extent=40))
    plain, default = cover_of(voxels, hulls=300), cover_of(voxels)
    assert_covers(default, voxels)
    assert default.manifest.conservativeness <= plain.manifest.conservativeness
    assert default.manifest.summary["onboard_bytes"] <= 0.75 * plain.manifest.summary["onboard_bytes"]
    assert default.manifest.parameters["hulls"] == 300
    assert merge(MergeConfig(), voxels, jobs=3).manifest.summary == default.manifest.summary


def test_an_empty_journal_records_the_volumes_of_a_default_merge():
    journal = _core.MergeJournal()
    first = merge(MergeConfig(), SCENE, jobs=1, journal=journal)
    assert len(journal) > 0
    assert merge(MergeConfig(), SCENE, jobs=1, journal=journal).arrays.keys() == first.arrays.keys()
