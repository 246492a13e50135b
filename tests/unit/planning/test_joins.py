"""Plans that jump between their pieces, or touch a gate in a piece of a nanosecond, are no motion."""

import dataclasses
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.artifacts.manifest import PlanPass
from alula.schemas.errors import ArtifactError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.mission import Mission, PassTable
from alula.stages.planning.exact import is_crossed
from alula.stages.planning.joins import APART, LEAST_DURATION_S, faults_of_joins, require_motion
from alula.stages.planning.plan import plan
from alula.stages.planning.verify import verify_plan
from support.flights.flights import mission
from support.scenes.covers import boxes_cover

FAR_WALL = [[100, 0, 0, 102, 14, 30], [-20, -20, -2, 60, 60, -1]]


@pytest.fixture(scope="module")
def cover():
    return boxes_cover(FAR_WALL)


def forged(point, duration, **fields) -> Artifact:
    """A plan of linear pieces from point to point, whatever its speed does between them."""
    point, duration = np.array(point, float), np.array(duration, float)
    coefficient = np.zeros((len(duration), 4, 8))
    coefficient[:, :3, 0] = point[:-1]
    time = np.concatenate([[0.0], np.cumsum(duration)])
    coefficient[:, :3, 1] = np.diff(point, axis=0) / np.diff(time)[:, None]
    return make_artifact(
        PLAN,
        {
            "time": time,
            "coefficient": coefficient,
            "waypoint": np.column_stack([point, np.zeros(len(point))]),
        },
        frame="world",
        unit="m",
        radius_m=0.1,
        speed_m_s=2.0,
        certificate={},
        **{"parameters": {}, "summary": {}, "limits": {"speed_m_s": 2.0}, **fields},
    )


def turning_in_a_nanosecond():
    """1 m/s to the right, then 1 m/s upwards, with rests of 1 ns between."""
    point = [[0, 0, 1], [0, 0, 1], [1, 0, 1], [1, 0, 1], [1, 1, 1], [1, 1, 1]]
    return forged(point, [1e-9, 1, 1e-9, 1, 1e-9])


def through_a_gate_in_nanometres():
    """From behind a gate to its plane, 4 nm to and fro, and back."""
    x = np.array([1.0, 2e-9, -2e-9, 0, 2e-9, 1.0])
    where = {"point_m": [0, 0, 1], "normal": [1, 0, 0], "radius_m": 0.5}
    gate = PlanPass(kind="gate", number=1, time_s=1 + 3e-3, **where)
    return forged(np.column_stack([x, 0 * x, 1 + 0 * x]), [1, *[1.5e-3] * 3, 1], passes=[gate])


def failed(made, cover):
    return {check.name for check in verify_plan(made, cover=cover).checks if not check.ok}


def test_a_turn_within_a_nanosecond_is_neither_proven_nor_flown(cover):
    made = turning_in_a_nanosecond()
    assert failed(made, cover) == {"continuity"}
    faults = faults_of_joins(made["time"], made["coefficient"])
    assert {i for i, fault in faults if "lasts 1e-09 s" in fault} == {0, 2, 4}
    assert {i for i, fault in faults if "the velocity jumps by 1 " in fault} == {0, 1, 2, 3}
    with pytest.raises(ArtifactError, match="the plan is no motion: at 1e-09 s"):
        require_motion(made)
    with pytest.raises(ArtifactError, match="the plan is no motion: at 1e-09 s"):
        mission("none", plan=made)  # of `fly`


def test_a_gate_that_is_touched_in_nanometres_is_not_passed(cover):
    assert "start, vias, gates, goal" in failed(through_a_gate_in_nanometres(), cover)


@pytest.mark.parametrize("duration_s", [2e-3, 0.1, 1.0, 100.0])
@pytest.mark.parametrize("order", range(5))
def test_bounds_of_a_jump_do_not_depend_on_the_pieces(order, duration_s):
    for size, jumps in ((0.5, False), (2.0, True)):
        coefficient = np.zeros((2, 4, 8))
        coefficient[0, :3, 0] = coefficient[1, :3, 0] = 1000.0
        factor = np.prod(np.arange(1, order + 1))
        coefficient[1, 1, order] += size * APART[order] / factor
        time = np.array([0.0, duration_s, 2 * duration_s])
        assert bool(faults_of_joins(time, coefficient)) is jumps


