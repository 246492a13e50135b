"""A vehicle that `identify` measured follows velocities in simulations as it did in flight."""

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.vehicle import VelocitiesTable, read_vehicle
from alula.schemas.world import WorldScenario
from alula.schemas.world_defaults import completed
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from support.paths import VEHICLES

COPTER = read_vehicle(VEHICLES / "arducopter.toml")
MEASURED = msgspec.structs.replace(COPTER, velocities=VelocitiesTable(horizontal_lag=(0.56, 0.18)))


def gain_of(vehicle, speed_m_s):
    scenario = msgspec.convert(
        {
            "schema": "alula/scenario",
            "version": "2.0",
            "name": "stop",
            "vehicle": {"interface": "velocity", "max_speed_m_s": speed_m_s},
            "mission": {"kind": "hover", "start_m": [0.0, 0.0, 1.0]},
        },
        WorldScenario,
    )
    return completed(scenario, vehicle).vehicle.velocity_gain_per_s


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0, 2.0])
def test_a_simulated_stop_takes_as_long_as_the_measured_one(speed_m_s):
    spec = _core.VehicleSpec(
        quadrotor(MEASURED),
        interface="velocity",
        gains=tracking_gains(MEASURED, 0.5),
        velocity_gain_per_s=gain_of(MEASURED, speed_m_s),
        max_speed_m_s=speed_m_s,
    )
    start = np.zeros(12)
    start[2], start[6] = 1.0, speed_m_s
    rest = _core.Mission.to((0.0, 0.0, 1.0), gain_per_s=1e-9, speed_m_s=1e-6, hovers=True)
    simulation = _core.SimulationSpec(
        spec,
        options=_core.FlightOptions(dt_s=0.01),
        rules=_core.SimulationRules(plant_steps=10, ends_at_goal=False),
    )
    (log,) = _core.simulate(simulation, [_core.Task(start, rest, max_time_s=3.0, stop_distance_m=1e-9)], [])
    below = np.flatnonzero(log["state"][:, 6] < np.exp(-1) * speed_m_s)[0] * 0.01
    assert below == pytest.approx(0.56 + 0.18 * speed_m_s, rel=0.1)


def test_a_vehicle_that_was_not_measured_keeps_its_own_gain():
    assert gain_of(COPTER, 1.0) == COPTER.tracking.kv_per_s
