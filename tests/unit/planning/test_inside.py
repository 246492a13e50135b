"""Flights are meant to be above the floor and in the closed space of a map, unless bounds say otherwise."""

import dataclasses

import numpy as np
import pytest

from alula import _core
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.scenario import decoded
from alula.stages.planning.endpoints import free_points
from alula.stages.planning.inside import enclosed, inside_of
from alula.stages.planning.plan import plan
from alula.stages.planning.space import mapped_box, plan_space
from alula.stages.simulation.simulate import simulate_world
from support.scenes.covers import with_manifest
from support.scenes.small_scenes import box_cover

CONFIG = PlanConfig(radius_m=0.2)
GROUND = ((-100, -100, -2), (100, 100, 0))  # in voxels of 0.1 m
HEDGE = ((-100, 96, 0), (100, 100, 30))  # as high as the house
SPOT = ((40, 40, -20), (42, 42, -18))  # matter 2 m below the floor
HOUSE = [  # 6 x 5 x 2.8 m within, with a doorway of 0.9 x 2 m and a window of 1 x 1 m
    ((-32, -27, 28), (32, 27, 30)),
    ((-32, -27, 0), (-30, 27, 28)),
    ((30, -27, 0), (32, 5, 28)),
    ((30, 14, 0), (32, 27, 28)),
    ((30, 5, 20), (32, 14, 28)),
    ((-30, -27, 0), (30, -25, 28)),
    ((-30, 25, 0), (-10, 27, 28)),
    ((0, 25, 0), (30, 27, 28)),
    ((-10, 25, 0), (0, 27, 8)),
    ((-10, 25, 18), (0, 27, 28)),
]
GARDEN = box_cover([GROUND, HEDGE, SPOT, *HOUSE])
OPEN = with_manifest(box_cover([GROUND, HEDGE, SPOT]), floor_m=0.0)


def in_house(points):
    return ((points > (-3, -2.5, 0)) & (points < (3, 2.5, 2.8))).all(axis=-1)


def pairs(cover):
    """Starts and goals of random flights, shape (16, 3)."""
    scenario = decoded(
        {
            "vehicle": {"type": "single-integrator", "radius_m": 0.15},
            "world": {"cover": "x"},
            "safety": {"filters": ["polytope-cbf"]},
            "rules": {"trials": 8, "max_time_s": 0.02},
        }
    )
    trials = simulate_world(scenario, cover=cover, jobs=1).trials
    return np.array([point for trial in trials for point in (trial.start_m, trial.goal_m)])


@pytest.mark.slow
def test_free_points_are_in_the_house_unless_bounds_ask_for_the_garden():
    space = plan_space(CONFIG, GARDEN)
    assert in_house(free_points(CONFIG, space, 12)).all()
    around = dataclasses.replace(CONFIG, bounds=(-10, -10, 0, 10, 10, 3))
    assert not in_house(free_points(around, space, 12)).all()


def test_points_are_moved_into_the_house_not_out_of_it():
    """From the outer half of a wall the nearest free point is outside; --nearest-free takes one inside."""
    start = (-3.15, 0.0, 1.4)
    moved = plan(dataclasses.replace(CONFIG, start=start, goal=(2, 0, 1.4), nearest_free=True), GARDEN)
    assert in_house(moved["waypoint"][0, :3])
    np.testing.assert_allclose(moved["waypoint"][0, :3], (-2.799, 0, 1.4), atol=0.02)


def test_random_pairs_are_in_the_house():
    assert in_house(pairs(GARDEN)).all()


def test_free_points_and_pairs_are_above_a_known_floor():
    space = plan_space(CONFIG, OPEN)
    assert space.floor_m == 0.0
    assert free_points(CONFIG, space, 12)[:, 2].min() > 0
    assert pairs(OPEN)[:, 2].min() > 0
    unknown = with_manifest(OPEN, floor_m=None)
    assert pairs(unknown)[:, 2].min() < 0


@pytest.mark.parametrize("seed", range(3))
def test_the_enclosure_of_a_point_is_that_of_rays_in_numpy(seed):
    """Boxes and rays by slabs."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-9, -9, 0.1), (9, 9, 2.7), (40, 3))
    space = plan_space(CONFIG, GARDEN)
    mapped = mapped_box(space)
    found = enclosed(space.map, points, mapped.lower, mapped.upper, 0.002)
    ways = np.array([w for w in np.ndindex(3, 3, 3) if w != (1, 1, 1)]) - 1.0
    boxes = 0.1 * np.array([GROUND, HEDGE, SPOT, *HOUSE], float)
    hits = np.zeros((len(points), len(ways)), bool)
    for low, high in boxes:
        with np.errstate(divide="ignore", invalid="ignore"):
            a = (low - points[:, None]) / ways
            b = (high - points[:, None]) / ways
        near, far = np.fmin(a, b), np.fmax(a, b)
        hits |= (near.max(axis=-1) <= far.min(axis=-1)) & (far.min(axis=-1) >= 0)
    np.testing.assert_allclose(found, hits.mean(axis=1), atol=1 / 26)
    assert isinstance(space.map, _core.ObstacleMap)


def test_walls_with_gaps_that_a_vehicle_does_not_pass_are_walls():
    side = np.arange(0, 64, 3)
    faces = [
        np.stack(np.meshgrid(side, side, [level], indexing="ij"), axis=-1).reshape(-1, 3) for level in (0, 63)
    ]
    cubes = np.unique(np.concatenate([np.roll(face, k, axis=1) for face in faces for k in range(3)]), axis=0)
    space = plan_space(CONFIG, box_cover([(tuple(cube), tuple(cube + 1)) for cube in cubes]))
    room = mapped_box(space).room(0.2)
    inside = inside_of(space.map, *room, 0.2, None)
    assert inside.is_closed
    assert inside.holds(np.random.default_rng(0).uniform(1, 5.4, (200, 3))).all()


def test_a_hedge_and_ground_alone_are_no_closed_space():
    lawn = box_cover([GROUND, ((0, 0, 0), (2, 2, 64))])  # points just above it are no closed space
    for cover, is_closed in ((GARDEN, True), (OPEN, False), (lawn, False)):
        space = plan_space(CONFIG, cover)
        room = mapped_box(space).room(0.2)
        assert inside_of(space.map, *room, 0.2, 0.0).is_closed is is_closed
