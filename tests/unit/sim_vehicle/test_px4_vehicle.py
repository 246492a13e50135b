"""The simulated vehicle with PX4's documented behaviour, tested by a client on its own clock."""

import math
import struct

import pytest

from alula.schemas.scenarios.vehicle import read_vehicle
from alula.stages.sim_vehicle.common.estimator import EstimatorOptions
from alula.stages.sim_vehicle.common.faults import Fault
from alula.stages.sim_vehicle.common.packets import mavlink as m
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from alula.stages.sim_vehicle.px4.vehicle import ZURICH, Px4Copter
from support.paths import VEHICLES
from support.vehicles.autopilot_client import Client

REFUSED, ACCEPTED = m.MAV_RESULT_TEMPORARILY_REJECTED, m.MAV_RESULT_ACCEPTED
VELOCITY, STOP = 0x9C7, 0xDC7
FAST = {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25}


class Px4Client(Client):
    kind = Px4Copter

    def __init__(self, parameters=None, **keywords):
        super().__init__(parameters=FAST | (parameters or {}), **keywords)

    def px4_mode(self, mode):
        return self.command(m.MAV_CMD_DO_SET_MODE, 1, mode >> 16 & 0xFF, mode >> 24)

    def velocities(self, seconds, velocity=(0, 0, 0), period=0.05):
        for _ in range(round(seconds / period)):
            self.target(VELOCITY, v=velocity)
            self.wait(period)

    def beat(self, kind):
        self.send(m.MAVLink_heartbeat_message(kind, m.MAV_AUTOPILOT_INVALID, 0, 0, m.MAV_STATE_ACTIVE, 3))

    def offboard(self, height=1.5):
        """Vehicle in the air that follows velocity set-points."""
        self.wait(0.6)
        self.velocities(1.2)
        assert self.px4_mode(Px4Mode.OFFBOARD) == ACCEPTED
        assert self.arm() == ACCEPTED
        self.velocities(1.1)
        for _ in range(50):
            if self.height < height:
                self.velocities(0.1, (0, 0, -2.0))
        assert self.height >= height
        self.velocities(0.6)
        return self

    @property
    def told(self):
        """The newest reported mode and state."""
        self.wait(1.05)
        beat = self.last("HEARTBEAT")
        return Px4Mode(beat.custom_mode), beat.system_status, bool(beat.base_mode & 128)

    @property
    def said(self):
        """All texts; long ones arrive in pieces."""
        return "".join(self.texts())

    def value(self, name):
        self.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        (found,) = (e for e in self.wait(0.02) if e.get_type() == "PARAM_VALUE")
        return found


def test_it_tells_that_it_is_px4_and_streams_by_itself():
    client = Px4Client()
    client.wait(1.1)
    beat = client.last("HEARTBEAT")
    assert (beat.type, beat.autopilot) == (m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_PX4)
    assert beat.custom_mode == 4 << 16 | 3 << 24  # AUTO, LOITER
    kinds = {message.get_type() for message in client.heard}
    assert {
        "LOCAL_POSITION_NED",
        "ODOMETRY",
        "HIGHRES_IMU",
        "ESTIMATOR_STATUS",
        "EXTENDED_SYS_STATE",
    } <= kinds
    assert client.last("HIGHRES_IMU").zacc == pytest.approx(-9.81, abs=0.05)
    count = sum(message.get_type() == "ODOMETRY" for message in client.wait(1.0))
    assert 29 <= count <= 31
    client.interval("ODOMETRY", 100)
    assert 98 <= sum(message.get_type() == "ODOMETRY" for message in client.wait(1.0)) <= 102
    assert client.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ODOMETRY, 0) == ACCEPTED
    assert 29 <= sum(message.get_type() == "ODOMETRY" for message in client.wait(1.0)) <= 31
    assert client.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == ACCEPTED
    capabilities = client.last("AUTOPILOT_VERSION").capabilities
    assert capabilities & m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    assert not capabilities & m.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT


def test_the_estimates_flags_are_those_of_the_real_one():
    """As PX4 itself sent them in its simulation: at rest without a position, at rest, in the air."""
    client = Px4Client(options=EstimatorOptions(boot_time_s=2.0))
    client.wait(1.1)
    assert client.last("ESTIMATOR_STATUS").flags == 0xE5
    client.wait(2.0)
    assert client.last("ESTIMATOR_STATUS").flags == 0x3FF
    client.offboard()
    client.velocities(1.0)
    assert client.last("ESTIMATOR_STATUS").flags == 0x37F


