"""The simulated vehicle moved by hand, and motion capture with another origin."""

import json

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.loop.frame_check import HandCheck
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.common.estimator import EstimatorOptions
from alula.stages.sim_vehicle.common.hand import Hand
from alula.stages.sim_vehicle.common.packets import Codec, mavlink
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.sim_vehicle.simulator import Camera, SimulatedVehicle
from alula.stages.vehicles.frames import LocalFrame


def state_of(motion, frame):
    """State that a link derives from the vehicle's estimate."""
    return VehicleState(
        *(0.0, frame.position_from_ned(np.array(motion.position))),
        frame.vector_from_ned(np.array(motion.velocity)),
        *(np.array((1.0, 0.0, 0.0, 0.0)), np.zeros(3)),
    )


def carried(frame, *, hears=True, until_s=20.0, kind=ArduCopter):
    """The vehicle after a client was connected for a time, the result of the check, and its distance."""
    copter = kind(FASTBRIDGE, options=EstimatorOptions(boot_time_s=3.0), hand=Hand())
    check, farthest = HandCheck(), 0.0
    while copter.time_s < until_s:
        if hears and copter.time_s > 1:
            copter.note_ground_station(255)
        copter.tick()
        if copter.estimator.has_position and round(copter.time_s * 400) % 8 == 0:
            check.update(state_of(copter.estimator.motion, frame))
        farthest = max(farthest, float(np.linalg.norm(copter.airframe.truth.position)))
    return copter, check, farthest


@pytest.mark.parametrize(("kind", "mode"), [(ArduCopter, Mode.GUIDED), (Px4Copter, Px4Mode.POSCTL)])
def test_a_hand_moves_it_east_north_and_up_and_puts_it_back(kind, mode):
    copter, check, farthest = carried(LocalFrame(), kind=kind)
    assert (check.prompt, check.verdict()) == ("", "")
    np.testing.assert_allclose(check.moved, 0.4 * np.eye(3), atol=0.1)
    assert farthest == pytest.approx(0.4 * np.sqrt(3), abs=1e-6)
    assert copter.airframe.truth.position == pytest.approx((0, 0, 0), abs=1e-12)
    assert not copter.airframe.is_carried
    assert copter.is_landed
    assert copter.set_mode(mode)
    assert copter.arm()


def test_a_map_that_is_turned_against_the_vehicle_shows_in_the_hand():
    _, check, _ = carried(LocalFrame(yaw_rad=np.pi / 2))
    assert "a move along +x was seen as" in check.verdict()


def test_without_a_client_nobody_touches_it():
    assert carried(LocalFrame(), hears=False, until_s=9.0)[2] == 0.0


@pytest.mark.parametrize("kind", [ArduCopter, Px4Copter], ids=lambda kind: kind.AUTOPILOT)
def test_a_companion_is_a_client_for_whom_it_is_moved(kind):
    vehicle = SimulatedVehicle(kind(FASTBRIDGE, options=EstimatorOptions(boot_time_s=1.0), hand=Hand()))
    companion, farthest = Codec(255), 0.0
    while vehicle.time_s < 14:
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4, 3)
        vehicle.receive(companion.encode(beat))
        vehicle.advance(vehicle.time_s + 0.5)
        farthest = max(farthest, float(np.linalg.norm(vehicle.copter.airframe.truth.position)))
    assert farthest == pytest.approx(0.4 * np.sqrt(3), abs=0.01)


def test_a_hand_lets_go_of_what_is_armed():
    copter = ArduCopter(FASTBRIDGE, options=EstimatorOptions(boot_time_s=3.0), hand=Hand())
    copter.set_mode(4)
    while not copter.airframe.is_carried:
        copter.note_ground_station(255)
        copter.tick()
    for _ in range(400):
        copter.tick()
    assert np.linalg.norm(copter.airframe.truth.position) > 0.1
    copter.set_mode(4)
    assert copter.arm()
    copter.tick()
    assert not copter.airframe.is_carried
    assert copter.airframe.truth.position == pytest.approx((0, 0, 0), abs=1e-12)


def test_cameras_see_it_where_it_was_put():
    copter = ArduCopter(FASTBRIDGE)
    seen = json.loads(Camera(1, (0.8, -0.7, 0.1)).datagram(0.5, copter.airframe.truth))
    assert seen["position_m"] == pytest.approx([0.8, -0.7, 0.1], abs=0.005)
