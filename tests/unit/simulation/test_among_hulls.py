"""Points moved by velocities among hulls: pairs, outcomes, verdicts, plans, proofs, foreign filters."""

import hashlib
import math
import re
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.scenarios.scenario import decoded
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering import registry
from alula.stages.filtering.polytope_cbf import barrier
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.runlog import world as runlog
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.simulate import simulate_world
from alula.stages.simulation.summary import world_guarantee, world_summary, world_words
from support.flights.foreign_filters import provide
from support.flights.world_runs import set_value
from support.scenes.small_scenes import ball_scene, box_cover, line_plan

TWO_BLOCKS = [((10, 10, 0), (14, 30, 20)), ((24, 0, 0), (28, 20, 20))]
ROOM = (0.0, 0.0, 0.0, 4.0, 4.0, 2.0)
POINT = {"type": "single-integrator", "radius_m": 0.1, "max_speed_m_s": 1.0}
FAST = POINT | {"radius_m": 0.15, "max_speed_m_s": 2.25}  # for plans of `line_plan`


def made(filters=("polytope-cbf",), vehicle=POINT, **tables):
    """A scenario of twelve pairs in a room with a cover, or with other tables."""
    world = {"cover": "x"} | tables.pop("world", {})
    mission = {"bounds_m": ROOM, "beyond_map_m": 10.0} | tables.pop("mission", {})
    rules = {"trials": 12, "max_time_s": 40.0} | tables.pop("rules", {})
    safety = {"filters": filters} | tables.pop("safety", {})
    return decoded(
        {"vehicle": vehicle, "world": world, "mission": mission, "safety": safety, "rules": rules} | tables
    )


def simulated(cover, *filters, scene=None, pairs=None, jobs=1, **tables):
    if scene is not None:
        tables["world"] = {"scene": "x"} | tables.get("world", {})
    scenario = made(filters or ("polytope-cbf",), **tables)
    return simulate_world(scenario, cover=cover, scene=scene, pairs=pairs, jobs=jobs)


def along(cover, plan, *filters, vehicle=FAST, allow_tight=True, jobs=1, **tables):
    mission = {"kind": "plan", "plan": "x", "allow_tight": allow_tight, "beyond_map_m": 10.0} | tables.pop(
        "mission", {}
    )
    scenario = decoded(
        {
            "vehicle": vehicle,
            "world": {"cover": "x"},
            "mission": mission,
            "safety": {"filters": filters or ("polytope-cbf",)},
        }
        | tables
    )
    return simulate_world(scenario, cover=cover, plan=plan, jobs=jobs)


def test_filtered_flights_stay_clear_and_unfiltered_ones_do_not():
    cover = box_cover(TWO_BLOCKS)
    runs = [simulated(cover, name) for name in ("polytope-cbf", "none")]
    filtered, free = map(world_summary, runs)
    assert filtered["collisions"] == 0
    assert filtered["min_map_clearance_m"] >= 0
    assert filtered["filtered_steps"] > 0
    assert world_guarantee(runs[0], cover).claims["proven_by_filter"]
    assert free["collisions"] > 0
    assert free["reached"] == 12
    assert free["success_rate"] == 1 - free["collisions"] / 12
    assert free["filtered_steps"] == 0
    assert not world_guarantee(runs[1], cover).claims["proven_by_filter"]
    assert [t.start_m for t in runs[0].trials] == [t.start_m for t in runs[1].trials]
    for run, summary in zip(runs, (filtered, free), strict=True):
        assert sum(summary[name] for name in ("reached", "stuck", "timeout", "refused")) == 12
        assert summary["trials"] == 12
        assert summary["filter_kind"] == "native"
        for trial in run.trials:
            assert trial.max_speed_m_s <= 1 + 1e-6
            assert np.linalg.norm(np.subtract(trial.goal_m, trial.start_m)) >= 0.3 * 6


