"""Straight plans: exact durations, proofs where they are clear, and plain words where they are not."""

import math

import numpy as np
import pytest

from alula.schemas.artifacts.artifact import read_artifact, write_artifact
from alula.schemas.artifacts.manifest import UNPROVEN_PLAN
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.adherence import PlanJudge, require_room
from alula.stages.planning.limits import Limits, motion_limits
from alula.stages.planning.plan import plan
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.planning.straight import PEAKS, straight_duration
from alula.stages.planning.trajectory import evaluate
from alula.stages.planning.verify import verify_plan
from support.flights.flights import mission
from support.scenes.small_scenes import box_cover

BOX = box_cover([((18, 14, 0), (22, 30, 20))])
THROUGH = {"start": (0.3, 2.0, 1.0), "goal": (3.7, 2.0, 1.0), "straight": True}
BESIDE = {"start": (0.3, 0.9, 1.0), "goal": (3.7, 0.8, 1.4), "straight": True}
TIGHT = 1e-5  # relative: a plan this much faster breaks a limit


def uses(limits, start, goal, duration_s):
    """Largest share of each limit that the septic uses, by dense samples and the limits' definitions."""
    time = np.linspace(0, duration_s, 20_001)
    peak = 2.1875 * np.linalg.norm(np.subtract(goal, start)) / duration_s
    knots, coefficient = rest_to_rest(start, goal, peak)
    v, a, j, s = (evaluate(knots, coefficient[:, :3], time, order) for order in (1, 2, 3, 4))
    thrust = a + np.array([0, 0, limits.gravity_m_s2])
    tilt = np.arctan2(np.hypot(thrust[:, 0], thrust[:, 1]), thrust[:, 2])
    room = limits.gravity_m_s2 - limits.least_thrust_m_s2
    return [
        np.linalg.norm(v, axis=1).max() / limits.speed_m_s,
        np.linalg.norm(a, axis=1).max() / limits.acceleration_m_s2,
        np.linalg.norm(j, axis=1).max() / limits.jerk_m_s3,
        np.linalg.norm(s, axis=1).max() / limits.snap_m_s4,
        np.linalg.norm(thrust, axis=1).max() / limits.most_thrust_m_s2,
        tilt.max() / limits.tilt_rad,
        0.0 if math.isinf(room) else (-a[:, 2]).max() / room,
    ]


WIDE = {"speed_m_s": 50.0, "acceleration_m_s2": 50.0}


@pytest.mark.parametrize(
    ("own", "which"),
    [
        ({"speed_m_s": 2.0}, 0),
        ({"acceleration_m_s2": 3.0}, 1),
        ({"jerk_m_s3": 5.0}, 2),
        ({"snap_m_s4": 30.0}, 3),
        ({"most_thrust_m_s2": 11.0}, 4),
        ({"tilt_rad": 0.2}, 5),
        ({"least_thrust_m_s2": 9.0}, 6),
    ],
)
def test_the_duration_is_the_shortest_that_keeps_every_limit(own, which):
    limits, rng = Limits(**WIDE | own), np.random.default_rng(which)
    for _ in range(5):
        start, goal = rng.uniform(-3, 3, (2, 3))
        duration = straight_duration(start, goal, limits)
        share = uses(limits, start, goal, duration)
        assert max(share) <= 1 + 1e-6
        assert share[which] >= 1 - 1e-4
        assert max(uses(limits, start, goal, (1 - 1e-3) * duration)) > 1


def test_peaks_are_those_of_the_derivatives():
    time = np.linspace(0, 1, 100_001)
    knots, coefficient = rest_to_rest((0, 0, 0), (1, 0, 0), 2.1875)
    for order, peak in enumerate(PEAKS, 1):
        assert np.abs(evaluate(knots, coefficient[:, :3], time, order)).max() == pytest.approx(peak, rel=1e-7)


@pytest.mark.parametrize(
    "own", [{}, {"acceleration_m_s2": 0.9}, {"tilt_rad": 0.07, "speed_m_s": 3.0}, {"smooth": 1.5}]
)
def test_a_clear_straight_plan_is_proven_again_with_its_limits(own):
    made = plan(PlanConfig(beyond_map_m=3.0, **BESIDE | own), BOX)
    assert made.manifest.is_proven
    assert made.manifest.requires == []
    found = verify_plan(made, cover=BOX)
    assert found.covered, found
    limits = motion_limits(PlanConfig(beyond_map_m=3.0, **BESIDE | own, radius_m=0.25), FASTBRIDGE)
    shortest = straight_duration(np.array(BESIDE["start"]), np.array(BESIDE["goal"]), limits)
    assert made["time"].tolist() == pytest.approx([0, own.get("smooth", 1.0) * shortest], rel=TIGHT)