def test_offboard_is_accepted_while_disarmed_and_arms_with_a_stream_that_is_fast_and_long_enough():
    client = Px4Client()
    client.wait(0.6)
    assert client.px4_mode(Px4Mode.OFFBOARD) == ACCEPTED
    assert client.arm() == REFUSED
    client.velocities(0.9)
    assert client.arm() == REFUSED
    client.velocities(3.0, period=0.6)  # slower than 2 Hz does not count
    assert client.arm() == REFUSED
    client.velocities(1.2, period=0.4)
    assert client.arm() == ACCEPTED
    assert client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0) == ACCEPTED
    client.wait(1.2)  # the stream stopped: it does not arm
    assert client.arm() == REFUSED
    assert "Preflight Fail: no offboard signal" in client.said
    assert "Arming denied: Resolve system health failures first" in client.said


@pytest.mark.parametrize(
    "wrong",
    [
        {"mask": 128 | 64},  # without thrust
        {"mask": 128 | 1},  # without a roll rate
        {"mask": 128, "thrust": math.nan},
    ],
)
def test_set_points_without_all_their_parts_are_none(wrong):
    client = Px4Client()
    client.wait(0.6)
    assert client.px4_mode(Px4Mode.OFFBOARD) == ACCEPTED
    client.stream(1.2, **wrong)
    assert client.arm() == REFUSED
    client.stream(1.2, mask=128, thrust=0.0)
    assert client.arm() == ACCEPTED


def test_positions_of_single_axes_or_strange_frames_are_none_and_nan_leaves_a_field_out():
    client = Px4Client()
    client.wait(0.6)
    for _ in range(30):
        client.target(VELOCITY & ~1)  # x alone beside the velocity
        client.target(VELOCITY, frame=m.MAV_FRAME_LOCAL_OFFSET_NED)
        client.target(STOP, v=(math.nan, 0, 0))
        client.wait(0.05)
    assert not client.copter.has_stream
    for _ in range(30):
        client.target(0x800, p=[math.nan] * 3, v=(0, 0, 0), a=[math.nan] * 3)
        client.wait(0.05)
    assert client.copter.has_stream


def test_rates_and_thrust_hover_at_the_hover_throttle():
    client = Px4Client().offboard()
    hover = client.copter.parameters["MPC_THR_HOVER"]
    assert hover == pytest.approx(client.copter.hover_throttle, rel=1e-5)
    client.stream(0.4, thrust=hover)
    before = client.climb
    client.stream(1.0, thrust=hover)
    assert client.climb == pytest.approx(before, abs=0.1)
    client.stream(0.5, omega=(0, 0, 1.0), thrust=hover)
    assert client.truth.omega[2] == pytest.approx(1.0, abs=0.05)
    # No division by the cosine of the tilt, no climb rates.
    client.stream(0.3, omega=(1.0, 0, 0), thrust=hover)
    assert client.copter.attitude.throttle_command == pytest.approx(hover, rel=1e-6)


def test_reported_thrust_stays_that_of_the_last_attitude_while_rates_are_flown():
    client = Px4Client().offboard()
    client.interval("ATTITUDE_TARGET", 50)
    client.velocities(0.2)
    last = client.last("ATTITUDE_TARGET")
    client.stream(1.0, omega=(0, 0, 0.4), thrust=0.2)
    kept = client.last("ATTITUDE_TARGET")
    assert kept.time_boot_ms - last.time_boot_ms <= 50
    assert kept.thrust == pytest.approx(client.copter.hover_throttle, rel=0.05)
    assert kept.body_yaw_rate == pytest.approx(0.4, abs=0.05)
    client.velocities(0.2)
    assert client.last("ATTITUDE_TARGET").time_boot_ms > kept.time_boot_ms + 1000


def test_each_axis_follows_rates_with_its_own_time_constant():
    client = Px4Client(vehicle=read_vehicle(VEHICLES / "px4-sih.toml")).offboard()
    hover = client.copter.parameters["MPC_THR_HOVER"]
    client.stream(0.14, omega=(0.5, 0, 0.5), thrust=hover)
    roll, _, yaw = client.truth.omega
    assert roll > 0.6 * 0.5
    assert yaw < 0.4 * 0.5


