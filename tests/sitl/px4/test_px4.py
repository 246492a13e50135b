"""Flights of PX4's own simulation, judged by its true motion."""

import math
import time

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import path_clearance
from support.flights.flights import mission
from support.paths import VEHICLES
from support.scenes.small_scenes import ball_scene, box_cover, line_plan
from support.vehicles.ardupilot_sitl import GOAL, START, flight
from support.vehicles.px4_responses import MEASURED, SPREAD, measure
from support.vehicles.px4_sitl import TOLD, px4
from support.vehicles.responses import Wired
from support.vehicles.sim_vehicle_process import until

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

RESTING = 0x3FF
VEHICLE = VEHICLES / "px4-sih.toml"
SIH = ("--vehicle", str(VEHICLE))
HULLS = box_cover([((35, 12, 0), (45, 22, 40)), ((-20, -45, 0), (110, -40, 40))])  # 1.2 m beside the line
BALLS = ball_scene([(4.0, 1.5, 1.5), (4.0, -4.2, 1.5)], 0.3)


def test_a_dry_run_of_a_ready_px4_passes(tmp_path):
    with px4(tmp_path) as sim, flight(sim, tmp_path, *SIH, "--dry-run") as fly:
        assert fly.end(150.0) == 0, fly.said
        assert "check estimator: holds" in fly.said
        assert until(lambda: sim.flags)[-1][1] == RESTING  # our simulated PX4 sends this, too


def test_px4_arms_flies_and_lands_by_satellites(tmp_path):
    """Its simulated receiver wanders by a metre, which may end a flight early; the walls are 6 m away."""
    plan = line_plan(START, GOAL, 24.0)
    with px4(tmp_path) as sim, flight(sim, tmp_path, *SIH, plan=plan) as fly:
        begun = fly.wait_for("armed: taking off")
        ended = fly.wait_for("on the ground: disarming")
        code = fly.end(60.0)
        path, flags = np.array(sim.truth), np.array(sim.flags)
    assert path[:, 3].max() > 1.0
    assert np.abs(path[:, 2]).max() < 3.0
    assert abs(path[-1, 3]) < 0.5
    if fly.at("plan finished: landing"):
        assert code in (0, 4), fly.said
        assert path[:, 1].max() > 12.0
    else:
        assert code == 6, fly.said
        ends = (
            "off the climb path",
            "position contradicts velocity",
            "drifts from its hold",
            "held too often",
        )
        assert any(words in fly.said for words in ends), fly.said
    flying = flags[(flags[:, 0] > begun + 5.0) & (flags[:, 0] < ended - 5.0), 1]
    assert set(flying.astype(int)) == {RESTING & ~128}


def test_lost_satellites_land_px4_before_its_own_flags_change(tmp_path):
    """They change 5.2 s later, and its failsafe of injected failures does not know its own simulation."""
    with px4(tmp_path) as sim, flight(sim, tmp_path, *SIH) as fly:
        fly.wait_for("flying the plan")
        time.sleep(6.0)
        lost_s = time.monotonic()
        sim.set(SIM_GPS_USED=0)
        assert fly.wait_for("estimator not healthy: landing", 5.0) - lost_s < 1.5
        assert fly.end() == 6, fly.said
        assert "the flight ended early: estimator not healthy (no new satellite fix" in fly.said
        at = next(row for row in sim.truth if row[0] >= lost_s)
        assert math.dist(at[1:3], sim.truth[-1][1:3]) < 3.0
        assert sim.truth[-1][3] < 0.5


def test_an_estimate_that_slips_from_its_satellites_lands_px4(tmp_path):
    """An antenna that seems 3.3 m ahead: fixes and flags stay good, and it landed there with exit code 0."""
    plan = line_plan(START, GOAL, 36.0)
    with px4(tmp_path) as sim, flight(sim, tmp_path, "--near", "1.0", *SIH, plan=plan) as fly:
        fly.wait_for("flying the plan")
        time.sleep(3.0)
        jumped_s = time.monotonic()
        sim.set(SENS_GPS0_OFFX=3.3)
        assert fly.wait_for("estimator not healthy: landing", 6.0) - jumped_s < 4.0
        assert fly.end() == 6, fly.said
        assert "m from the way by the velocities of satellites" in fly.said
        found_s = fly.at("estimator not healthy: landing")
        at = next(row for row in sim.truth if row[0] >= found_s)
        assert math.dist(at[1:3], sim.truth[-1][1:3]) < 1.5  # by its landing mode 1.8 and 1.9 m
        assert sim.truth[-1][3] < 0.5


def test_the_real_program_has_the_stored_answers_parameters_and_times(tmp_path):
    with px4(tmp_path, start={}) as sim, Wired(sim.port) as line:
        found = measure(line)
    times = {name: found.pop(name) for name in SPREAD}
    assert found == {name: value for name, value in MEASURED.items() if name not in SPREAD}
    for name, (least, most) in SPREAD.items():
        assert least < times[name] < most, (name, times)


@pytest.mark.parametrize(
    "name", ["polytope-cbf", "cone-di", "safer-splat", "cone-ecbf", "cone-backup", "shield"]
)
def test_no_filter_touches_anything_with_the_noise_of_its_simulation(tmp_path, name):
    """The plan may not be flown to its end by such an estimate, but the exit code says so."""
    plan = line_plan((0.0, 0.0, 1.5), (8.0, 0.0, 1.5), 17.5)  # 1 m/s
    is_scene = name not in ("polytope-cbf", "shield")
    words = ("--near", "1.0", "--filter", name, "--allow-tight", *SIH)
    with (
        px4(tmp_path) as sim,
        flight(sim, tmp_path, *words, plan=plan, cover=BALLS if is_scene else HULLS) as fly,
    ):
        code = fly.end(200.0)
        path = np.array([row[1:] for row in sim.truth if row[3] > 0.4])
    here = {"scene": BALLS} if is_scene else {"cover": HULLS}
    made = mission(name, plan=plan, vehicle=read_vehicle(VEHICLE), is_clear=True, **here)
    assert min(float(path_clearance(path, each).min()) for _, each in made.obstacles) > 0.15
    assert "on the ground below its plan" not in fly.said  # by rates, with a wrong throttle, it sank
    if code == 0:
        assert "plan finished: landing" in fly.said
        assert path[:, 0].max() > 7.0
    elif fly.at("plan finished: landing"):
        assert code == 4, fly.said
        assert "landed away from the plan's end" in fly.said
    else:
        assert code in (4, 6), fly.said
        assert "the flight ended early" in fly.said or "took too long" in fly.said


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0, 2.0])
def test_an_estimator_that_is_told_its_noise_lands_px4_at_the_end_of_its_plan(tmp_path, speed_m_s):
    """With less noise than there is, its velocity misleads its landing mode: 23 of 50 landed away."""
    plan = line_plan((0.0, 0.0, 1.5), (8.0, 0.0, 1.5), 8 * 2.1875 / speed_m_s)
    words = ("--near", "1.0", "--filter", "cone-ecbf", "--allow-tight", *SIH)
    with px4(tmp_path, TOLD) as sim, flight(sim, tmp_path, *words, plan=plan, cover=BALLS) as fly:
        assert fly.end(200.0) == 0, fly.said
        assert math.dist(sim.truth[-1][1:3], (8.0, 0.0)) < 0.7  # 17 flights: 0.45 at most
