"""Simulated flights: pairs, outcomes, verdicts, plans, filters of other packages."""

import dataclasses

import msgspec
import numpy as np
import pytest

from alula.schemas import foreign_filters
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering import registry
from alula.stages.filtering.protocol import FilterResult, FilterStatus, FilterWorld
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.simulation.hulls.simulate import simulate
from alula.stages.simulation.pairs import central_box, sample_pairs
from support.small_scenes import ball_scene, box_cover, line_plan

TWO_BLOCKS = [((10, 10, 0), (14, 30, 20)), ((24, 0, 0), (28, 20, 20))]
ROOM = (0.0, 0.0, 0.0, 4.0, 4.0, 2.0)


def quick(**options):
    return SimulateConfig(**{"trials": 12, "bounds": ROOM, "max_time_s": 40.0, **options})


def test_filtered_flights_stay_clear_and_unfiltered_ones_do_not():
    cover = box_cover(TWO_BLOCKS)
    filtered, free = (simulate(quick(filter=name), cover) for name in ("polytope-cbf", "none"))
    assert filtered.summary["collisions"] == 0
    assert filtered.summary["min_map_clearance_m"] >= 0
    assert filtered.summary["filtered_steps"] > 0
    assert filtered.guarantee.claims["proven_by_filter"]
    assert free.summary["collisions"] > 0
    assert free.summary["reached"] == 12
    assert free.summary["success_rate"] == 1 - free.summary["collisions"] / 12
    assert free.summary["filtered_steps"] == 0
    assert not free.guarantee.claims["proven_by_filter"]
    assert [t.start_m for t in filtered.trials] == [t.start_m for t in free.trials]
    for result in (filtered, free):
        outcomes = sum(result.summary[name] for name in ("reached", "stuck", "timeout", "refused"))
        assert outcomes == result.summary["trials"] == 12
        for trial in result.trials:
            assert trial.max_speed_m_s <= 1 + 1e-6
            assert np.linalg.norm(np.subtract(trial.goal_m, trial.start_m)) >= 0.3 * 6


def test_a_start_that_violates_the_filters_condition_is_stated():
    """psi >= radius is the filter's premise; psi may be below it although the sphere touches nothing."""
    cover = box_cover([((10, 10, 0), (14, 30, 20))])  # up to x = 1.4 m, y = 3 m
    config = SimulateConfig(max_time_s=5.0, allow_tight=True)
    beside = simulate(config, cover, plan=line_plan([1.5, 2.0, 1.0], [3.0, 2.0, 1.0]))
    assert beside.trials[0].start_margin_m == pytest.approx(0.1 - 0.15, abs=1e-4)
    corner = simulate(config, cover, plan=line_plan([1.52, 3.12, 1.0], [3.0, 3.5, 1.0]))
    assert corner.trials[0].map_clearance_m >= 0
    assert corner.trials[0].start_margin_m == pytest.approx(0.12 - 0.15, abs=1e-4)
    for result in (beside, corner):
        assert result.summary["unsafe_starts"] == 1
        assert "1 of 1 flights began with psi below the radius" in result.summary["notes"][-1]
        assert "1 of 1 starts violated this condition" in result.guarantee.statement
        assert result.guarantee.claims["unsafe_starts"] == 1
        assert not result.guarantee.claims["proven_by_filter"]
    clear = simulate(config, cover, plan=line_plan([1.6, 2.0, 1.0], [3.0, 2.0, 1.0]))
    assert clear.trials[0].start_margin_m == pytest.approx(0.05, abs=1e-4)
    assert clear.summary["unsafe_starts"] == 0
    assert "notes" not in clear.summary
    assert clear.guarantee.claims["proven_by_filter"]


def test_nothing_depends_on_the_number_of_threads():
    cover = box_cover(TWO_BLOCKS)
    one, two = (simulate(quick(), cover, jobs=jobs) for jobs in (1, 2))
    assert one.trials == two.trials
    assert one.summary == two.summary
    for a, b in zip(one.flights, two.flights, strict=True):
        for field in dataclasses.fields(a):
            assert getattr(a, field.name).tobytes() == getattr(b, field.name).tobytes()


def test_a_trial_does_not_depend_on_how_many_there_are_but_on_the_seed():
    cover = box_cover(TWO_BLOCKS)
    few, many, other = (
        simulate(quick(trials=n, seed=seed), cover).trials for n, seed in ((3, 0), (12, 0), (3, 1))
    )
    assert few == many[:3]
    assert few != other


def test_a_goal_behind_a_flat_wall_leaves_the_flight_stuck():
    wall = box_cover([((20, -50, -50), (22, 90, 70))])
    result = simulate(quick(trials=8, bounds=(0.0, 1.0, 0.0, 4.0, 1.2, 0.2), separation=0.6), wall)
    crossing = [t for t in result.trials if (t.start_m[0] < 2) != (t.goal_m[0] < 2)]
    assert crossing
    assert all(t.outcome == "stuck" for t in crossing)
    assert result.summary["collisions"] == 0


