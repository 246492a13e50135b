"""Flights among moving obstacles: stored verdicts, limits, figures, equal results on all workers."""

import json
import math
import pickle
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import MovingFilterParameters
from alula.schemas.scenarios.defaults import vehicle_of
from alula.schemas.scenarios.scenario import Scenario, decoded, read_scenario
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.filtering.moving_filters import moving_options
from alula.stages.simulation import simulate as module
from alula.stages.simulation.chunks import RunParts, TrialChunk, TrialJournal
from alula.stages.simulation.judge import worst_clearance
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.simulate import simulate_world
from alula.stages.simulation.summary import world_guarantee, world_summary, world_timing
from alula.stages.verdict import wilson_interval
from alula.stages.world.obstacles import static_walls
from support.clusters import Cluster
from support.effort import examples
from support.paths import EXAMPLES, SUPPORT

AHEAD = {"motion": "accelerating", "distance_m": 30.0, "acceleration_m_s2": (0.2, 0.8)}
ASIDE = {
    **{"motion": "curving", "distance_m": 30.0, "azimuth_rad": (0.35, 0.6), "either_side": True},
    "heading_rad": (0.4, 0.8),
}
LIMITS = {"max_speed_m_s": 12.0, "max_acceleration_m_s2": 6.0, "max_jerk_m_s3": 60.0}
BASE = {
    "vehicle": {"type": "double-integrator", "radius_m": 0.15, **LIMITS},
    "world": {"moving": [ASIDE, AHEAD]},
    "mission": {
        **{"kind": "goal", "start_m": (0.0, 0.0, 10.0), "goal_m": (200.0, 0.0, 10.0)},
        **{"start_speed_m_s": 4.0, "speed_m_s": 4.0, "receded_s": 1.0},
    },
    "safety": {"filters": ["dr-acbf"]},
    "rules": {"trials": 40, "seed": 3, "logged": 2, "plant_steps": 10, "max_time_s": 14.0},
}


def made(**tables) -> Scenario:
    tree = {key: BASE.get(key, {}) | tables.get(key, {}) for key in {*BASE, *tables}}
    return decoded({"schema": "alula/scenario", "version": "2.0"} | tree, "test")


def behind(name, **parameters):
    """The table `safety` with one filter, or with none."""
    table = {"filters": [] if name == "none" else [name]}
    return table | ({("dr-acbf" if name == "none" else name): parameters} if parameters else {})


def fly(scenario: Scenario, **how):
    return simulate_world(scenario, vehicle_of(scenario, Path()), **how)


def flown(scenario: Scenario, first=0, count=1, **how):
    """Native logs of consecutive trials."""
    whole = msgspec.structs.replace(scenario.rules, trials=first + count)
    ready = prepare(msgspec.structs.replace(scenario, rules=whole), vehicle_of(scenario, Path()))
    return ready.fly(first, count, **how)


def test_defaults_are_those_of_the_native_code():
    scenario = made()
    told = prepare(scenario, vehicle_of(scenario, Path())).told
    given = moving_options(told, MovingFilterParameters())
    options = {key: float(np.float32(value)) for key, value in given.items()}
    native = {key: float(np.float32(value)) for key, value in _core.moving_filter_defaults().items()}
    assert options == native


