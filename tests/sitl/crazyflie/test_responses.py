"""The Crazyflie's real firmware has the responses that the simulated one is compared with."""

import numpy as np
import pytest

from support.vehicles.crazyflie_host import crazyflie
from support.vehicles.crazyflie_responses import MEASURED, measure

OF_THE_BODY = "silent: touches down at [m/s]"  # differs between two programs with the same firmware

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]


def test_the_real_firmware_has_the_stored_responses(tmp_path):
    with crazyflie(tmp_path, (0.0, 0.0, 0.0), "--seed", "1") as vehicle:
        found = measure(vehicle.link("pid"), lambda: np.array(vehicle.truth)[:, 1:])
    del found[OF_THE_BODY]
    stored = {name: value for name, value in MEASURED.items() if name != OF_THE_BODY}
    assert found == {name: pytest.approx(value, rel=0.1, abs=0.02) for name, value in stored.items()}
