"""Fastest curves: continuity, cells and limits without rounding; against the convex problem in cvxpy."""

import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula._core import MotionLimits, minimum_time
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE, BodyTable, LimitsTable, Vehicle
from alula.stages.planning.fastest import MovingState, fastest_curve, keeps, straight_curve
from alula.stages.planning.limits import LIMIT_SHARE, Limits, motion_limits
from alula.stages.planning.opening import Opening
from alula.stages.planning.trajectory import evaluate
from alula.stages.vehicles.bodies import quadrotor
from support.effort import examples, some
from support.models.chains import box_chain, exact_derivatives
from support.models.convex_core import Problem, minimum_scale, minimum_snap

CONFIG = PlanConfig(beyond_map_m=3.0, start=(0, 0, 0), goal=(1, 0, 0), speed_m_s=2.0)
LIMITS = motion_limits(CONFIG, FASTBRIDGE)


def solve(corridor, limits=LIMITS, pieces=3, **options):
    curve = fastest_curve(corridor, range(len(corridor.start) - 1), limits, pieces, **options)
    assert curve is not None
    return curve


def convex(corridor, curve, limits=LIMITS, state=None):
    cells = [corridor.rows(i) for i in range(len(corridor.start) - 1)]
    joints = np.flatnonzero(np.diff(curve.cell))
    return Problem(
        normal=[normal for normal, _ in cells],
        offset=[offset for _, offset in cells],
        cell=curve.cell,
        limits=limits,
        state=corridor.point[:1] if state is None else state,
        goal=corridor.point[-1],
        via={int(i): q for i, q, v in zip(joints, corridor.joint, corridor.is_via, strict=True) if v},
    )


@given(st.integers(0, 10**6), st.integers(1, 5), st.booleans())
@settings(deadline=None, max_examples=examples(30))
def test_curves_are_smooth_in_their_cells_within_limits_and_pass_their_points(seed, cells, via):
    corridor = box_chain(seed, cells, via)
    curve = solve(corridor, pieces=2 + seed % 2)
    time, c = curve.time, curve.coefficient()
    assert keeps(curve.point, curve.duration, LIMITS).all()
    for points, cell in zip(curve.point, curve.cell, strict=True):
        normal, offset = corridor.rows(cell)
        assert (points @ normal.T <= offset + 1e-12).all()
    np.testing.assert_array_equal(c[0, :, 0], corridor.point[0])
    np.testing.assert_allclose(evaluate(time, c, time[-1]), corridor.point[-1], atol=1e-12)
    for order, tolerance in enumerate((1e-12, 1e-10, 1e-8, 1e-6, 1e-4)):
        at_start, at_end = (evaluate(time, c, t, order) for t in (0.0, time[-1]))
        if order:
            np.testing.assert_allclose(at_start, 0, atol=tolerance)
            np.testing.assert_allclose(at_end, 0, atol=tolerance)
        for i in range(len(c) - 1):
            piece = evaluate([0, curve.duration[i]], c[i : i + 1], curve.duration[i], order)
            np.testing.assert_allclose(piece, evaluate(time, c, time[i + 1], order), atol=tolerance)
    if via:
        ends = curve.point[np.flatnonzero(np.diff(curve.cell)), -1]
        np.testing.assert_array_equal(ends, corridor.joint)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2])
def test_limits_hold_in_exact_arithmetic_at_ten_thousand_random_times(seed):
    curve = solve(box_chain(seed, 4))
    time, c = curve.time, curve.coefficient()
    limits = [
        Fraction(x) for x in (LIMITS.speed_m_s, LIMITS.acceleration_m_s2, LIMITS.jerk_m_s3, LIMITS.snap_m_s4)
    ]
    g, tangent = Fraction(LIMITS.gravity_m_s2), Fraction(LIMITS.tangent)
    most, least = Fraction(LIMITS.most_thrust_m_s2), Fraction(LIMITS.least_thrust_m_s2)
    rng = np.random.default_rng(seed)
    largest = [Fraction(0)] * 4
    for t in rng.uniform(0, time[-1], 10_000):
        piece = int(np.searchsorted(time, t, side="right")) - 1
        _, *derivatives = exact_derivatives(c[piece], t - time[piece])
        for order, (x, y, z) in enumerate(derivatives):
            squared = x * x + y * y + z * z
            assert squared <= limits[order] ** 2
            largest[order] = max(largest[order], squared)
        x, y, z = derivatives[1]
        assert x * x + y * y + (z + g) ** 2 <= most**2
        assert z + g >= least
        assert x * x + y * y <= (tangent * (z + g)) ** 2
    assert largest[0] > (Fraction(9, 10) * limits[0]) ** 2  # it is fast
    assert largest[1] > (Fraction(8, 10) * limits[1]) ** 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "via"), [(0, False), (2, True), pytest.param(3, True, marks=pytest.mark.slow)]
)
def test_no_curve_with_the_same_ratios_of_durations_is_faster_in_the_convex_reference(seed, via):
    corridor = box_chain(seed, 3, via)
    curve = solve(corridor)
    scale = minimum_scale(convex(corridor, curve), curve.duration, 2e-3)
    assert 0.985 <= scale <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_other_ratios_of_durations_are_not_faster_either(seed):
    """Neither a random change of the durations nor equal ones, by the convex reference."""
    corridor = box_chain(seed, 2)
    curve = solve(corridor)
    problem = convex(corridor, curve)
    rng = np.random.default_rng(seed)
    for spread in some((0.03, 0.3), 2):
        duration = curve.duration * np.exp(spread * rng.normal(size=len(curve.duration)))
        assert minimum_scale(problem, duration, 2e-3) * duration.sum() >= 0.985 * curve.time[-1]
    equal = np.ones(len(curve.duration))
    assert minimum_scale(problem, equal, 2e-3) * equal.sum() >= 1.01 * curve.time[-1]


