"""Compression compared with rational arithmetic: hulls of all widths, the cover after each merge, and W."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.exact import cross, cutting, dot, exact_excess, facets_of
from support.scenes.covers import cover_of, furniture, holds_voxel, planes, rows, voxels_of

# The hull's arithmetic changes between 177 and 178, and between 2^17 and 2^17 + 1; 2^20 is the limit.
EXTENTS = [1, 2, 20, 176, 177, 178, 230, 2**17 - 1, 2**17, 2**17 + 1, 2**18, 2**20 - 1, 2**20]
LEAST_WEIGHT = 1e-6  # of a hull that is no box and whose box is not full
voxel_sets = st.sets(st.tuples(*3 * [st.integers(-3, 3)]), min_size=2, max_size=24)


@st.composite
def points_of_extent(draw, most):
    """Points of one extent anywhere in the range: corners, edges, middles, and what lies beside them.

    Half of the time three of them make the largest determinant there is, 2 extent^3, nearly, and others
    lie within a step of their plane: what is rounded there shows.
    """
    extent = draw(st.sampled_from(EXTENTS))
    place = [draw(st.sampled_from([-(2**20), 0, 2**20 - extent])) for _ in range(3)]
    inner = st.one_of(st.sampled_from([0, 1, extent // 2, extent - 1, extent]), st.integers(0, extent))
    points = draw(st.lists(st.tuples(inner, inner, inner), min_size=2, max_size=most))
    if draw(st.booleans()):
        step = st.integers(0, min(2, extent))
        tight = [[abs(end * extent - draw(step)) for end in p] for p in ((1, 1, 0), (1, 0, 1), (0, 1, 1))]
        normal = cross(np.subtract(tight[1], tight[0]).tolist(), np.subtract(tight[2], tight[0]).tolist())
        points = [(*p[:2], beside(normal, dot(normal, tight[0]), p, extent, draw(step))) for p in points]
        points += map(tuple, tight)
    elif draw(st.booleans()):  # the extent itself
        points += [(0, 0, 0), (extent, extent, extent)]
    if draw(st.integers(0, 3)) == 0:  # many in one plane
        points += [(x, y, (x + y) // 2) for x, y, _ in points]
    return [tuple(c + p for c, p in zip(point, place, strict=True)) for point in points]


def beside(normal, offset, point, extent, step):
    """The z of a plane over a point's x and y, a step or none away."""
    if normal[2] == 0:
        return point[2]
    z = (offset - normal[0] * point[0] - normal[1] * point[1]) // normal[2]
    return min(max(z + step - 1, 0), extent)


def lattice_hull(points):
    found = _core.lattice_hull(np.array(points, np.int32))
    offsets = found["plane_offset"].tolist()
    half_spaces = list(zip(map(tuple, found["plane_normal"].tolist()), offsets, strict=True))
    return half_spaces, [tuple(v) for v in found["vertex"].tolist()]


@given(points_of_extent(most=7))
@example([(0, 0, 0), (177, 0, 177), (177, 177, 0), (0, 177, 177), (177, 177, 177), (88, 177, 177)])
@example([(0, 0, 0), (178, 1, 177), (178, 178, 1), (1, 177, 178), (178, 178, 178), (89, 178, 178)])
@settings(deadline=None, max_examples=examples(250))
def test_hulls_are_those_of_the_definition_at_every_width(points):
    exact = facets_of(points)
    if not exact:
        with pytest.raises(ValueError, match="no volume"):
            _core.lattice_hull(np.array(points, np.int32))
        return
    half_spaces, vertices = lattice_hull(points)
    assert half_spaces == sorted(exact)
    corners = {p for p in points if sum(dot(n, p) == o for n, o in exact) >= 3}
    assert vertices == sorted(corners)