@settings(max_examples=examples(25), deadline=None)
@given(
    name=st.sampled_from(["dr-acbf", "dr-acbf-qp", "mpc", "cbf-qp", "rp-cbf", "none"]),
    a_max=st.floats(0.5, 20),
    j_max=st.floats(5, 500),
    delay_s=st.floats(0, 0.1),
    trial=st.integers(0, 2**31),
    hovers=st.booleans(),
)
def test_commands_stay_in_the_box_and_the_vehicle_within_its_limits(
    name, a_max, j_max, delay_s, trial, hovers
):
    body = {"max_acceleration_m_s2": a_max, "max_jerk_m_s3": j_max, "actuation_delay_s": delay_s}
    way = {"kind": "hover", "goal_m": None, "start_speed_m_s": 0.0} if hovers else {}
    scenario = made(
        safety=behind(name),
        vehicle=body | {"max_speed_m_s": 7.0},
        mission=way,
        rules={"max_time_s": 6.0, "seed": trial, "trials": 1},
    )
    log = flown(scenario)[0]
    assert np.isfinite(log["state"]).all()
    assert np.abs(log["command"][:, :3]).max() <= a_max * (1 + 1e-6)
    p, v = log["state"][:-1, :3], log["state"][:, 6:9]
    speed = np.linalg.norm(v, axis=1)
    assert log["max_speed_m_s"] <= 7 + 1e-9
    assert speed.max() <= log["max_speed_m_s"]
    free = (speed[2:] < 6.8) & (speed[1:-1] < 6.8) & (speed[:-2] < 6.8)
    jerk = np.diff(v, n=2, axis=0) / 0.01**2
    assert (np.abs(jerk)[free] <= j_max + 1e-6).all()
    norms = np.linalg.norm(jerk, axis=1)
    assert log["max_jerk_m_s3"] == pytest.approx(norms.max())
    assert log["mean_jerk_m_s3"] == pytest.approx(norms.mean())
    assert log["refused_ticks"] == 0
    # The least distances are those of the path, which was sampled 100 times a second.
    gap = np.linalg.norm(log["obstacle"] - p[:, None], axis=2)
    assert (log["closest_m"] <= gap.min(axis=0) + 1e-9).all()
    assert (log["closest_m"] >= gap.min(axis=0) - 0.01 * 25).all()


def test_what_the_filter_commands_is_flown_by_a_point_whose_limit_is_that_of_a_length():
    body = {"max_speed_m_s": None, "max_jerk_m_s3": None, "max_acceleration_m_s2": 6.0}
    log = flown(made(vehicle=body))[0]
    length = np.linalg.norm(log["command"][:, :3], axis=1)
    assert length.max() > 5.9  # it dodges with all it has
    assert length.max() <= 6.0
    assert not (log["mark"] & 4).any()  # and nothing was cut off


def test_no_filter_flies_straight_to_the_goal():
    scenario = made(
        safety=behind("none"),
        world={"moving": []},
        rules={"max_time_s": 40.0, "trials": 1},
        mission={"goal_m": (40, 0, 10)},
    )
    log = flown(scenario)[0]
    assert log["end"] == "timeout"
    assert np.abs(log["state"][:, 1:3] - [0, 10]).max() < 1e-9
    assert abs(log["state"][-1, 0] - 40) < 0.05
    assert log["path_length_m"] >= 40 - 0.05


def test_the_filter_avoids_what_hits_without_it():
    straight = [{"motion": "constant-velocity", "distance_m": 30.0, "speed_m_s": (5.9, 6.1)}]
    hits = fly(made(world={"moving": straight}, safety=behind("none")), jobs=2).trials
    assert all(trial.collision and trial.obstacles[0].collision for trial in hits)
    kept = fly(made(world={"moving": straight}), jobs=2).trials
    assert sum(trial.collision for trial in kept) <= 1
    for trial in kept:
        (met,) = trial.obstacles
        assert met.detected_s <= met.warned_s
        assert met.closest_m <= met.separation_m + 1e-12
        assert 5 < met.closing_m_s < 11


def plain(run) -> tuple:
    """Results that must not depend on the workers."""
    return msgspec.json.encode(run.trials), msgspec.json.encode(run.flights)


def test_results_do_not_depend_on_workers_chunks_or_interruptions(monkeypatch):
    scenario = made()
    whole = fly(scenario, jobs=1)
    assert [trial.index for trial in whole.trials] == list(range(40))
    worst = sorted(whole.trials, key=worst_clearance)[:3]
    assert worst[0].index == 28
    others = sorted(trial.index for trial in worst if trial.index > 1)
    assert [flight.trial for flight in whole.flights] == [0, 1, *others]
    assert plain(fly(scenario, jobs=3)) == plain(whole)

    journal = TrialJournal()

    def stop(done: int, total: int) -> None:
        if done >= 16:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fly(scenario, journal=journal, jobs=1, progress=stop)
    assert len(journal) == 16
    seen = []
    resumed = TrialJournal(journal.snapshot())
    again = fly(scenario, journal=resumed, jobs=2, progress=lambda *at: seen.append(at))
    assert seen[0] == (16, 40)
    assert seen[-1] == (40, 40)
    assert plain(again) == plain(whole)
    monkeypatch.setattr(module, "CHUNK", 7)
    assert plain(fly(scenario, jobs=2)) == plain(whole)
    with pytest.raises(ValueError, match=r"."):
        TrialJournal(b"\x01\x02")


