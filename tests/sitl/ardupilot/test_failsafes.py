"""The vehicle's own failsafes, as the real autopilot reports them."""

import time

import pytest

from support.vehicles.ardupilot_sitl import flight, sitl

pytestmark = pytest.mark.sitl

BATTERY = {"BATT_FS_LOW_ACT": 1, "BATT_LOW_TIMER": 1}


@pytest.mark.parametrize(
    ("parameters", "trouble", "cause"),
    [
        (BATTERY, {"BATT_LOW_VOLT": 20}, "Battery Failsafe; Battery 1 is low"),
        ({"FS_THR_ENABLE": 3}, {"SIM_RC_FAIL": 1}, "Radio Failsafe"),
        ({"FS_THR_ENABLE": 1}, {"SIM_RC_FAIL": 1}, "Radio Failsafe"),
    ],
)
def test_a_failsafe_is_named_and_left_to_the_vehicle(tmp_path, parameters, trouble, cause):
    with sitl(tmp_path, parameters) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(3.0)
        sim.set(**trouble)
        fly.wait_for("vehicle's own failsafe", 10.0)
        assert "by the pilot" not in fly.said
        time.sleep(1.0)
        fly.interrupt()
        assert fly.end() == 6, fly.said
        assert f"the flight ended early: vehicle's own failsafe ({cause}" in fly.said


def test_a_mode_of_the_pilot_is_the_pilots(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(3.0)
        sim.command(176, 1, 9)  # DO_SET_MODE, LAND
        fly.wait_for("mode changed by the pilot", 10.0)
        assert fly.end() == 4, fly.said
