"""Headings of plans: along the motion, towards a point, wrapped, within limits, and flown."""

import dataclasses
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.mission import Mission, PassTable
from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.planning.heading import is_turning
from alula.stages.planning.limits import LIMIT_SHARE, motion_limits
from alula.stages.planning.plan import plan
from alula.stages.planning.trajectory import evaluate
from alula.stages.planning.verify import verify_plan
from alula.stages.simulation.prepare import prepare
from alula.stages.vehicles.bodies import quadrotor
from support.effort import examples
from support.scenes.covers import boxes_cover

EMPTY = boxes_cover([])
SQUARE = ((4.0, 0.0, 1.0), (4.0, 4.0, 1.0), (0.0, 4.0, 1.0), (0.0, 0.0, 1.0))
ROUND = PlanConfig(beyond_map_m=3.0, start=(2, 0, 1), goal=(2, 0, 1), via=SQUARE, radius_m=0.2, speed_m_s=1.0)


def flown(made, count=20_001):
    """Times, heading and its two derivatives, position and velocity."""
    t = np.linspace(0, made["time"][-1], count)[:-1]
    values = [evaluate(made["time"], made["coefficient"], t, order) for order in range(3)]
    return t, *(each[:, 3] for each in values), values[0][:, :3], values[1][:, :3]


def wrapped(angle):
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def test_along_the_motion_the_heading_is_that_of_the_velocity_lap_by_lap():
    made = plan(dataclasses.replace(ROUND, yaw="along", loops=3), EMPTY)
    _, yaw, rate, acceleration, _, velocity = flown(made)
    limits = made.manifest.limits
    assert 0.5 * limits["yaw_rate_rad_s"] < np.abs(rate).max() <= limits["yaw_rate_rad_s"]
    assert np.abs(acceleration).max() <= limits["yaw_acceleration_rad_s2"]
    assert np.abs(np.diff(yaw)).max() < 0.01  # it does not jump from pi to -pi
    assert yaw[-1] - yaw[0] == pytest.approx(3 * 2 * np.pi, abs=0.7)
    speed = np.hypot(*velocity[:, :2].T)
    error = np.abs(wrapped(yaw - np.arctan2(velocity[:, 1], velocity[:, 0])))[speed > 0.3]
    assert np.median(error) < 0.05
    assert error.max() < 0.7  # in corners, which turn faster than the vehicle may
    assert made.manifest.summary["max_heading_error_rad"] == pytest.approx(error.max(), abs=0.3)
    assert verify_plan(made, cover=EMPTY).covered


def test_at_rest_and_straight_up_the_heading_remains_that_of_before():
    mission = Mission(yaw="along", passes=(PassTable(point_m=(2, 2, 1), hold_s=2.0),))
    made = plan(
        PlanConfig(beyond_map_m=3.0, start=(0, 0, 1), goal=(2, 2, 3), radius_m=0.2), EMPTY, mission=mission
    )
    t, yaw, *_, position, velocity = flown(made)
    hold = made.manifest.passes[0]
    resting = (t > hold.time_s) & (t < hold.time_s + hold.hold_s)
    assert resting.sum() > 1000
    assert np.abs(velocity[resting]).max() < 1e-9
    assert np.linalg.norm(position[resting] - (2, 2, 1), axis=1).max() < 1e-9
    assert yaw == pytest.approx(math.pi / 4, abs=0.01)


def test_towards_a_point_and_of_single_passes():
    target = (2.0, 2.0, 0.0)
    made = plan(dataclasses.replace(ROUND, yaw="towards:2,2,0"), EMPTY)
    _, yaw, *_, position, _ = flown(made)
    wanted = np.arctan2(target[1] - position[:, 1], target[0] - position[:, 0])
    assert np.abs(wrapped(yaw - wanted)).max() < 0.05
    passes = (
        PassTable(point_m=(4, 0, 1), yaw_rad=-1.0, hold_s=1.0),
        PassTable(point_m=(4, 4, 1), look_at_m=(0, 4, 1), hold_s=3.0),
    )
    config = PlanConfig(beyond_map_m=3.0, start=(0, 0, 1), goal=(0, 0, 1), radius_m=0.2)
    made = plan(config, EMPTY, mission=Mission(yaw_rad=3.0, passes=passes))
    t, yaw, *_ = flown(made)
    first, second = made.manifest.passes
    at = [np.interp(each.time_s + 0.5 * each.hold_s, t, yaw) for each in (first, second)]
    assert wrapped(at[0] + 1.0) == pytest.approx(0, abs=0.15)
    assert wrapped(at[1] - np.pi) == pytest.approx(0, abs=0.05)
    assert wrapped(yaw[-1] - 3.0) == pytest.approx(0, abs=0.05)
    assert verify_plan(made, cover=EMPTY).covered


def test_a_constant_heading_has_no_limits_and_is_that_of_before():
    made = plan(dataclasses.replace(ROUND, yaw="-2.5"), EMPTY)
    assert (made["coefficient"][:, 3] == np.array([-2.5, *[0.0] * 7])).all()
    assert "yaw_rate_rad_s" not in made.manifest.limits
    assert "heading" not in [check.name for check in verify_plan(made, cover=EMPTY).checks]
    one = Mission(passes=(PassTable(point_m=(4, 0, 1), yaw_rad=1.0),))
    assert is_turning(one)  # from 0
    assert not is_turning(Mission(yaw_rad=1.0, passes=one.passes))
    for wrong in ("up", "towards:1,2", "1 2", "9", "nan", "towards:1,2,inf", ""):
        with pytest.raises(UsageError, match="--yaw is"):
            dataclasses.replace(ROUND, yaw=wrong)


