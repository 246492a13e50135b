"""Runs by a pilot in a fence: verdicts, starts, guarantees, notes, refusals."""

import math

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import GeofenceParameters
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.summary import world_guarantee, world_summary
from alula.stages.vehicles.racer import racer_model
from support.flights.fence_flights import fly_in
from support.flights.piloted_runs import BOX, RACER, STARTS, TICK_S, fly, scenario
from support.scenes.small_scenes import ball_scene, box_cover

# Verdicts.


def test_the_parameters_of_a_file_are_those_of_the_onboard_code():
    fence = _core.Fence(box=((-1.0, -1, -1), (1.0, 1, 1)))
    onboard = _core.Geofence(fence, racer_model(RACER)).parameters
    written = msgspec.structs.asdict(GeofenceParameters())
    assert onboard.keys() - written.keys() == {"radius_m"}
    assert written.keys() - onboard.keys() == {"alpha"}
    for key in onboard.keys() & written.keys():
        assert np.float32(written[key]) == np.float32(onboard[key]), key


def test_a_motion_that_diverges_is_no_flight():
    for drag in (1e4, 1e300):
        with pytest.raises(UsageError, match=r"vehicle.*diverges"):
            fly({"vehicle.disturbance.linear_drag_n_s_m": (drag,) * 3})


@pytest.mark.parametrize("rule", ["geofence", "backup-qp", "none"])
def test_trials_are_those_of_native_flights_made_by_hand(rule):
    where = _core.Fence(box=(BOX[:3], BOX[3:]))
    geofence = _core.Geofence(where, racer_model(RACER), {"radius_m": RACER.body.radius_m})
    logs = fly_in(
        geofence,
        starts=(STARTS[:3], STARTS[3:]),
        tilt_rad=math.radians(57.3),
        pilot=_core.Pilot("aggressive"),
        model=racer_model(RACER),
        rule=rule,
        duration_s=1.5,
        seed=5,
        count=10,
    )
    names = [] if rule == "none" else [rule]
    run = fly({"rules.dt_s": TICK_S, "safety.filters": names})
    assert [t.fence_clearance_m for t in run.trials] == [log["min_distance_m"] for log in logs]
    assert [t.fence.interventions for t in run.trials] == [log["interventions"] for log in logs]
    assert all(t.steps == 600 for t in run.trials)
    for trial, log in zip(run.trials, logs, strict=True):
        fence = trial.fence
        assert trial.start_m == log["start"][:3].tolist()
        assert trial.goal_m == log["last"][:3].tolist()
        assert trial.duration_s == pytest.approx(1.5)
        assert fence.passed_steps + fence.blended_steps + fence.backup_steps == trial.steps
        assert trial.filtered_steps == (trial.steps - log["passed"] if names else 0)
        assert trial.path_length_m == pytest.approx(log["path_length_m"], rel=1e-12)
        assert [one.name for one in trial.filters or []] == names


def test_path_jerk_and_distance_are_those_of_the_states():
    ready = prepare(scenario(), RACER)
    (log,) = ready.fly(0, 1)
    trial, states = ready.judged(0, log), log["state"]
    length = np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1).sum()
    assert trial.path_length_m == pytest.approx(length, rel=5e-3)
    jerk = np.linalg.norm(np.diff(states[:, 6:9], n=2, axis=0), axis=1) / 0.0025**2
    assert log["mean_jerk_m_s3"] == pytest.approx(trial.mean_jerk_m_s3, rel=1e-9)
    assert trial.mean_jerk_m_s3 == pytest.approx(jerk.mean(), rel=1e-9)
    assert trial.max_jerk_m_s3 == pytest.approx(jerk.max(), rel=1e-9)
    inside = np.minimum(states[:-1, :3] - BOX[:3], np.array(BOX[3:]) - states[:-1, :3]).min(axis=1) - 0.25
    distance = log["fence"]["distance"]
    assert distance == pytest.approx(inside, abs=0.02)  # of the chord that ends there: less by its length
    assert (distance <= inside + 1e-9).all()


def test_the_fence_of_a_pilot_without_a_filter_has_faces_and_hulls():
    cover = box_cover([((-20, -20, 0), (20, 20, 20))])  # 2 m below the start
    start = {"start_m": (0.0, 0.0, 4.0)}
    fall = {
        "safety.filters": [],
        "mission.pilot.kind": "fall",
        "mission.beyond_map_m": 10.0,
        "world.cover": "x",
        "rules.trials": 1,
        "rules.max_time_s": 0.5,
    }
    run = fly(fall, start, cover=cover)
    (trial,) = run.trials
    height = 0.5 * 9.81 * 0.5**2  # of free fall
    assert trial.map_clearance_m == pytest.approx(2 - height - 0.25, abs=1e-3)
    assert trial.fence_clearance_m == pytest.approx(3.5 - height - 0.25, abs=1e-3)
    found = world_summary(run)["fence"]
    assert found["min_distance_m"] == trial.map_clearance_m
    assert (found["passed"], found["min_h_i_m"]) == (200, None)
    assert found["start_h_i_m"] > 0


def test_a_pilot_elsewhere_has_no_figures_of_a_fence():
    nowhere = {"world": {}, "rules.trials": 1, "rules.max_time_s": 0.1, "safety.filters": []}
    run = fly(nowhere)
    assert run.trials[0].fence is None
    assert "fence" not in world_summary(run)
    by_rates = fly({"vehicle.interface": "body-rates", "rules.trials": 1, "rules.max_time_s": 0.1})
    assert by_rates.trials[0].fence is None
    assert by_rates.trials[0].fence_clearance_m > 0


