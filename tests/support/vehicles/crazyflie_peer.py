"""A simulated Crazyflie in real time on loopback, and a link to it, for tests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from alula.schemas.scenarios.vehicle import Vehicle, read_vehicle
from alula.stages.sim_vehicle.common.endpoint import Endpoint, open_endpoint
from alula.stages.sim_vehicle.crazyflie.vehicle import CrazyflieOptions, SimulatedCrazyflie
from support.paths import VEHICLES

SPEED = 2.0  # of time, for vehicle and link alike
VEHICLE = VEHICLES / "crazyflie21.toml"


def clock() -> float:
    return SPEED * time.monotonic()


def pause(seconds: float) -> None:
    time.sleep(seconds / SPEED)


def crazyflie_vehicle() -> Vehicle:
    return read_vehicle(VEHICLE)


class Served:
    """The vehicle, where it is, and whether its packets pass."""

    def __init__(self, vehicle: SimulatedCrazyflie, port: int) -> None:
        self.vehicle, self.port = vehicle, port
        self.is_cut = self.is_mute = False

    @property
    def address(self) -> str:
        return f"udp://127.0.0.1:{self.port}"

    def receive(self, data: bytes) -> None:
        if not self.is_cut:
            self.vehicle.receive(data)

    def advance(self, to_s: float) -> list[bytes]:
        packets = self.vehicle.advance(to_s)
        return [] if self.is_cut or self.is_mute else packets


def _live(served: Served, endpoint: Endpoint, ends: threading.Event) -> None:
    begin = lived = clock()
    while not ends.is_set():
        for data in endpoint.read():
            served.receive(data)
        begin += max(0.0, clock() - lived - 0.5)  # what a busy machine loses is not made up for
        lived = clock()
        endpoint.write(served.advance(lived - begin))
        time.sleep(0.003)


@contextmanager
def served(**options: Any) -> Iterator[Served]:
    pytest.importorskip("cflib", reason="cflib, of the extra crazyflie, is not there")
    vehicle = SimulatedCrazyflie(crazyflie_vehicle(), CrazyflieOptions(**options))
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    found = Served(vehicle, int(endpoint.name.rpartition(":")[2]))
    ends = threading.Event()
    thread = threading.Thread(target=_live, args=(found, endpoint, ends), daemon=True)
    thread.start()
    try:
        yield found
    finally:
        ends.set()
        thread.join(5)
        endpoint.close()


def fly_until(
    link: Any, is_done: Callable[[], bool], most_s: float = 10.0, make: Callable[[], Any] | None = None
) -> bool:
    """Poll at 100 Hz, and send what `make` gives, until something is so."""
    end = clock() + most_s
    while not is_done():
        now = clock()
        if now > end:
            return False
        link.poll(now)
        if make is not None:
            link.send(make(), now)
        pause(max(0.0, now + 0.01 - clock()))
    return True