@pytest.mark.parametrize(
    ("order", "by", "found"),
    [
        (0, 0.1, "the heading jumps by"),
        (1, 0.1, "the heading jumps by"),
        (3, 30.0, "yaw_acceleration_rad_s2"),
    ],
)
def test_verify_finds_a_damaged_heading(order, by, found):
    made = plan(dataclasses.replace(ROUND, yaw="along"), EMPTY)
    coefficient = np.array(made["coefficient"])
    coefficient[5, 3, order] += by
    broken = dataclasses.replace(made, arrays={**made.arrays, "coefficient": coefficient})
    failed = [each for each in verify_plan(broken, cover=EMPTY).checks if not each.ok]
    assert {each.name for each in failed} <= {"heading", "continuity"}
    assert any(found in offence.fault for each in failed for offence in each.first)
    limits = {name: value for name, value in made.manifest.limits.items() if "yaw" not in name}
    unlimited = dataclasses.replace(made, manifest=msgspec.structs.replace(made.manifest, limits=limits))
    assert [each.name for each in verify_plan(unlimited, cover=EMPTY).checks if not each.ok] == ["heading"]


@pytest.mark.parametrize("acceleration", [3.0, 8.0])
@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=examples(40))
def test_motions_with_a_turning_heading_need_only_the_share_of_rotors_and_rates(acceleration, seed):
    """Independent: thrust and torque of the native rigid body, from derivatives drawn at the limits."""
    limits = motion_limits(dataclasses.replace(ROUND, acceleration_m_s2=acceleration), FASTBRIDGE, turns=True)
    rng = np.random.default_rng(seed)
    g = limits.gravity_m_s2

    def drawn(most):
        v = rng.normal(size=3)
        return most * v / np.linalg.norm(v)

    a, j, s = drawn(acceleration * rng.uniform() ** (1 / 3)), drawn(limits.jerk_m_s3), drawn(limits.snap_m_s4)
    thrust = a + np.array([0, 0, g])
    c = np.linalg.norm(thrust)
    if not (
        c <= limits.most_thrust_m_s2
        and thrust[2] >= limits.least_thrust_m_s2
        and np.hypot(*thrust[:2]) <= limits.tangent * thrust[2]
    ):
        return
    turn = rng.choice([-1, 1], 2) * (limits.yaw_rate_rad_s, limits.yaw_acceleration_rad_s2)
    heading, step = rng.uniform(-np.pi, np.pi), 1e-4

    def frame(t):
        up = thrust + j * t + s * t * t / 2
        psi = heading + turn[0] * t + turn[1] * t * t / 2
        b3 = up / np.linalg.norm(up)
        b2 = np.cross(b3, [np.cos(psi), np.sin(psi), 0])
        b2 /= np.linalg.norm(b2)
        return np.column_stack([np.cross(b2, b3), b2, b3])

    def rate(t):
        of = frame(t - step).T @ frame(t + step)
        return np.array([of[2, 1] - of[1, 2], of[0, 2] - of[2, 0], of[1, 0] - of[0, 1]]) / (4 * step)

    omega, omega_rate = rate(0.0), (rate(step) - rate(-step)) / (2 * step)
    body = quadrotor(FASTBRIDGE)
    inertia = np.asarray(body.inertia)
    torque = inertia * omega_rate + np.cross(omega, inertia * omega)
    rotor = np.asarray(body.inverse_allocation) @ np.array([body.mass * c, *torque])
    hover = body.mass * g / 4
    assert (rotor <= hover + LIMIT_SHARE * (4.25 - hover) + 1e-3).all()
    assert (rotor >= hover - LIMIT_SHARE * hover - 1e-3).all()
    assert (np.abs(omega) <= LIMIT_SHARE * np.array(FASTBRIDGE.rates.max_rad_s) + 1e-6).all()


def test_a_simulated_quadrotor_turns_as_its_plan_does():
    made = plan(dataclasses.replace(ROUND, yaw="along"), EMPTY)
    scenario = decoded(
        {
            "vehicle": {"file": "fastbridge.toml", "interface": "wrench"},
            "world": {"cover": "x"},
            "mission": {"kind": "plan", "plan": "x", "beyond_map_m": 20.0},
            "safety": {"filters": ["cone-backup"]},
        }
    )
    run = prepare(scenario, FASTBRIDGE, cover=boxes_cover([[100, 100, 0, 101, 101, 1]]), plan=made, jobs=1)
    (log,) = run.fly(0, 1, jobs=1)
    assert log["end"] == "reached"
    yaw = 4 * np.arctan2(log["state"][:, 5], 1)  # of sigma = axis tan(angle / 4), for small tilts
    planned = run.missions.curves[0].at(np.arange(len(yaw)) * run.judge.dt_s)[:, 15]
    assert np.abs(wrapped(yaw - planned)[100:]).max() < 0.1
    assert np.ptp(planned) > 5
