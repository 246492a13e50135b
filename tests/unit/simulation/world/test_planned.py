"""Pairs flown along plans of their own, where the straight flight ends in front of a wall."""

import numpy as np
import pytest

from alula.cli.main import run
from alula.schemas.artifact import read_artifact, write_artifact
from alula.schemas.errors import UsageError
from alula.schemas.kinds import COVER
from alula.schemas.run import read_run
from alula.schemas.world import decoded
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.world.simulate import simulate_world
from alula.stages.simulation.world.summary import world_summary
from support.small_scenes import ball_scene, box_cover
from support.world_runs import IDEAL_POINT, flown

# Two rooms of 4 m x 4 m x 2 m, in voxels of 0.1 m, with a wall between them whose door is at its side.
SHELL = [
    ((-1, -1, -1), (81, 41, 0)),
    ((-1, -1, 20), (81, 41, 21)),
    ((-1, -1, 0), (81, 0, 20)),
    ((-1, 40, 0), (81, 41, 20)),
    ((-1, 0, 0), (0, 40, 20)),
    ((80, 0, 0), (81, 40, 20)),
]
WALL = [((40, 0, 0), (42, 28, 20))]
SEALED = [((40, 0, 0), (42, 40, 20))]
BOUNDS = (0.0, 0.0, 0.0, 8.0, 4.0, 2.0)


def pairs():
    """Four pairs with the wall between them, and one within a room."""
    rng = np.random.default_rng(1)
    start = rng.uniform([0.5, 0.5, 0.5], [3, 2, 1.5], (5, 3))
    goal = rng.uniform([5, 0.5, 0.5], [7.5, 2, 1.5], (5, 3))
    goal[4] = (3.0, 3.5, 1.0)
    return Pairs(start, goal, 0, 0)


def simulated(cover, progress=None, **mission):
    """Flights of the five pairs."""
    scenario = decoded(
        {
            "vehicle": {"type": "single-integrator", "radius_m": 0.3},
            "world": {"cover": "x"},
            "mission": {"bounds_m": BOUNDS, "margin_m": 0.0} | mission,
            "safety": {"filters": ["polytope-cbf"]},
            "rules": {"trials": 5},
        }
    )
    return simulate_world(scenario, cover=cover, pairs=pairs(), progress=progress)


def test_straight_pairs_get_stuck_at_the_wall_and_planned_ones_pass_the_door():
    cover = box_cover(SHELL + WALL)
    steps = []
    straight = world_summary(simulated(cover))
    along = simulated(cover, lambda done, total: steps.append(done / total), planned=True)
    assert steps == sorted(steps)
    assert min(steps) < 0.5 < steps[-1] == 1  # planning is a half of it
    planned = world_summary(along)
    assert straight["reached"] <= 1
    assert "planned_pairs" not in straight
    assert planned["reached"] == 5
    assert planned["collisions"] == 0
    assert planned["planned_pairs"] == 5
    assert planned["unplanned_pairs"] == 0
    for trial, given in zip(along.trials, pairs().goal, strict=True):
        np.testing.assert_array_equal(trial.goal_m, given)
        assert trial.max_speed_m_s <= 1 + 1e-6


def test_pairs_without_a_plan_are_flown_straight_and_counted():
    cover = box_cover(SHELL + SEALED)
    straight, planned = (simulated(cover, planned=flag) for flag in (False, True))
    summary = world_summary(planned)
    assert summary["planned_pairs"] == 1
    assert summary["unplanned_pairs"] == 4
    assert summary["collisions"] == 0
    assert [t.outcome for t in straight.trials[:4]] == [t.outcome for t in planned.trials[:4]]


def test_references_among_ellipsoids_follow_the_plans():
    """The wall as balls of 0.1 m; the plans keep from the hulls around them."""
    y, z = np.meshgrid(np.arange(0.1, 2.8, 0.2), np.arange(0.1, 2, 0.2))
    balls = np.column_stack([np.full(y.size, 4.1), y.ravel(), z.ravel()])
    scene, cover = ball_scene(balls, 0.1), box_cover(SHELL + WALL)
    given = {"scene": scene, "pairs": pairs(), "vehicle": IDEAL_POINT, "trials": 5}
    given |= {"radius_m": 0.3, "speed_m_s": 1.0, "max_time_s": 40.0, "margin_m": 0.0}
    straight = flown(**given)
    assert straight.summary["collisions"] == 4
    planned = flown(planned=True, cover=cover, **given)
    assert planned.summary["collisions"] == planned.guarantee.claims["hull_collisions"]
    assert planned.guarantee.claims["scene_collisions"] == 0
    assert planned.summary["reached"] == 5
    assert planned.summary["planned_pairs"] == 5
    assert planned.summary["min_map_clearance_m"] > -0.02  # the controller tracks the plan that closely
    with pytest.raises(UsageError, match=r"`\$.mission.planned`: plans are made in a cover; set world.cover"):
        flown(planned=True, **given)


def test_a_plan_is_not_planned_again():
    with pytest.raises(UsageError, match=r"`\$\.mission\.planned`"):
        decoded({"mission": {"kind": "plan", "plan": "x", "planned": True}})


def test_the_command_plans_the_pairs_of_another_run(tmp_path, capsys):
    cover = tmp_path / "rooms.cover.npz"
    write_artifact(cover, box_cover(SHELL + WALL))
    assert read_artifact(cover, COVER) is not None
    box = f"mission.bounds_m={','.join(map(str, BOUNDS))}"
    radius = ["--set", "vehicle.radius_m=0.3"]
    first, second = tmp_path / "a.run.mcap", tmp_path / "b.run.mcap"
    words = ["simulate", str(cover), "-q", "-o"]
    assert run([*words, str(first), "--trials", "3", "--set", box, *radius]) == 0
    assert run([*words, str(second), "--pairs-from", str(first), "--planned", *radius]) == 0
    one, two = read_run(first), read_run(second)
    assert [t.goal_m for t in one.trials] == [t.goal_m for t in two.trials]
    assert two.summary["reached"] == 3 > one.summary["reached"]
    assert two.summary["collisions"] == 0
    assert two.provenance.parameters["mission"]["planned"] is True
