"""The app's filter in the Crazyflie's real firmware, flown into corners, judged by its true motion."""

import time

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.vehicles.setpoints import VelocitySetpoint
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover
from support.vehicles.crazyflie_host import crazyflie

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

VEHICLE = read_vehicle(VEHICLES / "crazyflie21.toml")
HALF, HIGH = 12, 18  # of the room [voxels of 0.1 m]
OUT = HALF + 3
WALLS = [
    ((HALF, -OUT, 0), (OUT, OUT, HIGH)),
    ((-OUT, -OUT, 0), (-HALF, OUT, HIGH)),
    ((-OUT, HALF, 0), (OUT, OUT, HIGH)),
    ((-OUT, -OUT, 0), (OUT, -HALF, HIGH)),
    ((-OUT, -OUT, HIGH), (OUT, OUT, HIGH + 3)),  # the ceiling
]
COVER = box_cover(WALLS)
RADIUS_M, BEYOND_M = 0.15, 0.02  # the filter's, by default; overshoot
CENTRE = np.array([0.0, 0.0, 1.0])


def fly_into_corners(folder, speed_m_s, seed, **options):
    """Path in four corners: two straight, one of them below the ceiling, and two along a wall [m]."""
    rng = np.random.default_rng(seed)
    with crazyflie(
        folder, (0.0, 0.0, 0.0), "--seed", str(seed), image=encode_map(COVER, indexed=True)
    ) as vehicle:
        link = open_link(vehicle.link("oot", **options), LinkOptions(vehicle=VEHICLE))
        link.open(10.0)
        link.prepare()

        def live(seconds, velocity=None):
            """Send the velocity, or what leads to the centre."""
            end = time.monotonic() + seconds
            while (now := time.monotonic()) < end:
                link.poll(now)
                way = CENTRE - vehicle.truth[-1][2:5]
                home = way * min(1.5, 0.8 / max(np.linalg.norm(way), 1e-9))
                link.send(VelocitySetpoint(home if velocity is None else velocity, 0.0), now)
                time.sleep(0.01)

        def rest(seconds):
            end = time.monotonic() + seconds
            while (now := time.monotonic()) < end:
                link.poll(now)
                time.sleep(0.01)

        rest(1.0)
        link.order(Order.ARM, time.monotonic())
        rest(0.3)
        link.order(Order.TAKE_OFF, time.monotonic(), CENTRE[2])
        rest(4.0)
        link.order(Order.TAKE_CONTROL, time.monotonic())
        begin = len(vehicle.truth)
        for corner in range(4):
            along = corner in (1, 2)  # along the wall from the corner before, pressed to it
            if not along:
                live(3.0)
            aside = 90 - rng.uniform(10, 20) if along else 45 + rng.uniform(-15, 15)
            bearing = np.radians(90 * corner + aside)
            way = np.array([np.cos(bearing), np.sin(bearing), 0.4 if corner == 3 else 0.0])
            live((2.1 if along else 1.5) / speed_m_s + 2.0, speed_m_s * way / np.linalg.norm(way))
        path = np.array([sample[2:5] for sample in vehicle.truth[begin:]])
        link.order(Order.LAND, time.monotonic())
        rest(0.5)
        link.close()
    reached = np.abs(path[:, :2]).min(axis=1).max()
    assert reached > 0.1 * HALF - RADIUS_M - 0.15  # it came into a corner
    return path


def clearance(path):
    """Least distance from the walls [m]."""
    return float(path_clearance(path, hull_obstacles(Hulls.from_cover(COVER))).min())


@pytest.mark.parametrize("speed_m_s", [0.3, 0.5, 0.8, 1.0])
def test_it_stops_in_corners(tmp_path, speed_m_s):
    assert clearance(fly_into_corners(tmp_path, speed_m_s, 1)) > RADIUS_M - BEYOND_M
