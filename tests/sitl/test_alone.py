"""The real autopilot when `alula fly` ends or stands still while it flies body rates."""

import signal
import time

import numpy as np
import pytest

from support.ardupilot_sitl import flight, sitl
from support.paths import VEHICLES
from support.small_scenes import line_plan

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

SPEED = 0.8
PLAN = line_plan((0.0, 0.0, 1.5), (14.0, 0.0, 1.5), 14.0 * 2.1875 / SPEED)  # the top speed of a septic
BY_RATES = ("--filter", "cone-backup", "--allow-tight", "--vehicle", str(VEHICLES / "arducopter.toml"))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_it_stops_within_the_distance_that_was_said(tmp_path, number):
    with sitl(tmp_path) as sim, flight(sim, tmp_path, *BY_RATES, plan=PLAN) as fly:
        begun = fly.wait_for("flying the plan")
        fly.wait_for("coasts at most")
        said = float(fly.said.split("coasts at most ")[1].split(" m")[0])
        time.sleep(0.5 * 14.0 * 2.1875 / SPEED - (time.monotonic() - begun))  # at top speed
        fly.process.send_signal(number)
        ended = time.monotonic()
        time.sleep(6.0)
        if number == signal.SIGSTOP:
            fly.process.send_signal(signal.SIGCONT)
            fly.wait_for("vehicle's own failsafe", 5.0)
            assert "GCS Failsafe" in fly.said
        truth = np.array([row for row in sim.truth if ended - 0.05 <= row[0] < ended + 6.0])
        coasted = float(np.linalg.norm(truth[:, 1:3] - truth[0, 1:3], axis=1).max())
        speed = np.linalg.norm(np.diff(truth[:3, 1:3], axis=0)) / (truth[1, 0] - truth[0, 0])
        print(f"coasted {coasted:.2f} m from {speed:.2f} m/s, said {said:.1f} m")
        assert coasted < said
        assert np.ptp(truth[:, 3]) < 3.0
