"""Takeover of a Crazyflie by its watchdog: it holds and lands by plans on board when the program ended."""

import struct

import numpy as np
import pytest

from alula.stages.flight.watchdog import companion
from alula.stages.flight.watchdog.companion import STALL_S, STOPPING_S
from alula.stages.flight.watchdog.crazyflie_companion import SINK_M_S, Takeover
from support.vehicles.crazyflie_rehearsal import Rehearsal, velocity

FLOOR = 0.0


def made(*, is_in_control=True, ends=True):
    """A takeover after a loop that lived at 5 s."""
    found = Takeover({"floor_m": FLOOR})
    found.beat(companion.BEAT.pack(1, 5.0, is_in_control, 0, -1.0, 0, 1))
    if ends:
        found.take(b"")
    return found


def answer(packet, error=0):
    return packet[:4] + bytes([error])


def test_a_program_that_ended_in_control_is_missing_at_once_and_one_that_stalled_is_not():
    assert made().is_missing(5.01)
    assert not made(ends=False).is_missing(5.0 + 2 * STALL_S)
    assert not made(is_in_control=False).is_missing(5.01)
    well = made(ends=False)
    well.take(companion.FAREWELL)
    well.take(b"")
    assert not well.is_missing(5.01)


@pytest.mark.parametrize("error", [0, 1])
def test_each_command_is_repeated_until_it_is_accepted(error):
    found = made()
    found.begin(5.0)
    first = found.poll(5.0)
    assert [packet[0] >> 4 for packet in first] == [8, 7]  # the plan before the end of set-points
    assert found.poll(5.01) == []
    assert found.poll(5.06) == first
    found.frames.take(answer(first[0], error), is_datagram=True)
    assert found.poll(5.12) == ([] if error == 0 else first)
    (land,) = found.poll(5.0 + STOPPING_S)
    assert struct.unpack("<BBf?f?f", land[1:])[2] == FLOOR
    found.frames.take(answer(land), is_datagram=True)
    assert found.poll(5.1 + STOPPING_S) == []
    assert found.is_over
    assert found.words[-1] == "watchdog: the vehicle lands"


def test_a_command_that_is_never_answered_ends_it():
    found = made()
    found.begin(5.0)
    for step in range(400):
        found.poll(5.0 + 0.05 * step)
    assert found.words[-1] == "watchdog: the vehicle did not confirm that it lands"


def test_the_simulated_vehicle_comes_to_rest_near_where_it_was_and_lands():
    rehearsal = Rehearsal(controller=1)
    rehearsal.fly(0.8)
    rehearsal.live(2.0, velocity(0.73, 0, 0))
    place, found, sink = rehearsal.vehicle.body.position.copy(), made(), [0.0]
    found.begin(rehearsal.vehicle.time_s)
    while not (found.is_over and rehearsal.height == 0.0) and rehearsal.vehicle.time_s < 20.0:
        for packet in found.poll(rehearsal.vehicle.time_s):
            rehearsal.vehicle.receive(packet)
        rehearsal.live(0.02)
        for packet in rehearsal.heard:
            found.frames.take(packet, is_datagram=True)
        rehearsal.heard.clear()
        assert np.linalg.norm(rehearsal.vehicle.body.position[:2] - place[:2]) < 0.35
        sink.append(-rehearsal.vehicle.body.velocity[2])
    assert rehearsal.height == 0.0
    assert max(sink) < 3.0 * SINK_M_S
