"""The estimate of what the model leaves out, against plants that have it."""

import math

import numpy as np
import pytest

from alula import _core
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.vehicles.bodies import quadrotor, tracking_gains

DT = 0.01
BODY = quadrotor(FASTBRIDGE)
GAINS = tracking_gains(FASTBRIDGE, 0.5)


def flight_of(time_s, *, goal=(0.0, 0.0, 1.0), interface="wrench", delay_s=0.0):
    row = np.zeros(18)
    row[:3] = goal
    spec = _core.VehicleSpec(
        BODY,
        interface=interface,
        gains=GAINS,
        rate_time_constant_s=(0.04, 0.04, 0.2),
        assumed=_core.ActuatorModel(delay_s=delay_s),
    )
    options = _core.FlightOptions(dt_s=DT, disturbance_time_s=time_s)
    return _core.Flight(spec, options, _core.Mission.given(), []), row


def hover(time_s, wind, seconds, *, drag=0.3, seed=0, noise=0.0):
    """Hover by wrenches in a wind; states and estimates by tick."""
    flight, row = flight_of(time_s)
    plant = _core.Plant(
        BODY,
        _core.PlantOptions(
            linear_drag=(drag,) * 3, wind_m_s=wind, sensor=_core.SensorOptions(velocity_noise_m_s=noise)
        ),
        seed=seed,
    )
    start = np.zeros(12)
    start[2] = 1.0
    plant.reset(start)
    states, estimates, bounds = [], [], []
    for k in range(round(seconds / DT)):
        flight.observe(k * DT, plant.measured, target=row)
        found = flight.decide()
        flight.sent()
        for _ in range(5):
            plant.step(DT / 5, found["command"][3:7])
        plant.switch_shadow()
        states.append(plant.state)
        estimates.append(found["disturbance"])
        bounds.append(found["disturbance_bound"])
    return np.array(states), np.array(estimates), np.array(bounds)


def test_hovering_in_wind_has_no_offset_and_the_estimate_is_the_drag():
    wind = np.array([3.0, -2.0, 0.5])
    states, estimates, bounds = hover(0.1, tuple(wind), 6.0)
    np.testing.assert_allclose(states[-1, :3], [0, 0, 1], atol=5e-3)
    np.testing.assert_allclose(estimates[-1], 0.3 / BODY.mass * wind, atol=0.02)
    assert bounds[-1] < 0.05
    assert bounds[:30].max() > 1.0
    drifting, nothing, _ = hover(0.0, tuple(wind), 6.0)
    assert np.linalg.norm(drifting[-1, :3] - [0, 0, 1]) > 0.5
    assert not nothing.any()


def test_without_wind_nothing_is_estimated():
    _, estimates, bounds = hover(0.1, (0, 0, 0), 3.0, drag=0.0)
    assert np.abs(estimates).max() < 1e-9
    assert bounds.max() < 1e-9


@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.05, 0.0), (0.0, 0.04), (0.05, 0.0325)])
def test_known_lag_and_delay_are_no_disturbance(lag_s, delay_s):
    """The thrust of an interval is what the rotors had in it, not what was commanded last."""
    model = _core.ActuatorModel(motor_time_constant_s=lag_s, delay_s=delay_s)
    spec = _core.VehicleSpec(BODY, interface="wrench", gains=GAINS, assumed=model)
    options = _core.FlightOptions(dt_s=DT, disturbance_time_s=0.1)
    flight = _core.Flight(spec, options, _core.Mission.given(), [])
    sensor = _core.SensorOptions(delay_s=delay_s)
    plant = _core.Plant(BODY, _core.PlantOptions(motor_time_constant_s=lag_s, sensor=sensor))
    state, row, fastest, worst = np.zeros(12), np.zeros(18), 0.0, 0.0
    plant.reset(state)
    for k in range(300):
        row[:3] = (0.5, 0.3, 0.4) if k % 100 < 50 else (0, 0, 0)  # away and back, at full tilt
        flight.observe(k * DT, plant.measured, target=row)
        found = flight.decide()
        flight.sent()
        before = np.array(plant.state)[6:9]
        for _ in range(10):
            plant.step(DT / 10, found["command"][3:7])
        plant.switch_shadow()
        fastest = max(fastest, np.linalg.norm(np.array(plant.state)[6:9] - before) / DT)
        worst = max(worst, np.linalg.norm(found["disturbance"]), found["disturbance_bound"])
    assert fastest > 1
    assert worst < 0.1


def test_noise_is_not_amplified_beyond_its_share():
    # Both poles at q = exp(-dt / T): the variance of the estimate for white noise of the velocity.
    _, estimates, _ = hover(0.1, (0, 0, 0), 40.0, drag=0.0, noise=0.01)
    q = math.exp(-DT / 0.1)
    impulse, v, d = [], 0.0, 0.0
    for k in range(400):
        error = (1.0 if k == 0 else 0.0) - (v + DT * d)
        v, d = v + DT * d + (1 - q * q) * error, d + (1 - q) ** 2 / DT * error
        impulse.append(d)
    expected = 0.01 * math.sqrt(sum(x * x for x in impulse))
    assert estimates[200:].std(axis=0) == pytest.approx([expected] * 3, rel=0.5)


@pytest.mark.parametrize("lean", [0.0, 0.2, -0.3])
def test_a_lean_at_the_start_is_taken_for_a_wind_that_it_leans_against(lean):
    flight, row = flight_of(0.1)
    state = np.zeros(12)
    state[2], state[4] = 1.0, math.tan(lean / 4)  # about y: the thrust points to +x
    flight.observe(0.0, state, target=row)
    found = flight.decide()
    assert found["disturbance"] == pytest.approx((-9.81 * math.tan(lean), 0, 0), abs=1e-9)
    # The controller sees a level attitude at its goal: no torque, and the thrust of hovering with this lean.
    np.testing.assert_allclose(found["command"][4:7], 0, atol=1e-9)
    assert found["command"][3] == pytest.approx(BODY.mass * 9.81 / math.cos(lean), rel=1e-9)


def test_the_estimate_is_limited():
    _, estimates, _ = hover(0.1, (40.0, 0, 0), 2.0)
    assert np.linalg.norm(estimates, axis=1).max() == pytest.approx(4.0, abs=1e-9)


@pytest.mark.parametrize("time_s", [0.01, -1.0, math.nan, 11.0])
def test_times_out_of_range_are_refused(time_s):
    with pytest.raises(ValueError, match="time of a disturbance observer"):
        flight_of(time_s)
