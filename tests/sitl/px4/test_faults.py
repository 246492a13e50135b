"""The real PX4 when `alula fly` ends, and when the pilot or a failsafe takes it over; by motion capture."""

import math
import signal
import time
from contextlib import contextmanager, nullcontext

import pytest

from support.paths import VEHICLES
from support.vehicles.ardupilot_sitl import flight
from support.vehicles.px4_sitl import MOCAP, px4

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

SIH = ("--vehicle", str(VEHICLES / "px4-sih.toml"))
POSITION, LAND = (3, 0), (4, 6)


@contextmanager
def flown(folder, *more, **start):
    """A simulation by motion capture, whose estimate does not wander, and a flight with it."""
    with px4(folder, MOCAP, **start) as sim, sim.sticks() if start else nullcontext():
        words = ("--mocap", f"udp:127.0.0.1:{sim.mocap_port}", *SIH, *more)
        with flight(sim, folder, *words) as fly:
            yield sim, fly


def flying(fly):
    """Wait until it flies at about half a metre per second."""
    fly.wait_for("flying the plan")
    time.sleep(5.0)


def coasted(sim, ended_s, until_s):
    """Largest distance from where it was, at a height [m]."""
    rows = [row[1:] for row in list(sim.truth) if ended_s - 0.05 <= row[0] < until_s]
    return max(math.dist(row[:2], rows[0][:2]) for row in rows)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_watchdog_lands_it_within_the_distance_that_was_said(tmp_path, number):
    with flown(tmp_path) as (sim, fly):
        flying(fly)
        fly.process.send_signal(number)
        ended_s = time.monotonic()
        time.sleep(4.0)
        distance = coasted(sim, ended_s, ended_s + 4.0)
        said = float(fly.said.split("it coasts at most ")[1].split(" m ")[0])
        modes = [mode for at, *mode in sim.modes if at > ended_s + 1.5]
        assert modes
        assert all(tuple(mode) == LAND for mode in modes)
        assert distance < said
        if number == signal.SIGSTOP:
            fly.process.send_signal(signal.SIGCONT)
            assert fly.end() == 4, fly.said
            assert "watchdog took over (the loop stalled for " in fly.said
            assert sim.truth[-1][3] < 0.5


@pytest.mark.parametrize("mode", [POSITION, LAND])
def test_a_mode_of_the_pilot_is_the_pilots(tmp_path, mode):
    with flown(tmp_path, start={"NAV_RCL_ACT": 3, "COM_LOW_BAT_ACT": 2}) as (sim, fly):
        flying(fly)
        sim.mode(*mode)
        fly.wait_for("mode changed by the pilot", 5.0)
        if mode == POSITION:
            time.sleep(2.0)
            assert tuple(sim.modes[-1][1:]) == POSITION
            sim.mode(*LAND)
        assert fly.end() == 4, fly.said


def test_a_critical_battery_is_named_and_lands_it(tmp_path):
    with flown(tmp_path, "--battery", "0") as (sim, fly):
        flying(fly)
        sim.set(SIM_BAT_MIN_PCT=5, SIM_BAT_DRAIN=1)
        fly.wait_for("vehicle's own failsafe", 10.0)
        assert fly.end() == 6, fly.said
        assert "the flight ended early: vehicle's own failsafe" in fly.said
        assert sim.truth[-1][3] < 0.5
