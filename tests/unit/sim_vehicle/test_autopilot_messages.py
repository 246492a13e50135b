"""Requests of clients: parameters, intervals, missions, time, signatures."""

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.errors import UsageError
from alula.stages.sim_vehicle.ardupilot.parameters import TABLE
from alula.stages.sim_vehicle.common.packets import mavlink
from alula.stages.sim_vehicle.common.parameters import Parameters
from support.effort import examples
from support.vehicles.autopilot_client import EXACT, GUIDED, Client, of

KEY = bytes(range(32))


def test_the_heartbeat_is_that_of_a_copter_once_a_second():
    client = Client()
    beats = of("HEARTBEAT", client.wait(4.9))
    assert len(beats) == 5
    beat = beats[-1]
    assert (beat.type, beat.autopilot, beat.custom_mode) == (2, 3, 0)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


def test_all_parameters_are_listed_once_and_read_by_name_and_index():
    client = Client()
    client.wait(0.1)
    client.send(mavlink.MAVLink_param_request_list_message(1, 1))
    values = of("PARAM_VALUE", client.wait(1))
    assert [v.param_index for v in values] == list(range(len(TABLE)))
    assert {v.param_id for v in values} == set(TABLE)
    assert {v.param_count for v in values} == {len(TABLE)}
    for name, index in ((b"GUID_TIMEOUT", -1), (b"", values[40].param_index)):
        client.send(mavlink.MAVLink_param_request_read_message(1, 1, name, index))
        (answer,) = of("PARAM_VALUE", client.wait(0.01))
        assert answer.param_id == (name.decode() or values[40].param_id)
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", 9999))
    assert not of("PARAM_VALUE", client.wait(0.05))


def test_the_defaults_are_the_traps():
    client = Client()
    names = {
        "GUID_OPTIONS": 0,
        "GUID_TIMEOUT": 3,
        "ATC_ANGLE_BOOST": 1,
        "FS_GCS_ENABLE": 0,
        "EK3_SRC1_POSXY": 3,
        "VISO_TYPE": 0,
        "GPS1_TYPE": 1,
        "ARMING_CHECK": 1,
        "MAV_GCS_SYSID": 255,
    }
    for name, value in names.items():
        assert client.copter.parameters[name] == value


def test_a_parameter_that_is_set_answers_with_what_now_holds():
    client = Client()

    def put(name, value):
        client.send(mavlink.MAVLink_param_set_message(1, 1, name, value, 9))
        return of("PARAM_VALUE", client.wait(0.01))

    assert put(b"GUID_TIMEOUT", 0.3)[0].param_value == pytest.approx(0.3)
    assert put(b"GUID_OPTIONS", 8.4)[0].param_value == 8
    assert put(b"VISO_TYPE", 1000)[0].param_value == 127
    assert put(b"GUID_TIMEOUT", math.nan)[0].param_value == pytest.approx(0.3)
    assert put(b"NO_SUCH", 1) == []
    put(b"MAV_SYSID", 7)
    assert of("HEARTBEAT", client.wait(1.1))[0].get_srcSystem() == 7


@settings(deadline=None)
@given(st.sampled_from(sorted(TABLE)), st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_integer_parameters_stay_within_their_type(name, value):
    parameters = Parameters(table=TABLE)
    assert parameters.set(name, value)
    bits = {2: 8, 4: 16, 6: 32}.get(TABLE[name][0])
    if bits is None:
        assert parameters[name] == value
    else:
        assert parameters[name] == int(parameters[name])
        assert -(2 ** (bits - 1)) <= parameters[name] < 2 ** (bits - 1)


def test_unknown_parameters_at_boot_are_refused():
    with pytest.raises(UsageError, match="no parameter is called 'NOPE'"):
        Parameters({"NOPE": 1}, table=TABLE)
    with pytest.raises(UsageError, match="no meaning"):
        Parameters({"GUID_TIMEOUT": math.inf}, table=TABLE)


def test_messages_come_only_at_the_rate_they_were_asked_for():
    client = Client()
    client.wait(1.0)
    assert not of("ATTITUDE", client.heard)  # no rate is set at boot
    for name, hertz in (("ATTITUDE_QUATERNION", 100), ("LOCAL_POSITION_NED", 50), ("SYS_STATUS", 2)):
        client.interval(name, hertz)
        times = of(name, client.wait(2))
        assert len(times) == pytest.approx(2 * hertz, abs=1)
    stamps = [m.time_boot_ms for m in of("LOCAL_POSITION_NED", client.wait(1))]
    assert {b - a for a, b in itertools.pairwise(stamps)} == {20}
    number = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    assert client.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, number) == 0
    assert client.last("MESSAGE_INTERVAL").interval_us == 20000
    assert client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, -1) == 0
    assert not of("LOCAL_POSITION_NED", client.wait(1))


