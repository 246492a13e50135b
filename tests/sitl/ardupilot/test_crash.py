"""Crashes on the real autopilot: no set-points follow, it disarms, and the command says what happened."""

import time

import pytest

from support.vehicles.ardupilot_sitl import flight, sitl

pytestmark = pytest.mark.sitl


@pytest.mark.parametrize(
    ("rotors", "words"),
    [
        (15, ("on the ground below its plan", "crashed")),
        (1, ("upside down", "crashed", "on the ground below")),
    ],
)
def test_a_vehicle_whose_rotors_fail_gets_no_more_thrust(tmp_path, rotors, words):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(3.0)
        sim.set(SIM_ENGINE_MUL=0, SIM_ENGINE_FAIL=rotors)
        failed_s = time.monotonic()
        ended_s = _printed(fly, words)
        assert ended_s - failed_s < 4.0
        assert fly.end(20.0) == 6, fly.said
        assert not sim.newest["HEARTBEAT"].base_mode & 128, fly.said  # its motors stand still
        assert "no longer controls the vehicle" not in fly.said


def _printed(fly, words):
    """When the first of them was printed [s]."""
    end_s = time.monotonic() + 5.0
    while not any(map(fly.at, words)) and time.monotonic() < end_s:
        time.sleep(0.02)
    return min(filter(None, map(fly.at, words)))
