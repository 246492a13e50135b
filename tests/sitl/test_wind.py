"""The check of the frame in flight on the real autopilot, in a wind that pushes from the lift-off on."""

import pytest

from support.ardupilot_sitl import flight, sitl

pytestmark = pytest.mark.sitl

WIND = {"SIM_WIND_SPD": 6, "SIM_WIND_DIR": 200, "SIM_WIND_T": 1}  # the same at all heights


def test_wind_is_no_wrong_frame(tmp_path):
    with sitl(tmp_path, WIND) as sim, flight(sim, tmp_path, "--near", "3") as fly:
        fly.wait_for("plan finished: landing", 120.0)
        assert "contradicts the frame" not in fly.said