def test_the_filter_sees_its_own_state_with_the_noise_of_the_sensor():
    noisy = {"own_position_sigma_m": 0.05, "own_velocity_sigma_m_s": 0.1}
    (log,) = flown(made(estimation={"sensor": noisy}, safety=behind("none")))
    error = log["estimate"][:, [0, 1, 2, 6, 7, 8]] - log["state"][:-1][:, [0, 1, 2, 6, 7, 8]]
    np.testing.assert_allclose(error.std(axis=0), [0.05] * 3 + [0.1] * 3, rtol=0.15)
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.02)
    (exact,) = flown(made(safety=behind("none")))
    np.testing.assert_array_equal(exact["estimate"], exact["state"][:-1])


def test_a_trial_is_a_function_of_seed_and_number():
    first, other = fly(made()).trials, fly(made(rules={**BASE["rules"], "seed": 4})).trials
    assert msgspec.json.encode(first) != msgspec.json.encode(other)
    more = fly(made(rules={**BASE["rules"], "trials": 50, "logged": 0})).trials
    assert msgspec.json.encode(more[:40]) == msgspec.json.encode(first)


def test_the_trial_that_came_closest_is_always_logged():
    """Not only the closest of the first ones, which is farther away."""
    scenario = made()
    run = fly(scenario)
    gaps = [min(o.closest_m for o in trial.obstacles) for trial in run.trials]
    worst = int(np.argmin(gaps))
    assert worst >= scenario.rules.logged
    shown = {flight.trial: msgspec.json.encode(flight) for flight in run.flights}
    assert {*range(scenario.rules.logged), worst} <= shown.keys()
    assert len(shown) <= scenario.rules.logged + 3
    more = fly(made(rules={"logged": worst + 1}))
    assert msgspec.json.encode(more.flights[worst]) == shown[worst]


def test_a_chunk_that_is_flown_elsewhere_is_the_same():
    walls = [{"lower_m": (-5, 1.5, 0), "upper_m": (60, 2.5, 20)}]
    scenario = made(world={"moving": [AHEAD], "walls": walls}, rules={"trials": 20})
    whole = fly(scenario)
    parts = RunParts("a", scenario, vehicle_of(scenario, Path()), {})
    sent = [pickle.loads(pickle.dumps(TrialChunk(parts, first, 5))) for first in (0, 15)]
    module._prepared_once.cache_clear()
    found = [module.fly_elsewhere(chunk) for chunk in sent]
    assert module._prepared_once.cache_info().misses == 1
    assert [trial for chunk in found for trial in chunk.trials] == whole.trials[:5] + whole.trials[15:]
    assert found[0].flights == whole.flights[:2]
    assert found[1].flights == []


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # those of other packages
def test_a_worker_that_is_lost_loses_nothing(tmp_path):
    scenario = made(rules={"trials": 200})
    whole = fly(scenario, jobs=2)
    cluster = Cluster(tmp_path, 2)
    lost = []

    def progress(done, total):
        if done > total // 4 and not lost:
            lost.append(done)
            cluster.workers[0].kill()

    try:
        far = fly(scenario, scheduler=cluster.wait_for_workers(), progress=progress)
        assert lost
        assert cluster.workers[0].wait() == -9
        assert plain(far) == plain(whole)
    finally:
        cluster.stop()


