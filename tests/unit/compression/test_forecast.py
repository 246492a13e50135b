"""The number of voxels is known before the work: estimates, remedies, and Gaussians that dominate."""

import re

import numpy as np
import pytest

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InputError
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig
from alula.stages.compression import forecast, tiles
from alula.stages.compression import voxelize as stage
from alula.stages.compression.forecast import (
    dominant,
    estimated_voxels,
    fitting_size,
    may_exceed,
    most_voxels,
)
from alula.stages.compression.tiles import Ellipsoids, mark
from alula.stages.compression.voxelize import voxelize


def street(count=4000, seed=0, **fields):
    """Flat Gaussians on a ground of 200 m and on walls along it; a few are 5 m long."""
    rng = np.random.default_rng(seed)
    mean = rng.uniform([-100, -10, 0], [100, 10, 6], (count, 3))
    mean[::2, 2] = 0
    mean[1::4, 1] = -10
    quat = rng.normal(size=(count, 4))
    values = {
        "mean": mean.astype(np.float32),
        "scale": np.exp(rng.normal(-2, 0.8, (count, 3))).astype(np.float32),
        "quat_wxyz": (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32),
    }
    keywords = {"sigma": 1.0, "inflation_m": 0.0, "voxel_size_m": 0.1, "crop": None, "min_overlap": 1}
    return Ellipsoids(**values, **(keywords | fields))


def with_a_giant(ellipsoids, row=77, semi=8.0):
    ellipsoids.scale[row] = semi
    return ellipsoids


def scene_of(ellipsoids, **fields):
    count = len(ellipsoids.mean)
    arrays = {name: getattr(ellipsoids, name) for name in ("mean", "scale", "quat_wxyz")}
    arrays |= {"opacity": np.ones(count), "color": np.zeros((count, 3))}
    keywords = {"frame": "world", "unit": "m", "parameters": {}, "summary": {}, "source": {}} | fields
    return make_artifact(SCENE, arrays, **keywords)


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"voxel_size_m": 0.07},
        {"min_overlap": 2},
        {"crop": (-50.0, -10.0, 0.0, 20.0, 4.0, 2.0)},
        {"inflation_m": 0.1},
        {"loss": np.full((4000, 3), 0.02, np.float32)},
    ],
)
def test_estimates_are_within_a_tenth(fields):
    ellipsoids = street(**fields)
    count = len(mark(ellipsoids, 0, None).index)
    assert count > 5_000
    assert estimated_voxels(ellipsoids) == pytest.approx(count, rel=0.12)
    assert most_voxels(ellipsoids) >= count
    assert may_exceed(ellipsoids, count - 1, 0)
    assert not may_exceed(ellipsoids, int(most_voxels(ellipsoids)) + 1, 0)


def test_a_coarse_count_spares_most_scenes_the_estimate():
    ellipsoids = street()
    count = len(mark(ellipsoids, 0, None).index)
    limit = 64 * len(mark(street(voxel_size_m=0.4), 0, None).index)
    assert count < limit < most_voxels(ellipsoids)
    assert not may_exceed(ellipsoids, limit, 0)
    assert may_exceed(ellipsoids, limit - 1, 0)


def test_a_size_that_fits_is_found():
    ellipsoids = street()
    limit = len(mark(ellipsoids, 0, None).index) // 10
    size, voxels = fitting_size(ellipsoids, limit)
    found = len(mark(street(voxel_size_m=size), 0, None).index)
    assert 0.3 * limit < found <= limit
    assert voxels == pytest.approx(found, rel=0.12)
    assert size <= 0.5


