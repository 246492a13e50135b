"""Proof that voxels contain ellipsoids: it accepts the result of voxelize and no smaller set."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InputError
from alula.stages.compression.ellipsoids import unproven_voxels
from support.effort import examples

MARGIN = 2e-13  # of the coordinates' size: how far voxelize rounds outward, see voxelize.hpp


def rows(mean, scale, quat):
    quat = np.atleast_2d(np.asarray(quat, float))
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    return tuple(np.ascontiguousarray(np.atleast_2d(a), np.float32) for a in (mean, scale, quat))


def proof(splats, index, sigma=1.0, g=0.05, inflation=0.0, crop=None, min_overlap=1, jobs=0):
    index = np.ascontiguousarray(index, np.int32).reshape(-1, 3)
    return _core.unproven_voxels(*splats, sigma, g, inflation, crop, min_overlap, index, jobs)


@st.composite
def nasty_scenes(draw):
    """Needles, discs, ties with the grid, axis-aligned and nearly so, far from the origin."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 60))
    g = draw(st.sampled_from([0.001, 0.02, 0.05, 0.3]))
    mean = rng.uniform(-8, 8, (n, 3)) * g + draw(st.sampled_from([0.0, 10.0, 1e3, 1e4]))
    if draw(st.booleans()):
        mean = np.round(mean / g) * g
    scale = {
        "round": 10 ** rng.uniform(-1.5, 0.6, (n, 3)) * g,
        "disc": np.c_[10 ** rng.uniform(-1, 0.6, (n, 2)) * g, np.full(n, 1e-6)],
        "leaf": np.c_[np.full((n, 2), 3 * g), np.full(n, 1e-9)],
        "needle": np.c_[10 ** rng.uniform(-1, 0.8, n) * g, np.full((n, 2), 1e-9)],
        "any": 10 ** rng.uniform(-9, np.log10(4 * g), (n, 3)),
    }[draw(st.sampled_from(["round", "disc", "leaf", "needle", "any"]))]
    quat = rng.normal(size=(n, 4))
    plain = rng.random(n) < 0.4
    quat[plain] = rng.integers(-1, 2, (plain.sum(), 4)) + np.array([1e-9, 0, 0, 1e-7])
    inflation = draw(st.sampled_from([0.0, 0.0, 0.1 * g, g]))
    crop = (*(mean.mean(0) - 4 * g), *(mean.mean(0) + 4 * g)) if draw(st.booleans()) else None
    return rows(mean, scale, quat), draw(st.sampled_from([1.0, 2.5])), g, inflation, crop


@settings(max_examples=examples(150), deadline=None)
@given(scene=nasty_scenes(), min_overlap=st.integers(1, 4))
def test_whatever_voxelize_makes_is_proven(scene, min_overlap):
    splats, sigma, g, inflation, crop = scene
    index, overlap, *_ = _core.voxelize(*splats, sigma, g, inflation, crop)
    kept = index[overlap >= min_overlap]
    total, voxel, ellipsoid = proof(splats, kept, sigma, g, inflation, crop, min_overlap)
    assert total == 0, (voxel[0], ellipsoid[0])


@settings(max_examples=examples(60), deadline=None)
@given(scene=nasty_scenes(), pick=st.integers(0, 2**31))
def test_a_missing_voxel_is_reported_with_an_ellipsoid_that_touches_it(scene, pick):
    splats, sigma, g, _, crop = scene
    index, *_ = _core.voxelize(*splats, sigma, g, 0.0, crop)
    if len(index) == 0:
        return
    gone = pick % len(index)
    total, voxel, ellipsoid = proof(splats, np.delete(index, gone, axis=0), sigma, g, 0.0, crop)
    assert total == 1
    np.testing.assert_array_equal(voxel, index[[gone]])
    alone = tuple(a[ellipsoid] for a in splats)
    assert index[gone].tolist() in _core.voxelize(*alone, sigma, g, 0.0, crop)[0].tolist()


def test_with_min_overlap_only_voxels_touched_often_enough_must_be_there():
    rng = np.random.default_rng(1)
    splats = rows(rng.uniform(-0.3, 0.3, (80, 3)), rng.uniform(0.01, 0.1, (80, 3)), rng.normal(size=(80, 4)))
    index, overlap, *_ = _core.voxelize(*splats, 1.0, 0.05)
    for least in (1, 2, 5):
        total, voxel, _ = proof(splats, np.zeros((0, 3)), min_overlap=least)
        assert total == (overlap >= least).sum()
        np.testing.assert_array_equal(voxel, index[overlap >= least][:100])
    assert proof(splats, index[overlap >= 5], min_overlap=4)[0] == (overlap == 4).sum()


