"""Runs of scenarios of version 2: verdicts against numpy, summaries, guarantees, plans, refusals."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from alula.schemas.errors import InputError, UsageError
from alula.schemas.scenarios.defaults import vehicle_of
from alula.schemas.scenarios.scenario import decoded
from alula.stages.simulation.judge import hits_static, worst_clearance
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.simulate import simulate_world
from alula.stages.simulation.summary import world_guarantee, world_summary, world_timing
from support.flights.foreign_filters import Broken, Holding, Limiting, Passing, provide
from support.scenes.covers import with_manifest
from support.scenes.small_scenes import ball_scene, box_cover, line_plan, with_vias

WALL = ((15, -20, 0), (18, 20, 30))  # in voxels of 0.1 m
COVER = box_cover([WALL])
PILLARS = box_cover([((12, 3, 0), (15, 8, 25)), ((22, -8, 0), (25, -2, 25)), ((30, 2, 0), (33, 6, 25))])
CENTRES, BALL = np.array([(1.5, 0.05, 1.1), (2.4, 0.6, 0.9)]), 0.2
STRAIGHT = {"kind": "goal", "start_m": (0, 0, 1), "goal_m": (3, 0, 1.3), "beyond_map_m": 10.0}
ARTIFACTS = {"cover": COVER, "scene": ball_scene(CENTRES, BALL)}
SPHERE = 0.1


def scenario(**tree):
    return decoded({"schema": "alula/scenario", "version": "2.0"} | tree, "test")


def parts(tree, files):
    made = scenario(**tree)
    named = {"cover": made.world.cover, "scene": made.world.scene, "plan": made.mission.plan}
    given = {role: (ARTIFACTS | files)[role] for role, name in named.items() if name is not None}
    return made, vehicle_of(made, Path()), given


def simulated(jobs=1, files=None, **tree):
    made, vehicle, given = parts(tree, files or {})
    return simulate_world(made, vehicle, jobs=jobs, **given)


def one(files=None, **tree):
    """The native log and the verdict of the first flight."""
    made, vehicle, given = parts(tree, files or {})
    ready = prepare(made, vehicle, jobs=1, **given)
    (log,) = ready.fly(0, 1, jobs=1)
    return log, ready.judged(0, log)


def dense(path, each=50):
    """Points on the chords of a path."""
    share = np.linspace(0, 1, each, endpoint=False)[:, None]
    return np.vstack([(path[:-1, None] + share * np.diff(path, axis=0)[:, None]).reshape(-1, 3), path[-1]])


def box_distance(p, low, high):
    """Signed distance of points to a box, negative inside."""
    beyond = np.maximum(np.asarray(low) - p, p - np.asarray(high))
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


POINT = {"type": "single-integrator", "radius_m": SPHERE}
QUADROTOR = {"type": "fastbridge", "radius_m": SPHERE}


# Verdicts.


@pytest.mark.parametrize("vehicle", [POINT, QUADROTOR])
def test_a_flight_through_a_wall_is_a_collision_as_deep_as_numpy_says(vehicle):
    log, trial = one(vehicle=vehicle, world={"cover": "x"}, mission=STRAIGHT)
    deepest = box_distance(dense(log["path"]), *(0.1 * np.array(WALL))).min() - SPHERE
    assert deepest < -0.24
    assert trial.map_clearance_m == pytest.approx(deepest, abs=1e-4)
    assert trial.collision
    assert hits_static(trial)
    assert trial.outcome == "reached"


def test_the_clearance_to_ellipsoids_is_that_of_numpy():
    log, trial = one(vehicle=QUADROTOR, world={"scene": "x"}, mission=STRAIGHT)
    apart = np.linalg.norm(dense(log["path"])[:, None] - CENTRES, axis=2).min() - BALL - SPHERE
    assert trial.scene_clearance_m == pytest.approx(apart, abs=1e-4)
    assert trial.map_clearance_m is None
    assert trial.collision


def test_the_clearance_to_the_fence_is_that_of_numpy():
    box, faces = (-1, -0.5, 0.5, 2.5, 0.5, 2.0), [[1.0, 1.0, 0.5, 3.4]]
    log, trial = one(
        vehicle=QUADROTOR,
        world={"fence": {"box_m": box, "faces": faces}},
        mission=STRAIGHT | {"goal_m": (3, 0.2, 1)},
    )
    p, n = log["path"], np.array(faces[0][:3])
    inside = [p - box[:3], np.array(box[3:]) - p, ((faces[0][3] - p @ n) / np.linalg.norm(n))[:, None]]
    expected = np.concatenate(inside, axis=1).min() - SPHERE
    assert expected < -0.5
    assert trial.fence_clearance_m == pytest.approx(expected, abs=1e-12)
    assert trial.collision
    assert hits_static(trial)


def test_the_clearance_to_moving_obstacles_is_that_of_brute_force():
    moving = [
        {"position_m": (2.0, 1.0, 1.2), "velocity_m_s": (0.1, -0.6, 0.0), "radius_m": 0.2},
        {"position_m": (3.0, -1.0, 1.0), "velocity_m_s": (-0.5, 0.3, 0.02), "radius_m": 0.15},
    ]
    log, trial = one(vehicle=QUADROTOR, world={"moving": moving}, mission=STRAIGHT, rules={"max_time_s": 3.0})
    p = dense(log["path"], 20)
    time = (np.arange(len(p)) / 20 * 1e-3)[:, None]
    each = [
        np.linalg.norm(p - np.array(one["position_m"]) - time * np.array(one["velocity_m_s"]), axis=1).min()
        for one in moving
    ]
    np.testing.assert_allclose([met.closest_m for met in trial.obstacles], each, atol=1e-5)
    clearance = [least - one["radius_m"] - SPHERE for least, one in zip(each, moving, strict=True)]
    assert trial.moving_clearance_m == pytest.approx(min(clearance), abs=1e-5)
    assert [met.collision for met in trial.obstacles] == [value <= 0 for value in clearance]
    assert trial.collision == (min(clearance) < 0)
    assert not hits_static(trial)
    assert trial.outcome == "timeout"


def test_what_a_flight_did_is_that_of_its_log():
    log, trial = one(vehicle=QUADROTOR, mission=STRAIGHT | {"speed_m_s": 2.0})
    velocity, length = log["state"][:, 6:9], np.linalg.norm(np.diff(log["path"], axis=0), axis=1)
    assert trial.outcome == log["end"] == "reached"
    assert trial.steps == len(log["mark"])
    assert trial.duration_s == pytest.approx(0.01 * trial.steps)
    assert trial.path_length_m == pytest.approx(length.sum())
    assert trial.straight_length_m == pytest.approx(math.dist(STRAIGHT["start_m"], STRAIGHT["goal_m"]))
    assert trial.max_speed_m_s == pytest.approx(length.max() / 1e-3)  # between ticks too
    assert trial.max_speed_m_s >= np.linalg.norm(velocity, axis=1).max()
    acceleration, jerk = np.diff(velocity, axis=0) / 0.01, np.diff(velocity, n=2, axis=0) / 1e-4
    assert trial.max_acceleration_m_s2 == pytest.approx(np.linalg.norm(acceleration, axis=1).max())
    assert trial.max_jerk_m_s3 == pytest.approx(np.linalg.norm(jerk, axis=1).max())
    assert trial.mean_jerk_m_s3 == pytest.approx(np.linalg.norm(jerk, axis=1).mean())
    assert np.linalg.norm(log["state"][-1, :3] - STRAIGHT["goal_m"]) <= 0.05
    assert worst_clearance(trial) == math.inf


def test_the_start_moves_as_the_scenario_says():
    fast = STRAIGHT | {"start_speed_m_s": 1.5}
    log, _ = one(vehicle=QUADROTOR, mission=fast, rules={"max_time_s": 0.1})
    way = np.subtract(STRAIGHT["goal_m"], STRAIGHT["start_m"])
    np.testing.assert_allclose(log["state"][0, 6:9], 1.5 * way / np.linalg.norm(way))
    for mission in (
        {"kind": "hover", "start_m": (0, 0, 1)},
        {"kind": "waypoints", "start_m": (0, 0, 1), "waypoints_m": [(1, 0, 1), (1, 1, 1)]},
    ):
        given = mission | {"start_velocity_m_s": (0.1, 0.2, 0.3)}
        log, _ = one(vehicle=QUADROTOR, mission=given, rules={"max_time_s": 0.1})
        np.testing.assert_allclose(log["state"][0, 6:9], (0.1, 0.2, 0.3))
    for mission, key in (
        ({"kind": "hover", "start_m": (0, 0, 1), "start_speed_m_s": 1.0}, "start_speed_m_s"),
        (STRAIGHT | {"start_yaw_deg": 10.0}, "start_yaw_deg"),
        ({"kind": "pilot", "start_m": (0, 0, 1), "start_speed_m_s": 1.0}, "start_velocity_m_s"),
    ):
        with pytest.raises(UsageError, match=key):
            scenario(mission=mission)


# Runs of many trials.


AMONG = {
    "vehicle": QUADROTOR,
    "world": {"cover": "x"},
    "mission": {"kind": "pairs", "bounds_m": (0, -2, 0.3, 4, 2, 2), "beyond_map_m": 10.0},
}
HOVER = {"kind": "hover", "start_m": (0, 0, 1)}


def test_the_worst_flights_are_in_the_log_whatever_is_logged():
    rules = {"trials": 8, "logged": 0, "max_time_s": 2.0}
    run = simulated(files={"cover": PILLARS}, rules=rules, **AMONG)
    order = sorted(run.trials, key=worst_clearance)
    assert [flight.trial for flight in run.flights] == sorted(trial.index for trial in order[:3])
    assert world_summary(run)["worst_trial"] == order[0].index
    both = simulated(files={"cover": PILLARS}, rules=rules | {"logged": 8}, **AMONG)
    assert both.trials == run.trials
    shown = {flight.trial: flight for flight in both.flights}
    for flight in run.flights:
        np.testing.assert_array_equal(flight.rows("state"), shown[flight.trial].rows("state"))


def test_trials_do_not_depend_on_jobs_or_on_their_number():
    tree = {"files": {"cover": PILLARS}, "safety": {"filters": ["polytope-cbf", "shield"]}} | AMONG
    few = simulated(rules={"trials": 3, "max_time_s": 1.0}, **tree)
    many = simulated(jobs=3, rules={"trials": 20, "max_time_s": 1.0}, **tree)
    assert many.trials[:3] == few.trials
    assert world_summary(many)["trials"] == 20


@pytest.mark.parametrize(
    ("tree", "is_random"),
    [
        ({"mission": HOVER}, False),
        ({"mission": STRAIGHT, "world": {"cover": "x"}, "safety": {"filters": ["shield"]}}, False),
        ({"mission": HOVER, "estimation": {"position_noise_m": 0.01}}, True),
        ({"mission": HOVER, "estimation": {"rate_noise_rad_s": 0.01}}, True),
        ({"mission": STRAIGHT, "estimation": {"lost_share": 0.3, "delay_s": 0.02}}, True),
        (
            {
                "mission": HOVER,
                "vehicle": QUADROTOR
                | {"disturbance": {"gust_m_s": (1, 1, 1), "linear_drag_n_s_m": (0.1, 0.1, 0.1)}},
            },
            True,
        ),
        ({"mission": HOVER, "world": {"moving": [{"distance_m": 5.0}]}}, True),
        ({"mission": HOVER, "world": {"moving": [{"distance_m": 5.0, "speed_m_s": 3.0}]}}, False),
    ],
)
def test_trials_that_cannot_differ_are_flown_once(tree, is_random):
    rules = {"trials": 2, "max_time_s": 0.5}
    given = {"vehicle": QUADROTOR, "rules": rules} | tree
    if not is_random:
        with pytest.raises(
            UsageError, match=r"`\$.rules.trials`: all 2 flights would be the same.*rules.trials=1"
        ):
            simulated(**given)
        assert len(simulated(**given | {"rules": rules | {"trials": 1}}).trials) == 1
        return
    made, vehicle, files = parts(given, {})
    ready = prepare(made, vehicle, jobs=1, **files)
    first, second = ready.fly(0, 2, jobs=1)
    known = ("path", "obstacle")
    assert any(not np.array_equal(first[key], second[key]) for key in known)


def test_noise_that_a_vehicle_by_sticks_does_not_have_is_refused():
    tree = {"vehicle": {"type": "racer7"}, "mission": {"kind": "pilot", "start_m": (0, 0, 5)}}
    with pytest.raises(UsageError, match=r"estimation.position_noise_m.*leave it out"):
        simulated(estimation={"position_noise_m": 0.1}, **tree)


def test_the_summary_counts_what_the_trials_say():
    ball = {"motion": "ballistic", "radius_m": 0.1, "distance_m": 3.0, "azimuth_rad": (-1.5, 1.5)}
    run = simulated(
        files={"cover": PILLARS},
        vehicle=QUADROTOR,
        world={"cover": "x", "moving": [ball | {"speed_m_s": (4.0, 6.0)}]},
        mission=AMONG["mission"],
        estimation={"sensor": {"kind": "mocap", "rate_hz": 100.0, "position_sigma_m": 0.002}},
        safety={"filters": ["dr-acbf", "shield"]},
        rules={"trials": 6, "max_time_s": 1.5},
    )
    trials, summary = run.trials, world_summary(run)
    steps = sum(trial.steps for trial in trials)
    certified = sum(trial.certified_steps for trial in trials)
    moving = sum(trial.certified_moving_steps for trial in trials)
    assert 0 <= moving <= certified <= steps
    assert certified > 0
    assert summary["certified_share_static"] == certified / steps
    assert summary["certified_share_moving"] == moving / steps
    assert summary["steps"] == steps
    assert summary["static_collisions"] == sum(map(hits_static, trials)) == 0
    assert summary["moving_collisions"] == sum(
        any(met.collision for met in trial.obstacles) for trial in trials
    )
    good = sum(trial.outcome == "reached" and not trial.collision for trial in trials)
    low, high = stats.binomtest(good, len(trials)).proportion_ci(0.95, "wilson")
    assert summary["success_rate"] == good / len(trials)
    assert summary["success_interval"] == pytest.approx([low, high], abs=1e-9)
    for part in ("map", "moving"):
        least = min(getattr(trial, f"{part}_clearance_m") for trial in trials)
        assert summary[f"min_{part}_clearance_m"] == least
    assert summary["min_scene_clearance_m"] is summary["min_fence_clearance_m"] is None
    assert [one.name for one in trials[0].filters] == ["dr-acbf", "shield"]
    assert sum(one.filters[-1].certified for one in trials) == certified
    timing = world_timing(run)
    assert timing["ticks"] == timing["filter_calls"] == steps
    assert 0 < timing["filter_p50_s"] <= timing["tick_max_s"]


# Guarantees.


SHIELDED = {
    "vehicle": QUADROTOR,
    "world": {"cover": "x"},
    "mission": STRAIGHT | {"goal_m": (1.0, 0, 1)},
    "safety": {"filters": ["shield"]},
    "rules": {"max_time_s": 0.3},
}


def guarantee(cover=COVER, **tree):
    run = simulated(files={"cover": cover}, **SHIELDED | tree)
    return run, world_guarantee(run, cover)


def test_the_chain_from_the_scene_to_the_flight_holds_when_everything_fits():
    run, found = guarantee()
    assert sum(trial.certified_steps for trial in run.trials) == sum(trial.steps for trial in run.trials)
    assert found.claims["chain"]["holds"]
    assert found.claims["certified_against"] == ["hulls"]
    assert found.statement.startswith(
        "In all steps shield proved, by a rollout of the model, that a backup manoeuvre"
    )
    assert (
        "keeps 0.1 m, the radius, and half of margin_m, 0.01 m, from every hull of the cover until it rests"
        in found.statement
    )


def test_a_rate_loop_as_modelled_leaves_the_chain_whole():
    run, found = guarantee(vehicle=QUADROTOR | {"interface": "body-rates"})
    assert sum(trial.certified_steps for trial in run.trials) == sum(trial.steps for trial in run.trials)
    chain, loop = found.claims["chain"], "a rate loop with a time constant of 0.02 s"
    assert chain["holds"]
    assert f"for the model with {loop}." in found.statement
    assert any(
        f"thrust and body rates that are held for 0.01 s, which {loop}" in w for w in chain["assumptions"]
    )


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (
            {"vehicle": QUADROTOR | {"interface": "body-rates", "rate_gain_scale": 1.1}},
            "a rate loop other than the model's",
        ),
        ({"vehicle": QUADROTOR | {"mass_scale": 1.01}}, "a mass or thrust"),
        ({"vehicle": QUADROTOR | {"thrust_scale": 0.99}}, "a mass or thrust"),
        ({"vehicle": QUADROTOR | {"disturbance": {"motor_time_constant_s": 0.02}}}, "a motor lag"),
        ({"vehicle": QUADROTOR | {"assumed": {"delay_s": 0.01}}}, "a delay other"),
        ({"vehicle": QUADROTOR | {"disturbance": {"linear_drag_n_s_m": (0.01, 0, 0)}}}, "drag"),
        ({"estimation": {"delay_s": 0.01}}, "a delay other"),
        ({"estimation": {"position_noise_m": 1e-4}}, "noise"),
        ({"estimation": {"rate_noise_rad_s": 1e-4}}, "noise"),
        ({"estimation": {"lost_share": 0.1}}, "lost measurements"),
        ({"cover": with_manifest(COVER, min_overlap=2)}, "fewer than 2 ellipsoids"),
        ({"cover": with_manifest(COVER, min_opacity=0.1)}, "opacity below 0.1"),
        ({"cover": with_manifest(COVER, ignore_loss=True)}, "splat file's format"),
    ],
)
def test_what_the_model_leaves_out_breaks_the_chain_and_is_said(tree, words):
    _, found = guarantee(**tree)
    assert not found.claims["chain"]["holds"]
    assert words in found.claims["chain"]["statement"]
    if "cover" not in tree:
        assert words in found.statement


def test_only_what_was_certified_is_claimed():
    _, found = guarantee(safety={"filters": []})
    assert found.claims["chain"] is found.claims["certified_against"] is None
    _, found = guarantee(safety={"filters": ["polytope-cbf"]})
    assert found.claims["chain"] is found.claims["certified_against"] is None
    assert "nothing was guaranteed beforehand" in found.statement
    run, found = guarantee(mission=STRAIGHT | {"start_velocity_m_s": (6.0, 0, 0), "goal_m": (1.2, 0, 1)})
    certified, steps = run.trials[0].certified_steps, run.trials[0].steps
    assert certified < steps
    assert f"In {certified} of {steps} steps" in found.statement
    assert not found.claims["chain"]["holds"]
    run = simulated(**SHIELDED | {"world": {"scene": "x"}})
    found = world_guarantee(run, None)
    assert found.claims["certified_against"] == ["ellipsoids"]
    assert found.claims["chain"] is None


# Plans.


def planned(via=(), plan=None, **tree):
    made = plan if plan is not None else line_plan((0, 0, 1), (1.0, -0.4, 1.2), 3.0)
    given = {
        "vehicle": QUADROTOR,
        "world": {"cover": "x"},
        "mission": {"kind": "plan", "plan": "x", "beyond_map_m": 10.0},
    }
    run = simulated(files={"plan": with_vias(made, via, 1.5), "cover": PILLARS}, **given | tree)
    return run.trials[0]


def test_a_plan_is_flown_when_each_via_point_was_passed():
    trial = planned([(0.5, -0.2, 1.1)])
    assert (trial.outcome, trial.collision) == ("reached", False)
    assert trial.plan.missed == []
    trial = planned([(0.5, -0.2, 1.1), (0.5, 0.0, 1.1)])
    assert trial.outcome == "missed-via"
    assert trial.plan.missed == [2]  # counted from 1
    mission = {"kind": "plan", "plan": "x", "via_tolerance_m": 0.25, "beyond_map_m": 10.0}
    assert planned([(0.5, -0.2, 1.1), (0.5, 0.0, 1.1)], mission=mission).outcome == "reached"


def test_a_plan_that_is_nearer_to_the_map_than_the_filter_lets_it_is_refused():
    tight = line_plan((0, 0.18, 1), (2.0, 0.18, 1), 4.0)  # 0.12 m below the first pillar
    tree = {"vehicle": QUADROTOR | {"radius_m": 0.15}, "plan": tight}
    with pytest.raises(UsageError, match=r"is 0.12\d* m from the map, and shield keeps 0.15"):
        planned(safety={"filters": ["shield"]}, **tree)
    mission = {"kind": "plan", "plan": "x", "allow_tight": True, "beyond_map_m": 10.0}
    trial = planned(safety={"filters": ["shield"]}, mission=mission, **tree)
    assert not trial.collision


# Filters from elsewhere, and odd values.


@pytest.fixture
def others(monkeypatch):
    class Short(Passing):
        def __call__(self, state, nominal):
            return dataclasses.replace(super().__call__(state, nominal), u=np.zeros(2))

    class Raising(Passing):
        def __call__(self, state, nominal):
            raise ValueError("no idea")

    known = {"limiting": Limiting, "broken": Broken, "holding": Holding, "short": Short, "raising": Raising}
    provide(monkeypatch, known)


def test_a_filter_of_another_package_flies_and_its_mistakes_do_not(others):
    tree = {"vehicle": QUADROTOR, "world": {"scene": "x"}, "mission": STRAIGHT}
    run = simulated(safety={"filters": ["holding"]}, rules={"max_time_s": 0.5}, **tree)
    assert run.trials[0].backup_steps == run.trials[0].steps == 50
    run = simulated(safety={"filters": ["limiting"], "limiting": {"stop_x": 0.2}}, **tree)
    assert run.trials[0].outcome == "refused"
    assert run.trials[0].refused_steps == 1
    ball = {"position_m": (9, 9, 9), "velocity_m_s": (0.0, 0.1, 0.0)}
    for world in ({"scene": "x"}, {"scene": "x", "moving": [ball]}):
        for name in ("broken", "short"):
            with pytest.raises(
                InputError, match=r"the filter returned array.*, which is no acceleration, at \[0.0"
            ):
                simulated(safety={"filters": [name]}, **tree | {"world": world})
        with pytest.raises(RuntimeError, match="the filter Raising failed: no idea"):
            simulated(safety={"filters": ["raising"]}, **tree | {"world": world})


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        ({"rules": {"dt_s": 1e-5, "max_time_s": 0.01}}, "rules.dt_s"),
        ({"estimation": {"lost_share": 0.1, "stale_s": math.inf}}, "set estimation.stale_s=9"),
        ({"estimation": {"lost_share": 0.1, "stale_s": 9.0}, "rules": {"max_time_s": 0.2}}, None),
        ({"estimation": {"stale_s": math.inf}, "rules": {"max_time_s": 0.2, "dt_s": 1e-3}}, None),
        ({"rules": {"max_time_s": 0.2, "plant_steps": 1, "filter_ticks": 3, "controller_ticks": 5}}, None),
        ({"vehicle": {"type": "fastbridge", "radius_m": 0.0}, "rules": {"max_time_s": 0.2}}, None),
    ],
)
@pytest.mark.parametrize("filters", [[], ["shield"]])
def test_values_at_the_ends_of_their_ranges_fly_or_are_refused(tree, words, filters):
    given = {
        "vehicle": QUADROTOR,
        "world": {"cover": "x"},
        "mission": STRAIGHT,
        "safety": {"filters": filters},
    }
    if words is None:
        (trial,) = simulated(**given | tree).trials
        assert trial.steps == round(0.2 / tree["rules"].get("dt_s", 0.01))
    else:
        with pytest.raises(UsageError, match=words):
            simulated(**given | tree)