# First 16 digits of the SHA-256 of all paths, outcomes, filtered steps and the minimum clearance of the
# hulls [m], as flown by the loop of a single integrator that this one replaced.
FLOWN = {
    "polytope-cbf": (
        "055ab50652a1fdc9",
        ["stuck", "reached", "reached", "reached", "reached", "stuck"],
        [1199, 319, 360, 0, 0, 1096],
        0.01792322958355813,
    ),
    "none": (
        "9040196ffb606ea4",
        ["reached"] * 6,
        [0] * 6,
        -0.3000000000000056,
    ),
    "paper": (
        "9b6be0a22d04f6a4",
        ["stuck", "reached", "reached", "reached", "reached", "stuck"],
        [1190, 302, 348, 0, 0, 1082],
        5.596526915646605e-06,
    ),
    "onboard": (
        "85e68148b4da6378",
        ["stuck", "reached", "reached", "reached", "reached", "stuck"],
        [1199, 319, 360, 0, 0, 1096],
        0.017952316650207523,
    ),
}
FLOWN["scene"] = FLOWN["polytope-cbf"]
HOW = {
    "none": {"safety": {"filters": []}},
    "paper": {"safety": {"polytope-cbf": {"smoothing": "paper"}}},
    "onboard": {"world": {"onboard": True}},
    "scene": {"scene": ball_scene([[2.0, 3.0, 1.0]], 0.6)},
}


def same_as_before(ready, expected):
    digest, outcomes, filtered, clearance = expected
    logs = ready.fly(0, len(outcomes), jobs=1)
    trials = [ready.judged(i, log) for i, log in enumerate(logs)]
    assert [t.outcome for t in trials] == outcomes
    assert [t.filtered_steps for t in trials] == filtered
    assert min(t.map_clearance_m for t in trials) == clearance
    found = hashlib.sha256(b"".join(log["path"].tobytes() for log in logs)).hexdigest()
    return found[:16] == digest


@pytest.mark.parametrize("name", FLOWN)
def test_flights_are_those_of_the_older_loop_bit_by_bit(name):
    tables = dict(HOW.get(name, {}))
    scene = tables.pop("scene", None)
    if scene is not None:
        tables["world"] = {"scene": "x"}
    scenario = made(**tables, rules={"seed": 11, "trials": 6, "max_time_s": 20.0})
    ready = prepare(scenario, cover=box_cover(TWO_BLOCKS), scene=scene)
    assert ready.missions.start[0].tolist() == [0.5080701306974351, 2.738514453837221, 1.2759625431129606]
    assert ready.missions.counts["sampled_points"] == 20
    assert ready.missions.counts["sampled_inside_obstacles"] == 4
    assert same_as_before(ready, FLOWN[name])


def test_a_plan_is_flown_as_by_the_older_loop_bit_by_bit():
    tables = {"vehicle": FAST, "world": {"cover": "x"}, "safety": {"filters": ["polytope-cbf"]}}
    mission = {"kind": "plan", "plan": "x", "allow_tight": True, "beyond_map_m": 10.0}
    scenario = decoded(tables | {"mission": mission, "rules": {"max_time_s": 20.0}})
    plan = line_plan([0.2, 0.2, 1.0], [2.0, 3.6, 1.0])
    ready = prepare(scenario, cover=box_cover(TWO_BLOCKS), plan=plan)
    assert same_as_before(ready, ("481b30952b9faa7f", ["off-plan"], [205], 0.023984104164004427))


@pytest.mark.parametrize("filters", [(), ("polytope-cbf",), ("polytope-cbf", "timid")])
def test_every_filter_flies_the_same_pairs_which_are_clear_by_psi(others, filters):
    cover, scene = box_cover(TWO_BLOCKS), ball_scene([[2.0, 3.0, 1.0]], 0.6)
    fence = {"box_m": (0.0, 0.0, 0.0, 4.0, 3.8, 2.0)}
    world = {"scene": "x", "fence": fence, "inflation_m": 0.03}
    ready = prepare(made(filters, world=world, rules={"trials": 40}), cover=cover, scene=scene)
    ends = np.concatenate([ready.missions.start, ready.missions.goal])
    bare = prepare(made((), world=world, rules={"trials": 40}), cover=cover, scene=scene)
    np.testing.assert_array_equal(ends, np.concatenate([bare.missions.start, bare.missions.goal]))
    known = FilterWorld(hulls=Hulls.from_cover(cover), radius_m=0.13, speed_m_s=1.0, dt_s=0.01)
    assert barrier(known).psi(ends)[1].min() >= 0.1 + 0.03 + 0.05 - 1e-4
    assert (np.linalg.norm(ends - [2.0, 3.0, 1.0], axis=1) >= 0.6 + 0.1 + 0.03 + 0.05 - 1e-6).all()
    assert (ends[:, 1] <= 3.8 - 0.1 - 0.05).all()


