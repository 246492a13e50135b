"""PolyMerge, eq. 16 and the single integrator: the nominal command against its quadratic program."""

import numpy as np
import pytest

from alula import _core
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.vehicles.bodies import quadrotor

DT = 0.01


def state_at(position):
    state = np.zeros(12)
    state[:3] = position
    return state


def point(max_speed_m_s=1e9):
    return _core.VehicleSpec(
        quadrotor(FASTBRIDGE),
        model="single-integrator",
        interface="velocity",
        gains=_core.TrackingGains(),
        max_speed_m_s=max_speed_m_s,
    )


def nominal(start, goal, gain=2.0, v_max=1e9):
    mission = _core.Mission.to(list(goal), gain_per_s=gain, speed_m_s=v_max)
    flight = _core.Flight(point(v_max), _core.FlightOptions(dt_s=DT), mission, [])
    flight.observe(0.0, state_at(start))
    return np.array(flight.decide()["command"][:3])


def test_the_nominal_velocity_is_the_minimum_norm_solution_of_the_clf_row():
    import cvxpy as cp

    rng = np.random.default_rng(0)
    for c in (0.5, 2.0, 7.0):
        start, goal = rng.normal(size=(2, 3))
        u, error = cp.Variable(3), start - goal
        lyapunov = 0.5 * error @ error  # V, with grad V = x - x_goal
        problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(u)), [error @ u <= -c * lyapunov])
        problem.solve(solver=cp.CLARABEL)
        np.testing.assert_allclose(nominal(start, goal, c), u.value, atol=1e-6)


def test_the_nominal_velocity_is_scaled_to_the_speed_limit():
    np.testing.assert_allclose(nominal((0, 0, 0), (3, -4, 0), v_max=0.5), [0.3, -0.4, 0])


def test_a_step_is_that_of_the_single_integrator():
    gain, goal = 4.0, np.array([1.5, 1.0, 3.25])  # u = gain / 2 (goal - start) = (1, -2, 0.5)
    simulation = _core.SimulationSpec(
        point(), options=_core.FlightOptions(dt_s=DT), rules=_core.SimulationRules(plant_steps=1)
    )
    task = _core.Task(state_at((1, 2, 3)), _core.Mission.to(goal.tolist(), gain_per_s=gain), max_time_s=DT)
    (log,) = _core.simulate(simulation, [task], [])
    assert log["command"][0, :3] == pytest.approx([1.0, -2.0, 0.5])
    assert log["path"][-1] == pytest.approx([1.01, 1.98, 3.005])