def test_a_long_straight_flight_takes_its_length_over_the_speed_and_two_ramps():
    short = box_chain(0, 1)
    along = short.point[1] - short.point[0]
    size = 12 / np.linalg.norm(along)
    corridor = dataclasses.replace(short, point=size * short.point, offset=size * short.offset)
    bound = 12 / LIMITS.speed_m_s + LIMITS.speed_m_s / LIMITS.acceleration_m_s2
    assert bound < solve(corridor).time[-1] < 1.12 * bound


def test_single_cells_can_have_lower_limits_of_the_speed():
    corridor = box_chain(5, 3)
    fast, slow = solve(corridor), solve(dataclasses.replace(corridor, speed=np.array([9.0, 0.3, 2.0])))
    for curve, limit in ((fast, [2.0, 2.0, 2.0]), (slow, [2.0, 0.3, 2.0])):
        speed = 7 * np.linalg.norm(np.diff(curve.point, axis=1), axis=2) / curve.duration[:, None]
        most = [speed[curve.cell == cell].max() for cell in range(3)]
        assert (most <= np.array(limit) * (1 + 1e-12)).all()
    assert fast.time[-1] < slow.time[-1]
    assert most[1] > 0.28


@pytest.mark.parametrize("seed", range(3))
def test_in_a_longer_time_snap_is_that_of_the_convex_reference(seed):
    corridor = box_chain(seed, 3, seed == 2)
    fast, slow = solve(corridor), solve(corridor, smooth=1.3)
    np.testing.assert_allclose(slow.duration, 1.3 * fast.duration, rtol=1e-12)
    answer = minimum_snap(convex(corridor, slow), slow.duration)
    assert answer is not None
    cost, point = answer
    assert squared_snap(slow) == pytest.approx(cost, rel=0.02)
    assert squared_snap(slow) < 0.5 * squared_snap(fast)
    np.testing.assert_allclose(slow.point, point, atol=0.02)


def squared_snap(curve):
    node, weight = np.polynomial.legendre.leggauss(5)
    time, c = curve.time, curve.coefficient()
    t = time[:-1, None] + curve.duration[:, None] * (1 + node) / 2
    return float(
        (np.linalg.norm(evaluate(time, c, t, 4), axis=2) ** 2 * weight * curve.duration[:, None] / 2).sum()
    )


def test_a_curve_begins_with_the_motion_that_is_given_and_a_start_that_is_too_fast_has_none():
    corridor = box_chain(1, 3)
    along = corridor.point[1] - corridor.point[0]
    velocity = 0.8 * along / np.linalg.norm(along)
    motion = MovingState(velocity, np.array([0.3, -0.2, 0.1]), np.array([1.0, 0.5, -2.0]))
    curve = solve(corridor, start=motion)
    time, c = curve.time, curve.coefficient()
    for order, value in enumerate((corridor.point[0], *dataclasses.astuple(motion))):
        np.testing.assert_allclose(evaluate(time, c, 0.0, order), value, atol=1e-9)
    assert curve.time[-1] < solve(corridor).time[-1]
    assert keeps(curve.point, curve.duration, LIMITS).all()
    state = np.stack([corridor.point[0], *dataclasses.astuple(motion)])
    assert minimum_snap(convex(corridor, curve, state=state), curve.duration) is not None
    away = MovingState(-1.9 * along / np.linalg.norm(along), np.zeros(3), np.zeros(3))
    assert fastest_curve(corridor, range(3), LIMITS, 3, start=away) is None