def test_walls_are_avoided_and_judged_as_the_exact_distance_says():
    walls = [{"lower_m": (-5, side, 0), "upper_m": (60, side + 1, 20)} for side in (1.5, -2.5)]
    scenario = made(world={"moving": [AHEAD], "walls": walls}, safety=behind("dr-acbf", clearance_m=0.6))
    hulls = static_walls(scenario.world.walls, None)
    assert len(hulls) == 2
    trials = fly(scenario).trials
    for trial, log in zip(trials, flown(scenario, count=8), strict=False):
        exact = path_clearance(log["state"][:, :3], hull_obstacles(hulls)).min() - scenario.vehicle.radius_m
        assert trial.map_clearance_m <= exact + 1e-4  # the path of the log has corners
        assert trial.map_clearance_m >= exact - 1e-2
    assert all(trial.map_clearance_m > 0 for trial in trials)
    assert sum(trial.collision for trial in trials) <= 2
    ahead = {"moving": [], "walls": [{"lower_m": (10, -1, 9), "upper_m": (11, 1, 11)}]}
    blind = fly(made(world=ahead, rules={"trials": 1})).trials
    assert all(trial.outcome == "timeout" for trial in blind)


def test_walls_that_are_passed_by_do_not_hide_the_one_ahead():
    slabs = [{"lower_m": (-2, -5 + i / 4, 9), "upper_m": (-0.5, -4.8 + i / 4, 11)} for i in range(40)]
    ahead = {"lower_m": (10, -20, 0), "upper_m": (11, 20, 20)}
    way = {"start_speed_m_s": 0.0, "speed_m_s": 10.0, "controller": {"gain_per_s": 4.0}}
    scenario = made(
        mission=way,
        world={"moving": [], "walls": [*slabs, ahead]},
        rules={"max_time_s": 4.0, "trials": 1},
    )
    assert all(trial.map_clearance_m > 0 for trial in fly(scenario).trials)


def test_a_weak_vehicle_sees_a_wall_in_time_to_stop():
    wall = {"lower_m": (150, -20, 0), "upper_m": (151, 20, 20)}
    scenario = made(
        mission={"goal_m": (1000.0, 0, 10), "start_speed_m_s": 12.0, "speed_m_s": 12.0},
        vehicle={"max_acceleration_m_s2": 1.0},
        world={"moving": [], "walls": [wall]},
        rules={"max_time_s": 40.0, "trials": 1},
    )
    assert all(trial.map_clearance_m > 0 for trial in fly(scenario).trials)


def test_a_trial_is_flown_even_if_nothing_comes():
    gone = {"position_m": (-20.0, 0, 10), "velocity_m_s": (-6.0, 0, 0)}
    scenario = made(world={"moving": [gone]}, mission={"receded_s": 0.0}, rules={"trials": 1})
    (trial,) = fly(scenario).trials
    assert (trial.outcome, trial.steps) == ("passed", 1)
    assert trial.obstacles[0].closest_m == pytest.approx(20, abs=0.2)


def test_the_summary_counts_runs_and_obstacles():
    run = fly(made(safety=behind("none"), rules={"trials": 30}))
    summary = world_summary(run)
    good = sum(not trial.collision for trial in run.trials)
    assert (summary["trials"], summary["collisions"]) == (30, 30 - good)
    assert summary["success_interval"] == list(wilson_interval(good, 30))
    for i, met in enumerate(summary["obstacles"]):
        safe = sum(not trial.obstacles[i].collision for trial in run.trials)
        assert met["success_rate"] == safe / 30
        assert met["success_interval"] == list(wilson_interval(safe, 30))
        assert met["mean_closest_m"] == pytest.approx(np.mean([t.obstacles[i].closest_m for t in run.trials]))
    assert summary["passed"] + summary["timeout"] == 30
    assert summary["moving_collisions"] == summary["collisions"]
    assert summary["active_steps"] == sum(trial.active_steps for trial in run.trials) > 0
    assert summary["mean_mission_risk"] == pytest.approx(np.mean([t.mission_risk for t in run.trials]))
    assert summary["max_jerk_limit_m_s3"] == 60
    json = msgspec.json.decode(msgspec.json.encode(summary))
    assert json == summary  # no number that JSON does not have