def test_a_start_that_violates_the_filters_condition_is_stated():
    """psi >= radius is the filter's premise; psi may be below it although the sphere touches nothing."""
    cover = box_cover([((10, 10, 0), (14, 30, 20))])  # up to x = 1.4 m, y = 3 m
    rules = {"rules": {"max_time_s": 5.0}}
    beside = along(cover, line_plan([1.5, 2.0, 1.0], [3.0, 2.0, 1.0]), **rules)
    assert beside.trials[0].start_margin_m == pytest.approx(0.1 - 0.15, abs=1e-4)
    corner = along(cover, line_plan([1.52, 3.12, 1.0], [3.0, 3.5, 1.0]), **rules)
    assert corner.trials[0].map_clearance_m >= 0
    assert corner.trials[0].start_margin_m == pytest.approx(0.12 - 0.15, abs=1e-4)
    for run in (beside, corner):
        summary, guarantee = world_summary(run), world_guarantee(run, cover)
        assert summary["unsafe_starts"] == 1
        assert "1 of 1 flights began with psi below the radius" in summary["notes"][-1]
        assert "1 of 1 starts violated this condition" in guarantee.statement
        assert guarantee.claims["unsafe_starts"] == 1
        assert not guarantee.claims["proven_by_filter"]
    assert "psi falls to" in world_summary(corner)["notes"][0]
    clear = along(cover, line_plan([1.6, 2.0, 1.0], [3.0, 2.0, 1.0]), **rules)
    assert clear.trials[0].start_margin_m == pytest.approx(0.05, abs=1e-4)
    assert world_summary(clear)["unsafe_starts"] == 0
    assert "notes" not in world_summary(clear)
    assert world_guarantee(clear, cover).claims["proven_by_filter"]


WORSE = [
    {"estimation": {"position_noise_m": 0.01}},
    {"estimation": {"velocity_noise_m_s": 0.01}},
    {"estimation": {"delay_s": 0.02}},
    {"estimation": {"lost_share": 0.1}},
    {"estimation": {"lost_from_s": 1.0}},
    {"vehicle": {"type": "double-integrator", "interface": "velocity"}},
    {"vehicle": {"type": "crazyflie21", "interface": "velocity"}},
    {"filters": ("polytope-cbf", "timid")},
    {"safety": {"polytope-cbf": {"smoothing": "paper"}}},
]


@pytest.mark.parametrize("tables", WORSE)
def test_nothing_is_proven_of_what_the_proof_leaves_out(others, tables):
    cover = box_cover(TWO_BLOCKS)
    run = simulate_world(made(**({"rules": {"trials": 2, "max_time_s": 0.1}} | tables)), cover=cover, jobs=1)
    guarantee = world_guarantee(run, cover)
    assert not guarantee.claims.get("proven_by_filter", False)
    assert "From every start" not in guarantee.statement
    assert ("UNSAFE: the smoothing as printed" in guarantee.statement) == ("safety" in tables)


def test_what_is_proven_and_for_what():
    cover = box_cover(TWO_BLOCKS)
    guarantee = world_guarantee(simulated(cover, rules={"trials": 2}), cover)
    assert "From every start with psi >= radius, the filter keeps psi >= radius" in guarantee.statement
    assert "This holds for a velocity-controlled point with exact state" in guarantee.statement
    claims = guarantee.claims
    assert claims["start_condition"] == "psi >= radius"
    assert claims["vehicle_model"] == "single integrator, exact state, input held for dt"
    assert (claims["map_clear"], claims["map_collisions"], claims["continuous_time"]) == (True, 0, True)
    assert claims["cover_claims"] == {"covered": True}


def test_nothing_depends_on_the_number_of_threads():
    cover = box_cover(TWO_BLOCKS)
    one, two = (simulated(cover, jobs=jobs) for jobs in (1, 2))
    assert one.trials == two.trials
    assert world_summary(one) == world_summary(two)
    assert one.flights == two.flights
    assert len(one.flights) > 0


def test_a_trial_does_not_depend_on_how_many_there_are_but_on_the_seed():
    cover = box_cover(TWO_BLOCKS)
    few, many, other = (
        simulated(cover, rules={"trials": n, "seed": seed}).trials for n, seed in ((3, 0), (12, 0), (3, 1))
    )
    assert few == many[:3]
    assert few != other


def test_a_goal_behind_a_flat_wall_leaves_the_flight_stuck():
    wall = box_cover([((20, -50, -50), (22, 90, 70))])
    mission = {"bounds_m": (0.0, 1.0, 0.0, 4.0, 1.2, 0.2), "separation": 0.6}
    run = simulated(wall, mission=mission, rules={"trials": 8})
    crossing = [t for t in run.trials if (t.start_m[0] < 2) != (t.goal_m[0] < 2)]
    assert crossing
    assert all(t.outcome == "stuck" for t in crossing)
    assert world_summary(run)["collisions"] == 0


