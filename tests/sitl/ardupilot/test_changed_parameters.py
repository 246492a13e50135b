"""A parameter that another station changes on the real autopilot."""

import time

import pytest

from support.vehicles.ardupilot_sitl import flight, sitl

pytestmark = pytest.mark.sitl


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("GUID_OPTIONS", 0, "GUID_OPTIONS is 0, not 8"),
        ("FS_GCS_TIMEOUT", 60, "FS_GCS_TIMEOUT is 60, not 5"),
        ("WPNAV_ACCEL", 125, "WPNAV_ACCEL is 125, not 250"),
    ],
)
def test_a_changed_parameter_lands_it_and_is_named(tmp_path, name, value, words):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(3.0)
        changed_s = time.monotonic()
        sim.set(**{name: value})
        assert fly.wait_for("parameter changed by another station", 5.0) - changed_s < 2.0
        assert fly.end() == 6, fly.said
        assert f"({words})" in fly.said.splitlines()[-1]
