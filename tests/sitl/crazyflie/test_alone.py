"""What the Crazyflie's real firmware does when the program that flies it is killed."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.crazyflie_host import crazyflie
from support.vehicles.fly_process import fly
from support.vehicles.sim_vehicle_process import until

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

SPEED = 0.73  # largest of the plan [m/s]
PLAN = line_plan((0.0, 0.0, 0.8), (6.0, 0.0, 0.8), 6.0 * 2.1875 / SPEED)
COVER = box_cover([((-100, 60, 0), (200, 64, 20))])  # far away


def motion_after(folder, end):
    """Time [s], position [m] and velocity [m/s] from the end of `alula fly`, near top speed, until rest."""
    words = ("--vehicle", str(VEHICLES / "crazyflie21.toml"), "--speed", "1.1", "--beyond-map", "5")
    with (
        crazyflie(folder, (0.0, 0.0, 0.0), "--seed", "1") as vehicle,
        fly(vehicle.link("pid"), folder, *words, plan=PLAN, cover=COVER) as flown,
    ):
        flown.wait_for("flying the plan")
        until(lambda: vehicle.truth[-1][2] > 2.6)
        begin = len(vehicle.truth) - 1
        end(flown.process)
        until(lambda: vehicle.truth[-1][4] <= 0.0)
        found = np.array([sample[1:] for sample in vehicle.truth[begin:]])
        return found - [found[0, 0], *found[0, 1:3], 0.0, 0.0, 0.0, 0.0]


def test_the_watchdog_holds_and_lands_it_when_the_program_is_killed(tmp_path):
    found = motion_after(tmp_path, lambda process: process.send_signal(signal.SIGKILL))
    assert found[0, 4] > 0.65
    assert np.linalg.norm(found[:, 1:3], axis=1).max() < 0.4
    assert found[:, 6].min() > -0.8
    assert found[-1, 0] < 7.0


def test_without_its_watchdog_it_coasts_and_falls(tmp_path):
    def end(process):
        process.send_signal(signal.SIGSTOP)
        for child in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split():
            os.kill(int(child), signal.SIGKILL)
        process.send_signal(signal.SIGKILL)

    found = motion_after(tmp_path, end)
    falls_s = found[np.flatnonzero(found[:, 6] < -1.0)[0], 0]
    assert 2.0 < falls_s < 2.4
    assert 1.0 < np.linalg.norm(found[-1, 1:3]) < 2.2