def test_too_little_time_is_a_failure():
    run = simulated(box_cover(TWO_BLOCKS), rules={"trials": 2, "max_time_s": 0.5})
    summary = world_summary(run)
    assert summary["timeout"] == 2
    assert summary["success_rate"] == 0
    assert summary["mean_path_ratio"] is None
    assert [t.steps for t in run.trials] == [50, 50]


def test_a_scene_keeps_starts_away_and_is_judged_too():
    cover, scene = box_cover(TWO_BLOCKS), ball_scene([[2.0, 3.0, 1.0]], 0.6)
    run = simulated(cover, "none", scene=scene, rules={"trials": 20})
    for trial in run.trials:
        for point in (trial.start_m, trial.goal_m):
            assert np.linalg.norm(np.subtract(point, [2.0, 3.0, 1.0])) >= 0.6 + 0.1 + 0.05 - 1e-6
    hit = [t for t in run.trials if t.scene_clearance_m < 0]
    assert hit  # the ball is not in the cover
    assert all(t.collision for t in hit)
    assert world_summary(run)["min_scene_clearance_m"] == min(t.scene_clearance_m for t in run.trials)


def test_a_plan_is_flown_as_it_is_when_it_is_clear():
    plan = line_plan([0.2, 0.2, 1.0], [2.0, 3.6, 1.0])
    run = along(box_cover([TWO_BLOCKS[1]]), plan, allow_tight=False)
    (trial,), (flight,) = run.trials, run.flights
    assert trial.outcome == "reached"
    assert trial.filtered_steps == 0
    # forward Euler lags by about half a step of the reference
    reference = sample_plan(plan, 0.01)
    position, stride = flight.rows("state")[:, :3], round(1 / (0.01 * run.scenario.rules.log_rate_hz))
    count = min(len(position) - 1, len(reference) // stride)
    lag = np.linalg.norm(position[:count] - reference[::stride][:count], axis=1)
    assert count >= 100
    assert lag.max() < 0.01
    assert trial.duration_s == pytest.approx(6.0, abs=0.05)
    words = world_words(run.scenario, run.vehicle)
    assert "0.15 m" in words
    assert "2.25 m/s" in words


def test_the_log_ends_where_the_flight_ended_and_has_the_filters_margin():
    run = simulated(box_cover(TWO_BLOCKS), rules={"trials": 1, "log_rate_hz": 20.0, "logged": 1})
    (trial,), (flight,) = run.trials, run.flights
    assert flight.time_s(0.01)[-1] == pytest.approx(trial.duration_s)
    end = flight.rows("state")[-1, :3]
    assert np.linalg.norm(end - trial.goal_m) <= 0.01 * trial.straight_length_m + 1e-9
    assert flight.rows("margin").min() >= 0


@pytest.mark.parametrize("name", ["polytope-cbf", "none"])
def test_the_log_shows_the_margin_in_metres_and_velocities(name, monkeypatch):
    shown = []

    class Kept:
        def __init__(self, stream, topics):
            pass

        def send(self, topic, time_ns, message):
            shown.extend([message] if topic == "/safety" else [])

        def finish(self, record):
            pass

    monkeypatch.setattr(runlog, "LogWriter", Kept)
    cover = box_cover(TWO_BLOCKS)
    run = simulated(cover, name, rules={"trials": 1, "logged": 1})
    runlog.write_world_log(
        None,
        SimpleNamespace(trials=run.trials),
        run.flights,
        "world",
        dt_s=0.01,
        interface="velocity",
        filters=list(run.scenario.safety.filters),
        radii_m=[],
        radius_m=0.1,
        hulls=run.world.hulls,
        scene=None,
        sigma=1.0,
        faces=run.world.faces,
    )
    (flight,) = run.flights
    known = FilterWorld(hulls=run.world.hulls, radius_m=0.1, speed_m_s=1.0, dt_s=0.01, extent_m=10.0)
    psi = barrier(known).psi(np.ascontiguousarray(flight.rows("state")[:, :3]))
    nominal, command = flight.rows("nominal"), flight.rows("command")
    for i in range(0, len(nominal) - 1, 7):
        safety = shown[i]
        assert psi[0][i] - 0.1 - 0.02 <= safety.h_m <= psi[1][i] - 0.1 + 1e-4
        assert (safety.margin, safety.margin_unit) == (None, None)
        assert list(safety.u_nom_m_s.tuple) == pytest.approx(nominal[i].tolist(), abs=1e-6)
        assert list(safety.u_safe_m_s.tuple) == pytest.approx(command[i, :3].tolist(), abs=1e-6)


def test_a_plan_through_a_block_is_held_off():
    plan = line_plan([0.2, 2.0, 1.0], [3.8, 2.0, 1.0])
    (trial,) = along(box_cover(TWO_BLOCKS), plan, rules={"max_time_s": 20.0}).trials
    assert not trial.collision
    assert trial.map_clearance_m >= 0
    assert trial.filtered_steps > 0
    assert trial.outcome in ("stuck", "timeout")


def test_a_plan_that_starts_too_close_recovers_and_counts_as_collision():
    plan = line_plan([0.95, 2.0, 1.0], [0.2, 2.0, 1.0])
    (trial,) = along(box_cover(TWO_BLOCKS), plan).trials
    assert trial.fallback_steps > 0
    assert trial.collision
    assert trial.map_clearance_m == pytest.approx(0.05 - 0.15, abs=1e-9)


def test_inputs_that_do_not_fit_are_refused():
    cover = box_cover(TWO_BLOCKS)
    ball = [[2.0, 3.0, 1.0]]
    with pytest.raises(InputError, match="'other'"):
        simulated(cover, scene=ball_scene(ball, 0.6, frame="other"))
    with pytest.raises(InputError, match="not metres"):
        simulated(cover, scene=ball_scene(ball, 0.6, unit="arbitrary"))
    with pytest.raises(InputError, match="'other'"):
        along(cover, line_plan([0, 0, 0], [1, 0, 0], frame="other"))
    with pytest.raises(UsageError, match=r"`\$\.rules\.trials`: all 3 flights would be the same"):
        along(cover, line_plan([0, 0, 0], [1, 0, 0]), rules={"trials": 3})
    with pytest.raises(UsageError, match=r"'cbf'; known: none, polytope-cbf"):
        simulated(cover, "cbf")
    with pytest.raises(UsageError, match=r"set mission\.bounds_m"):
        simulated(box_cover([]), mission={"bounds_m": None}, rules={"trials": 1})


def test_files_that_the_scenario_does_not_name_or_that_are_missing_are_refused():
    cover, scene = box_cover(TWO_BLOCKS), ball_scene([[2.0, 3.0, 1.0]], 0.6)
    with pytest.raises(UsageError, match=r"`\$\.world\.scene`: a scene was given"):
        simulate_world(made(), cover=cover, scene=scene)
    with pytest.raises(UsageError, match=r"`\$\.world\.cover`: the cover 'x' was not given"):
        simulate_world(made(()))


def test_the_pairs_of_another_run_must_be_clear():
    cover = box_cover(TWO_BLOCKS)
    start, goal = np.array([[0.5, 2.0, 1.0]]), np.array([[1.501, 2.0, 1.0]])
    with pytest.raises(UsageError, match=r"`\$\.mission\.pairs_from`: trial 0 ends at \(1\.499"):
        simulated(cover, pairs=Pairs(start, goal - [0.002, 0, 0], 0, 0), rules={"trials": 1})
    run = simulated(cover, pairs=Pairs(start, goal, 0, 0), rules={"trials": 1})
    assert run.trials[0].goal_m == goal[0].tolist()


def test_without_room_for_pairs_it_says_so():
    with pytest.raises(InfeasibleError, match=r"trial 0.*widen mission\.bounds_m"):
        simulated(box_cover(TWO_BLOCKS), mission={"bounds_m": (1.1, 1.2, 0.2, 1.3, 2.8, 1.8)})


class Timid:
    """A filter from elsewhere: flies at a tenth of the speed, and gives up beyond a plane."""

    kind = "velocity"

    def __init__(self, world, parameters):
        assert isinstance(world, FilterWorld)
        self.stop_x = parameters.get("stop_x", np.inf)

    def reset(self):
        pass

    def __call__(self, state, nominal):
        if state.position[0] > self.stop_x:
            return FilterResult(nominal.velocity, FilterStatus.REFUSED, -1.0)
        return FilterResult(0.1 * nominal.velocity, FilterStatus.FILTERED, 1.0)


class Broken(Timid):
    def __call__(self, state, nominal):
        return FilterResult(np.full(3, np.nan), FilterStatus.OK, 1.0)


class Racing(Timid):
    def __call__(self, state, nominal):
        return FilterResult(2 * nominal.velocity, FilterStatus.FILTERED, 1.0)


@pytest.fixture
def others(monkeypatch):
    known = {"timid": Timid, "broken": Broken, "racing": Racing, "absent": None, "none": Broken}
    provide(monkeypatch, known)


def test_a_filter_from_another_package_flies(others):
    assert registry.filter_names()[:2] == ["none", "polytope-cbf"]
    assert registry.filter_names()[-4:] == ["absent", "broken", "racing", "timid"]
    cover = box_cover([((90, 90, 90), (91, 91, 91))])
    run = simulated(cover, "timid", rules={"trials": 2})
    summary = world_summary(run)
    assert summary["filter_kind"] == "python filter"
    assert summary["filtered_steps"] == summary["steps"] > 0
    assert all(t.max_speed_m_s <= 0.1 + 1e-9 for t in run.trials)
    assert "does not check what the filter 'timid' guarantees" in world_guarantee(run, cover).statement
    assert run.filter_times.quantile(1e-9) > 0
    refused = simulated(cover, "timid", rules={"trials": 4}, safety={"timid": {"stop_x": 0.0}})
    assert world_summary(refused)["refused"] == 4
    assert [t.infeasible_steps for t in refused.trials] == [1] * 4


def test_a_python_filter_that_passes_everything_flies_as_none_does(others, monkeypatch):
    cover = box_cover(TWO_BLOCKS)
    passing = lambda self, state, nominal: FilterResult(nominal.velocity, FilterStatus.OK, 1.0)  # noqa: E731
    monkeypatch.setattr(Timid, "__call__", passing)
    mine, native = (simulated(cover, name, rules={"trials": 3}).trials for name in ("timid", "none"))
    of_filters = {"filters", "min_margin", "backup_steps", "certified_steps", "certified_moving_steps"}
    for a, b in zip(mine, native, strict=True):
        same = [name for name in a.__struct_fields__ if name not in of_filters]
        assert [getattr(a, name) for name in same] == [getattr(b, name) for name in same]


def test_filters_that_fail_are_named(others):
    cover = box_cover(TWO_BLOCKS)
    with pytest.raises(UsageError, match="cannot be loaded from elsewhere:absent"):
        simulated(cover, "absent")
    with pytest.raises(InputError, match="no velocity"):
        simulated(cover, "broken")
    with pytest.raises(InputError, match="the filter returned a velocity above the speed limit"):
        simulated(cover, "racing")
    assert world_summary(simulated(cover, "none", rules={"trials": 1}))["reached"] == 1  # ours, not theirs


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("vehicle.radius_m", -1.0),
        ("vehicle.max_speed_m_s", 0.0),
        ("mission.speed_m_s", 0.0),
        ("mission.controller.gain_per_s", 0.0),
        ("safety.polytope-cbf.kappa_per_m", 0.0),
        ("rules.trials", 0),
        ("rules.dt_s", 0.0),
        ("rules.max_time_s", 0.0),
        ("rules.log_rate_hz", 0.0),
        ("mission.separation", 1.0),
        ("mission.stop_fraction", 0.0),
        ("mission.margin_m", math.nan),
        ("mission.bounds_m", (0.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        ("safety.polytope-cbf.smoothing", "some"),
        ("name", " "),
    ],
)
def test_scenarios_without_meaning_are_refused(key, value):
    tree = {"vehicle": dict(POINT), "safety": {"filters": ["polytope-cbf"]}}
    set_value(tree, key, value)
    with pytest.raises(UsageError, match=re.escape(f"`$.{key}")):
        decoded(tree)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"safety": {"polytope-cbf": {"beta": 200.0}}}, "at most 1 / dt_s = 100, not 200"),
        (
            {"mission": {"controller": {"gain_per_s": 300.0}}},
            "300 is unstable with rules.dt_s=0.01.*most 200",
        ),
    ],
)
def test_gains_that_are_too_high_for_the_time_step_are_refused(tables, words):
    with pytest.raises(UsageError, match=words):
        simulated(box_cover(TWO_BLOCKS), **tables)


def test_results_are_plain_json():
    cover = box_cover(TWO_BLOCKS)
    run = simulated(cover, rules={"trials": 1})
    for value in (run.trials, world_summary(run), world_guarantee(run, cover)):
        assert msgspec.json.decode(msgspec.json.encode(value)) is not None