def test_without_obstacles_the_time_is_near_that_of_full_acceleration():
    """Bang-bang bound of a straight line; jerk and snap cost a little."""
    corridor = box_chain(0, 1)
    length = np.linalg.norm(corridor.point[1] - corridor.point[0])
    limits = Limits(speed_m_s=1.0, acceleration_m_s2=5.0)
    bound = length / 1.0 + 1.0 / 5.0
    assert bound <= solve(corridor, limits, pieces=5).time[-1] <= 1.12 * bound


def test_results_are_the_same_each_time():
    a, b = (solve(box_chain(4, 4)) for _ in range(2))
    np.testing.assert_array_equal(a.point, b.point)


@given(st.integers(0, 10**6), st.floats(0.05, 5.0))
@settings(deadline=None, max_examples=examples(30))
def test_straight_curves_are_on_their_line_and_as_fast_as_their_shape_allows(seed, length):
    rng = np.random.default_rng(seed)
    along = rng.normal(size=3)
    along /= np.linalg.norm(along)
    a = rng.uniform(-3, 3, 3)
    curve = straight_curve(a, a + length * along, LIMITS)
    np.testing.assert_allclose(np.cross(curve.point - a, along), 0, atol=1e-12)
    assert keeps(curve.point, curve.duration, LIMITS).all()
    assert not keeps(curve.point, 0.999 * curve.duration, LIMITS).all()
    time, c = curve.time, curve.coefficient()
    for order in range(1, 5):
        np.testing.assert_allclose(evaluate(time, c, time[[0, -1]], order), 0, atol=1e-6)
        before = evaluate([0, curve.duration[0]], c[:1], curve.duration[0], order)
        np.testing.assert_allclose(before, evaluate(time, c, time[1], order), atol=1e-6)


@pytest.mark.parametrize("acceleration", [1.0, 3.0, 8.0, 20.0])
@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=examples(40))
def test_motions_within_the_limits_need_only_the_share_of_rotors_rates_and_tilt(acceleration, seed):
    """Independent: thrust and torque of the native rigid body, from derivatives drawn at the limits."""
    vehicle = FASTBRIDGE
    limits = motion_limits(dataclasses.replace(CONFIG, acceleration_m_s2=acceleration), vehicle)
    rng = np.random.default_rng(seed)
    g = limits.gravity_m_s2

    def drawn(most):
        v = rng.normal(size=3)
        return most * v / np.linalg.norm(v)

    a = drawn(acceleration * rng.uniform() ** (1 / 3))
    thrust = a + np.array([0, 0, g])
    c = np.linalg.norm(thrust)
    if c > limits.most_thrust_m_s2 or thrust[2] < limits.least_thrust_m_s2:
        return
    if np.hypot(*thrust[:2]) > limits.tangent * thrust[2]:
        return
    j, s = drawn(limits.jerk_m_s3), drawn(limits.snap_m_s4)
    # Attitude along the curve by finite differences of its frame, heading along x.
    step = 1e-4

    def frame(t):
        up = thrust + j * t + s * t * t / 2
        b3 = up / np.linalg.norm(up)
        b2 = np.cross(b3, [1.0, 0, 0])
        b2 /= np.linalg.norm(b2)
        return np.column_stack([np.cross(b2, b3), b2, b3])

    def rate(t):
        turn = frame(t - step).T @ frame(t + step)
        return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (
            4 * step
        )

    omega, omega_rate = rate(0.0), (rate(step) - rate(-step)) / (2 * step)
    body = quadrotor(vehicle)
    inertia = np.asarray(body.inertia)
    torque = inertia * omega_rate + np.cross(omega, inertia * omega)
    rotor = np.asarray(body.inverse_allocation) @ np.array([body.mass * c, *torque])
    hover = body.mass * g / 4
    assert (rotor <= hover + LIMIT_SHARE * (4.25 - hover) + 1e-3).all()
    assert (rotor >= hover - LIMIT_SHARE * hover - 1e-3).all()
    assert (np.abs(omega) <= LIMIT_SHARE * np.array(vehicle.rates.max_rad_s) + 1e-6).all()
    assert math.acos(min(1.0, thrust[2] / c)) <= LIMIT_SHARE * 1.0 + 1e-9


