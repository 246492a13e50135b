"""The simulated Crazyflie responds as the real firmware, which `tests/sitl` flies, to the same client."""

import json
import socket
import threading

import numpy as np
import pytest

from support.vehicles.crazyflie_peer import VEHICLE
from support.vehicles.crazyflie_responses import MEASURED, measure
from support.vehicles.sim_vehicle_process import free_port, until, vehicle

pytest.importorskip("cflib", reason="cflib, of the extra crazyflie, is not there")


def test_it_responds_as_the_real_firmware():
    rows = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(5.0)
        address = f"udp://127.0.0.1:{free_port()}"
        options = ("--vehicle", str(VEHICLE), "--mocap", f"udp:127.0.0.1:{line.getsockname()[1]}")
        with vehicle(address, *options, quick=()):
            thread = threading.Thread(target=_read, args=(line, rows), daemon=True)
            thread.start()
            until(lambda: rows)
            found = measure(f"{address}?controller=pid", lambda: np.array(rows))
        thread.join(10.0)
    assert found == {name: pytest.approx(value, rel=0.1, abs=0.02) for name, value in MEASURED.items()}


def _read(line, rows):
    """Append time [s], position [m] and velocity [m/s] until no more poses arrive."""
    while True:
        try:
            found = json.loads(line.recv(4096))
        except TimeoutError:
            return
        time_s, place = found["time_s"], found["position_m"]
        before = rows[max(0, len(rows) - 3)] if rows else None
        if before is None or time_s <= rows[-1][0]:
            velocity = (0.0, 0.0, 0.0)
        else:
            velocity = [(a - b) / (time_s - before[0]) for a, b in zip(place, before[1:4], strict=True)]
        rows.append((time_s, *place, *velocity))