def test_too_little_time_is_a_failure():
    result = simulate(quick(trials=2, max_time_s=0.5), box_cover(TWO_BLOCKS))
    assert result.summary["timeout"] == 2
    assert result.summary["success_rate"] == 0
    assert result.summary["mean_path_ratio"] is None
    assert [t.steps for t in result.trials] == [50, 50]


def test_a_scene_keeps_starts_away_and_is_judged_too():
    cover, scene = box_cover(TWO_BLOCKS), ball_scene([[2.0, 3.0, 1.0]], 0.6)
    result = simulate(quick(trials=20, filter="none"), cover, scene=scene)
    for trial in result.trials:
        for point in (trial.start_m, trial.goal_m):
            assert np.linalg.norm(np.subtract(point, [2.0, 3.0, 1.0])) >= 0.6 + 0.1 + 0.05 - 1e-6
    hit = [t for t in result.trials if t.scene_clearance_m < 0]
    assert hit  # the ball is not in the cover
    assert all(t.collision for t in hit)
    assert result.summary["min_scene_clearance_m"] == min(t.scene_clearance_m for t in result.trials)


def test_a_plan_is_flown_as_it_is_when_it_is_clear():
    plan = line_plan([0.2, 0.2, 1.0], [2.0, 3.6, 1.0])
    result = simulate(SimulateConfig(), box_cover([TWO_BLOCKS[1]]), plan=plan)
    (trial,) = result.trials
    assert trial.outcome == "reached"
    assert trial.filtered_steps == 0
    # forward Euler lags by about half a step of the reference
    reference = sample_plan(plan, 0.01).position_world
    flown, stride = result.flights[0], 5
    lag = np.linalg.norm(flown.position[:100] - reference[::stride][:100], axis=1)
    assert lag.max() < 0.01
    assert trial.duration_s == pytest.approx(6.0, abs=0.05)
    assert "0.15 m" in result.vehicle  # the plan's own radius
    assert "2.25 m/s" in result.vehicle


def test_a_plan_through_a_block_is_held_off():
    plan = line_plan([0.2, 2.0, 1.0], [3.8, 2.0, 1.0])
    result = simulate(SimulateConfig(max_time_s=20.0, allow_tight=True), box_cover(TWO_BLOCKS), plan=plan)
    (trial,) = result.trials
    assert not trial.collision
    assert trial.map_clearance_m >= 0
    assert trial.filtered_steps > 0
    assert trial.outcome in ("stuck", "timeout")


def test_a_plan_that_starts_too_close_recovers_and_counts_as_collision():
    plan = line_plan([0.95, 2.0, 1.0], [0.2, 2.0, 1.0])
    (trial,) = simulate(SimulateConfig(allow_tight=True), box_cover(TWO_BLOCKS), plan=plan).trials
    assert trial.fallback_steps > 0
    assert trial.collision
    assert trial.map_clearance_m == pytest.approx(0.05 - 0.15, abs=1e-9)


def test_plan_samples_are_the_polynomials():
    plan = line_plan([0.0, 1.0, 2.0], [3.0, 1.0, 2.0], duration_s=2.0)
    reference = sample_plan(plan, 0.3)
    time = np.minimum(np.arange(8) * 0.3, 2.0)
    tau = time / 2
    assert reference.position_world[:, 0] == pytest.approx(
        3 * (35 * tau**4 - 84 * tau**5 + 70 * tau**6 - 20 * tau**7), abs=1e-12
    )
    assert reference.velocity_world[:, 0] == pytest.approx(1.5 * 140 * tau**3 * (1 - tau) ** 3, abs=1e-12)
    assert reference.position_world[-1] == pytest.approx([3, 1, 2])
    assert np.abs(reference.velocity_world[-1]).max() < 1e-12


def test_inputs_that_do_not_fit_are_refused():
    cover = box_cover(TWO_BLOCKS)
    ball = [[2.0, 3.0, 1.0]]
    with pytest.raises(InputError, match="frame 'other'"):
        simulate(quick(), cover, scene=ball_scene(ball, 0.6, frame="other"))
    with pytest.raises(InputError, match="not metres"):
        simulate(quick(), cover, scene=ball_scene(ball, 0.6, unit="arbitrary"))
    with pytest.raises(InputError, match="frame 'other'"):
        simulate(SimulateConfig(), cover, plan=line_plan([0, 0, 0], [1, 0, 0], frame="other"))
    with pytest.raises(UsageError, match="flown once"):
        simulate(quick(trials=3), cover, plan=line_plan([0, 0, 0], [1, 0, 0]))
    with pytest.raises(UsageError, match=r"'cbf'; known: none, polytope-cbf"):
        simulate(quick(filter="cbf"), cover)
    with pytest.raises(UsageError, match="--bounds"):
        simulate(SimulateConfig(trials=1), box_cover([]))


