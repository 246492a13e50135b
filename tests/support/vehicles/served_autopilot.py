"""A simulated autopilot behind a socket, and a link to it, on one clock that tests move."""

from __future__ import annotations

import socket
from contextlib import contextmanager

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.simulator import SimulatedVehicle
from alula.stages.vehicles.frames import LocalFrame
from support.vehicles.autopilot_client import EXACT
from support.vehicles.mavlink_peer import Time

FRAME = LocalFrame(yaw_rad=0.6, origin_enu_m=(2.0, 1.0, 0.0))


FAST = {"WPNAV_SPEED_UP": 1000.0, "WPNAV_ACCEL_Z": 600.0, "PSC_JERK_Z": 18.0, "TKOFF_SLEW_TIME": 0.25}


G = FASTBRIDGE.body.gravity_m_s2


class Served:
    """The simulated autopilot behind a socket; lives as the tests' clock goes."""

    kind, fast = ArduCopter, FAST

    def __init__(self, options=EXACT, parameters=None, epoch_s=0.0, seed=3, terrain=None, **channel):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        given = self.fast | (parameters or {})
        copter = self.kind(FASTBRIDGE, parameters=given, options=options, seed=seed, terrain=terrain)
        self.vehicle = SimulatedVehicle(copter, seed=seed, epoch_s=epoch_s, **channel)
        self.copter = copter
        self.begin = self.peer = None

    def tick(self, now):
        while True:
            try:
                data, self.peer = self.socket.recvfrom(4096)
            except BlockingIOError:
                break
            self.vehicle.receive(data)
        self.begin = now if self.begin is None else self.begin
        for packet in self.vehicle.advance(now - self.begin):
            if self.peer is not None:
                self.socket.sendto(packet, self.peer)

    def true_state(self):
        """Position and velocity in the world."""
        truth = self.copter.airframe.truth
        return (
            FRAME.position_from_ned(np.array(truth.position)),
            FRAME.vector_from_ned(np.array(truth.velocity)),
        )


@contextmanager
def flight(*, served=None, prepare=True, **options):
    served = served or Served()
    time = Time(served)
    chosen = LinkOptions(frame=FRAME, clock=time, sleep=time.sleep, **options)
    link = open_link(f"udpout:127.0.0.1:{served.port}", chosen)
    try:
        link.open(5.0)
        if prepare:
            link.prepare()
        yield served, time, link
    finally:
        link.close()
        served.socket.close()


def take_off(time, link, height_m=1.5):
    for _ in range(40):
        if link.status.armed:
            break
        link.status.refusals.clear()
        link.order(Order.ARM, time())
        time.run(link, 1.0)
    assert link.status.armed, link.status.texts
    time.run(link, 2.5)
    link.order(Order.TAKE_OFF, time(), height_m)
    for _ in range(300):
        time.run(link, 0.1)
        if abs(link.state.position[2] - height_m) < 0.1 and abs(link.state.velocity[2]) < 0.1:
            break
    assert link.state.position[2] == pytest.approx(height_m, abs=0.15)
    assert not link.status.refusals
    link.order(Order.TAKE_CONTROL, time())
    time.run(link, 0.1)
    assert link.status.obeys


def stream(time, link, seconds, make):
    for _ in range(round(seconds * 100)):
        link.send(make(link.state), time())
        time.run(link, 0.01)
