"""PolyMerge's Table II by the app in the Crazyflie's firmware: from the floor, past a pillar, to a goal."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover
from support.vehicles.crazyflie_goals import fly_to_goal

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

BODY_M = read_vehicle(VEHICLES / "crazyflie21.toml").body.radius_m
RADIUS_M, WITHIN_M, RATE_HZ = 0.1, 0.05, 125.0  # of the filter; of the goal; with 150 hulls
START, GOAL, IN_WALL = (np.array(p) for p in ([0.0, 0.0, 0.8], [2.4, -0.3, 1.0], [3.0, -0.3, 1.0]))
FLOOR, PILLAR, WALL = (
    ((-10, -15, -1), (35, 15, 0)),
    ((12, -1, 0), (14, 2, 20)),
    ((30, -15, 0), (33, 15, 20)),
)
COVER = box_cover([FLOOR, PILLAR, WALL])


@pytest.mark.parametrize(("goal", "arrives"), [(GOAL, True), (IN_WALL, False)])
def test_the_app_flies_past_a_pillar_to_its_goal(tmp_path, goal, arrives):
    path, _ = fly_to_goal(
        tmp_path,
        *(0.0, START, goal, encode_map(COVER, indexed=True), 1, WITHIN_M),
        max_time_s=12.0,
        radius=RADIUS_M,
        divider=round(500 / RATE_HZ),
    )
    clear = float(path_clearance(path, hull_obstacles(Hulls.from_cover(COVER))).min())
    assert clear > max(RADIUS_M - 0.02, BODY_M)
    assert (float(np.linalg.norm(path - goal, axis=1).min()) <= WITHIN_M) == arrives
    assert path[:, 0].max() > 2.3