def test_a_slow_straight_plan_is_the_reference_of_fastbridge():
    made = plan(PlanConfig(beyond_map_m=3.0, **BESIDE, speed_m_s=0.5), BOX)
    time, coefficient = rest_to_rest(BESIDE["start"], BESIDE["goal"], 0.5)
    np.testing.assert_allclose(made["time"], time, rtol=2e-6)
    np.testing.assert_allclose(made["coefficient"], coefficient, rtol=2e-5, atol=1e-12)


def test_a_blocked_straight_plan_is_refused_or_says_that_it_is_not_proven(tmp_path):
    with pytest.raises(InfeasibleError, match=r"leads through an obstacle.*--allow-blocked"):
        plan(PlanConfig(beyond_map_m=3.0, **THROUGH), BOX)
    made = plan(PlanConfig(beyond_map_m=3.0, **THROUGH, allow_blocked=True), BOX)
    write_artifact(tmp_path / "s.plan.npz", made)
    read = read_artifact(tmp_path / "s.plan.npz")
    assert not read.manifest.is_proven
    assert read.manifest.requires == [UNPROVEN_PLAN]
    assert "not proven" in read.manifest.guarantee.statement
    assert read.manifest.guarantee.claims["map_clear"] is False
    found = verify_plan(read, cover=BOX)
    assert not found.covered
    assert [check.ok for check in found.checks] == [False, True, True, True]  # all but the clearance


def test_a_clear_plan_with_leave_to_be_blocked_is_proven_all_the_same():
    assert plan(PlanConfig(beyond_map_m=3.0, **BESIDE, allow_blocked=True), BOX).manifest.is_proven


@pytest.mark.parametrize("allow_blocked", [False, True])
def test_start_and_goal_are_free_in_any_case(allow_blocked):
    with pytest.raises(InfeasibleError, match=r"the goal .* is inside an obstacle"):
        plan(
            PlanConfig(beyond_map_m=3.0, **THROUGH | {"goal": (2.0, 2.0, 1.0)}, allow_blocked=allow_blocked),
            BOX,
        )


def test_words_that_do_not_go_together_are_refused():
    with pytest.raises(UsageError, match="leave out --via"):
        PlanConfig(beyond_map_m=3.0, **THROUGH, via=((2.0, 1.0, 1.0),))
    with pytest.raises(UsageError, match="plans with --straight"):
        PlanConfig(beyond_map_m=3.0, start=(0, 0, 0), goal=(1, 1, 1), allow_blocked=True)


def test_a_flight_along_a_plan_that_is_not_proven_is_judged_without_a_tube():
    made = plan(PlanConfig(beyond_map_m=3.0, **THROUGH, allow_blocked=True), BOX)
    judge = PlanJudge(made, [hull_obstacles(Hulls.from_cover(BOX))], 0.15, 0.15)
    around = np.array([(0.3, 2.0, 1.0), (1.5, 0.5, 1.0), (2.5, 0.5, 1.0), (3.7, 2.0, 1.0)])
    assert judge.result(around).outside_m == 0
    (note,) = require_room(judge, [0.25], "cone-backup", allow_tight=False)
    assert "not proven" in note


def test_a_plan_that_is_not_proven_is_flown_behind_a_filter_where_this_is_insisted_on():
    made = plan(PlanConfig(beyond_map_m=3.0, **THROUGH, allow_blocked=True), BOX)
    with pytest.raises(UsageError, match="--allow-blocked"):
        mission(cover=BOX, plan=made)
    with pytest.raises(UsageError, match="behind a filter only"):
        mission("none", cover=BOX, plan=made, allow_blocked=True)
    flown = mission(cover=BOX, plan=made, allow_blocked=True)
    assert flown.is_clear == (
        True,
        "piece [0] is not proven to keep 0.15 m from hulls made for every ellipsoid of the scene at 1 sigma "
        "(19.8 % of a Gaussian's mass); it leaves the mapped box, by at most 3 m (--beyond-map); flown "
        "behind the filter alone (--allow-blocked)",
    )
