"""Septic trajectories: derivatives, continuity, optimality, bounds and time allocation."""

import math

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import InputError
from alula.stages.planning.trajectory import control_points, evaluate, peak_bounds, subdivided
from support.effort import examples
from support.models.septic_splines import allocate_times, septic_spline


def walk(seed, count=7, step=1.0):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=(count, 3)) * step, axis=0)


def spline(seed, count=7, rest=None):
    rng = np.random.default_rng(seed)
    duration = rng.uniform(0.2, 3, count - 1)
    time = np.concatenate([[0], np.cumsum(duration)])
    return time, septic_spline(walk(seed, count), np.diff(time), rest)


@given(st.integers(0, 10**6), st.integers(1, 7))
@settings(deadline=None, max_examples=examples(40))
def test_derivatives_agree_with_exact_polynomial_differences(seed, order):
    time, c = spline(seed % 50)
    rng = np.random.default_rng(seed)
    piece = rng.integers(len(c))
    t = rng.uniform(time[piece], time[piece + 1])
    for d in range(3):
        reference = np.polynomial.Polynomial(c[piece, d]).deriv(order)(t - time[piece])
        scale = np.abs(c[piece, d]).sum() + 1
        assert evaluate(time, c, t, order)[d] == pytest.approx(reference, rel=1e-11, abs=1e-11 * scale)


def test_derivatives_agree_with_finite_differences():
    time, c = spline(1)
    t, h = np.linspace(time[0] + 0.01, time[-1] - 0.01, 50), 1e-5
    for order in (0, 1, 2):
        difference = (evaluate(time, c, t + h, order) - evaluate(time, c, t - h, order)) / (2 * h)
        exact = evaluate(time, c, t, order + 1)
        np.testing.assert_allclose(difference, exact, rtol=1e-5, atol=1e-4 * np.abs(exact).max())


def test_outside_its_time_a_trajectory_stays_at_its_ends():
    time, c = spline(2)
    np.testing.assert_allclose(evaluate(time, c, [-5.0]), evaluate(time, c, time[:1]))
    np.testing.assert_allclose(evaluate(time, c, time[-1] + 9), walk(2)[-1], atol=1e-9)
    assert evaluate(time, c, np.zeros((2, 5))).shape == (2, 5, 3)


@pytest.mark.parametrize("seed", range(6))
def test_the_spline_passes_its_waypoints_with_six_continuous_derivatives_from_rest_to_rest(seed):
    time, c = spline(seed)
    waypoint = walk(seed)
    np.testing.assert_allclose(c[:, :, 0], waypoint[:-1], atol=1e-12)
    duration = np.diff(time)
    for order in range(7):
        factor = np.array([math.factorial(j) / math.factorial(j - order) for j in range(order, 8)])
        left = np.einsum("kdj,j,kj->kd", c[:, :, order:], factor, duration[:, None] ** np.arange(8 - order))
        right = math.factorial(order) * c[:, :, order]
        tolerance = 1e-8 * np.abs(right).max()
        if order == 0:
            np.testing.assert_allclose(left, waypoint[1:], atol=1e-9)
        np.testing.assert_allclose(left[:-1], right[1:], atol=tolerance)
        if 1 <= order <= 3:
            np.testing.assert_allclose(right[0], 0, atol=tolerance)
            np.testing.assert_allclose(left[-1], 0, atol=tolerance)


def test_the_spline_has_the_least_snap_a_quadratic_program_finds():
    """The program sees only the definition: coefficients, ends, waypoints, three continuous derivatives."""
    waypoint, duration = np.array([0.0, 1.0, -0.5, 2.0]), np.array([1.0, 0.7, 1.3])
    nodes, weights = np.polynomial.legendre.leggauss(6)
    c = cp.Variable((3, 8))

    def row(t, order):
        return np.array(
            [
                math.factorial(j) / math.factorial(j - order) * t ** (j - order) if j >= order else 0.0
                for j in range(8)
            ]
        )

    cost, constraints = 0, []
    for k, length in enumerate(duration):
        for node, weight in zip((nodes + 1) / 2 * length, weights / 2 * length, strict=True):
            cost += weight * cp.square(row(node, 4) @ c[k])
        constraints += [row(0, 0) @ c[k] == waypoint[k], row(length, 0) @ c[k] == waypoint[k + 1]]
        for order in (1, 2, 3):
            after = row(0, order) @ c[k + 1] if k < 2 else 0
            constraints.append(row(length, order) @ c[k] == after)
    constraints += [row(0, order) @ c[0] == 0 for order in (1, 2, 3)]
    cp.Problem(cp.Minimize(cost), constraints).solve(solver=cp.CLARABEL)
    found = septic_spline(waypoint[:, None], duration)[:, 0]
    np.testing.assert_allclose(found, c.value, atol=1e-4 * np.abs(found).max())


