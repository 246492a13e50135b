"""Whether a flight followed its plan: via points in their order, the tube, room for the filter."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import UsageError
from alula.schemas.log.run import PlanResult
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.adherence import PlanJudge, complaint, outcome_of_plan, require_room, via_tolerance
from alula.stages.planning.plan import plan, resolve_plan
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.simulation.simulate import simulate_world
from alula.stages.simulation.summary import world_summary
from support.effort import examples
from support.scenes.covers import boxes_cover

WALLS = [(10, -30, 0, 12, -4, 20), (10, 4, 0, 12, 30, 20)]  # a door 0.8 m wide at x = 1, in cells of 0.1 m
CONFIG = PlanConfig(
    beyond_map_m=3.0, start=(0, 0, 1), goal=(3, 0, 1), via=((1.1, 0, 1), (2, 0.5, 1)), radius_m=0.2
)


@pytest.fixture(scope="module")
def cover():
    return boxes_cover(WALLS)


@pytest.fixture(scope="module")
def flight(cover):
    return plan(CONFIG, cover)


def judge_of(flight, cover, *, radius=0.1, tolerance=0.1):
    return PlanJudge(flight, [hull_obstacles(Hulls.from_cover(cover))], radius, tolerance)


def test_a_flight_on_the_plan_passes_all(flight, cover):
    path = sample_plan(flight, 0.01)
    result = judge_of(flight, cover).result(path)
    assert result.missed == []
    assert max(result.closest_m) < 0.02
    assert result.outside_m == 0
    assert outcome_of_plan("reached", result) == "reached"
    assert complaint(result) is None


def test_via_points_are_passed_in_their_order(flight, cover):
    path = sample_plan(flight, 0.01)
    result = judge_of(flight, cover).result(path[::-1])  # the second one first
    assert result.missed == [2]
    assert outcome_of_plan("reached", result) == "missed-via"
    assert "via point 2 was missed" in complaint(result)
    assert outcome_of_plan("stuck", result) == "stuck"


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=examples(40), deadline=None)
def test_the_closest_approach_is_that_of_dense_samples(flight, cover, seed):
    rng = np.random.default_rng(seed)
    path = np.array([1, 0, 1]) + np.cumsum(rng.normal(size=(12, 3)) * 0.3, axis=0)
    result = judge_of(flight, cover, tolerance=1e-9).result(path)
    share = np.linspace(0, 1, 400)[:, None]
    dense = np.concatenate([a + share * (b - a) for a, b in pairwise(path)])
    for closest, point in zip(result.closest_m, CONFIG.via, strict=True):
        expected = np.linalg.norm(dense - point, axis=1).min()
        assert expected - 0.005 <= closest <= expected + 1e-12


def test_the_tube_is_as_wide_as_the_plan_is_clear(flight, cover):
    """Beside the door the tube ends where a box test of the vehicle's sphere touches the wall."""
    judge, path = judge_of(flight, cover), sample_plan(flight, 0.01)
    door = np.abs(path[:, 0] - 1.1) < 0.3
    for aside, is_outside in ((0.25, False), (0.36, True)):
        moved = path.copy()
        moved[door, 1] = aside  # the walls begin at 0.4 m, the radius is 0.1 m
        result = judge.result(moved)
        assert (result.outside_m > 0) == is_outside
        assert outcome_of_plan("reached", without_via(result)) == ("off-plan" if is_outside else "reached")
    assert 0.02 <= result.outside_m <= 0.07
    assert "left the tube" in complaint(without_via(result))


def without_via(result):
    """The same without via points, which a moved path may miss."""
    return PlanResult(via_tolerance_m=0.1, closest_m=[], missed=[], outside_m=result.outside_m)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=examples(40), deadline=None)
def test_the_distance_from_the_tube_is_that_of_all_its_balls(flight, cover, seed):
    rng = np.random.default_rng(seed)
    judge = judge_of(flight, cover)
    path = np.array([1, 0, 1]) + np.cumsum(rng.normal(size=(40, 3)) * 0.2, axis=0)
    apart = np.linalg.norm(path[:, None] - judge.centre[None], axis=2)
    expected = max((apart - judge.width).min(axis=1).max() - judge.gap_m, 0)
    assert judge.result(path).outside_m == pytest.approx(expected, abs=1e-12)


def test_a_path_of_one_point_has_a_result(flight, cover):
    result = judge_of(flight, cover).result(np.array([[0.0, 0.0, 1.0]]))
    assert result.missed == [1, 2]
    assert result.outside_m == 0


def test_the_default_tolerance_is_the_radius_at_least_a_tenth():
    assert via_tolerance(None, 0.05) == 0.1
    assert via_tolerance(None, 0.25) == 0.25
    assert via_tolerance(0.02, 0.25) == 0.02


def test_a_plan_keeps_the_radius_and_the_margin_of_its_vehicle(cover):
    config = dataclasses.replace(CONFIG, radius_m=None)
    assert resolve_plan(config).radius_m == pytest.approx(FASTBRIDGE.body.radius_m + 0.1)
    made = plan(dataclasses.replace(config, margin_m=0.03), cover)
    assert made.manifest.radius_m == pytest.approx(0.18)
    assert (made.manifest.margin_m, made.manifest.via_m) == (0.03, [list(point) for point in CONFIG.via])
    with pytest.raises(UsageError, match=r"leave out --margin"):
        resolve_plan(dataclasses.replace(CONFIG, margin_m=0.1))


def test_a_filter_that_keeps_more_than_the_plan_is_refused_with_what_mends_it(flight, cover):
    judge = judge_of(flight, cover)
    assert 0.2 <= judge.distances_m[0] < 0.41
    assert require_room(judge, [0.2], "polytope-cbf", allow_tight=False) == []
    assert require_room(judge, [None], "polytope-cbf", allow_tight=False) == []
    assert require_room(judge, [9.0], "none", allow_tight=False) == []
    with pytest.raises(UsageError, match=r"plan with --radius 0\.5, or insist with --allow-tight"):
        require_room(judge, [0.5], "polytope-cbf", allow_tight=False)
    assert "it will hold the vehicle back" in require_room(judge, [0.5], "polytope-cbf", allow_tight=True)[0]


def flown(flight, cover, radius_m=0.1, **mission):
    """A flight along a plan behind polytope-cbf."""
    scenario = decoded(
        {
            "vehicle": {
                "type": "single-integrator",
                "radius_m": radius_m,
                "max_speed_m_s": 1.5 * flight.manifest.speed_m_s,
            },
            "world": {"cover": "x"},
            "mission": {"kind": "plan", "plan": "x"} | mission,
            "safety": {"filters": ["polytope-cbf"]},
        }
    )
    return simulate_world(scenario, cover=cover, plan=flight)


def test_a_simulated_plan_is_judged_by_its_via_points(flight, cover):
    own = flight.manifest.radius_m - flight.manifest.margin_m
    good = flown(flight, cover, own).trials[0]
    assert (good.outcome, good.plan.missed) == ("reached", [])
    strict = flown(flight, cover, own, via_tolerance_m=1e-5)
    assert strict.trials[0].outcome == "missed-via"
    summary = world_summary(strict)
    assert (summary["missed_via"], summary["reached"], summary["success_rate"]) == (1, 0, 0)
    with pytest.raises(UsageError, match=r"polytope-cbf keeps 0\.39 m"):
        flown(flight, cover, 0.39)
    held = flown(flight, cover, 0.39, allow_tight=True)
    assert "it will hold the vehicle back" in world_summary(held)["notes"][0]
    assert not held.trials[0].collision