def test_a_piece_lasts_a_millisecond(cover):
    rest = forged([[0, 0, 1]] * 3, [1.0, 0.9 * LEAST_DURATION_S])
    assert failed(rest, cover) == {"continuity"}
    assert failed(forged([[0, 0, 1]] * 3, [1.0, 1.1 * LEAST_DURATION_S]), cover) == set()


def test_the_bounds_are_ten_times_what_genuine_plans_need_100_km_from_the_origin():
    far = 10**6
    room = [[far, far, 0, far + 2, far + 14, 20], [far - 40, far - 40, -2, far + 40, far + 40, -1]]
    config = PlanConfig(start=(1e5 - 1, 1e5 - 1, 1), goal=(1e5 + 1, 1e5 + 1, 1.2), radius_m=0.2)
    config = dataclasses.replace(config, via=((1e5 - 1, 1e5 + 1.8, 1.0),))
    made = plan(config, boxes_cover(room))
    time, c = made["time"], np.asarray(made["coefficient"])[:, :3]
    powers = np.arange(8)
    most = np.zeros(5)
    for k in range(len(c) - 1):
        length = Fraction(time[k + 1]) - Fraction(time[k])
        for order in range(5):
            falling = [int(np.prod(range(j - order + 1, j + 1))) if j >= order else 0 for j in powers]
            for axis in range(3):
                end = sum(
                    Fraction(c[k, axis, j]) * falling[j] * length ** (j - order) for j in range(order, 8)
                )
                begin = Fraction(c[k + 1, axis, order]) * falling[order]
                most[order] = max(most[order], float(abs(end - begin)))
    assert (most < 0.1 * np.array(APART)).all()
    assert verify_plan(made, cover=boxes_cover(room)).covered


def test_a_plane_is_crossed_where_the_curve_leaves_it_on_both_sides():
    def crosses(x):
        pieces = [
            [(Fraction(p), Fraction(0), Fraction(0)) for p in np.linspace(a, b, 8)] for a, b in pairwise(x)
        ]
        return [is_crossed(pieces, k, (0, 0, 0), (1, 0, 0)) for k in range(len(x))]

    assert crosses([-2, -1, 0, 1, 2]) == [False, False, True, False, False]
    assert crosses([-2, -0.005, 0, 0.005, 2])[2]
    assert not any(crosses([2, 1, 0, -1, -2]))  # against the normal
    assert not any(crosses([-2, -1, 0, -1, -2]))  # to the plane and back
    assert not any(crosses([0, 1, 2]))  # begins in the plane
    assert not any(crosses([2, -0.005, 0, 0.005, 2]))  # from behind, and hardly before it
    dip = [(Fraction(p), Fraction(0), Fraction(0)) for p in (0, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0)]
    before = [(Fraction(p), Fraction(0), Fraction(0)) for p in np.linspace(-1, 0, 8)]
    assert is_crossed([before, dip], 1, (0, 0, 0), (1, 0, 0))  # well behind it within a piece
    back = [(Fraction(p), Fraction(0), Fraction(0)) for p in (0, *[0.05] * 6, -0.05)]  # and before it again
    assert is_crossed([before, back], 1, (0, 0, 0), (1, 0, 0))


def test_a_rest_shorter_than_a_piece_takes_a_little_longer(cover):
    config = PlanConfig(start=(0, 0, 1), goal=(2, 0, 1), radius_m=0.2)
    mission = Mission(passes=(PassTable(point_m=(1.0, 0.5, 1.0), hold_s=1e-5),))
    made = plan(config, cover, mission=mission)
    assert np.diff(made["time"]).min() >= LEAST_DURATION_S
    assert verify_plan(made, cover=cover).covered
