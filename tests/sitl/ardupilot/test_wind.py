"""Wind on the real autopilot: it is no wrong frame, and flights stay clear of the map in it."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.clearance import path_clearance
from support.flights.flights import mission
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.ardupilot_sitl import GOAL, START, flight, sitl

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

WIND = {"SIM_WIND_SPD": 6, "SIM_WIND_DIR": 200, "SIM_WIND_T": 1}  # the same at all heights
CORRIDOR = box_cover([((0, 8, 0), (140, 12, 40)), ((0, -12, 0), (140, -8, 40))])  # at y = 0.8 m and -0.8 m


def test_wind_is_no_wrong_frame(tmp_path):
    with sitl(tmp_path, WIND) as sim, flight(sim, tmp_path, "--near", "3") as fly:
        fly.wait_for("plan finished: landing", 120.0)
        assert "contradicts the frame" not in fly.said


# Body rates, then velocities and accelerations.
@pytest.mark.parametrize("name", ["cone-backup", "shield", "polytope-cbf", "safer-splat"])
@pytest.mark.parametrize("speed_m_s", [3, 6])
def test_a_flight_in_a_corridor_stays_clear_in_a_wind_that_rises_on_the_way(tmp_path, name, speed_m_s):
    plan = line_plan(START, GOAL, 24.0)
    more = ("--vehicle", str(VEHICLES / "arducopter.toml"), "--filter", name)
    rising = {"SIM_WIND_DIR": 180, "SIM_WIND_T": 1}  # from the south, across the corridor
    with sitl(tmp_path, rising) as sim, flight(sim, tmp_path, *more, plan=plan, cover=CORRIDOR) as fly:
        fly.wait_for("flying the plan")
        while sim.truth[-1][1] < 3.0:
            assert fly.process.poll() is None, fly.said
        sim.set(SIM_WIND_SPD=speed_m_s)
        fly.wait_for("plan finished: landing", 120.0)
        path = np.array([(x, y, z) for _, x, y, z, _ in sim.truth if z > 0.5])
        assert fly.end(20.0) == 0, fly.said  # in stronger wind it must lean less to notice that it has landed
    assert path[:, 0].max() > 13.0
    (_, walls), *_ = mission(cover=CORRIDOR, plan=plan).obstacles
    assert float(path_clearance(path, walls).min()) > FASTBRIDGE.body.radius_m
