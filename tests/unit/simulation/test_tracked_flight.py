"""The example vehicles behind the controller, sampled at 100 Hz with the wrench held, plant at 1 kHz."""

import numpy as np
import pytest

from alula._core import Plant, PlantOptions, ReferenceCurve, SensorOptions, track
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from support.models.quadrotor_model import body_to_inertial
from support.paths import VEHICLES

EXAMPLES = VEHICLES
GOAL, YAW = np.array([10.0, 3.0, 2.0]), 0.5


def fly(name, *, speed=5.0, offset=(0.0, 0.0, 0.0), seconds=2.0, **disturbance):
    """Distances from the reference and tilts, a row per tick; `seconds` beyond the reference's end."""
    vehicle = read_vehicle(EXAMPLES / f"{name}.toml")
    body, gains = quadrotor(vehicle), tracking_gains(vehicle)
    start = np.array([0.0, 0.0, 1.0])
    curve = ReferenceCurve(*rest_to_rest(start, GOAL, speed, yaw_rad=YAW))
    flown, x = Plant(body, PlantOptions(**disturbance), seed=1), np.zeros(12)
    x[:3], x[5] = start + offset, np.tan(YAW / 4)
    flown.reset(x)
    distance, tilt = [], []
    for k in range(round((curve.duration_s + seconds) * 100)):
        wanted = track(body, gains, flown.measured[None], curve.at(np.array([k * 0.01])))["wrench"]
        flown.fly(0.001, np.repeat(body.limited(wanted), 10, axis=0))
        flown.switch_shadow()
        distance.append(np.linalg.norm(flown.state[:3] - curve.at(np.array([(k + 1) * 0.01]))[0, :3]))
        tilt.append(np.arccos(np.clip(body_to_inertial(flown.state[3:6])[2, 2], -1, 1)))
    return np.array(distance), np.array(tilt)


@pytest.mark.parametrize("name", ["fastbridge", "crazyflie21", "racer7"])
def test_each_example_stays_within_millimetres_at_5_m_s(name):
    distance, _ = fly(name)
    assert distance.max() < 2e-3
    assert distance[-1] < 1e-4


@pytest.mark.every(2)
@pytest.mark.parametrize("name", ["fastbridge", "crazyflie21", "racer7"])
def test_lag_and_delay_cost_centimetres(name):
    distance, _ = fly(name, speed=2.0, motor_time_constant_s=0.02, sensor=SensorOptions(delay_s=0.01))
    assert 5e-3 < distance.max() < 4e-2
    assert distance[-1] < 1e-3


@pytest.mark.every(2)
@pytest.mark.parametrize("name", ["fastbridge", "crazyflie21", "racer7"])
def test_a_large_error_is_flown_back_without_tumbling(name):
    limit = read_vehicle(EXAMPLES / f"{name}.toml").tracking.max_tilt_rad
    distance, tilt = fly(name, offset=(-20.0, 15.0, 3.0), speed=2.0, seconds=1.0)
    assert distance[-1] < 0.05
    assert tilt.max() < limit + 0.25
