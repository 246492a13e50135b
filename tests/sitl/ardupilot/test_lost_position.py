"""Satellites, compass and clock of the real autopilot go wrong: noticed before its own failsafe, and told."""

import math
import time

import pytest

from support.vehicles.ardupilot_sitl import GOAL, flight, sitl

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


def test_fixes_that_jump_land_it_before_the_estimate_follows(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(6.0)
        jumped_s = time.monotonic()
        sim.set(SIM_GPS1_GLTCH_X=math.degrees(3.3 / 6378100.0))
        assert fly.wait_for("estimator not healthy: landing", 5.0) - jumped_s < 1.0
        assert fly.end() == 6, fly.said
        assert "the position of the satellites jumped by " in fly.said
        at = next(row for row in sim.truth if row[0] >= jumped_s)
        assert math.dist(at[1:3], sim.truth[-1][1:3]) < 1.5  # by its landing mode, 3.7 m
        assert sim.truth[-1][3] < 0.1


def test_a_compass_that_fails_lands_it_before_the_heading_is_lost(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(6.0)
        failed_s = time.monotonic()
        sim.set(**{f"SIM_MAG{number}_OFS_X": 400 for number in (1, 2, 3)})
        assert fly.wait_for("estimator not healthy: landing", 9.0) - failed_s < 3.0
        assert fly.end() == 6, fly.said
        assert "it contradicts what it measures: compass" in fly.said
        at = next(row for row in sim.truth if row[0] >= failed_s)
        assert math.dist(at[1:3], sim.truth[-1][1:3]) < 3.0


def test_a_simulation_faster_than_real_time_is_held_and_landed(tmp_path):
    with sitl(tmp_path) as sim, flight(sim, tmp_path) as fly:
        fly.wait_for("flying the plan")
        time.sleep(6.0)
        hurried_s = time.monotonic()
        sim.set(SIM_SPEEDUP=2)
        fly.wait_for("its clock runs faster than that of this computer", 3.0)
        assert fly.wait_for("took too long: landing", 12.0) - hurried_s < 9.0
        assert fly.end() == 4, fly.said
