"""A dry run on the real autopilot that would not arm."""

import pytest

from support.vehicles.ardupilot_sitl import flight, sitl

pytestmark = pytest.mark.sitl


def test_a_dry_run_says_why_the_vehicle_refuses(tmp_path):
    with sitl(tmp_path, {"SIM_RC_FAIL": 1}) as sim, flight(sim, tmp_path, "--dry-run") as fly:
        assert fly.end(150.0) == 6, fly.said
        assert "arming: the vehicle refuses: " in fly.said
        assert "RC not found" in fly.said.splitlines()[-1]


def test_a_dry_run_of_a_ready_vehicle_passes(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path, "--dry-run") as fly:
        assert fly.end(150.0) == 0, fly.said
        assert "check arming: holds, the vehicle's own checks hold" in fly.said
