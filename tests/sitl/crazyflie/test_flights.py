"""Flights of the Crazyflie's real firmware between walls and past a pillar, judged by its true motion."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance, scene_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from support.paths import VEHICLES
from support.scenes.small_scenes import ball_scene, box_cover, line_plan
from support.vehicles.crazyflie_host import crazyflie
from support.vehicles.fly_process import fly

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

VEHICLE = VEHICLES / "crazyflie21.toml"
RADIUS = read_vehicle(VEHICLE).body.radius_m
START, GOAL = (0.0, 0.0, 0.8), (3.0, 0.0, 0.8)
WALLS = [((-10, 8, 0), (45, 11, 20)), ((-10, -11, 0), (45, -8, 20)), ((18, 2, 0), (20, 5, 20))]  # voxels
COVER = box_cover(WALLS)  # at y = 0.8 m and -0.8 m, and a pillar 0.2 m beside the line
SCENE = ball_scene(
    np.concatenate(
        [0.1 * np.argwhere(np.ones(np.subtract(b, a))) + 0.1 * np.array(a) + 0.05 for a, b in WALLS]
    ),
    0.087,
)


def flown_path(folder, controller, cover, speed_m_s, *more, image=b"", **options):
    """Path of a flight along the line, while higher than 0.1 m [m]."""
    plan = line_plan(START, GOAL, 3.0 * 2.1875 / speed_m_s)
    words = ("--vehicle", str(VEHICLE), "--speed", str(1.5 * speed_m_s), "--allow-tight", *more)
    with (
        crazyflie(folder, (0.0, 0.0, 0.0), "--seed", "1", image=image) as vehicle,
        fly(vehicle.link(controller, **options), folder, *words, plan=plan, cover=cover) as flown,
    ):
        assert flown.end(120.0) == 0, flown.said
        path = np.array([sample[2:5] for sample in vehicle.truth])
    assert path[:, 0].max() > 2.8
    assert path[-1, 2] < 0.01  # it landed
    return path[path[:, 2] > 0.1]


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0])
def test_a_flight_by_pid_is_clear(tmp_path, speed_m_s):
    path = flown_path(tmp_path, "pid", COVER, speed_m_s)
    assert float(path_clearance(path, hull_obstacles(Hulls.from_cover(COVER))).min()) > RADIUS


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0])
def test_a_flight_by_mellinger_is_clear(tmp_path, speed_m_s):
    path = flown_path(tmp_path, "mellinger", SCENE, speed_m_s, "--filter", "cone-di")
    assert float(path_clearance(path, scene_obstacles(SCENE, 1.0)).min()) > RADIUS


def test_a_flight_by_the_app_is_clear(tmp_path):
    image = encode_map(COVER, indexed=True)
    path = flown_path(tmp_path, "oot", COVER, 0.5, "--filter", "none", image=image)
    assert float(path_clearance(path, hull_obstacles(Hulls.from_cover(COVER))).min()) > RADIUS