@given(st.sampled_from(EXTENTS[3:]), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=examples(60))
def test_hulls_of_pairs_are_those_of_all_their_corners_at_every_width(extent, seed):
    """Merged step by step from few voxels that far apart, each as the hull of a hull and further points."""
    rng = np.random.default_rng(seed)
    ends = np.array([0, 1, extent // 2, extent - 2, extent - 1])
    voxels = np.concatenate([[[0, 0, 0]], [[extent - 1] * 3], rng.choice(ends, (6, 3))])
    voxels = voxels_of(voxels - rng.choice([0, 2**19, 2**20 - 2**19]))
    cover = cover_of(voxels, hulls=1, method="paper", cluster_radius=int(rng.integers(0, 2)))
    corners = [
        tuple(a + b for a, b in zip(voxel, corner, strict=True))
        for voxel in rows(cover, 0, "member_index")
        for corner in product((0, 1), repeat=3)
    ]
    half_spaces, vertices = lattice_hull(corners)
    assert planes(cover, 0) == half_spaces
    assert rows(cover, 0, "vertex") == vertices
    outside = [c for c in corners if any(dot(n, c) > o for n, o in half_spaces)]
    assert not outside


def replay(sets, history):
    """The sets after each merge of a history, by what an alula/cover documents: merge k makes N + k."""
    element = dict(enumerate(sets))
    yield dict(element)
    for k, (left, right, _) in enumerate(history.tolist()):
        element[len(sets) + k] = element.pop(int(left)) | element.pop(int(right))
        yield dict(element)


def sets_of(cover):
    return [frozenset(rows(cover, hull, "member_index")) for hull in range(len(cover["plane_start"]) - 1)]


@given(voxel_sets, st.integers(0, 1))
@settings(deadline=None, max_examples=examples(15))
def test_the_cover_holds_every_voxel_after_each_merge(index, block):
    voxels = voxels_of(sorted(index))
    first = cover_of(voxels, hulls=10**6, method="paper", cluster_radius=block)
    starts = sets_of(first)
    whole = cover_of(first, hulls=1, method="paper")
    assert len(whole["history"]) == len(starts) - 1
    for element in replay(starts, whole["history"]):
        cover = cover_of(first, hulls=len(element), method="paper")
        assert sorted(map(sorted, element.values())) == sorted(map(sorted, sets_of(cover)))
        for hull, members in enumerate(sets_of(cover)):
            half_spaces = planes(cover, hull)
            assert all(holds_voxel(half_spaces, voxel) for voxel in members)
        assert frozenset().union(*element.values()) == index


@pytest.mark.every(2)
@pytest.mark.parametrize(
    "shape", [{"method": "default"}, {"method": "paper"}, {"facet_cap": 7}, {"kdop": 14}]
)
def test_the_cover_of_a_scene_holds_every_voxel_after_each_merge(shape):
    """In 64-bit integers, which hold these coordinates: every member in its hull, every voxel a member."""
    voxels = voxels_of(furniture(6, 9)[::3])
    index = set(map(tuple, voxels["index"].tolist()))
    first = cover_of(voxels, hulls=10**6, method="paper", cluster_radius=0)
    starts = len(sets_of(first))
    assert starts == len(index) > 60
    for hulls in range(starts, 0, -1):
        cover = cover_of(first, **({"hulls": hulls} | shape))
        assert len(cover["plane_start"]) - 1 <= hulls
        assert index == set(map(tuple, cover["member_index"].tolist()))
        for hull in range(len(cover["plane_start"]) - 1):
            mine = slice(*cover["plane_start"][hull : hull + 2])
            normal, offset = cover["plane_normal"][mine], cover["plane_offset"][mine]
            members = cover["member_index"][slice(*cover["member_start"][hull : hull + 2])].astype(np.int64)
            assert (members @ normal.T + np.maximum(normal, 0).sum(axis=1) <= offset).all()


@given(
    st.sets(st.tuples(*3 * [st.integers(0, 2)]), min_size=2, max_size=7),
    st.sampled_from(["default", "paper"]),
)
@example({(0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 1, 0), (1, 0, 1), (1, 1, 1)}, "paper")
@settings(deadline=None, max_examples=examples(12))
def test_w_is_the_volume_outside_the_voxels_and_zero_only_without_any(index, method):
    """Voxel by voxel with --cluster-radius 0, where start element i is voxel i."""
    voxels = voxels_of(sorted(index))
    history = cover_of(voxels, hulls=1, method=method, cluster_radius=0)["history"]
    singles = [frozenset([voxel]) for voxel in sorted(index)]
    weight, made = [0.0] * len(singles), list(singles)
    for left, right, w in history.tolist():
        members = made[int(left)] | made[int(right)]
        bound = max(weight[int(left)], weight[int(right)])
        made.append(members)
        weight.append(w)
        corners = [
            tuple(np.add(voxel, corner).tolist()) for voxel in members for corner in product((0, 1), repeat=3)
        ]
        half_spaces, _ = lattice_hull(corners)
        exact = exact_excess(half_spaces, index)
        assert w >= bound, "the weight of a part bounds that of the whole"
        if len(half_spaces) == 6:
            assert w == max(exact, Fraction(bound))
        elif exact == 0:
            assert 0 <= w <= max(LEAST_WEIGHT, bound)
        else:
            # Four by four lines per voxel; those in a diagonal plane count as inside.
            cut = [cell for cell in product(range(3), repeat=3) if cutting(half_spaces, cell)]
            assert w > 0
            assert w == pytest.approx(float(exact), abs=len(cut) / 8 + LEAST_WEIGHT)