def test_between_two_stops_the_spline_is_the_straight_septic():
    waypoint = np.array([[0, 0, 0], [1, 2, 3], [2, 2, 2], [5, 1, 0.0]])
    duration = np.array([1.0, 2.0, 0.5])
    c = septic_spline(waypoint, duration, [True, True, True, False])
    unit = np.array([0, 0, 0, 0, 35, -84, 70, -20])
    for k in range(3):  # the last waypoint is an end, so it is a stop as well
        step = waypoint[k + 1] - waypoint[k]
        expected = step[:, None] * unit / duration[k] ** np.arange(8)
        expected[:, 0] = waypoint[k]
        np.testing.assert_allclose(c[k], expected, atol=1e-9 * np.abs(expected).max())
    assert peak_bounds([0, 1.0], c[:1], 1)[0] == pytest.approx(2.1875 * math.sqrt(14), rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_control_points_give_the_same_curve_and_enclose_it(seed):
    time, c = spline(seed)
    points = control_points(time, c)
    s = np.linspace(0, 1, 33)
    basis = np.array([math.comb(7, i) * s**i * (1 - s) ** (7 - i) for i in range(8)])
    for k in range(len(c)):
        curve = evaluate(time, c, time[k] + s[:-1] * (time[k + 1] - time[k]))
        np.testing.assert_allclose((points[k] @ basis).T[:-1], curve, atol=1e-9)
    parts = subdivided(points, 32)
    np.testing.assert_allclose(parts[:, :, 1:, 0], parts[:, :, :-1, 7], atol=1e-9)
    np.testing.assert_allclose(parts[0, :, :, 0].T, (points[0] @ basis).T[:-1], atol=1e-9)


@pytest.mark.parametrize("derivative", [1, 2, 3])
def test_peak_bounds_are_above_and_close_to_dense_samples(derivative):
    for seed in range(5):
        time, c = spline(seed)
        bound = peak_bounds(time, c, derivative)
        for k in range(len(c)):
            t = np.linspace(time[k], np.nextafter(time[k + 1], 0), 4001)
            peak = np.linalg.norm(evaluate(time, c, t, derivative), axis=1).max()
            assert peak * (1 - 1e-9) <= bound[k] <= peak * 1.01


@pytest.mark.parametrize(("speed", "acceleration"), [(1.0, 3.0), (4.0, 8.0), (0.2, 3.0), (10.0, 0.5)])
def test_allocated_times_hold_the_limits_and_use_them(speed, acceleration):
    for seed in range(3):
        waypoint = walk(seed, 6)
        rest = np.arange(6) == 3
        duration = allocate_times(waypoint, speed, acceleration, rest)
        time = np.concatenate([[0], np.cumsum(duration)])
        c = septic_spline(waypoint, np.diff(time), rest)
        t = np.linspace(0, time[-1], 20001)
        fastest = np.linalg.norm(evaluate(time, c, t, 1), axis=1).max()
        hardest = np.linalg.norm(evaluate(time, c, t, 2), axis=1).max()
        assert fastest <= speed * (1 + 1e-12)
        assert hardest <= acceleration * (1 + 1e-12)
        assert max(fastest / speed, hardest / acceleration) > 0.99
        np.testing.assert_allclose(evaluate(time, c, time[3], 1), 0, atol=1e-8)


def test_wrong_shapes_are_refused():
    with pytest.raises(InputError, match="knots"):
        evaluate([0, 1], np.zeros((2, 3, 8)), 0.5)
    with pytest.raises(InputError, match="derivative"):
        evaluate([0, 1], np.zeros((1, 3, 8)), 0.5, 8)
