"""Arming, modes, landing, failsafes, the pilot, the estimator's errors."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import FASTBRIDGE, BodyTable, LimitsTable, Vehicle
from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.ardupilot.modes import MODES, Mode, refusal
from alula.stages.sim_vehicle.common import quaternions
from alula.stages.sim_vehicle.common.estimator import NO_POSITION, SETTLED, EstimatorOptions
from alula.stages.sim_vehicle.common.faults import Fault
from alula.stages.sim_vehicle.common.packets import mavlink
from support.vehicles.autopilot_client import GUIDED, LAND, LOITER, NOGPS, QUICK, Client

ACCEPTED, FAILED = 0, 4

numbers = st.floats(-3, 3)
units = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(c * c for c in q) > 0.01)


@settings(deadline=None)
@given(units, units, st.tuples(numbers, numbers, numbers))
def test_plain_rotations_equal_those_of_arrays(a, b, v):
    p, q = quaternions.unit(a), quaternions.unit(b)
    assert quaternions.multiply(p, q) == pytest.approx(multiply_quat_wxyz(np.array(p), np.array(q)))
    assert quaternions.rotate(p, v) == pytest.approx(matrix_from_quat_wxyz(np.array(p)) @ v, abs=1e-12)
    assert quaternions.from_mrp(quaternions.to_mrp(p)) == pytest.approx(p, abs=1e-12)
    assert quaternions.from_vector(quaternions.to_vector(p)) == pytest.approx(p, abs=1e-9)
    assert quaternions.cos_tilt(p) == pytest.approx(matrix_from_quat_wxyz(np.array(p))[2, 2], abs=1e-12)


@settings(deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_angles_survive_a_quaternion(roll, pitch, yaw):
    q = quaternions.from_euler(roll, pitch, yaw)
    assert quaternions.to_euler(q) == pytest.approx((roll, pitch, yaw), abs=1e-6)


def test_the_estimator_settles_36_seconds_after_boot_and_arming_waits_for_it():
    client = Client(options=EstimatorOptions())
    client.wait(5)
    assert client.mode(GUIDED) == ACCEPTED  # disarmed, any mode is
    assert client.arm() == FAILED
    assert client.texts()[-1] == "Arm: GPS 1: Bad fix"
    client.wait(20)
    assert client.arm() == FAILED
    assert client.texts()[-1] == "Arm: Need Position Estimate"
    assert client.arm(forced=True) == FAILED
    assert "forced" in client.texts()[-1]
    client.wait(36 - client.vehicle.time_s - 0.01)
    assert client.copter.estimator.flags == NO_POSITION
    client.wait(0.02)
    assert client.copter.estimator.flags == SETTLED
    assert client.arm() == ACCEPTED
    assert "PreArm: Need Position Estimate" in client.texts()


def test_force_never_arms():
    client = Client()
    client.wait(1)
    assert client.arm(forced=True) == FAILED
    assert not client.copter.is_armed


@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_is_refused_or_entered_as_its_row_says(mode):
    row = MODES[mode]
    assert (refusal(mode, has_position=False) is None) is not row.needs_position
    client = Client()
    client.wait(0.01)
    assert client.mode(mode) == ACCEPTED
    assert client.arm() == FAILED
    client.wait(1)
    assert client.mode(mode) == ACCEPTED
    assert client.arm() == (ACCEPTED if row.can_arm else FAILED)
    client.wait(1.5)
    assert client.last("HEARTBEAT").custom_mode == mode
    assert bool(client.last("HEARTBEAT").base_mode & 128) is row.can_arm


def test_an_armed_vehicle_without_a_position_does_not_enter_a_mode_that_needs_one():
    client = Client().fly(2)
    client.mode(NOGPS)
    client.vehicle.inject(Fault(kind="estimator"))
    client.wait(0.5)
    assert client.mode(GUIDED) == FAILED
    assert client.texts()[-1] == "Mode change to GUIDED failed: requires position"


def test_modes_that_are_not_there_are_refused_by_name():
    client = Client()
    client.wait(1)
    assert client.mode(3) == FAILED
    assert client.mode(99) == FAILED
    assert client.texts()[-2:] == ["Mode change to AUTO failed: not simulated", "No such mode 99"]


def test_take_off_needs_guided_arms_and_the_ground():
    client = Client()
    client.wait(1)
    assert client.command(22, 0, 0, 0, 0, 0, 0, 3) == FAILED
    client.mode(GUIDED)
    assert client.command(22, 0, 0, 0, 0, 0, 0, 3) == FAILED
    client.arm()
    for height in (-1, 0, math.nan):
        assert client.command(22, 0, 0, 0, 0, 0, 0, height) == FAILED
    assert client.command(22, 0, 0, 0, 0, 0, 0, 3) == ACCEPTED
    client.wait(8)
    assert client.height > 2.5
    assert client.command(22, 0, 0, 0, 0, 0, 0, 3) == FAILED


def test_landing_is_soft_detected_and_disarms():
    client = Client().fly(3)
    client.interval("EXTENDED_SYS_STATE", 5)
    assert client.command(400, 0) == FAILED  # not in the air
    assert client.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    client.wait(1)
    assert client.last("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_LANDING
    client.wait(9)
    assert not client.copter.is_armed
    assert client.last("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
    assert 0.2 < client.copter.airframe.touchdown_m_s < 0.8
    assert math.dist(client.truth.position, (0, 0, 0)) < 0.3


def test_it_disarms_by_itself_on_the_ground_and_by_force_in_the_air():
    client = Client()
    client.wait(1)
    client.mode(GUIDED)
    client.arm()
    client.wait(9.5)
    assert client.copter.is_armed
    client.wait(1)
    assert not client.copter.is_armed
    flying = Client().fly(2)
    assert flying.command(400, 0, 21196) == ACCEPTED
    flying.wait(2)
    assert flying.height == 0
    assert flying.copter.airframe.touchdown_m_s > 5


def test_return_climbs_flies_home_waits_and_lands():
    client = Client(parameters={"RTL_ALT": 600, "RTL_LOIT_TIME": 1000, "LAND_SPEED": 100}).fly(2)
    client.target(8 + 16 + 32 + 448 + 1024 + 2048, p=(4, 3, -2))
    client.wait(8)
    assert client.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    highest = 0.0
    while client.copter.is_armed and client.vehicle.time_s < 90:
        client.wait(0.5)
        highest = max(highest, client.height)
    assert highest == pytest.approx(6, abs=0.3)
    assert math.hypot(*client.truth.position[:2]) < 0.4


@pytest.mark.parametrize(
    ("action", "mode"), [(0, Mode.GUIDED), (1, Mode.RTL), (5, Mode.LAND), (7, Mode.BRAKE)]
)
def test_losing_the_ground_station_does_what_the_parameter_says(action, mode):
    client = Client(parameters={"FS_GCS_ENABLE": action}).fly(2)
    heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    client.wait(6)
    assert client.copter.mode is Mode.GUIDED  # no heartbeat ever arrived
    client.send(heartbeat)
    client.wait(4.9)
    assert client.copter.mode is Mode.GUIDED
    client.wait(0.4)
    assert client.copter.mode is mode
    if action:
        client.send(heartbeat)
        client.wait(0.3)
        assert client.texts()[-2:] == ["GCS Failsafe", "GCS Failsafe Cleared"]


def test_heartbeats_of_a_companion_do_not_count():
    client = Client(parameters={"FS_GCS_ENABLE": 5}, system=7)
    client.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    assert client.copter._gcs_s is None


@pytest.mark.parametrize(
    ("parameters", "share", "mode"),
    [
        ({}, 0.1, Mode.GUIDED),
        ({"BATT_FS_LOW_ACT": 2}, 0.1, Mode.RTL),
        ({"BATT_FS_LOW_ACT": 2, "BATT_CRT_VOLT": 10.0, "BATT_FS_CRT_ACT": 1}, 0.02, Mode.LAND),
        ({"BATT_LOW_MAH": 500, "BATT_FS_LOW_ACT": 1, "BATT_LOW_VOLT": 0}, 0.1, Mode.LAND),
    ],
)
def test_a_low_battery_does_what_its_parameters_say(parameters, share, mode):
    client = Client(parameters={"BATT_LOW_TIMER": 2, **parameters}).fly(2)
    assert client.copter.battery.remaining > 0.9
    client.vehicle.inject(Fault(kind="battery", amount=share))
    client.wait(3)
    assert client.copter.mode is mode
    assert any(text.startswith("Battery 1 is low") for text in client.texts())
    client.interval("SYS_STATUS", 5)
    client.wait(0.5)
    assert client.last("SYS_STATUS").battery_remaining <= 100 * share


def test_an_estimator_that_gives_up_lands_it_where_it_needs_a_position():
    client = Client().fly(2)
    client.interval("EKF_STATUS_REPORT", 10)
    client.vehicle.inject(Fault(kind="estimator"))
    client.wait(0.7)
    assert client.last("EKF_STATUS_REPORT").flags == NO_POSITION
    assert client.last("EKF_STATUS_REPORT").pos_horiz_variance > 0.8
    assert client.copter.mode is Mode.GUIDED
    client.wait(0.8)
    assert client.copter.mode is Mode.LAND
    assert "EKF Failsafe: changed to LAND Mode" in client.texts()
    client.wait(9)
    assert not client.copter.is_armed
    without = Client().fly(2)
    assert without.mode(NOGPS) == ACCEPTED
    without.vehicle.inject(Fault(kind="estimator"))
    without.wait(2)
    assert without.copter.mode is Mode.GUIDED_NOGPS


def test_the_pilot_takes_over_by_the_switch_and_by_an_override():
    client = Client().fly(3)
    client.copter.pilot.move(5, 1000)
    client.wait(0.2)
    client.copter.pilot.move(5, 1700)  # the fifth position: LOITER
    client.wait(0.2)
    assert client.copter.mode is Mode.LOITER
    client.wait(2)
    assert client.height == pytest.approx(3, abs=0.3)
    client.mode(GUIDED)
    channels = [65535] * 8 + [0] * 10
    channels[4] = 1300  # the second position: LAND
    client.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *channels))
    client.wait(0.2)
    assert client.copter.mode is Mode.LAND
    other = Client(system=9).fly(2)
    other.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *channels))
    other.wait(0.2)
    assert other.copter.mode is Mode.GUIDED  # only the ground station may


def test_sticks_fly_it_in_loiter():
    client = Client().fly(3)
    client.mode(LOITER)
    client.copter.pilot.move(2, 1400)  # forward
    client.wait(3)
    client.copter.pilot.move(2, 1500)
    assert client.truth.velocity[0] > 1
    client.wait(4)
    assert math.hypot(*client.truth.velocity[:2]) < 0.2


def test_losing_the_radio_returns():
    client = Client().fly(2)
    client.vehicle.inject(Fault(kind="radio-loss"))
    client.wait(0.3)
    assert client.copter.mode is Mode.RTL
    assert "Radio Failsafe" in client.texts()


def test_what_is_told_is_late_and_noisy_and_the_same_for_the_same_seed():
    def run(seed, options):
        client = Client(options=options, seed=seed).fly(2)
        client.interval("LOCAL_POSITION_NED", 50)
        errors = []
        for _ in range(100):
            client.wait(0.02)
            told = client.last("LOCAL_POSITION_NED")
            errors.append(np.subtract((told.x, told.y, told.z), client.truth.position))
        return np.array(errors), client

    first, _ = run(3, QUICK)
    assert np.array_equal(first, run(3, QUICK)[0])
    assert not np.array_equal(first, run(4, QUICK)[0])
    assert 0.002 < first.std() < 0.05
    late = EstimatorOptions(boot_time_s=0.5, delay_s=0.2)
    _, client = run(3, late)
    assert client.copter.estimator.reported is not client.copter.estimator.motion
    client.mode(LAND)
    client.wait(2)
    lag = client.copter.estimator.reported.position[2] - client.copter.estimator.motion.position[2]
    assert lag == pytest.approx(-0.2 * 0.5, abs=0.03)


def test_wind_and_drag_of_the_vehicle_act_from_the_side_they_blow():
    import msgspec

    table = msgspec.structs.replace(
        FASTBRIDGE.disturbance, linear_drag_n_s_m=(0.2, 0.2, 0.2), wind_m_s=(3.0, 0.0, 0.0)
    )
    windy = msgspec.structs.replace(FASTBRIDGE, disturbance=table)
    client = Client(vehicle=windy, parameters={"GUID_OPTIONS": 8}).fly(5)
    hover = client.copter.hover_throttle
    client.stream(1.5, thrust=hover, mask=7)
    north, east, _ = client.truth.velocity
    assert east > 0.8  # a wind to the east
    assert abs(north) < 0.2


def test_only_quadrotors_fly():
    point = Vehicle(
        name="p",
        model="double-integrator",
        body=BodyTable(radius_m=0.1),
        limits=LimitsTable(max_acceleration_m_s2=3.0),
    )
    with pytest.raises(UsageError, match="quadrotor is needed"):
        ArduCopter(point)
