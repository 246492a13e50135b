"""The app's filter in the Crazyflie's real firmware lets it take off from a floor of its cover."""

import time

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover
from support.vehicles.crazyflie_host import crazyflie

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]

VEHICLE = read_vehicle(VEHICLES / "crazyflie21.toml")


@pytest.mark.parametrize(("below", "above"), [(1, 0), (1, 1)])  # of the floor's hull, from the start [voxels]
def test_it_takes_off_from_a_floor(tmp_path, below, above):
    image = encode_map(box_cover([((-15, -15, -below), (15, 15, above))]), indexed=True)
    with crazyflie(tmp_path, (0.0, 0.0, 0.0), "--seed", "1", image=image) as vehicle:
        link = open_link(vehicle.link("oot"), LinkOptions(vehicle=VEHICLE))
        link.open(10.0)
        link.prepare()

        def live(seconds):
            end = time.monotonic() + seconds
            while (now := time.monotonic()) < end:
                link.poll(now)
                time.sleep(0.01)

        live(1.0)
        link.order(Order.ARM, time.monotonic())
        live(0.3)
        begin = len(vehicle.truth)
        link.order(Order.TAKE_OFF, time.monotonic(), 1.0)
        live(4.0)
        path = np.array(vehicle.truth[begin:])
        link.close()
    assert path[path[:, 4] > 0.9, 1][0] - path[0, 1] < 3.0
    assert np.linalg.norm(path[:, 2:4], axis=1).max() < 0.05