@pytest.mark.parametrize("shape", [[0.1, 0.1, 0.1], [0.2, 0.1, 1e-6], [0.3, 1e-9, 1e-9]])
def test_growing_an_ellipsoid_into_a_new_voxel_is_caught(shape):
    rng = np.random.default_rng(2)
    mean, scale, quat = rows([0, 0, 0], shape, rng.normal(size=4))
    g = 0.05
    index, *_ = _core.voxelize(mean, scale, quat, 1.0, g)
    marked = set(map(tuple, index.tolist()))
    low, high = 1.0, 1.6  # the level at which the first new voxel is touched, by bisection
    assert len(_core.voxelize(mean, scale, quat, high, g)[0]) > len(index)
    while high - low > 1e-15:
        middle = (low + high) / 2
        if middle in (low, high):
            break
        more = set(map(tuple, _core.voxelize(mean, scale, quat, middle, g)[0].tolist())) > marked
        low, high = (low, middle) if more else (middle, high)
    # Between the first level that voxelize marks and the first touched one lies its outward margin.
    slack = 20 * MARGIN * (np.sum(shape) + g) / np.max(shape)
    assert proof((mean, scale, quat), index, low, g)[0] == 0
    assert proof((mean, scale, quat), index, high + slack, g)[0] > 0


@pytest.mark.parametrize("inflation", [0.0, 0.2])
def test_huge_flat_splats_are_proven_within_a_crop(inflation):
    rng = np.random.default_rng(3)
    scale = [[100, 100, 1e-9], [100, 1e-3, 1e-3], [100, 80, 1e-2], [50, 100, 1e-6], [100, 1e-9, 1e-9]]
    splats = rows(rng.uniform(-1, 1, (5, 3)), scale, rng.normal(size=(5, 4)))
    crop = (-3.0, -3.0, -3.0, 3.0, 3.0, 3.0)
    index, *_ = _core.voxelize(*splats, 1.0, 0.1, inflation, crop)
    assert len(index) > 1000
    assert proof(splats, index, 1.0, 0.1, inflation, crop)[0] == 0
    index, *_ = _core.voxelize(*splats, 1.0, 2.0, inflation)
    assert proof(splats, index, 1.0, 2.0, inflation)[0] == 0


def test_voxels_that_the_grown_ellipsoid_reaches_must_be_there():
    rng = np.random.default_rng(6)
    (mean, scale, quat), inflation, g = rows([0.5, 0.5, 0.5], [2.0, 0.2, 0.01], [1, 0, 0, 0]), 0.5, 0.25
    index, *_ = _core.voxelize(mean, scale, quat, 1.0, g, inflation)
    u, ball = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 20000, 3)))
    normal = u / scale[0]
    points = mean[0] + u * scale[0] + inflation * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    reached = np.unique(
        np.floor(np.concatenate([points, mean[0] + u * scale[0] + inflation * ball]) / g), axis=0
    )
    inside = set(map(tuple, reached.astype(int).tolist()))
    for voxel in inside:
        kept = index[(index != voxel).any(axis=1)]
        assert proof((mean, scale, quat), kept, 1.0, g, inflation)[0] == 1
    assert 100 < len(inside) < len(index)


def test_the_first_hundred_are_listed_whatever_the_number_of_jobs():
    rng = np.random.default_rng(4)
    splats = rows(
        rng.uniform(-1, 1, (3000, 3)), rng.uniform(0.01, 0.2, (3000, 3)), rng.normal(size=(3000, 4))
    )
    index, *_ = _core.voxelize(*splats, 1.0, 0.05)
    shuffled = rng.permutation(index[::2])
    one = proof(splats, shuffled, jobs=1)
    many = proof(splats, np.concatenate([shuffled, shuffled]), jobs=5)
    assert one[0] == many[0] == len(index) // 2
    np.testing.assert_array_equal(one[1], index[1::2][:100])
    np.testing.assert_array_equal(one[1], many[1])
    np.testing.assert_array_equal(one[2], many[2])


def test_for_a_scene_artifact():
    mean, scale, quat = rows([[0, 0, 0], [100, 0, 0]], [[0.1] * 3, [60.0] * 3], [[1, 0, 0, 0]] * 2)
    arrays = {"mean": mean, "scale": scale, "quat_wxyz": quat, "opacity": [1, 1], "color": np.zeros((2, 3))}
    scene = make_artifact(SCENE, arrays, frame="world", unit="m", parameters={}, summary={}, source={})
    crop = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)
    found = unproven_voxels(scene, np.zeros((0, 3), np.int32), voxel_size_m=1.0, sigma=1.0, crop=crop)
    assert found.total == 8
    assert found.voxel.tolist() == [[i, j, k] for i in (-1, 0) for j in (-1, 0) for k in (-1, 0)]
    assert found.ellipsoid.tolist() == [0] * 8
    with pytest.raises(InputError, match="not those of this scene"):
        unproven_voxels(scene, found.voxel, voxel_size_m=1e-9, sigma=1.0)
