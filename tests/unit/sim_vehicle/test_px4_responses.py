"""The simulated PX4 answers, takes off and lands as PX4's own simulation, which `tests/sitl` flies."""

import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.sim_vehicle.simulator import SimulatedVehicle
from support.paths import VEHICLES
from support.vehicles.px4_responses import MEASURED, measure
from support.vehicles.responses import Stepped


@pytest.mark.slow
def test_it_answers_and_takes_as_long_as_the_real_one_within_a_tenth():
    vehicle = read_vehicle(VEHICLES / "px4-sih.toml")
    found = measure(Stepped(SimulatedVehicle(Px4Copter(vehicle, seed=1), seed=1)))
    for name in ("position at rest [m]", "velocity at rest [m/s]"):  # they say nothing of its noise in flight
        del found[name]
    near = {name: value for name, value in MEASURED.items() if name in found}
    assert found == {
        name: pytest.approx(value, rel=0.1) if isinstance(value, float) else value
        for name, value in near.items()
    }
    assert len(found) == len(MEASURED) - 2
