"""Loss of satellites on the real autopilot: noticed before its own failsafe, and told by the exit code."""

import math
import time

import pytest

from support.ardupilot_sitl import GOAL, flight, sitl

pytestmark = pytest.mark.sitl


def test_lost_satellites_land_it_at_once(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(6.0)
        lost_s = time.monotonic()
        sim.set(SIM_GPS1_ENABLE=0)
        assert fly.wait_for("estimator not healthy: landing", 5.0) - lost_s < 2.5
        assert fly.end() == 6, fly.said
        assert "the flight ended early: estimator not healthy (no new satellite fix" in fly.said
        at = next(row for row in sim.truth if row[0] >= lost_s)
        down = sim.truth[-1]
        assert math.dist(at[1:3], down[1:3]) < 2.0
        assert down[3] < 0.1


def test_satellites_lost_in_the_landing_are_told(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("plan finished: landing")
        sim.set(SIM_GPS1_ENABLE=0)
        assert fly.end() == 6, fly.said
        assert "the plan was flown, but not landed as planned: " in fly.said
        assert math.dist(sim.truth[-1][1:3], GOAL[:2]) < 1.0