def test_times_are_those_of_active_ticks_and_of_each_obstacle():
    run = fly(made(rules={"trials": 20}))
    timing, summary = world_timing(run), world_summary(run)
    assert timing["filter_calls"] == summary["active_steps"] == sum(t.active_steps for t in run.trials) > 0
    assert timing["ticks"] == summary["steps"] > timing["filter_calls"]
    times, ready = run.filter_times, [trial.active_steps for trial in run.trials]
    assert times.calls == sum(ready)
    assert timing["filter_mean_s"] == pytest.approx(timing["filter_total_s"] / times.calls)
    assert 0 < timing["filter_std_s"] < timing["filter_max_s"]
    assert timing["filter_p50_s"] <= timing["filter_p99_s"] <= timing["filter_max_s"]
    warned = np.array([[met.warned_s is not None for met in trial.obstacles] for trial in run.trials])
    reaction = np.array([[met.reaction_s for met in trial.obstacles] for trial in run.trials], np.float64)
    assert np.array_equal(np.isfinite(run.command_s), warned)
    np.testing.assert_array_equal(run.reaction_s, run.command_s + reaction)
    np.testing.assert_allclose(timing["command_mean_s"], np.nanmean(run.command_s, axis=0))
    np.testing.assert_allclose(timing["reaction_mean_s"], np.nanmean(run.reaction_s, axis=0))
    bare = world_timing(fly(made(safety=behind("none"), rules={"trials": 3})))
    assert "filter_calls" not in bare
    assert bare["reaction_mean_s"] == [None, None]  # nothing reacts


def test_nothing_is_promised_of_a_filter_that_goes_by_tracks():
    run = fly(made(rules={"trials": 4}))
    found = world_guarantee(run, None)
    assert found.statement.startswith(
        "dr-acbf decides by what was tracked, tick by tick; nothing was guaranteed"
    )
    assert found.statement.endswith("This holds for the obstacles, the sensor and the vehicle as simulated.")
    hits = sum(trial.collision for trial in run.trials)
    assert found.claims["proven_by_filter"] is False
    assert (found.claims["trials"], found.claims["collisions"]) == (4, hits)


STORED = json.loads((SUPPORT / "vectors_encounters.json").read_text())


@pytest.mark.every(2)
@pytest.mark.parametrize("example", sorted(STORED))
def test_verdicts_are_those_that_an_earlier_loop_gave(example):
    """That loop was another one, with another judge."""
    for name, stored in STORED[example].items():
        trials = len(next(iter(stored.values())))
        changes = {"safety.filters": name, "rules.trials": trials}
        flown = fly(read_scenario(EXAMPLES / "dr-acbf" / f"{example}.toml", changes)).trials
        for key, values in stored.items():
            found = [getattr(trial, key) for trial in flown]
            if key == "obstacles":
                found = [[list(msgspec.structs.asdict(met).values()) for met in each] for each in found]
            assert found == values, (name, key)


def test_what_means_nothing_together_is_refused_with_its_key(tmp_path):
    cases = {
        "vehicle": ({"max_speed_m_s": 12.0}, {"h_max_s": 0.1}, r"\$\.safety\.dr-acbf"),
        "sensor": ({"sigma_range_m": 0.0}, {}, r"\$\.estimation\.sensor"),
        "tracker": ({"transition": (0.5, 0.4, 0.1, 0.9)}, {}, r"\$\.estimation\.tracker"),
    }
    for table, (values, parameters, where) in cases.items():
        changed = {"vehicle": values} if table == "vehicle" else {"estimation": {table: values}}
        with pytest.raises(UsageError, match=where):
            fly(made(**changed, safety=behind("dr-acbf", **parameters)))
    with pytest.raises(UsageError, match=where):
        fly(made(estimation={"tracker": values}, safety=behind("none")))
    with pytest.raises(UsageError, match=r"\$\.safety\.dr-acbf"):
        fly(made(safety=behind("none", h_max_s=0.1)))
    with pytest.raises(UsageError, match=r"\$\.world\.moving\[0\]"):
        fly(made(world={"moving": [{"motion": "constant-velocity", "way_points_m": [(0, 0, 0)]}]}))