@pytest.mark.parametrize(
    ("action", "mode"),
    [(4, Px4Mode.LAND), (3, Px4Mode.RTL), (0, Px4Mode.POSCTL)],
)
def test_a_stream_that_stops_is_a_failsafe_after_the_timeout(action, mode):
    client = Px4Client({"COM_OF_LOSS_T": 0.3, "COM_OBL_RC_ACT": action}).offboard()
    client.wait(0.25)
    assert client.copter.flown is Px4Mode.OFFBOARD
    client.wait(0.2)
    assert client.told == (mode, m.MAV_STATE_CRITICAL, True)
    assert "Failsafe activated: no offboard signal" in client.said


def test_a_stream_that_comes_back_is_followed_again_unless_somebody_chose_a_mode():
    client = Px4Client({"COM_OBL_RC_ACT": 5}).offboard()
    client.wait(1.3)
    assert client.copter.flown is Px4Mode.HOLD
    client.velocities(0.9)
    assert client.copter.flown is Px4Mode.HOLD
    client.velocities(0.3)
    assert client.copter.flown is Px4Mode.OFFBOARD
    client.wait(1.3)
    assert client.px4_mode(Px4Mode.POSCTL) == ACCEPTED
    client.velocities(2.0)
    assert client.told[:2] == (Px4Mode.POSCTL, m.MAV_STATE_ACTIVE)


def test_nobody_flies_by_hand_without_a_radio():
    rules = {"COM_OBL_RC_ACT": 0, "COM_RCL_EXCEPT": 4, "NAV_RCL_ACT": 3, "COM_FAIL_ACT_T": 1.0}
    client = Px4Client(rules).offboard(1.0)
    client.vehicle.inject(Fault(kind="radio-loss"))
    client.velocities(2.0)
    assert client.copter.flown is Px4Mode.OFFBOARD  # excepted
    client.wait(1.2)
    assert client.copter.flown is Px4Mode.LAND


def test_a_lost_radio_holds_for_a_while_and_then_acts():
    client = Px4Client({"NAV_RCL_ACT": 3, "COM_FAIL_ACT_T": 2.0}).offboard()
    client.vehicle.inject(Fault(kind="radio-loss", duration=4.0))
    client.velocities(1.0)
    assert client.copter.flown is Px4Mode.HOLD
    client.velocities(1.5)
    assert client.copter.flown is Px4Mode.LAND
    client.velocities(2.0)
    assert client.copter.flown is Px4Mode.OFFBOARD  # by itself


def test_only_a_ground_stations_heartbeats_count_and_without_one_it_may_not_arm():
    client = Px4Client({"NAV_DLL_ACT": 3, "COM_DL_LOSS_T": 10, "COM_FAIL_ACT_T": 0.0})
    client.wait(0.6)
    client.beat(m.MAV_TYPE_ONBOARD_CONTROLLER)
    assert client.arm() == REFUSED
    assert "Preflight Fail: No connection to the ground control station" in client.said
    client.beat(m.MAV_TYPE_GCS)
    client.offboard(1.0)
    client.copter.parameters.set("COM_DL_LOSS_T", 2)
    client.beat(m.MAV_TYPE_GCS)
    client.velocities(1.8)
    assert client.copter.flown is Px4Mode.OFFBOARD
    client.beat(m.MAV_TYPE_ONBOARD_CONTROLLER)
    client.velocities(0.4)
    assert client.copter.flown is Px4Mode.LAND
    client.beat(m.MAV_TYPE_GCS)
    client.velocities(0.5)
    assert client.copter.flown is Px4Mode.OFFBOARD


def test_the_pilots_sticks_and_switch_take_over():
    client = Px4Client({"COM_RC_OVERRIDE": 3, "COM_FLTMODE4": 2, "COM_FLTMODE1": 4}).offboard()
    client.copter.pilot.move(1, 1600)  # less than 30 %
    client.velocities(0.5)
    assert client.copter.flown is Px4Mode.OFFBOARD
    client.copter.pilot.move(1, 1900)
    client.velocities(0.2)
    assert client.copter.flown is Px4Mode.POSCTL
    client.copter.pilot.move(1, 1500)
    client.velocities(1.2)
    assert client.copter.flown is Px4Mode.POSCTL
    client.copter.pilot.move(5, 1000)
    client.velocities(0.2)
    assert client.copter.flown is Px4Mode.HOLD


def test_sticks_do_nothing_in_offboard_unless_they_are_allowed_to():
    client = Px4Client().offboard()
    client.copter.pilot.move(1, 1900)
    client.velocities(0.5)
    assert client.copter.flown is Px4Mode.OFFBOARD
    client.px4_mode(Px4Mode.HOLD)
    client.wait(0.2)
    assert client.copter.flown is Px4Mode.POSCTL


