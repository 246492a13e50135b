"""PolyMerge, eq. 16 and the single integrator: the nominal controller against its quadratic program."""

import numpy as np
import pytest

from alula import _core

NO_REFERENCE = np.empty((0, 3))


def trial(start, goal, gain=2.0, v_max=1e9):
    rules = _core.TrialRules(
        dt_s=0.01, gain=gain, v_max=v_max, stop_fraction=0.01, stuck_speed=1e-3, stuck_steps=100, max_steps=50
    )
    return _core.Trial(list(start), list(goal), rules, NO_REFERENCE, NO_REFERENCE)


def test_the_nominal_velocity_is_the_minimum_norm_solution_of_the_clf_row():
    import cvxpy as cp

    rng = np.random.default_rng(0)
    for c in (0.5, 2.0, 7.0):
        start, goal = rng.normal(size=(2, 3))
        u, error = cp.Variable(3), start - goal
        lyapunov = 0.5 * error @ error  # V, with grad V = x - x_goal
        problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(u)), [error @ u <= -c * lyapunov])
        problem.solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(trial(start, goal, c).nominal(), u.value, atol=1e-6)


def test_the_nominal_velocity_is_scaled_to_the_speed_limit():
    nominal = np.array(trial((0, 0, 0), (3, -4, 0), v_max=0.5).nominal())
    np.testing.assert_allclose(nominal, [0.3, -0.4, 0])


def test_a_step_is_that_of_the_single_integrator():
    flight = trial((1, 2, 3), (5, 5, 5))
    flight.advance([1.0, -2.0, 0.5], False)
    assert flight.position == pytest.approx([1.01, 1.98, 3.005])