def test_the_interval_of_an_unknown_message_is_denied_with_a_text():
    client = Client()
    client.wait(1)
    assert client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 1000) == mavlink.MAV_RESULT_DENIED
    assert client.texts()[-1] == "No ap_message for mavlink id (9999)"
    number = mavlink.MAVLINK_MSG_ID_ATTITUDE
    assert client.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, -5) == mavlink.MAV_RESULT_DENIED
    for command in (mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE):
        assert client.command(command, 9999) == mavlink.MAV_RESULT_FAILED


def test_data_streams_come_and_go():
    client = Client()
    client.wait(1)
    client.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    kinds = {m.get_type() for m in client.wait(1)}
    expected = {"SYS_STATUS", "GPS_RAW_INT", "RC_CHANNELS", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"}
    assert expected | {"ATTITUDE", "VFR_HUD", "EKF_STATUS_REPORT", "BATTERY_STATUS"} <= kinds
    client.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 0))
    assert {m.get_type() for m in client.wait(1)} == {"HEARTBEAT"}


def test_each_message_can_be_requested_once():
    client = Client()
    client.wait(1)
    for number, name in client.vehicle.telemetry.ids.items():
        result = client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
        told = name != "POSITION_TARGET_LOCAL_NED"  # in GUIDED only
        assert result == (0 if told else 4), name
        assert bool(of(name, client.heard)) is told, name
    assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 9999) == 4
    version = client.last("AUTOPILOT_VERSION")
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert version.flight_sw_version >> 24 == 4


def test_positions_agree_between_local_global_and_truth():
    client = Client(options=EXACT).fly(5)
    client.target(8 + 16 + 32 + 448 + 1024 + 2048, p=(6, -4, -5))
    client.wait(10)
    for name in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SIM_STATE", "HOME_POSITION"):
        client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, getattr(mavlink, f"MAVLINK_MSG_ID_{name}"))
    local, place = client.last("LOCAL_POSITION_NED"), client.last("GLOBAL_POSITION_INT")
    home, truth = client.last("HOME_POSITION"), client.last("SIM_STATE")
    north = math.radians((place.lat - home.latitude) / 1e7) * 6378100
    east = math.radians((place.lon - home.longitude) / 1e7) * 6378100 * math.cos(math.radians(-35.36))
    assert (local.x, local.y, local.z) == pytest.approx((6, -4, -5), abs=0.1)
    assert (north, east) == pytest.approx((local.x, local.y), abs=0.03)
    assert place.relative_alt / 1000 == pytest.approx(-local.z, abs=0.03)
    assert truth.alt - home.altitude / 1000 == pytest.approx(5, abs=0.1)


def test_a_goal_given_by_latitude_is_flown_to():
    client = Client(options=EXACT).fly(3)
    lat, lon, _ = client.copter.estimator.global_position((3.0, 2.0, 0.0))
    client.send(
        mavlink.MAVLink_command_int_message(
            1,
            1,
            6,
            mavlink.MAV_CMD_DO_REPOSITION,
            0,
            0,
            -1,
            1,
            0,
            math.nan,
            int(lat * 1e7),
            int(lon * 1e7),
            4,
        )
    )
    client.wait(9)
    assert client.last("COMMAND_ACK").result == 0
    assert client.truth.position == pytest.approx((3, 2, -4), abs=0.15)


def test_there_is_no_mission_and_there_are_no_files_and_no_logs():
    client = Client()
    client.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    client.send(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    client.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    client.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, [5, 0, 0, 4] + [0] * 247))
    client.wait(0.05)
    assert client.last("MISSION_COUNT").count == 0
    assert client.last("LOG_ENTRY").num_logs == 0
    assert client.last("MISSION_ACK").type == mavlink.MAV_MISSION_UNSUPPORTED
    reply = client.last("FILE_TRANSFER_PROTOCOL").payload
    assert (reply[0], reply[3], reply[5], reply[12]) == (6, 129, 4, 7)


def test_time_is_told_to_who_asks():
    client = Client()
    client.wait(2)
    client.send(mavlink.MAVLink_timesync_message(0, 12345))
    client.wait(0.01)
    sync = client.last("TIMESYNC")
    assert (sync.tc1, sync.ts1) == (2_000_000_000, 12345)
    client.send(mavlink.MAVLink_timesync_message(1, 2))
    assert not of("TIMESYNC", client.wait(0.05))


