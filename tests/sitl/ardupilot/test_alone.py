"""The real autopilot when `alula fly` or its computer ends or stands still while it flies body rates."""

import os
import signal
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from alula.stages.sim_vehicle.common.packets import mavlink
from support.paths import VEHICLES
from support.scenes.small_scenes import line_plan
from support.vehicles.ardupilot_sitl import flight, sitl

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

SPEED = 0.8
PLAN = line_plan((0.0, 0.0, 1.5), (14.0, 0.0, 1.5), 14.0 * 2.1875 / SPEED)  # the top speed of a septic
BY_RATES = ("--filter", "cone-backup", "--allow-tight", "--vehicle", str(VEHICLES / "arducopter.toml"))
GUIDED, LAND = 4, 9
RUNS = int(os.environ.get("ALULA_RUNS", "1"))


def watchdog_of(process):
    """Process id of the watchdog of a flight."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return next(
        int(each) for each in children if b"companion.py" in Path(f"/proc/{each}/cmdline").read_bytes()
    )


def said(fly, words):
    """Distance before these words in the check of the failsafes [m]."""
    line = fly.said.split("it coasts at most ")[1].split("\n")[0]
    return float(line.split(f" m when {words}")[0].split(", ")[-1])


def at_top_speed(sim, fly):
    """Wait until it flies at top speed; the vehicle's modes are then reported often."""
    begun = fly.wait_for("flying the plan")
    sim.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_HEARTBEAT, 2e4)
    time.sleep(0.5 * 14.0 * 2.1875 / SPEED - (time.monotonic() - begun))


def coasted(sim, ended, label):
    """Distance and range of heights after the end [m], and the modes with the times of their change [s]."""
    truth = np.array([row for row in list(sim.truth) if ended - 0.05 <= row[0] < ended + 6.0])
    speed = np.linalg.norm(truth[4, 1:3] - truth[0, 1:3]) / (truth[4, 0] - truth[0, 0])
    distance = float(np.linalg.norm(truth[:, 1:3] - truth[0, 1:3], axis=1).max())
    modes = [(at - ended, mode) for at, mode in list(sim.modes) if at > ended]
    changes = [modes[0], *(new for old, new in pairwise(modes) if new[1] != old[1])]
    print(
        f"{label}: coasted {distance:.2f} m from {speed:.2f} m/s, modes",
        [(round(t, 3), m) for t, m in changes],
    )
    assert np.ptp(truth[:, 3]) < 3.0
    return distance, changes


@pytest.mark.parametrize("run", range(RUNS))
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_watchdog_lands_it_within_half_a_second_and_the_distance_that_was_said(tmp_path, number, run):
    with sitl(tmp_path) as sim, flight(sim, tmp_path, *BY_RATES, plan=PLAN) as fly:
        at_top_speed(sim, fly)
        fly.process.send_signal(number)
        ended = time.monotonic()
        time.sleep(6.0)
        if number == signal.SIGSTOP:
            fly.process.send_signal(signal.SIGCONT)
            fly.wait_for("watchdog took over: it stops the vehicle and lands it", 5.0)
            fly.wait_for("disarmed: the flight is over", 30.0)
            assert fly.end() == 4
            assert "the plan was not finished: watchdog took over (the loop stalled for 6." in fly.said
        distance, changes = coasted(sim, ended, f"{number.name} {run}")
        assert [mode for _, mode in changes if mode != GUIDED] == [LAND]
        assert changes[-1][0] < 0.5
        assert distance < said(fly, "this program dies")


def test_when_the_computer_dies_its_own_failsafe_lands_it_within_the_distance_that_was_said(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path, *BY_RATES, plan=PLAN) as fly:
        at_top_speed(sim, fly)
        os.kill(watchdog_of(fly.process), signal.SIGKILL)
        fly.wait_for("the watchdog has ended; the vehicle's own failsafes remain", 2.0)
        fly.process.kill()
        ended = time.monotonic()
        time.sleep(6.0)
        distance, changes = coasted(sim, ended, "both killed")
        assert [mode for _, mode in changes] == [GUIDED, LAND]
        assert distance < said(fly, "its computer does")