def test_without_room_for_pairs_it_says_so():
    with pytest.raises(InfeasibleError, match="trial 0"):
        simulate(quick(bounds=(1.1, 1.2, 0.2, 1.3, 2.8, 1.8)), box_cover(TWO_BLOCKS))


def test_pairs_are_clear_apart_uniform_and_counted():
    def psi(points):
        return np.abs(points[:, 0] - 0.5) - 0.1  # a slab in the middle

    pairs = sample_pairs(400, 7, (np.zeros(3), np.ones(3)), 0.5, psi, lambda points, hard: hard >= 0.05)
    assert (np.linalg.norm(pairs.goal - pairs.start, axis=1) >= 0.5).all()
    for points in (pairs.start, pairs.goal):
        assert (psi(points) >= 0.05).all()
        assert ((points >= 0) & (points <= 1)).all()
    assert abs(pairs.start[:, 1].mean() - 0.5) < 0.06  # 4 standard errors
    share = pairs.sampled_inside_hulls / pairs.sampled
    assert share == pytest.approx(0.2, abs=0.05)


def test_default_bounds_leave_out_far_vertices():
    blocks = [((i, 0, 0), (i + 1, 1, 1)) for i in range(199)] + [((5000, 0, 0), (5001, 1, 1))]
    _, upper = central_box(Hulls.from_cover(box_cover(blocks)).vertices_world, None, "hulls")
    assert upper[0] < 20.1


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


class Point:
    def __init__(self, name, target):
        self.name, self.value, self.target = name, f"elsewhere:{name}", target

    def load(self):
        if self.target is None:
            raise ImportError("no module named 'elsewhere'")
        return self.target


@pytest.fixture
def others(monkeypatch):
    points = [Point("timid", Timid), Point("broken", Broken), Point("absent", None), Point("none", Broken)]
    monkeypatch.setattr(
        foreign_filters, "entry_points", lambda group: points if group == "alula.filters" else []
    )


def test_a_filter_from_another_package_flies(others):
    assert registry.filter_names()[:2] == ["none", "polytope-cbf"]
    assert registry.filter_names()[-3:] == ["absent", "broken", "timid"]
    cover = box_cover([((90, 90, 90), (91, 91, 91))])
    result = simulate(quick(trials=2, filter="timid"), cover)
    assert result.summary["filter_kind"] == "python filter"
    assert result.summary["filtered_steps"] == result.summary["steps"] > 0
    assert all(t.max_speed_m_s <= 0.1 + 1e-9 for t in result.trials)
    assert "does not check what the filter 'timid' guarantees" in result.guarantee.statement
    assert (result.filter_s > 0).all()
    given = quick(trials=4, filter="timid", filter_parameters={"stop_x": 0.0})
    refused = simulate(given, cover)
    assert refused.summary["refused"] == 4
    assert [t.infeasible_steps for t in refused.trials] == [1] * 4


def test_a_python_filter_that_passes_everything_flies_as_none_does(others, monkeypatch):
    cover = box_cover(TWO_BLOCKS)
    passing = lambda self, state, nominal: FilterResult(nominal.velocity, FilterStatus.OK, 1.0)  # noqa: E731
    monkeypatch.setattr(Timid, "__call__", passing)
    mine, native = (simulate(quick(trials=3, filter=name), cover).trials for name in ("timid", "none"))
    assert mine == native


def test_filters_that_fail_are_named(others):
    cover = box_cover(TWO_BLOCKS)
    with pytest.raises(UsageError, match="cannot be loaded from elsewhere:absent"):
        simulate(quick(filter="absent"), cover)
    with pytest.raises(InputError, match="no velocity"):
        simulate(quick(filter="broken"), cover)
    assert simulate(quick(trials=1, filter="none"), cover).summary["reached"] == 1  # ours, not theirs


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("radius_m", -1.0),
        ("speed_m_s", 0.0),
        ("gain", 0.0),
        ("kappa_per_m", 0.0),
        ("trials", 0),
        ("dt_s", 0.0),
        ("max_time_s", 0.0),
        ("log_rate_hz", 0.0),
        ("separation", 1.0),
        ("stop_fraction", 0.0),
        ("margin_m", float("nan")),
        ("bounds", (0.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        ("smoothing", "some"),
        ("name", " "),
    ],
)
def test_configurations_without_meaning_are_refused(field, value):
    with pytest.raises(UsageError):
        SimulateConfig(**{field: value})


@pytest.mark.parametrize(("field", "value", "most"), [("beta", 200.0, 100), ("gain", 300.0, 200)])
def test_gains_that_are_too_high_for_the_time_step_are_refused(field, value, most):
    with pytest.raises(UsageError, match=f"dt = {most} at --dt 0.01, not {value:g}"):
        simulate(quick(**{field: value}), box_cover(TWO_BLOCKS))


def test_results_are_plain_json():
    result = simulate(quick(trials=1), box_cover(TWO_BLOCKS))
    for value in (result.trials, result.summary, result.guarantee):
        assert msgspec.json.decode(msgspec.json.encode(value)) is not None