def test_messages_for_others_and_unknown_commands_are_left_alone():
    client = Client()
    client.wait(1)
    client.send(mavlink.MAVLink_command_long_message(2, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    client.send(mavlink.MAVLink_command_long_message(1, 100, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    assert not of("COMMAND_ACK", client.wait(0.1))
    assert not client.copter.is_armed
    assert client.command(31000) == mavlink.MAV_RESULT_UNSUPPORTED


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_noise_on_the_line_harms_nothing(noise):
    client = Client()
    client.vehicle.receive(noise)
    client.vehicle.receive(bytes(300))  # completes a frame of any announced length
    client.wait(0.1)
    assert client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_ATTITUDE) == 0


def extremes(kind):
    """Messages of a kind with fields over the whole of their types."""
    fields = []
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        sort = kind.fieldtypes[kind.fieldnames.index(name)]
        if sort == "char":
            one = st.sampled_from([name.encode() for name in sorted(TABLE)])
        elif sort in ("float", "double"):
            one = st.one_of(st.floats(width=32), st.floats(-3, 3, width=32))
        elif name == "target_system" or name == "target_component":
            one = st.just(1)
        elif name == "command":
            one = st.sampled_from(COMMANDS)
        else:
            bits, low = int(sort.strip("uint_")), 0 if sort[0] == "u" else 1
            one = st.integers(-low * 2 ** (bits - 1), 2 ** (bits - low) - 1)
        fields.append(
            one if length < 2 or sort == "char" else st.lists(one, min_size=length, max_size=length)
        )
    order = [kind.ordered_fieldnames.index(name) for name in kind.fieldnames]
    return st.tuples(*[fields[i] for i in order]).map(lambda values: kind(*values))


COMMANDS = (16, 20, 21, 22, 115, 176, 178, 179, 185, 192, 400, 401, 410, 510, 511, 512, 520)
ASKED = (
    *("command_long", "command_int", "set_attitude_target", "set_position_target_local_ned", "param_set"),
    *("set_mode", "param_request_read", "request_data_stream", "set_gps_global_origin", "ping"),
    *("vision_position_estimate", "vision_speed_estimate", "rc_channels_override", "timesync"),
    *("mission_request_list", "file_transfer_protocol", "heartbeat"),
)


@settings(deadline=None, max_examples=examples(30))
@given(st.lists(st.one_of([extremes(getattr(mavlink, f"MAVLink_{n}_message")) for n in ASKED]), max_size=40))
def test_no_message_whatever_it_holds_stops_the_vehicle(messages):
    client = Client(parameters={"VISO_TYPE": 1})
    client.wait(0.6)
    client.mode(GUIDED)
    client.arm()
    client.wait(3.1)
    client.command(22, 0, 0, 0, 0, 0, 0, 2.0)
    client.wait(0.5)
    client.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 20, 1))
    for message in messages:
        client.send(message)
        client.wait(0.02)
    client.wait(0.3)
    motion = client.copter.airframe.truth
    values = (*motion.position, *motion.velocity, *motion.attitude, *motion.omega)
    assert all(map(math.isfinite, values))


def signed(client, key=KEY, since=1):
    client.mav.signing.secret_key = key
    client.mav.signing.sign_outgoing = True
    client.mav.signing.timestamp = since
    client.mav.signing.allow_unsigned_callback = lambda mav, number: False


def test_a_serial_channel_with_a_key_refuses_what_is_not_signed_by_it():
    client = Client(channel=1, key=KEY)
    request = mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1)
    client.send(request)
    assert not of("PARAM_VALUE", client.wait(0.05))
    assert client.vehicle.codec.unsigned_refused == 1
    signed(client, bytes(32)[:-1] + b"x")
    client.send(request)
    assert not of("PARAM_VALUE", client.wait(0.05))
    signed(client, since=100)
    client.send(request)
    (value,) = of("PARAM_VALUE", client.wait(0.05))
    assert value.get_signed()


def test_channel_zero_takes_unsigned_packets_even_with_a_key():
    client = Client(channel=0, key=KEY)
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1))
    (value,) = of("PARAM_VALUE", client.wait(0.05))
    assert value.get_header().incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED


def test_a_key_that_is_sent_holds_from_then_on_but_not_once_armed():
    client = Client(channel=1)
    client.wait(1)
    client.mode(GUIDED)
    client.arm()
    setup = mavlink.MAVLink_setup_signing_message(1, 1, list(KEY), 5)
    client.send(setup)
    client.wait(0.05)
    assert client.texts()[-1] == "ERROR: Won't setup signing when armed"
    client.command(400, 0)
    client.send(setup)
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1))
    assert not of("PARAM_VALUE", client.wait(0.05))
