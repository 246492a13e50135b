"""The real PX4 with motion capture and with signatures."""

import math

import numpy as np
import pytest

from support.paths import VEHICLES
from support.scenes.small_scenes import line_plan
from support.vehicles.ardupilot_sitl import flight
from support.vehicles.px4_sitl import MOCAP, px4

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

SIH = ("--vehicle", str(VEHICLES / "px4-sih.toml"))
KEY = bytes(range(32))


def test_it_flies_a_plan_to_its_end_by_motion_capture(tmp_path):
    plan = line_plan((0.0, 0.0, 1.5), (4.0, 0.0, 1.5), 12.0)
    with px4(tmp_path, MOCAP) as sim:
        words = ("--mocap", f"udp:127.0.0.1:{sim.mocap_port}", *SIH)
        with flight(sim, tmp_path, *words, plan=plan) as fly:
            assert fly.end(120.0) == 0, fly.said
        path = np.array(sim.truth)
    assert math.dist(path[-1, 1:3], (4.0, 0.0)) < 0.5
    assert np.abs(path[:, 2]).max() < 0.5


def test_with_a_key_it_is_flown_by_signed_packets_only(tmp_path):
    """Its time stamps begin at 0, as years after its key was stored."""
    key = tmp_path / "key"
    key.write_bytes(KEY)
    with px4(tmp_path, {"MAV_SIGN_CFG": 2}, key=KEY) as sim:
        with flight(sim, tmp_path, *SIH, "--dry-run") as fly:
            assert fly.end(60.0) == 6, fly.said
        with flight(sim, tmp_path, *SIH, "--signing-key", str(key), "--dry-run") as fly:
            assert fly.end(150.0) == 0, fly.said