def test_the_examples_read_and_fly():

    folder = EXAMPLES / "dr-acbf"
    names = {path.stem for path in folder.glob("*.toml")}
    assert {"scenario-1", "scenario-2", "thrown", "approaching", "wall"} <= names
    for name in sorted(names):
        run = fly(read_scenario(folder / f"{name}.toml", {"rules.trials": 8}))
        assert math.isfinite(sum(o.closest_m for t in run.trials for o in t.obstacles))
        assert all(o.detected_s is not None for t in run.trials for o in t.obstacles)


@settings(deadline=None, max_examples=examples(60))
@given(st.integers(0, 2**32 - 1))
def test_the_risk_bounds_how_often_an_obstacle_hits(seed):
    rng = np.random.default_rng(seed)
    p = rng.normal(size=3) * [4, 1, 1] + [5, 0, 0]
    v, a = rng.normal(size=3) * 2 - [8, 0, 0], rng.uniform(-6, 6, 3)
    factor = np.diag([0.2] * 3 + [0.6] * 3) @ rng.normal(size=(6, 6)) / 2
    covariance = factor @ factor.T
    risk = _core.collision_risk(p, v, covariance[np.tril_indices(6)], a, 0.3, 0.4)
    if p @ v >= 0:
        assert risk == 0
        return
    t = np.linspace(0, 0.4, 4001)[:, None]
    way = p + v * t - a * t**2 / 2
    best = np.linalg.norm(way, axis=1).argmin()
    drawn = rng.multivariate_normal(np.r_[p, v], covariance, 4000)
    then = drawn[:, :3] + t[best] * drawn[:, 3:] - a * t[best] ** 2 / 2
    hits = np.mean(np.linalg.norm(then, axis=1) <= 0.3)
    assert 0 <= risk <= 1
    assert hits <= risk + 4 * math.sqrt(max(risk * (1 - risk), 1e-4) / 4000)
    assert risk == 1 if np.linalg.norm(way[best]) < 0.3 - 1e-6 else True


def test_the_risk_of_a_flight_is_less_with_a_filter_and_bounds_its_collisions():
    risks = {}
    for name in ("none", "dr-acbf", "cbf-qp"):
        trials = fly(made(safety=behind(name))).trials
        hits = np.mean([sum(o.collision for o in t.obstacles) for t in trials])
        assert all((t.risk_spent is None) == (name != "dr-acbf") for t in trials)
        risks[name] = np.mean([t.mission_risk for t in trials])
        assert hits <= risks[name]
    assert max(risks["dr-acbf"], risks["cbf-qp"]) < 0.5 * risks["none"]


def test_a_sensor_that_turns_loses_fewer_obstacles():
    warned = []
    for rate in (0.0, 1.0):
        aside = ASIDE | {"distance_m": 50.0}
        known = {"sensor": {"yaw_rate_rad_s": rate}, "tracker": {"coast_s": 0.0}}
        trials = fly(made(world={"moving": [aside]}, estimation=known)).trials
        warned.append(sum(t.obstacles[0].warned_s is not None for t in trials))
    assert warned[1] > warned[0]


def test_what_is_thrown_is_dodged_on_its_parabola():

    path = EXAMPLES / "dr-acbf" / "thrown.toml"

    def good(changes):
        trials = fly(read_scenario(path, {"rules.trials": 60} | changes)).trials
        return sum(not t.collision for t in trials)

    assert good({}) >= 48
    assert good({"safety.dr-acbf.accelerated": False}) <= 40
    assert good({"safety.filters": "none"}) <= 36


def test_an_obstacle_that_cannot_meet_the_vehicle_is_a_wrong_scenario():
    path = EXAMPLES / "dr-acbf" / "thrown.toml"
    scenario = read_scenario(path, {"rules.trials": 1, "world.moving.0.drag_per_m": 5.0})
    with pytest.raises(UsageError, match=r"\$\.world\.moving`: with this drag no throw reaches"):
        fly(scenario)
