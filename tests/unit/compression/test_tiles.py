"""Tiles do not change the result: the same bytes for all sizes, numbers of jobs and crops."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression import tiles
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.tiles import Ellipsoids, mark, mark_tiles
from alula.stages.compression.voxelize import voxelize
from support.effort import examples

SHAPES = {
    "round": [0.11, 0.09, 0.1],
    "disc": [0.3, 0.2, 1e-6],
    "needle": [0.7, 1e-6, 1e-6],
    "thread": [0.7, 1e-12, 1e-12],
    "dust": [1e-4, 2e-4, 1e-5],
    "huge": [100, 120, 80],
    "sheet": [100, 90, 1e-6],
    "wire": [100, 1e-5, 1e-5],
}
TURNS = ([1, 0, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [1, 1, 1, 1], [1, 1e-7, 0, 1e-9], None)


@st.composite
def scenes(draw):
    """Up to thirty ellipsoids around a crop of a few voxels, some tangent to the lattice, some of 100 m."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 30))
    g = draw(st.sampled_from([0.05, 0.125, 0.3]))
    names = rng.choice(list(SHAPES), n)
    scale = np.array([SHAPES[name] for name in names]) * rng.uniform(0.3, 1, (n, 3))
    mean = rng.uniform(-4, 4, (n, 3)) * g
    mean += (scale.max(axis=1) > 10)[:, None] * rng.normal(0, 60, (n, 3))
    tangent = rng.random(n) < 0.3
    mean[tangent] = np.round(mean[tangent] / g) * g
    quat = np.array([TURNS[k] or rng.normal(size=4) for k in rng.integers(0, len(TURNS), n)], float)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    span = draw(st.integers(1, 9)) * g
    corner = rng.uniform(-6, 2, 3) * g
    return Ellipsoids(
        mean=mean.astype(np.float32),
        scale=scale.astype(np.float32),
        quat_wxyz=quat.astype(np.float32),
        sigma=draw(st.sampled_from([1.0, 2.5])),
        inflation_m=draw(st.sampled_from([0.0, 0.0, 0.2])) * g,
        voxel_size_m=g,
        crop=(*corner, *(corner + span)),
        min_overlap=draw(st.sampled_from([1, 1, 2])),
    )


def assert_equal(one, other):
    for name in ("index", "overlap", "reach"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert (one.below, one.max_overlap) == (other.below, other.max_overlap)


@settings(max_examples=examples(80), deadline=None)
@given(ellipsoids=scenes(), edge=st.integers(1, 40), chunk=st.sampled_from([1, 7, 1000]))
def test_every_tile_size_gives_the_same_voxels(ellipsoids, edge, chunk):
    whole = mark(ellipsoids, 1, None)
    calls = []
    size, tiles.CHUNK = tiles.CHUNK, chunk
    try:
        tiled = mark_tiles(ellipsoids, edge, 2, None, lambda done, total: calls.append((done, total)))
    finally:
        tiles.CHUNK = size
    assert_equal(tiled, whole)
    if len(whole.index):
        done, total = zip(*calls, strict=True)
        assert len(set(total)) == 1
        assert list(done) == sorted(done)
        assert done[-1] == total[0]


@settings(max_examples=examples(40), deadline=None)
@given(ellipsoids=scenes(), seed=st.integers(0, 2**32 - 1))
def test_whether_a_voxel_is_marked_does_not_depend_on_the_crop(ellipsoids, seed):
    """Every box of whole voxels gives its part of the result."""
    index, overlap, *_ = _core.voxelize(**ellipsoids.level())
    lower, upper = np.sort(np.random.default_rng(seed).integers(-8, 8, (2, 3)), axis=0)
    keep = ((index >= lower) & (index <= upper)).all(axis=1)
    part = _core.voxelize(**ellipsoids.level(), tile=(lower.tolist(), upper.tolist()))
    np.testing.assert_array_equal(part[0], index[keep])
    np.testing.assert_array_equal(part[1], overlap[keep])


def test_each_tile_lists_the_ellipsoids_whose_boxes_meet_it():
    rng = np.random.default_rng(5)
    mean = rng.uniform(-2, 2, (50, 3)).astype(np.float32)
    scale = rng.uniform(0.05, 0.4, (50, 1)).repeat(3, axis=1).astype(np.float32)  # spheres: boxes are known
    quat = np.tile(np.float32([1, 0, 0, 0]), (50, 1))
    g, edge = 0.1, 7
    tile, start, row = _core.tiles_of(mean, scale, quat, 1.0, g, 0.0, None, edge)
    found = {tuple(t): row[start[i] : start[i + 1]].tolist() for i, t in enumerate(tile.tolist())}
    expected = {}
    for i in range(50):
        low, high = (
            np.floor(np.floor((mean[i].astype(float) + sign * scale[i]) / g) / edge).astype(int)
            for sign in (-1, 1)
        )
        for t in itertools.product(*(range(a, b + 1) for a, b in zip(low, high, strict=True))):
            expected.setdefault(t, []).append(i)
    assert found == expected
    assert [tuple(t) for t in tile.tolist()] == sorted(expected)


def scene_of(n=300, **fields):
    rng = np.random.default_rng(8)
    quat = rng.normal(size=(n, 4))
    arrays = {
        "mean": rng.uniform(-1, 1, (n, 3)),
        "scale": rng.uniform(0.01, 0.2, (n, 3)),
        "quat_wxyz": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "opacity": np.linspace(0, 1, n),
        "color": np.zeros((n, 3)),
    }
    keywords = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}} | fields
    return make_artifact(SCENE, arrays, **keywords)


