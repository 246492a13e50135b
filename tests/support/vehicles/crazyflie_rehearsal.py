"""A simulated Crazyflie on a clock of the test, spoken to in bytes."""

from __future__ import annotations

import struct

import pytest

from alula.stages.sim_vehicle.crazyflie.supervisor import Stage
from alula.stages.sim_vehicle.crazyflie.vehicle import CrazyflieOptions, SimulatedCrazyflie
from support.vehicles.crazyflie_peer import crazyflie_vehicle

SAFE = 0x0C


def packet(port: int, channel: int, data: bytes) -> bytes:
    return bytes([port << 4 | SAFE | channel]) + data


def velocity(x: float, y: float, z: float, turn_deg_s: float = 0.0) -> bytes:
    return packet(7, 0, struct.pack("<B4f", 8, x, y, z, turn_deg_s))


def take_off(height: float, duration: float) -> bytes:
    return packet(8, 0, struct.pack("<BBff?f", 7, 0, height, 0.0, True, duration))


ARM, DISARM = packet(9, 1, b"\1\1"), packet(9, 1, b"\1\0")


class Rehearsal:
    def __init__(self, controller: int = 2, **options) -> None:
        self.vehicle = SimulatedCrazyflie(crazyflie_vehicle(), CrazyflieOptions(**options))
        self.vehicle.parameters.values["stabilizer.controller"] = controller
        self.heard: list[bytes] = []

    def live(self, seconds: float, send=None) -> None:
        end = self.vehicle.time_s + seconds
        while self.vehicle.time_s < end - 1e-6:
            if send is not None:
                self.vehicle.receive(send() if callable(send) else send)
            self.heard += self.vehicle.advance(self.vehicle.time_s + 0.01)

    def ask(self, data: bytes) -> list[bytes]:
        self.vehicle.receive(data)
        answers = self.vehicle.advance(self.vehicle.time_s)
        return [each for each in answers if each[0] >> 4 == data[0] >> 4]

    def fly(self, height: float = 0.5) -> None:
        self.live(0.1)
        self.vehicle.receive(ARM)
        self.live(0.1)
        self.vehicle.receive(take_off(height, 1.5))
        self.live(2.5)
        assert self.vehicle.body.position[2] == pytest.approx(height, abs=0.05)

    @property
    def height(self) -> float:
        return float(self.vehicle.body.position[2])

    @property
    def stage(self) -> Stage:
        return self.vehicle.supervisor.stage
