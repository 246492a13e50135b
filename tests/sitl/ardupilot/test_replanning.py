"""Flights of the real autopilot straight at a wall: the filter stops them, and new plans lead around it."""

import numpy as np
import pytest

from alula.schemas.log.run import read_run
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE, read_vehicle
from alula.stages.clearance import path_clearance
from alula.stages.flight.links.mavlink.autopilots import ARDUPILOT
from alula.stages.flight.mission import make_commander
from alula.stages.flight.replay import replay
from alula.stages.planning.plan import plan
from support.flights.flights import mission
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover
from support.vehicles.ardupilot_sitl import GOAL, START, flight, sitl

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

WALL = box_cover([((70, -20, 0), (76, 15, 40))])  # in the way, from y = -2 m to 1.5 m
COPTER = VEHICLES / "arducopter.toml"
FENCE = (-3.0, -4.0, -1.0, 17.0, 4.0, 6.0)
AS_FLOWN = {"stale_s": 0.4, "latency_s": 0.05, "fence": FENCE}  # with support.vehicles.fly_process.LOOSE


@pytest.mark.parametrize("name", ["polytope-cbf", "cone-backup"])
def test_a_flight_straight_at_a_wall_arrives_behind_its_filter(tmp_path, name):
    config = PlanConfig(
        beyond_map_m=10.0, start=START, goal=GOAL, speed_m_s=1.0, straight=True, allow_blocked=True
    )
    straight = plan(config, WALL)
    words = ("--filter", name, "--allow-blocked", "--fence", *map(str, FENCE))
    words += ("--vehicle", str(COPTER)) if name == "cone-backup" else ()
    land = {"FS_THR_ENABLE": 3, "FS_DR_ENABLE": 1}  # it must not fly home from beside a wall
    with sitl(tmp_path, land) as sim, flight(sim, tmp_path, *words, plan=straight, cover=WALL) as flown:
        code = flown.end(150.0)
        assert any("plan finished: landing" in line for line in flown.said.splitlines()), flown.said
        assert code == 0 or "left the tube" in flown.said  # velocities are followed late
        path = np.array([(x, y, z) for _, x, y, z, _ in sim.truth if z > 0.5])
    made = mission(
        name,
        cover=WALL,
        plan=straight,
        vehicle=read_vehicle(COPTER) if name == "cone-backup" else FASTBRIDGE,
        allow_blocked=True,
        **AS_FLOWN,
    )
    assert path[:, 0].max() > 13.0
    ((_, obstacles),) = made.obstacles
    assert float(path_clearance(path, obstacles).min()) > FASTBRIDGE.body.radius_m
    assert read_run(tmp_path / "f.run.mcap").summary["new_plans"] >= 1
    found = replay(tmp_path / "f.run.mcap", make_commander(made, ARDUPILOT.accepts))
    assert found.differing == []
