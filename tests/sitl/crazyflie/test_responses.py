"""The Crazyflie's real firmware has the responses that the simulated one is compared with."""

import numpy as np
import pytest

from support.crazyflie_host import crazyflie
from support.crazyflie_responses import MEASURED, measure

pytestmark = [pytest.mark.sitl, pytest.mark.realtime]


def test_the_real_firmware_has_the_stored_responses(tmp_path):
    with crazyflie(tmp_path, (0.0, 0.0, 0.0), "--seed", "1") as vehicle:
        found = measure(vehicle.link("pid"), lambda: np.array(vehicle.truth)[:, 1:])
    assert found == {name: pytest.approx(value, rel=0.1, abs=0.02) for name, value in MEASURED.items()}
