"""Levelling by a given direction or by the floor."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import CheckError, InputError, UsageError
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig
from alula.stages.alignment.estimates import Given
from alula.stages.alignment.evidence import Correspondences
from alula.stages.alignment.levelling import level_by_direction, level_by_floor, turn_up
from alula.stages.alignment.plane_search import best_level_plane
from alula.stages.alignment.scale_align import scale_align, scale_only
from alula.stages.alignment.similarity import transform_points
from alula.stages.reconstruction.demo_scene import world_from_scene
from support.effort import examples
from support.scenes import floor_scenes

UP = np.array([0.0, 0.0, 1.0])


@settings(max_examples=examples(60), deadline=None)
@given(st.tuples(*[st.floats(-10, 10)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
@example((0.0, 1e-5, -1.0))
def test_a_direction_is_turned_up_by_the_smallest_rotation(direction):
    up = np.array(direction) / np.linalg.norm(direction)
    rotation = turn_up(up)
    np.testing.assert_allclose(rotation @ up, UP, atol=1e-13)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(rotation) == pytest.approx(1)
    angle = Rotation.from_matrix(rotation).magnitude()
    assert angle == pytest.approx(np.arctan2(np.hypot(*up[:2]), up[2]), abs=1e-6)


def test_straight_down_is_turned_up_too():
    np.testing.assert_allclose(turn_up(-UP) @ -UP, UP)
    assert level_by_direction(-UP).facts["turned_deg"] == pytest.approx(180)


def room(seed, noise=0.01, below=0.02):
    """A furnished room of 8 x 6 x 3 m without ceiling, walls denser than the floor, noise under it."""
    rng = np.random.default_rng(seed)
    size = np.array([8.0, 6.0, 3.0])
    floor = rng.uniform(size=(6000, 3)) * size * [1, 1, 0]
    walls = rng.uniform(size=(12000, 3)) * size
    walls[:6000, 0], walls[6000:, 1] = 0, 6
    table = rng.uniform(size=(2500, 3)) * [2, 1.5, 0] + [3, 2, 0.75]
    under = rng.uniform(size=(int(below * 20000), 3)) * size - [0, 0, 3]
    points = np.concatenate([floor, walls, table])
    return np.concatenate([points + noise * rng.normal(size=points.shape), under])


def tilted(points, seed, angle=0.3):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3) * [1, 1, 0]
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    return points @ turn.T + rng.normal(size=3), turn @ UP


@pytest.mark.parametrize("seed", range(4))
def test_the_floor_of_a_tilted_room_is_found_not_its_table_or_walls(seed):
    points, up = tilted(room(seed), seed)
    level = level_by_floor(points, UP, 0.1)
    moved = transform_points(level.motion, points)
    assert np.degrees(np.arccos(np.clip(up @ level.facts["up"], -1, 1))) < 0.1
    assert abs(np.median(moved[:6000, 2])) < 0.003
    assert level.facts["turned_deg"] == pytest.approx(np.degrees(0.3), abs=0.1)
    assert 0.005 < level.facts["sigma_m"] < 0.03


@pytest.mark.slow
def test_the_reported_tilt_and_height_are_as_uncertain_as_they_are():
    tilts, heights = [], []
    for seed in range(24):
        level = level_by_floor(room(seed + 100), UP, 0.1)
        up = np.array(level.facts["up"])
        sigma = np.radians(level.facts["tilt_sigma_deg"])
        tilts += [-up[1] / sigma[0], up[0] / sigma[1]]
        centre = np.array([4.0, 3, 0])
        heights.append((transform_points(level.motion, centre[None])[0, 2]) / level.facts["height_sigma_m"])
    assert np.std(tilts) < 1.6
    assert np.std(tilts) > 0.5
    assert np.sqrt(np.mean(np.square(heights))) < 2.5


def test_a_street_is_level_without_walls_too():
    rng = np.random.default_rng(0)
    ground = rng.uniform(-20, 20, (8000, 3)) * [1, 1, 0]
    ground[:, 2] = 0.02 * np.sin(ground[:, 0])
    cars = rng.uniform(size=(3000, 3)) * [4, 2, 1.5] + [3, 3, 0]
    points, up = tilted(np.concatenate([ground, cars]), 1, 0.2)
    level = level_by_floor(points, UP, 0.1)
    assert np.degrees(np.arccos(np.clip(up @ level.facts["up"], -1, 1))) < 0.1


@pytest.mark.slow
def test_what_has_no_floor_is_refused_with_figures():
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(1000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    with pytest.raises(CheckError, match="no floor was found: the best plane"):
        level_by_floor(3 * ball, UP, 0.02)
    with pytest.raises(CheckError, match="no floor was found"):
        level_by_floor(room(0)[6000:18000], UP, 0.1)
    with pytest.raises(InputError, match="only 3 cubes"):
        level_by_floor(np.eye(3), UP, 0.1)


@pytest.mark.slow
def test_the_rough_ground_of_a_real_street():
    """Its frame is upright by other sensors; the street itself slopes a little."""
    root = os.environ.get("ALULA_DATA")
    if not root:
        pytest.skip("ALULA_DATA is not set")
    rows = np.fromfile(Path(root) / "istanbul-outdoor/tile_x001_y000.splat", "<f4").reshape(-1, 8)
    points = rows[:, :3].astype(np.float64)
    turned, up = tilted(points - points.mean(axis=0), 1, 0.15)
    for threshold in (0.1, 0.3):
        level = level_by_floor(turned, UP, threshold)
        assert np.degrees(np.arccos(np.clip(up @ level.facts["up"], -1, 1))) < 2
        assert 0.03 < level.facts["sigma_m"] < 0.6 * threshold


def tilt_and_height(level, points, up, floor):
    """Error of the tilt in degrees, and the median height of the true floor."""
    height = transform_points(level.motion, points)[floor, 2]
    return np.degrees(np.arccos(np.clip(up @ level.facts["up"], -1, 1))), np.median(height)


@pytest.mark.every(3)
@pytest.mark.parametrize("seed", range(5))
def test_a_floor_that_holds_a_seventh_of_a_cluttered_apartment_is_found(seed):
    points, floor = floor_scenes.apartment(seed)
    turned, up = tilted(points, seed, 0.25)
    level = level_by_floor(turned, UP, 0.1)
    tilt, height = tilt_and_height(level, turned, up, floor)
    assert tilt < 0.1
    assert abs(height) < 0.01
    assert not level.warnings


@pytest.mark.every(3)
@pytest.mark.parametrize("upper", [0.6, 1.0, 1.5])
def test_of_two_floors_the_lower_one_is_taken_and_the_other_reported(upper):
    points, floor = floor_scenes.terraces(3, upper=upper)
    turned, up = tilted(points, 3, 0.25)
    level = level_by_floor(turned, UP, 0.1)
    tilt, height = tilt_and_height(level, turned, up, floor)
    assert tilt < 0.1
    assert abs(height) < 0.01
    assert len(level.warnings) == 1
    assert re.match(
        r"a second level plane, 0\.29 m above the floor, has \d+% of its points", level.warnings[0]
    )
    assert level.facts["others"][0]["relative_share"] == pytest.approx(upper, abs=0.3)  # of occupied cubes


@pytest.mark.slow
def test_the_crowned_road_of_a_street_is_level():
    points, road = floor_scenes.street(0)
    turned, up = tilted(points, 2, 0.25)
    level = level_by_floor(turned, UP, 0.1)
    tilt, height = tilt_and_height(level, turned, up, road)
    assert tilt < 0.1
    assert abs(height) < 0.05


@pytest.mark.slow
def test_ground_that_is_too_rough_is_refused_with_the_limit_and_a_threshold_that_works():
    points, _ = floor_scenes.street(0, rough=0.06)
    with pytest.raises(CheckError) as caught:
        level_by_floor(points, UP, 0.1)
    match = re.search(
        r"scatter by (\S+) m .* more than 0\.06 m, which is 0\.6 of --threshold 0\.1; "
        r"--threshold (\S+) finds one with \d+% of the scene",
        str(caught.value),
    )
    assert match
    assert float(match[1]) > 0.06
    assert level_by_floor(points, UP, float(match[2])).facts["lean_deg"] < 0.2


def test_the_order_of_the_points_does_not_matter():
    points, _ = floor_scenes.apartment(1)
    shuffled = np.random.default_rng(5).permutation(points)
    first, second = (level_by_floor(p, UP, 0.1).facts for p in (points, shuffled))
    assert first["height_m"] == pytest.approx(second["height_m"], abs=1e-6)
    assert first["up"] == pytest.approx(second["up"], abs=1e-6)


@pytest.mark.parametrize("scale", [0.05, 0.1])
def test_no_plane_has_a_score_above_the_bound(scale):
    """Against all planes through triples of a small scene, rated one by one."""
    rng = np.random.default_rng(8)
    points = np.concatenate([rng.uniform(-1, 1, (60, 3)), rng.uniform(-1, 1, (30, 3)) * [1, 1, 0.04]])
    normal, offset, bound = best_level_plane(points, scale, np.radians(40))

    def score(normal, offset):
        height = points @ normal - offset
        return (np.abs(height) <= scale + 1e-9).sum() - 0.5 * (height < -2 * scale - 1e-9).sum()

    found, highest = score(normal, offset), 0.0
    for _ in range(1000):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        other = np.cross(b - a, c - a)
        other *= np.sign(other[2]) / np.linalg.norm(other)
        if other[2] >= np.cos(np.radians(40)):
            highest = max(highest, *(score(other, other @ a + shift) for shift in (-scale, 0, scale)))
    assert found >= 0.8 * highest
    assert highest <= bound * found + 1e-9


def scene_of(points):
    from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
    from alula.stages.reconstruction import import_splat as stage

    rows = len(points)
    splats = stage.Splats(
        format="ply",
        mean=points.astype(np.float32),
        scale=np.full((rows, 3), 0.01, np.float32),
        quat_wxyz=np.tile(np.array([1, 0, 0, 0], np.float32), (rows, 1)),
        opacity=np.ones(rows, np.float32),
        color=np.zeros((rows, 3), np.uint8),
    )
    return stage.import_splat(ImportSplatConfig(min_opacity=0), splats)


def test_levelling_follows_the_scale_and_is_recorded():
    points, up = tilted(room(1), 3)
    scene = scene_of(points / 2.5)
    config = ScaleAlignConfig(floor=True, up=tuple((up + np.array([0.1, -0.1, 0])).tolist()))
    found = scale_align(config, scene, Given(scale_only(2.5), "scale"), 0)
    record = found.manifest.alignment
    assert record["level"]["by"] == "floor"
    assert record["scale"] == 2.5
    np.testing.assert_allclose(np.array(record["matrix"])[2, :3] / 2.5, record["level"]["up"], atol=1e-12)
    np.testing.assert_allclose(record["level"]["up"], up, atol=2e-3)
    assert abs(np.median(found["mean"][:6000, 2])) < 0.004
    assert found.manifest.parameters["floor"] is True
    by_hand = scale_align(ScaleAlignConfig(up=tuple(up.tolist())), scene, scale_only(2.5), 0)
    np.testing.assert_allclose(np.ptp(by_hand["mean"][:6000, 2]), 0, atol=0.1)
    assert by_hand.manifest.alignment["level"]["by"] == "direction"


def test_distances_and_a_floor_add_their_errors():
    points, up = tilted(room(1), 3)
    scene = scene_of(points)
    lengths = (((0, 0, 0), (1, 0, 0), 1.0), ((0, 0, 0), (0, 2, 0), 2.01), ((0, 0, 0), (0, 0, 3), 2.99))
    plain, level = (
        scale_align(config, scene, lengths, 0).manifest.suggested_inflation_m
        for config in (ScaleAlignConfig(), ScaleAlignConfig(floor=True, up=tuple(up.tolist())))
    )
    assert level > plain > 0


def test_a_metric_scene_may_only_be_levelled_and_an_arbitrary_one_not():
    points, _ = tilted(room(2), 5, 0.1)
    scene = scene_of(points)
    with pytest.raises(UsageError, match="alone are for scenes in metres"):
        scale_align(ScaleAlignConfig(up=(0, 0, 1)), scene, None, 0)
    with pytest.raises(UsageError, match="--floor needs --up"):
        scale_align(ScaleAlignConfig(floor=True), scene, Given(scale_only(1.0), "scale"), 0)
    metric = scale_align(ScaleAlignConfig(), scene, scale_only(1.0), 0)
    found = scale_align(ScaleAlignConfig(floor=True), metric, None, 0)
    assert found.manifest.alignment["method"] == "level"
    assert found.manifest.alignment["level"]["turned_deg"] == pytest.approx(np.degrees(0.1), abs=0.1)
    assert found.manifest.world_from_scene.scale == 1


def test_evidence_that_fixes_the_rotation_is_not_levelled():
    rows = np.random.default_rng(0).normal(size=(5, 3))
    evidence = Correspondences(tuple("abcde"), rows, rows)
    with pytest.raises(UsageError, match="fixes its rotation already"):
        scale_align(ScaleAlignConfig(up=(0, 0, 1)), scene_of(rows), evidence, 0)


def test_the_built_in_room_stands_on_its_floor():
    """Its own frame is tilted in every axis; the truth knows by how much."""
    from alula.stages.reconstruction.demo_scene import demo_scene

    truth: Similarity = world_from_scene()
    splats = demo_scene(DemoSceneConfig(gaussians=20_000), 0)
    up = np.array(truth.rotation).T @ UP
    level = level_by_floor(
        truth.scale * np.asarray(splats.mean, np.float64),
        Rotation.from_rotvec([0.2, 0.1, 0]).apply(up),
        0.1,
    )
    assert np.degrees(np.arccos(np.clip(up @ level.facts["up"], -1, 1))) < 0.05
