"""Random pairs with a blocked straight line, and speeds at which a vehicle catches up with its reference."""

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.scenarios.vehicle import FASTBRIDGE, TrackingTable
from alula.stages.filtering.protocol import FilterResult, FilterStatus
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.simulation.pairs import sample_pairs
from alula.stages.vehicles.bodies import tracking_gains
from alula.stages.world.vehicle import catch_up_m_s
from support.flights.foreign_filters import Passing
from support.flights.reference_flights import along, vehicle_of
from support.flights.world_runs import flown
from support.models.clearances import clearance_to_scene
from support.scenes.fabricate import make_scene

FIELD = make_scene(12, low=(0, 0, 0), high=(6, 4, 3))
BOX = (0.0, 0.0, 0.0, 6.0, 4.0, 3.0)


def quick(scene=FIELD, **fields):
    given = {"trials": 12, "bounds_m": BOX, "max_time_s": 0.05, "inflation_m": 0.04}
    return flown(scene=scene, **(given | fields))


def ends(result):
    return [(t.start_m, t.goal_m) for t in result.trials]


def test_blocked_pairs_are_those_of_any_under_the_condition():
    any_, blocked = (quick(which=which) for which in ("any", "blocked"))
    kept = 0
    for trial, other in zip(any_.trials, blocked.trials, strict=True):
        for t in (trial, other):
            line = clearance_to_scene([t.start_m, t.goal_m], FIELD, 1.0).min()
            assert t.line_clearance_m == pytest.approx(line - 0.15, abs=1e-9)
        assert other.line_clearance_m < 0.04
        if trial.line_clearance_m < 0.04:  # such a pair stays the same, whatever the others are
            kept += 1
            assert other.start_m == trial.start_m
            assert other.goal_m == trial.goal_m
        for point in (other.start_m, other.goal_m):
            assert clearance_to_scene([point], FIELD, 1.0).min() >= 0.15 + 0.04 + 0.05 - 1e-9
    assert 0 < kept < 12
    assert (any_.summary["blocked_pairs"], any_.summary["sampled_pairs"]) == (kept, 12)
    assert blocked.summary["blocked_pairs"] == 12 < blocked.summary["sampled_pairs"]
    assert blocked.summary["sampled_points"] > any_.summary["sampled_points"]


def test_pairs_are_the_same_bit_by_bit_at_any_speed():
    slow, fast = (ends(quick(speed_m_s=v)) for v in (0.7, 3.1))
    assert slow == fast


def test_a_trial_has_the_same_pair_however_many_there_are():
    twelve, three = (ends(quick(which="blocked", trials=n)) for n in (12, 3))
    assert twelve[:3] == three
    other = ends(quick(which="blocked", trials=3, seed=1))
    assert not any(a == b for a, b in zip(three, other, strict=True))


def test_pairs_without_a_condition_are_as_ever():
    """The first clear point of a block and the first far enough from it, straight from the generator."""
    found = sample_pairs(
        4,
        7,
        (np.zeros(3), np.ones(3)),
        0.8,
        lambda points: points[:, 0] - 0.2,
        lambda points, psi: psi >= 0,
    )
    for i in range(4):
        generator = np.random.Generator(np.random.Philox(key=np.array([7, i], np.uint64)))
        points = generator.random((256, 3))
        clear = points[points[:, 0] >= 0.2]
        np.testing.assert_array_equal(found.start[i], clear[0])
        far = clear[np.linalg.norm(clear - clear[0], axis=1) >= 0.8]
        np.testing.assert_array_equal(found.goal[i], far[0])
    assert found.candidates == 4


def test_without_anything_in_the_way_there_is_no_blocked_pair():
    alone = make_scene(1, low=(50, 50, 50), high=(51, 51, 51))
    with pytest.raises(
        InfeasibleError, match=r"trial 0: no start and goal .* with a blocked line between them"
    ):
        quick(which="blocked", scene=alone)
    with pytest.raises(UsageError, match=r"`\$.mission.which`|mission.which"):
        quick(which="free")


class Late(Passing):
    """Stays at the start for fourteen seconds."""

    def __init__(self):
        super().__init__()
        self.ticks = 0

    def reset(self):
        self.ticks = 0

    def __call__(self, state, nominal):
        self.ticks += 1
        if self.ticks > 1400:
            return super().__call__(state, nominal)
        return FilterResult(-2 * state.velocity, FilterStatus.FILTERED)


@pytest.mark.parametrize("plant", ["double-integrator", "quadrotor"])
def test_a_vehicle_that_was_held_up_keeps_to_half_as_much_again_as_its_reference(plant):
    speed = 2.0
    limit = catch_up_m_s(FASTBRIDGE, speed)
    assert limit == 1.0
    reference = _core.ReferenceCurve(*rest_to_rest((0, 0, 1), (30, 0, 1), speed))

    def fastest(most):
        vehicle = vehicle_of(model=plant, gains=tracking_gains(FASTBRIDGE, most))
        (log,) = along([reference], [Late()], vehicle, stuck_ticks=2000)
        assert log["end"] == "reached"
        return np.linalg.norm(log["state"][:, 6:9], axis=1).max()

    limited, free = fastest(limit), fastest(np.inf)
    assert 1.2 * speed < limited < 1.5 * speed * (1 + 1e-3)
    assert free > 1.7 * speed


def test_the_limit_is_the_option_s_then_the_vehicle_s_then_half_the_speed():
    own = msgspec.structs.replace(FASTBRIDGE, tracking=TrackingTable(catch_up_m_s=0.7))
    assert catch_up_m_s(own, 1.0) == 0.7
    assert catch_up_m_s(own, 1.0, 0.3) == 0.3
    assert catch_up_m_s(FASTBRIDGE, 3.0) == 1.5
    with pytest.raises(UsageError, match="catch_up_m_s"):
        quick(catch_up_m_s=0.0)
