"""Volumes of unions of polytopes, compared with rational arithmetic, sampling and each other."""

from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge
from papers.polymerge.measure import measure_cover, measure_points
from support.effort import examples, some
from support.models.exact import exact_union, voxel_planes
from support.scenes.covers import furniture, planes, voxels_of

NO_VOXELS = np.empty((0, 3), np.int32)


def lattice_hull(points):
    found = _core.lattice_hull(np.array(points, np.int32))
    return [
        (tuple(n), o)
        for n, o in zip(found["plane_normal"].tolist(), found["plane_offset"].tolist(), strict=True)
    ]


def measured(hulls, boxes, voxels=NO_VOXELS, jobs=1):
    """The native function on integer planes."""
    normal = np.array([n for hull in hulls for n, _ in hull], np.float64)
    offset = np.array([o for hull in hulls for _, o in hull], np.float64)
    length = np.linalg.norm(normal, axis=1)
    start = np.cumsum([0, *(len(hull) for hull in hulls)])
    lower, upper = (np.array([box[side] for box in boxes], np.float64) for side in (0, 1))
    return _core.union_measure(
        normal / length[:, None], offset / length, start, lower, upper, voxels, 1e-9, jobs, None
    )


points = st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=4, max_size=7)


@settings(deadline=None, max_examples=examples(20))
@given(st.lists(points, min_size=1, max_size=4), st.integers(-1000, 1000))
def test_the_union_is_that_of_rational_arithmetic_within_the_stated_error(clouds, shift):
    hulls, boxes = [], []
    for cloud in clouds:
        moved = [tuple(c + shift for c in p) for p in cloud]
        try:
            hulls.append(lattice_hull(moved))
        except ValueError:  # flat
            continue
        boxes.append((np.min(moved, axis=0), np.max(moved, axis=0)))
    if not hulls:
        return
    found = measured(hulls, boxes)
    off = abs(Fraction(found["volume"]) - exact_union(hulls))
    assert off <= Fraction(found["error"])
    assert found["error"] < 1e-6


def test_voxels_are_filled_as_rational_arithmetic_says():
    rng = np.random.default_rng(5)
    clouds = [rng.integers(0, 4, (6, 3)).tolist() for _ in range(3)]
    hulls = [lattice_hull(cloud) for cloud in clouds]
    boxes = [(np.min(cloud, axis=0), np.max(cloud, axis=0)) for cloud in clouds]
    cells = np.array(some([c for c in product(range(1, 4), repeat=3) if sum(c) % 2], 2), np.int32)
    found = measured(hulls, boxes, cells)
    assert found["volume"] == pytest.approx(measured(hulls, boxes)["volume"], abs=found["error"])
    filled = []
    for x, y, z in cells.tolist():
        filled.append(exact_union([hull + voxel_planes((x, y, z)) for hull in hulls]))
    assert found["intersection"] == pytest.approx(float(sum(filled)), abs=found["error"])
    assert found["whole"] == sum(f == 1 for f in filled)


def test_hulls_that_share_vertices_edges_and_planes_are_counted_once():
    cube = [(x, y, z) for x in (0, 2) for y in (0, 2) for z in (0, 2)]
    wedges = [cube[:i] + cube[i + 1 :] for i in range(8)] + [cube, cube]
    hulls = [lattice_hull(w) for w in wedges]
    boxes = [((0, 0, 0), (2, 2, 2))] * len(hulls)
    cells = np.array(list(product(range(2), repeat=3)), np.int32)
    whole = measured(hulls, boxes, cells)
    assert whole["volume"] == pytest.approx(8, abs=1e-12)
    assert whole["intersection"] == pytest.approx(8, abs=1e-12)
    assert whole["whole"] == 8
    without = measured(hulls[:2], boxes[:2])
    assert without["volume"] == pytest.approx(float(exact_union(hulls[:2])), abs=1e-12)
    tetrahedra = [lattice_hull([(0, 0, 0), (k, 1, 0), (k, 0, 2), (0, 1, 3)]) for k in range(1, 7)]
    many = measured(tetrahedra, [((0, 0, 0), (k, 1, 3)) for k in range(1, 7)])
    assert many["volume"] == pytest.approx(float(exact_union(tetrahedra)), abs=many["error"])
    box = np.array(list(product(range(6), range(1), range(3))), np.int32)
    inside = measured(tetrahedra, [((0, 0, 0), (k, 1, 3)) for k in range(1, 7)], box)
    assert inside["intersection"] == pytest.approx(many["volume"], abs=2 * many["error"])
    assert inside["whole"] == 0


@pytest.fixture(scope="module")
def scene():
    return voxels_of(furniture(3, 16)[:-5])


@pytest.mark.parametrize("method", ["default", "paper"])
def test_a_cover_states_its_exact_volume_and_fills_every_voxel(scene, method):
    cover = merge(MergeConfig(hulls=12, method=method), scene)
    found = measure_cover(cover, scene["index"][::-1])
    assert found.voxels == len(scene["index"])
    assert found.open_voxels == 0
    assert found.filled == pytest.approx(1, abs=1e-12)
    assert found.conservativeness == pytest.approx(cover.manifest.conservativeness, abs=1e-12)
    stated = cover.manifest.certificate["conservativeness"]
    assert stated["rounding_error_voxels"] < 1e-6
    assert measure_cover(cover, jobs=1) == measure_cover(cover, jobs=3)
    points = np.random.default_rng(0).uniform(-9, 9, (100_000, 3))
    inside = np.zeros(len(points), bool)
    for hull in range(len(cover["plane_start"]) - 1):
        normal, offset = zip(*planes(cover, hull), strict=True)
        inside |= (points @ np.array(normal).T <= np.array(offset)).all(axis=1)
    sigma = 18**3 * np.sqrt(inside.mean() * (1 - inside.mean()) / len(points))
    assert found.union == pytest.approx(inside.mean() * 18**3, abs=5 * sigma)


def test_hulls_of_other_tools_are_measured_from_their_points(scene):
    cover = merge(MergeConfig(hulls=12), scene)
    start = cover["vertex_start"]
    parts = [cover["vertex"][a:b].astype(np.float64) for a, b in pairwise(start)]
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    found = measure_points([*parts, flat], scene["index"])
    assert found.union == pytest.approx(measure_cover(cover).union, abs=1e-8)
    assert found.open_voxels == 0
    smaller = [p.mean(axis=0) + (p - p.mean(axis=0)) * (1 - 1e-4) for p in parts]
    shrunk = measure_points(smaller, scene["index"], jobs=2)
    assert shrunk == measure_points(smaller, scene["index"], jobs=1)
    assert 0 < shrunk.open_voxels < shrunk.voxels
    assert shrunk.union < found.union
    assert 0.99 < shrunk.filled < 1
    assert measure_points(smaller, scene["index"], sliver=0.01).open_voxels < shrunk.open_voxels
    assert measure_points([], scene["index"]).open_voxels == len(scene["index"])


def test_what_cannot_be_measured_is_refused(scene):
    with pytest.raises(InputError, match="finite"):
        measure_points([np.full((8, 3), np.nan)], scene["index"])
    with pytest.raises(InputError, match="no occupied voxel"):
        measure_points([], NO_VOXELS)