def test_the_gaussians_that_dominate_are_named():
    ellipsoids = with_a_giant(street())
    many, few = len(mark(ellipsoids, 0, None).index), len(mark(street(), 0, None).index)
    assert many > 5 * few
    found = dominant(ellipsoids, float(many), 2 * few)
    assert found.rows == (77,)
    assert found.longest == 8.0
    assert street().scale.max() < found.limit < 8.0
    assert found.voxels == pytest.approx(few, rel=0.12)
    assert dominant(street(), float(few), few // 10) is None


def test_what_merge_cannot_take_is_refused_before_the_work(monkeypatch):
    """68 million voxels were written first, and merge refused them."""
    scene = scene_of(with_a_giant(street()))
    monkeypatch.setattr(stage, "_mark", lambda *_: pytest.fail("marked"))
    with pytest.raises(InputError) as caught:
        voxelize(VoxelizeConfig(size_m=0.1, max_voxels=500_000), scene)
    words = str(caught.value)
    assert re.search(r"^voxels of 0.1 m: about 2,[0-9]00,000, more than the 500,000 of --max-voxels", words)
    size = float(re.search(r"--size ([0-9.]+) makes about [0-9,]+;", words)[1])
    assert "without the largest Gaussian (row 77; semi-axis up to 8 m) there are about" in words
    assert len(mark(with_a_giant(street(voxel_size_m=size)), 0, None).index) <= 500_000


def test_the_filter_is_in_units_of_the_file():
    similarity = {"scale": 4.0, "rotation": np.eye(3).tolist(), "translation_m": [0, 0, 0]}
    from alula.schemas.artifacts.manifest import Similarity

    scene = scene_of(with_a_giant(street()), world_from_scene=Similarity(**similarity))
    limit = int(1.5 * len(mark(street(), 0, None).index))
    with pytest.raises(InputError) as caught:
        voxelize(VoxelizeConfig(size_m=0.1, max_voxels=limit), scene)
    found = re.search(
        r"without the largest Gaussian \(row 77; semi-axis up to 8 m\) there are about [0-9,]+: import-splat "
        r"--max-scale ([0-9.]+) \(file units\) removes semi-axes above ([0-9.]+) m",
        str(caught.value),
    )
    assert float(found[1]) * 4 == pytest.approx(float(found[2]), rel=0.01)
    assert street().scale.max() < float(found[2]) < 8


def test_a_number_near_the_limit_is_counted_exactly():
    ellipsoids = street()
    count = len(mark(ellipsoids, 0, None).index)
    scene = scene_of(ellipsoids)
    made = voxelize(VoxelizeConfig(size_m=0.1, max_voxels=count), scene)
    assert len(made["index"]) == count
    with pytest.raises(InputError, match=f"more than the {count - 1:,} of --max-voxels"):
        voxelize(VoxelizeConfig(size_m=0.1, max_voxels=count - 1), scene)


def test_a_gaussian_that_fills_much_of_the_voxels_is_noted():
    scene = scene_of(with_a_giant(street()))
    notes = voxelize(VoxelizeConfig(size_m=0.1), scene).manifest.summary["notes"]
    assert re.match(
        r"Gaussian 77 of 4000, with a semi-axis of 8 m, alone fills [89][0-9]% of the voxels", notes[0]
    )
    assert "notes" not in voxelize(VoxelizeConfig(size_m=0.1), scene_of(street())).manifest.summary


def test_most_scenes_are_not_estimated(monkeypatch):
    monkeypatch.setattr(stage, "estimated_voxels", lambda *_: pytest.fail("estimated"))
    assert len(voxelize(VoxelizeConfig(size_m=0.1), scene_of(street()))["index"]) > 20_000


def test_a_scene_of_too_many_tiles_counts_as_infinite():
    mean = np.array([[0, 0, 0], [1e5, 1e5, 1e5]], np.float32)
    ellipsoids = Ellipsoids(
        mean=mean,
        scale=np.full((2, 3), 3e4, np.float32),
        quat_wxyz=np.tile(np.float32([1, 0, 0, 0]), (2, 1)),
        **{"sigma": 1.0, "inflation_m": 0.0, "voxel_size_m": 0.05, "crop": None, "min_overlap": 1},
    )
    assert estimated_voxels(ellipsoids) == np.inf
    with pytest.raises(
        InputError, match="far more than the 16,777,216 of --max-voxels, which merge can take"
    ):
        voxelize(VoxelizeConfig(), scene_of(ellipsoids))
    assert tiles.LONGEST_EDGE == 2**20


@pytest.mark.slow
def test_balls_that_overlap_much_are_estimated_from_fewer_tiles(monkeypatch):
    """300 balls nearly fill the same ball of 20 m; their union has its volume, and each tile all of them."""
    rng = np.random.default_rng(0)
    balls = Ellipsoids(
        mean=rng.normal(scale=0.1, size=(300, 3)).astype(np.float32),
        scale=np.full((300, 3), 20.0, np.float32),
        quat_wxyz=np.tile(np.float32([1, 0, 0, 0]), (300, 1)),
        sigma=1.0,
        inflation_m=0.0,
        voxel_size_m=0.1,
        crop=None,
        min_overlap=1,
    )
    counted = []
    mark = forecast.mark
    monkeypatch.setattr(forecast, "mark", lambda *a, **named: counted.append(1) or mark(*a, **named))
    found = forecast.estimated_voxels(balls)
    assert len(counted) == 40
    assert found == pytest.approx(4 / 3 * np.pi * 203**3, rel=0.35)
