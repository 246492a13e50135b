"""Measurement of a Crazyflie's responses by one client, on its real firmware or on the simulated one.

The client is `alula`'s own link; motions are judged by the truth, times are the vehicle's.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.vehicles.setpoints import VelocitySetpoint
from support.paths import VEHICLES

HEIGHT_M, SPEED_M_S = 1.0, 0.7
# Of the firmware of August 2026, with the mass, inertia and thrust curve of a Crazyflie 2.1 and no drag.
MEASURED = {
    "bits at rest": 526.0,
    "bits armed": 526.0,
    "take-off to 90 % [s]": 2.25,
    "height after it [m]": 1.07,
    "63 % of a step [s]": 0.31,
    "speed after 2 s [m/s]": 0.703,
    "63 % of a stop [s]": 0.315,
    "way of a stop [m]": 0.187,
    "silent: falls after [s]": 2.09,
    "silent: sideways at 0.5 s [m]": 0.353,
    "silent: sideways at 2 s [m]": 1.375,
    "silent: touches down at [m/s]": 3.79,
}
Truth = Callable[[], FloatArray]  # rows of time [s], position [m] and velocity [m/s] until now


def measure(address: str, truth: Truth) -> dict[str, float]:
    """Take-off, lag of velocities, and what follows when the link falls silent; by the controller PID."""
    vehicle = read_vehicle(VEHICLES / "crazyflie21.toml")
    link = open_link(address, LinkOptions(vehicle=vehicle))
    link.open(10.0)
    link.prepare()

    def live(seconds: float, velocity: tuple[float, float, float] | None = None) -> None:
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            link.poll(now)
            if velocity is not None:
                link.send(VelocitySetpoint(np.array(velocity), 0.0), now)
            time.sleep(0.01)

    def since(start: float) -> FloatArray:
        found = truth()
        return found[found[:, 0] >= start]

    live(1.0)
    found = {"bits at rest": float(link._orders.info or 0)}
    link.order(Order.ARM, time.monotonic())
    live(0.3)
    found["bits armed"] = float(link._orders.info or 0)
    begin = truth()[-1, 0]
    link.order(Order.TAKE_OFF, time.monotonic(), HEIGHT_M)
    live(4.5)
    climb = since(begin)
    found["take-off to 90 % [s]"] = climb[climb[:, 3] > 0.9 * HEIGHT_M, 0][0] - begin
    found["height after it [m]"] = climb[-1, 3]
    link.order(Order.TAKE_CONTROL, time.monotonic())
    live(1.0, (0.0, 0.0, 0.0))
    begin = truth()[-1, 0]
    live(2.0, (SPEED_M_S, 0.0, 0.0))
    step = since(begin)
    found["63 % of a step [s]"] = step[step[:, 4] > 0.632 * SPEED_M_S, 0][0] - begin
    found["speed after 2 s [m/s]"] = step[-1, 4]
    begin = truth()[-1, 0]
    live(2.0, (0.0, 0.0, 0.0))
    step = since(begin)
    found["63 % of a stop [s]"] = step[step[:, 4] < 0.368 * SPEED_M_S, 0][0] - begin
    found["way of a stop [m]"] = step[:, 1].max() - step[0, 1]
    live(2.0, (SPEED_M_S, 0.0, 0.0))
    begin = truth()[-1, 0]
    time.sleep(4.0)  # silence: nothing is polled, nothing is sent
    silent = since(begin)
    falls = np.flatnonzero(silent[:, 6] < -0.5)
    found["silent: falls after [s]"] = silent[falls[0], 0] - begin
    found["silent: sideways at 0.5 s [m]"] = np.interp(begin + 0.5, silent[:, 0], silent[:, 1]) - silent[0, 1]
    found["silent: sideways at 2 s [m]"] = np.interp(begin + 2.0, silent[:, 0], silent[:, 1]) - silent[0, 1]
    found["silent: touches down at [m/s]"] = -silent[:, 6].min()
    link.close()
    return found