@pytest.mark.every(2)
@pytest.mark.parametrize("tile_m", [0.1, 0.34, 1.0, 1000.0])
def test_the_artifact_is_the_same_whatever_the_tile(tile_m):
    config = VoxelizeConfig(size_m=0.1, min_overlap=2, crop=(-1, -1, -1, 0.5, 1, 1), min_opacity=0.25)
    plain = voxelize(config, scene_of())
    tiled = voxelize(config, scene_of(), tile_m=tile_m, jobs=3)
    assert tiled.manifest == plain.manifest
    assert plain.manifest.guarantee.claims["left_out"]["gaussians_below_opacity"] == 75
    for name in ("index", "overlap"):
        np.testing.assert_array_equal(tiled[name], plain[name])


def test_only_gaussians_of_the_opacity_are_marked_and_proven():
    scene = scene_of()
    half = scene["opacity"] >= np.float32(0.5)
    voxels = voxelize(VoxelizeConfig(size_m=0.1, min_opacity=0.5), scene)
    rows = [np.ascontiguousarray(scene[name][half]) for name in ("mean", "scale", "quat_wxyz")]
    index, overlap, *_ = _core.voxelize(*rows, 1.0, 0.1)
    np.testing.assert_array_equal(voxels["index"], index)
    np.testing.assert_array_equal(voxels["overlap"], overlap)
    assert voxels.manifest.min_opacity == 0.5
    options = {"voxel_size_m": 0.1, "sigma": 1.0}
    assert unproven_voxels(scene, index, min_opacity=0.5, **options).total == 0
    lacking = unproven_voxels(scene, index, min_opacity=0.4, **options)
    assert lacking.total > 0
    assert ((scene["opacity"][lacking.ellipsoid] >= 0.4) & ~half[lacking.ellipsoid]).all()
    with pytest.raises(InfeasibleError, match="no Gaussian has an opacity of at least 1"):
        voxelize(VoxelizeConfig(min_opacity=1.0), _faint())


def _faint():
    scene = scene_of()
    arrays = dict(scene.arrays) | {"opacity": np.full(300, 0.5, np.float32)}
    return make_artifact(SCENE, arrays, frame="world", unit="m", parameters={}, summary={}, source={})


def test_tiles_that_mean_nothing_or_are_too_many_are_refused():
    config = VoxelizeConfig(size_m=0.1)
    for tile_m in (0.0, -1.0, 1e9):
        with pytest.raises(UsageError, match="--tile must be more than 0"):
            voxelize(config, scene_of(), tile_m=tile_m)
    large = scene_of(3)
    arrays = dict(large.arrays) | {"scale": np.full((3, 3), 8, np.float32)}
    large = make_artifact(SCENE, arrays, frame="world", unit="m", parameters={}, summary={}, source={})
    with pytest.raises(InputError, match="too many tiles of this size; use a larger --tile"):
        voxelize(config, large, tile_m=0.1)


def test_lists_are_joined_in_order():
    rng = np.random.default_rng(0)
    index = np.unique(rng.integers(-4, 4, (200, 3)), axis=0).astype(np.int32)
    overlap = np.arange(len(index), dtype=np.uint32)
    owner = rng.integers(0, 6, len(index))
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(7)).astype(np.int64)
    joined = _core.joined_voxels(index[order], overlap[order], start)
    np.testing.assert_array_equal(joined[0], index)
    np.testing.assert_array_equal(joined[1], overlap)
    with pytest.raises(ValueError, match="not ascending"):
        _core.joined_voxels(index, overlap, np.array([0, 5, 3]))