@pytest.mark.parametrize(
    ("altitude", "height"),
    [(ZURICH[2] + 4.0, 4.0), (4.0, 2.5), (math.nan, 2.5)],  # above the sea; as ArduPilot means it; left out
)
def test_take_off_is_to_an_altitude_above_the_sea(altitude, height):
    client = Px4Client()
    client.wait(0.6)
    assert client.arm() == ACCEPTED
    assert client.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, altitude) == ACCEPTED
    assert client.copter.flown is Px4Mode.TAKEOFF
    client.wait(8.0)
    assert client.height == pytest.approx(height, abs=0.5)
    assert client.told[0] is Px4Mode.HOLD
    assert ("Using minimum takeoff altitude: 2.50 m" in client.said) == (altitude == 4.0)


def test_it_disarms_after_a_landing_and_without_a_take_off():
    client = Px4Client({"COM_DISARM_PRFLT": 3.0, "MPC_LAND_SPEED": 1.5}).offboard(1.0)
    client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    assert client.copter.is_armed  # in the air
    assert client.command(m.MAV_CMD_NAV_LAND) == ACCEPTED
    assert client.told[0] is Px4Mode.LAND
    assert client.last("EXTENDED_SYS_STATE").landed_state == m.MAV_LANDED_STATE_LANDING
    for _ in range(60):
        if not client.copter.is_landed:
            client.wait(0.1)
    assert client.copter.is_landed
    client.wait(1.5)
    assert client.copter.is_armed
    client.wait(1.0)
    assert not client.copter.is_armed
    assert client.arm() == REFUSED  # in Land
    assert client.px4_mode(Px4Mode.HOLD) == ACCEPTED
    assert client.arm() == ACCEPTED
    client.wait(2.5)
    assert client.copter.is_armed
    client.wait(1.0)
    assert not client.copter.is_armed
    assert client.arm(forced=True) == ACCEPTED


def test_integers_travel_bit_by_bit_and_other_types_are_refused():
    client = Px4Client()
    found = client.value("COM_FLTMODE1")
    assert found.param_type == m.MAV_PARAM_TYPE_INT32
    assert struct.unpack_from("<i", bytes(found.get_msgbuf()), 10) == (-1,)
    assert client.value("COM_OF_LOSS_T").param_value == 1.0

    def put(name, value, kind):
        client.send(m.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
        return [e for e in client.wait(0.02) if e.get_type() == "PARAM_VALUE"]

    (bits,) = struct.unpack("<f", struct.pack("<i", 4))
    assert len(put("COM_OBL_RC_ACT", bits, m.MAV_PARAM_TYPE_INT32)) == 1
    assert client.copter.parameters["COM_OBL_RC_ACT"] == 4
    assert put("COM_OBL_RC_ACT", 5.0, m.MAV_PARAM_TYPE_REAL32) == []
    assert client.copter.parameters["COM_OBL_RC_ACT"] == 4
    put(
        "COM_OBL_RC_ACT", 5.0, m.MAV_PARAM_TYPE_INT32
    )  # cast as for ArduPilot: a wrong value, which it accepts
    assert client.copter.parameters["COM_OBL_RC_ACT"] == 0x40A00000
    assert put("GUID_OPTIONS", 8.0, m.MAV_PARAM_TYPE_REAL32) == []


def test_a_bad_estimate_and_an_empty_battery_land_it():
    client = Px4Client({"COM_LOW_BAT_ACT": 3}).offboard()
    client.vehicle.inject(Fault(kind="battery", amount=0.02))
    client.velocities(0.5)
    assert client.copter.flown is Px4Mode.LAND
    client = Px4Client().offboard()
    client.vehicle.inject(Fault(kind="estimator"))
    client.velocities(0.5)
    assert client.copter.flown is Px4Mode.OFFBOARD
    client.velocities(1.0)
    assert client.copter.flown is Px4Mode.LAND


def test_the_pilots_switch_as_a_fault_goes_to_places_of_px4s_own():
    client = Px4Client().offboard()
    client.vehicle.inject(Fault(kind="mode"))
    client.velocities(0.2)
    assert client.copter.flown is Px4Mode.POSCTL
    client.vehicle.inject(Fault(kind="mode", amount=5))
    client.velocities(0.2)
    assert client.copter.flown is Px4Mode.RTL
