"""`alula identify` on ArduPilot's own simulation gives the responses that were measured apart from it."""

import math
import subprocess
import sys

import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.vehicles.velocity_lag import stop_time_s
from support.paths import VEHICLES
from support.vehicles.ardupilot_sitl import sitl
from support.vehicles.fly_process import LOOSE
from support.vehicles.responses import MEASURED

pytestmark = [pytest.mark.sitl, pytest.mark.realtime, pytest.mark.slow]


def test_the_file_has_the_responses_of_the_real_program(tmp_path):
    output = tmp_path / "mine.toml"
    with sitl(tmp_path) as sim:
        words = [
            *(sys.executable, "-P", "-m", "alula.cli", "identify", "--link", f"udpin:127.0.0.1:{sim.port}"),
            *("--box", "-8 -8 0 8 8 16", "--speeds", "1,2", "--rates", *LOOSE),
            *("--vehicle", str(VEHICLES / "arducopter.toml"), "-o", str(output)),
        ]
        done = subprocess.run(words, capture_output=True, text=True, timeout=600)
    print(done.stdout, done.stderr)
    assert done.returncode == 0, done.stderr
    vehicle = read_vehicle(output)
    for speed in (1.0, 2.0):
        level = stop_time_s(vehicle.velocities.horizontal_lag, speed)
        climb = stop_time_s(vehicle.velocities.vertical_lag, speed)
        assert level == pytest.approx(MEASURED[f"stop_{speed:g}_s"], rel=0.1)
        assert climb == pytest.approx(MEASURED[f"stop_up_{speed:g}_s"], rel=0.1)
    # A set-point waits for the next of the vehicle's 400 ticks a second, and a state for its interval.
    for name, time_s in zip(("roll", "pitch", "yaw"), vehicle.rates.axis_time_constant_s, strict=True):
        assert time_s == pytest.approx(MEASURED[f"{name}_s"], rel=0.15, abs=0.02)
    assert vehicle.identified.autopilot.startswith("ArduPilot")
    # Its own parameters bound no rate command but the acceleration of turns, ATC_ACCEL_Y_MAX = 27000.
    assert vehicle.identified.yaw_acceleration_rad_s2 == pytest.approx(math.radians(270.0), rel=0.1)
    assert vehicle.identified.reached_rad_s[2] == pytest.approx(4.0, rel=0.1)
    assert all(rate > 1.0 for rate in vehicle.identified.reached_rad_s[:2])
    assert vehicle.rates.max_rad_s == (10.0, 10.0, 4.0)
    assert "by ATC_" not in done.stdout + done.stderr  # no parameter is wrong by more than a quarter
