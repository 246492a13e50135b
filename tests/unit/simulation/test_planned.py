"""Pairs flown along plans of their own, where the straight flight ends in front of a wall."""

import msgspec
import numpy as np
import pytest

from alula.cli.main import run
from alula.cli.verbs.runs import check_trials
from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.errors import CheckError, InfeasibleError, UsageError
from alula.schemas.log.run import read_run
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.defaults import completed
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicles import VEHICLES
from alula.stages.planning.limits import motion_limits
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.simulate import simulate_world
from alula.stages.simulation.summary import world_summary
from alula.stages.world.behind import undisturbed
from alula.stages.world.world import World
from support.flights.world_runs import IDEAL_POINT, flown
from support.scenes.small_scenes import ball_scene, box_cover

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


def simulated(cover, progress=None, which=range(5), **mission):
    """Flights of some of the pairs."""
    every = pairs()
    chosen = Pairs(every.start[list(which)], every.goal[list(which)], 0, 0)
    scenario = decoded(
        {
            "vehicle": {"type": "single-integrator", "radius_m": 0.3},
            "world": {"cover": "x"},
            "mission": {"bounds_m": BOUNDS, "margin_m": 0.0, "beyond_map_m": 10.0} | mission,
            "safety": {"filters": ["polytope-cbf"]},
            "rules": {"trials": len(chosen.start)},
        }
    )
    return simulate_world(scenario, cover=cover, pairs=chosen, progress=progress)


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


@pytest.mark.slow
def test_pairs_without_a_plan_are_named_and_not_flown():
    cover = box_cover(SHELL + SEALED)
    planned = simulated(cover, planned=True, which=(0, 4))
    summary = world_summary(planned)
    assert (summary["trials"], summary["planned_pairs"], summary["unplanned_pairs"]) == (1, 1, 1)
    np.testing.assert_array_equal(planned.trials[0].goal_m, pairs().goal[4])
    assert planned.trials[0].plan is not None
    (note,) = summary["notes"]
    where = " ".join(f"{value:.3f}" for value in pairs().start[0])
    assert note.startswith("the planner found no way for 1 of 2 pairs, which were not flown: pair 0 from (")
    assert where in note
    with pytest.raises(InfeasibleError, match="no way for 1 of 1 pairs: pair 0 from"):
        simulated(cover, planned=True, which=(0,))


@pytest.mark.slow
def test_plans_that_were_not_flown_to_their_goals_fail_the_check():
    """The outcomes are replaced: a run with a flight that is stuck, late or off its plan is refused."""
    run = simulated(box_cover(SHELL + WALL), planned=True)
    check_trials("a", run.scenario, run.trials)
    ends = ("reached", "stuck", "timeout", "off-plan", "reached")
    trials = [msgspec.structs.replace(one, outcome=end) for one, end in zip(run.trials, ends, strict=True)]
    words = "3 of 5 plans were not flown as planned: 1 stuck, 1 timeout, 1 off-plan; trial 1: the flight"
    with pytest.raises(CheckError, match=words):
        check_trials("a", run.scenario, trials)
    straight = simulated(box_cover(SHELL + WALL))
    check_trials("a", straight.scenario, straight.trials)  # nothing was promised of these


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
    among_balls = flown(planned=True, **given)
    assert among_balls.summary["collisions"] == 0


@pytest.mark.parametrize(
    ("vehicle", "name"), [("crazyflie21", "polytope-cbf"), ("fastbridge", "cone-backup")]
)
def test_a_quadrotor_flies_its_plans_without_its_filter_acting(vehicle, name, monkeypatch):
    """Towards a wall, where the filter acts along the fastest plan."""
    cover = box_cover([((20, -20, -20), (22, 20, 20))])
    ends = Pairs(np.array([[0.6, 0.0, 0.0]]), np.array([[1.65, 0.4, 0.0]]), 0, 0)
    scenario = decoded(
        {
            "vehicle": {"type": vehicle},
            "world": {"cover": "x"},
            "mission": {"planned": True, "margin_m": 0.1, "beyond_map_m": 10.0},
            "safety": {"filters": [name]},
            "rules": {"trials": 1},
        }
    )

    def flight():
        ready = prepare(scenario, cover=cover, pairs=ends, jobs=1)
        (log,) = ready.fly(0, 1, jobs=1)
        return ready, ready.judged(0, log)

    ready, trial = flight()
    plan, limits = ready.missions.plans[0].manifest, motion_limits(PlanConfig(), VEHICLES[vehicle])
    assert plan.vehicle == vehicle
    assert plan.limits == limits.record()
    assert trial.outcome == "reached"
    assert not trial.collision
    assert trial.filtered_steps <= 0.01 * trial.steps
    assert trial.saturated_steps == 0
    assert trial.max_tracking_error_m < 0.01
    monkeypatch.setattr(World, "behind", lambda self: None)
    _, fastest = flight()
    assert fastest.filtered_steps > 0.02 * fastest.steps
    assert fastest.duration_s < trial.duration_s


def test_random_noise_is_left_out_where_plans_are_made_for_a_filter():
    """The same seed with another number of trials, and noise, gives the same plans."""
    given = {"vehicle": {"type": "crazyflie21"}, "world": {"cover": "x"}, "safety": {"filters": ["shield"]}}
    still = completed(decoded(given), VEHICLES["crazyflie21"])
    noisy = completed(
        decoded(
            given
            | {"estimation": {"position_noise_m": 0.01, "delay_s": 0.02}}
            | {"vehicle": {"type": "crazyflie21", "disturbance": {"gust_m_s": [1, 1, 1]}}}
        ),
        VEHICLES["crazyflie21"],
    )
    delayed = msgspec.structs.replace(still.estimation, delay_s=0.02)
    assert undisturbed(noisy) == msgspec.structs.replace(still, estimation=delayed)


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