def test_options_lower_the_limits_of_the_vehicle_and_points_have_no_tilt():
    own = motion_limits(dataclasses.replace(CONFIG, acceleration_m_s2=8.0), FASTBRIDGE)
    lower = motion_limits(
        dataclasses.replace(
            CONFIG, acceleration_m_s2=8.0, jerk_m_s3=3.0, snap_m_s4=20.0, tilt_rad=0.1, body_rate_rad_s=0.2
        ),
        FASTBRIDGE,
    )
    assert lower.tilt_rad == 0.1 < own.tilt_rad
    assert lower.snap_m_s4 < 20.0  # of so slow a body rate
    assert lower.jerk_m_s3 == pytest.approx(0.2 * lower.least_thrust_m_s2)
    point = Vehicle(
        name="point",
        model="double-integrator",
        body=BodyTable(radius_m=0.1),
        limits=LimitsTable(max_acceleration_m_s2=2.0),
    )
    of_point = motion_limits(CONFIG, point)
    assert of_point.acceleration_m_s2 == LIMIT_SHARE * 2.0
    assert of_point.record() == {
        "speed_m_s": 2.0,
        "acceleration_m_s2": LIMIT_SHARE * 2.0,
        "gravity_m_s2": 9.81,
    }
    with pytest.raises(UsageError, match="--tilt applies to a quadrotor, not to a double-integrator"):
        motion_limits(dataclasses.replace(CONFIG, tilt_rad=0.3), point)


def test_pieces_that_do_not_fit_their_cells_are_refused():
    corridor = box_chain(0, 2)
    for cell in ([0, 0, 1], [0, 0, 2, 2], [1, 1, 0, 0]):
        with pytest.raises(ValueError, match="do not fit together"):
            minimum_time(
                corridor.normal,
                corridor.offset,
                corridor.start,
                np.array(cell, np.uint32),
                MotionLimits(speed=1.0, acceleration=1.0),
                corridor.point[:1],
                corridor.point[-1].tolist(),
                np.zeros((len(cell) - 1, 3)),
                np.zeros(len(cell) - 1, np.uint8),
                0.01,
                1e-2,
                100,
                1.0,
            )


def with_openings(seed, is_disc, radius=0.1):
    """A chain with discs or balls about its joints; discs lie across the mean of the two directions."""
    corridor = box_chain(seed, 3, True)
    way = np.diff(corridor.point, axis=0)
    way /= np.linalg.norm(way, axis=1)[:, None]
    normal = way[:-1] + way[1:]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    opening = {
        j: Opening(joint, n if is_disc else np.zeros(3), radius)
        for j, (joint, n) in enumerate(zip(corridor.joint, normal, strict=True))
    }
    return dataclasses.replace(corridor, opening=opening)


@given(st.integers(0, 10**6), st.booleans(), st.floats(1e-4, 0.14))
@settings(deadline=None, max_examples=examples(25))
def test_curves_pass_discs_along_their_normals_and_balls_anywhere(seed, is_disc, radius):
    corridor = with_openings(seed, is_disc, radius)
    curve = solve(corridor)
    assert keeps(curve.point, curve.duration, LIMITS).all()
    for joint, opening in corridor.opening.items():
        before, after = curve.point[3 * joint + 2], curve.point[3 * joint + 3]
        np.testing.assert_array_equal(before[-1], after[0])
        assert np.linalg.norm(after[0] - opening.centre) <= radius + 1e-12
        if is_disc:
            heights = [(points - opening.centre) @ opening.normal for points in (before, after)]
            assert abs(heights[0][-1]) < 1e-12
            assert heights[0][:-1].max() < 0 < heights[1][1:].min()


@pytest.mark.slow
@pytest.mark.parametrize("is_disc", [True, False])
def test_with_openings_no_curve_is_faster_in_the_convex_reference(is_disc):
    corridor = with_openings(0, is_disc)
    curve = solve(corridor, pieces=2)
    assert curve.time[-1] < 0.97 * solve(dataclasses.replace(corridor, opening={}), pieces=2).time[-1]
    problem = convex(dataclasses.replace(corridor, is_via=np.zeros(2, np.bool_)), curve)
    opening = {2 * joint + 1: each for joint, each in corridor.opening.items()}
    problem = dataclasses.replace(problem, opening=opening)
    assert minimum_snap(problem, 0.985 * curve.duration) is None
    assert minimum_snap(problem, 1.001 * curve.duration) is not None


def test_cells_with_a_lower_speed_hold_it_and_the_convex_reference_is_not_faster():
    corridor = dataclasses.replace(box_chain(4, 3), speed=np.array([np.inf, 0.5, np.inf]))
    curve = solve(corridor, pieces=2)
    speed = np.linalg.norm(np.diff(curve.point, axis=1), axis=2).max(axis=1) * 7 / curve.duration
    assert 0.45 < speed[curve.cell == 1].max() <= 0.5
    assert speed[curve.cell != 1].max() > 0.6
    assert not keeps(curve.point, curve.duration / 1.01, LIMITS, corridor.speed[curve.cell]).all()
    problem = dataclasses.replace(convex(corridor, curve), speed=corridor.speed[curve.cell])
    assert minimum_snap(problem, 0.985 * curve.duration) is None
    assert minimum_snap(problem, 1.001 * curve.duration) is not None