def test_random_starts_are_clear_of_what_is_no_part_of_the_fence():
    ball = ball_scene(np.array([[0.0, 0.0, 19.0]]), 14.0)  # most of the box of starts
    few = {"safety.filters": [], "world.scene": "x", "rules.trials": 12, "rules.max_time_s": 0.05}
    run = fly(few, scene=ball)
    free = fly({key: value for key, value in few.items() if key != "world.scene"})
    apart = np.linalg.norm(np.array([t.start_m for t in run.trials]) - (0, 0, 19.0), axis=1)
    assert apart.min() >= 14.25 - 1e-6
    before = np.linalg.norm(np.array([t.start_m for t in free.trials]) - (0, 0, 19.0), axis=1)
    kept = before > 14.5
    assert 0 < kept.sum() < 12
    same = [a.start_m == b.start_m for a, b in zip(run.trials, free.trials, strict=True)]
    assert np.array(same)[kept].all()
    with pytest.raises(UsageError, match=r"`\$\.mission\.start_box_m`: no start in the box is safe"):
        fly(few, scene=ball_scene(np.array([[0.0, 0.0, 19.0]]), 30.0))


# Guarantees and notes.


HEAVY = {"vehicle.mass_scale": 1.5, "rules.trials": 8, "rules.max_time_s": 3.0}


def test_what_the_filter_does_not_know_makes_it_leave_and_is_said():
    run = fly(HEAVY)
    summary = world_summary(run)
    found = summary["fence"]
    assert found["violations"] == sum(trial.collision for trial in run.trials) > 0
    assert found["min_distance_m"] == run.trials[summary["worst_trial"]].fence_clearance_m < 0
    said = world_guarantee(run, None)
    assert "mass_scale 1.5" in said.statement
    assert "The vehicle differed from the filter's model" in said.statement
    assert said.claims["as_modelled"] is False
    assert said.claims["proven_by_filter"] is False
    careful = fly(HEAVY | {"safety.geofence.reserve_m": 6.0})
    assert world_summary(careful)["fence"]["violations"] == 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, None),
        ({"estimation.lost_from_s": 0.05}, None),  # the filter tells
        ({"vehicle.thrust_scale": 0.9}, "thrust_scale 0.9"),
        ({"vehicle.rate_gain_scale": 0.7}, "rate_gain_scale 0.7"),
        ({"estimation.delay_s": 0.02}, "delay_s 0.02"),
        ({"estimation.delay_s": 0.02, "safety.geofence.latency_s": 0.02}, None),
        ({"vehicle.disturbance.sag_share": 0.2}, "sag_share 0.2"),
        ({"vehicle.disturbance.linear_drag_n_s_m": (0.1, 0.1, 0.1)}, "drag"),
    ],
)
def test_the_guarantee_says_how_the_truth_differs_from_the_model(changes, words):
    said = world_guarantee(fly(changes | {"rules.trials": 1, "rules.max_time_s": 0.1}), None)
    assert said.claims["as_modelled"] is (words is None)
    assert said.statement.startswith("As long as the model is right, h_I > 0 at the start")
    assert ("differed" in said.statement) is (words is not None)
    assert words is None or words in said.statement


def test_notes_say_when_nothing_is_promised():
    lost = {"estimation.lost_from_s": 0.2, "rules.logged": 0, "rules.max_time_s": 1.0, "rules.trials": 2}
    assert any("stale_limit_s" in note for note in world_summary(fly(lost))["notes"])
    blind = lost | {"estimation.lost_from_s": 0.0, "rules.trials": 1}
    assert any("refused" in note for note in world_summary(fly(blind))["notes"])
    start = {"start_m": (15.0, 0.0, 5.0), "start_velocity_m_s": (30.0, 0.0, 0.0)}
    run = fly({"rules.max_time_s": 0.5, "rules.trials": 1}, start)
    assert run.start_h_i_m < 0
    summary = world_summary(run)
    assert summary["fence"]["start_h_i_m"] == run.start_h_i_m
    assert any("braking from there is not known" in note for note in summary["notes"])


@pytest.mark.parametrize(
    ("changes", "start", "words"),
    [
        (
            {},
            {"start_m": (19.9, 0.0, 5.0)},
            r"`\$\.mission\.start_m`: the start .* is 0\.15 m inside .* outside",
        ),
        (
            {"mission.start_box_m": (30, 0, 1, 31, 1, 2)},
            None,
            r"`\$\.mission\.start_box_m`: no start in the box",
        ),
        (
            {"vehicle.disturbance.wind_m_s": (1, 0, 0)},
            None,
            r"`\$\.vehicle.*`: wind and gusts act through drag",
        ),
        ({"vehicle.radius_m": 200.0}, None, r"`\$\.safety\.geofence`: "),
        ({"vehicle.radius_m": 200.0, "safety.filters": []}, None, r"`\$\.safety\.geofence`: "),
    ],
)
def test_numbers_that_mean_nothing_together_name_their_key(changes, start, words):
    with pytest.raises(UsageError, match=words):
        fly(changes | {"rules.trials": 1}, start)


def test_a_gain_that_is_too_high_matters_only_to_the_regulation_function():
    late = {"rules.trials": 1, "rules.max_time_s": 0.05}
    with pytest.raises(UsageError, match=r"beta = 1000 takes over too late"):
        fly(late | {"safety.geofence.beta": 1000.0})
    fly(late | {"safety.geofence.beta": 1000.0, "safety.filters": []})
    fly(late | {"safety.geofence.beta": 1000.0, "safety.filters": ["backup-qp"]})
