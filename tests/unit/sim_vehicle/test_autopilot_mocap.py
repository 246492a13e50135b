"""Flight on motion capture: arming, the estimate, and the late detection of its loss."""

import math

import pytest

from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.common import quaternions
from alula.stages.sim_vehicle.common.estimator import NO_POSITION, SETTLED, EstimatorOptions
from alula.stages.sim_vehicle.common.packets import mavlink
from support.vehicles.autopilot_client import EXACT, GUIDED, Client

ACCEPTED, FAILED = 0, 4
MOCAP = {
    **{f"EK3_SRC1_{name}": 6 for name in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")},
    "VISO_TYPE": 1,
    "GPS1_TYPE": 0,
}


class Mocap:
    """Motion capture that sends the pose of the vehicle 50 times a second, in a turned frame."""

    def __init__(self, client, turn=0.0):
        self.client, self.turn = client, turn

    def send(self, offset=0.0):
        truth, usec = self.client.truth, int(self.client.vehicle.time_s * 1e6)
        q = quaternions.from_euler(0, 0, self.turn)
        x, y, z = quaternions.rotate(q, truth.position)
        angles = quaternions.to_euler(quaternions.multiply(q, truth.attitude))
        self.client.send(mavlink.MAVLink_vision_position_estimate_message(usec, x + offset, y, z, *angles))
        speed = quaternions.rotate(q, truth.velocity)
        self.client.send(mavlink.MAVLink_vision_speed_estimate_message(usec, *speed))

    def stream(self, seconds, **named):
        for _ in range(round(seconds / 0.02)):
            self.send(**named)
            self.client.wait(0.02)

    def origin(self):
        self.client.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 400000))

    def fly(self):
        self.stream(0.3)
        self.origin()
        self.stream(0.5)
        assert self.client.mode(GUIDED) == ACCEPTED
        assert self.client.arm() == ACCEPTED
        assert self.client.command(22, 0, 0, 0, 0, 0, 0, 2.0) == ACCEPTED
        self.stream(9)
        assert self.client.height == pytest.approx(2, abs=0.15)
        return self


def test_with_mocap_it_arms_some_time_after_the_origin_only():
    client = Client(options=EstimatorOptions(), parameters=MOCAP)
    mocap = Mocap(client)
    client.copter.mode = Mode.GUIDED
    mocap.stream(5)
    assert client.arm() == FAILED
    assert client.texts()[-1] == "Arm: Need Position Estimate"
    begin = client.vehicle.time_s
    mocap.origin()
    while client.vehicle.time_s < begin + 30 and not client.copter.estimator.has_position:
        mocap.stream(0.1)
    assert client.vehicle.time_s - begin == pytest.approx(15.6, abs=0.2)
    assert client.arm() == ACCEPTED
    assert "EKF3 IMU0 is using external nav data" in client.texts()
    assert client.last("GPS_GLOBAL_ORIGIN").latitude == 473977420
    assert client.last("HOME_POSITION").altitude == 400000


def test_without_mocap_messages_there_is_no_position_however_long_it_waits():
    client = Client(parameters=MOCAP)
    client.wait(5)
    Mocap(client).origin()
    client.wait(5)
    assert client.mode(GUIDED) == ACCEPTED
    assert client.arm() == FAILED


def test_flags_change_seven_seconds_after_mocap_stops_and_position_drifts_meanwhile():
    client = Client(parameters=MOCAP)
    mocap = Mocap(client).fly()
    client.interval("EKF_STATUS_REPORT", 20)
    client.interval("LOCAL_POSITION_NED", 20)
    mocap.stream(1)
    begin, place = client.vehicle.time_s, client.truth.position
    client.wait(6.9)
    assert client.last("EKF_STATUS_REPORT").flags == SETTLED
    drift = math.dist(client.truth.position, place)
    told = client.last("LOCAL_POSITION_NED")
    assert 0.2 < drift < 3
    assert math.dist((told.x, told.y, told.z), place) < 0.2  # it does not detect the loss
    client.wait(0.2)
    assert client.last("EKF_STATUS_REPORT").flags == NO_POSITION
    client.wait(1.2)
    assert client.copter.mode is Mode.LAND
    assert client.last("LOCAL_POSITION_NED").time_boot_ms < (begin + 7.1) * 1000
    client.wait(10)
    assert not client.copter.is_armed


def test_a_turned_mocap_frame_turns_the_estimate():
    client = Client(parameters=MOCAP, options=EXACT)
    Mocap(client, turn=0.7).fly()
    motion = client.copter.estimator.motion
    heading = quaternions.to_euler(motion.attitude)[2] - quaternions.to_euler(client.truth.attitude)[2]
    assert heading == pytest.approx(0.7, abs=0.02)
    turned = quaternions.rotate(quaternions.from_euler(0, 0, 0.7), client.truth.position)
    assert motion.position == pytest.approx(turned, abs=0.05)


def test_mocap_that_jumps_far_is_refused_at_first_and_nan_always():
    client = Client(parameters=MOCAP, options=EXACT)
    mocap = Mocap(client).fly()
    mocap.stream(1, offset=3.0)
    assert client.copter.estimator.motion.position[0] == pytest.approx(client.truth.position[0], abs=0.1)
    assert client.copter.estimator.variance > 0.8
    mocap.stream(0.5, offset=math.nan)
    assert all(map(math.isfinite, client.copter.estimator.motion.position))
