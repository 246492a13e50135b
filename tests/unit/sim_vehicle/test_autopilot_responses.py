"""The simulated autopilot answers and responds as ArduPilot's own simulation, which `tests/sitl` flies."""

import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.simulator import SimulatedVehicle
from support.vehicles.autopilot_client import EXACT
from support.vehicles.responses import ANSWERS, MEASURED, Measurer, Stepped, measure


def measurer(**options):
    return Measurer(Stepped(SimulatedVehicle(ArduCopter(FASTBRIDGE, seed=1, **options), seed=1)))


@pytest.mark.slow
def test_it_responds_within_a_tenth_of_the_real_one():
    found = measure(measurer(options=EXACT))
    assert found == {name: pytest.approx(value, rel=0.1) for name, value in MEASURED.items()}


def test_it_answers_as_the_real_one_before_it_has_a_position():
    assert measurer().greet() == ANSWERS
