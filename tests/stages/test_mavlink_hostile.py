"""What comes in over a MAVLink link and must change nothing: damaged, foreign, old, unsigned, absurd."""

from __future__ import annotations

import dataclasses
import math
import os
import pty
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_peer import Peer, Time, m
from test_mavlink_link import vehicle

from alula.schemas.errors import InputError, LinkError
from alula.stages.flight.frames import LocalFrame
from alula.stages.flight.links.mavlink_estimate import Estimate
from alula.stages.flight.links.mavlink_session import WANTED
from alula.stages.flight.links.mavlink_signing import Signer, read_key
from alula.stages.flight.links.mavlink_wire import Wire
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.flight.links.vehicle_clock import VehicleClock

KEY = bytes(range(32))
_COUNTED = ("bad_packets", "lost_packets")


def said(link, *but):
    """All that a link says of its vehicle, but for counts of packets."""
    state = (
        None if link.state is None else [getattr(link.state, f.name) for f in dataclasses.fields(link.state)]
    )
    status = {k: v for k, v in dataclasses.asdict(link.status).items() if k not in (*_COUNTED, *but)}
    return repr(state), repr(status)


def test_random_bytes_raise_nothing_and_change_nothing():
    prefix = st.sampled_from([b"", b"\xfd", b"\xfe", b"\xfd\x10\x00\x00\x00\x01\x01\x20\x00\x00"])

    @settings(deadline=None, max_examples=300)
    @given(st.lists(st.tuples(prefix, st.binary(max_size=600)), max_size=4))
    def check(parts):
        before = said(link)
        for head, data in parts:
            peer.send_bytes(head + data)
        link.poll(time())
        assert said(link) == before
        peer.send_bytes(b"\0" * 300)  # whatever was begun ends
        link.poll(time())
        assert said(link) == before

    with vehicle() as (peer, time, link):
        peer.send_state((1, 2, 3))
        time.run(link, 0.02)
        check()
        assert link.status.bad_packets > 100
        time.sleep(0.01)
        peer.send_state((4, 5, 6))
        before = said(link)
        link.poll(time())
        assert said(link) != before  # and it still listens


def test_of_a_real_log_all_that_pymavlink_reads_is_read_and_the_restart_in_it_is_found():
    folder = os.environ.get("ALULA_DATA")
    if folder is None:
        pytest.skip("ALULA_DATA is not set")
    data = (Path(folder) / "flight-logs" / "dronekit-flight.tlog").read_bytes()
    at, frames = 0, []
    while at < len(data):  # a time stamp, then a frame of MAVLink 1
        length = 8 + data[at + 9]
        frames.append((int.from_bytes(data[at : at + 8], "big") * 1e-6, data[at + 8 : at + 8 + length]))
        at += 8 + length
    wire, reference = Wire(255, 191, m.mavlink_map), m.MAVLink(None)
    estimate = Estimate(LocalFrame())
    read, states, refused = 0, 0, set()
    last = None
    for now, frame in frames:
        packets = [p for p in wire.take(frame, is_datagram=True) if p.message is not None]
        try:
            expected = reference.decode(bytearray(frame))
        except m.MAVError:
            refused.add(frame[5])
            assert packets == []
            continue
        (packet,) = packets
        assert packet.message.get_type() == expected.get_type()
        assert bytes(packet.message.get_msgbuf()) == frame
        read += 1
        if packet.system == 1:
            estimate.take(packet.message, now)
            states += estimate.state is not last
            last = estimate.state
    assert (read, refused) == (75477, {0, 142})  # one heartbeat is damaged; 142 has changed since
    assert estimate.jumps == 1
    assert estimate.dropped == 0
    assert states > 400


def framed(peer, number, payload):
    """A frame with a right checksum, whatever it carries."""
    kind = m.mavlink_map[number]
    head = bytes([len(payload), 0, 0, peer.mav.seq, 1, 1]) + number.to_bytes(3, "little")
    crc = m.x25crc(head + payload + bytes([kind.crc_extra])).crc
    peer.mav.seq = (peer.mav.seq + 1) % 256
    return b"\xfd" + head + payload + crc.to_bytes(2, "little")


@pytest.mark.parametrize("autopilot", [m.MAV_AUTOPILOT_ARDUPILOTMEGA, m.MAV_AUTOPILOT_PX4])
def test_whatever_the_vehicle_itself_says_raises_nothing_and_states_stay_finite(autopilot):
    numbers = sorted({getattr(m, f"MAVLINK_MSG_ID_{name}") for name in WANTED.split()})
    message = st.tuples(st.sampled_from(numbers), st.binary(min_size=1, max_size=255))

    @settings(deadline=None, max_examples=300)
    @given(st.lists(message, min_size=1, max_size=6))
    def check(messages):
        time.now_s += 0.01
        for number, payload in messages:
            peer.send_bytes(framed(peer, number, payload))
        link.poll(time())
        if link.state is not None:
            for each in dataclasses.fields(link.state):
                assert np.isfinite(getattr(link.state, each.name)).all()
            assert np.linalg.norm(link.state.attitude_wxyz) == pytest.approx(1.0)
        assert all(text.isprintable() for text in link.status.texts)
        assert len(link.status.texts) <= 100
        share = link.status.battery_share
        assert share is None or 0 <= share <= 1

    with vehicle(peer=Peer(autopilot=autopilot)) as (peer, time, link):
        link.order(Order.ARM, time())
        check()
        before = link.status.bad_packets
        peer.send_bytes(framed(peer, 0, bytes(9)))
        link.poll(time())
        assert link.status.bad_packets == before  # such frames are right


def test_every_damaged_byte_is_noticed():
    with vehicle() as (peer, time, link):
        peer.send_state((1, 2, 3))
        time.run(link, 0.02)
        before = said(link)
        time.now_s += 0.01
        peer.now_s = time()
        good = peer.pack(m.MAVLink_local_position_ned_message(peer.boot_ms(), 9, 9, 9, 1, 1, 1))
        for place in range(len(good)):
            bad = bytearray(good)
            bad[place] ^= 0x41
            peer.send_bytes(bytes(bad))
            peer.send_bytes(b"\0" * 300)
            link.poll(time())
        for length in range(len(good)):
            peer.send_bytes(good[:length])
            peer.send_bytes(b"\0" * 300)
            link.poll(time())
        assert said(link) == before


def test_a_frame_behind_damaged_ones_is_found():
    wire = Wire(1, 1, [m.MAVLINK_MSG_ID_HEARTBEAT])
    mav = m.MAVLink(None, srcSystem=3, srcComponent=1)
    good = bytes(m.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(mav))
    long_head = b"\xfd\xff\x00\x00\x00\x01\x01\x20\x00\x00"
    for data in (good[:-1] + b"\0" + good, b"noise" + good, long_head + good + bytes(300), good[:9] + good):
        packets = [p for p in wire.take(data) if p.message is not None]
        assert [p.system for p in packets] == [3], data
    for cut in range(1, len(good)):
        assert wire.take(good[:cut]) == []
        (packet,) = wire.take(good[cut:])
        assert packet.message.autopilot == 3


@pytest.mark.parametrize(
    ("system", "component"), [(2, 1), (1, 2), (1, 191), (255, 190), (0, 1)], ids=lambda v: str(v)
)
def test_only_the_vehicles_autopilot_is_believed(system, component):
    with vehicle() as (peer, time, link):
        peer.send_state((1, 2, 3))
        time.run(link, 0.02)
        before = said(link)
        other = m.MAVLink(None, srcSystem=system, srcComponent=component)
        time.now_s += 0.01
        for message in (
            m.MAVLink_local_position_ned_message(peer.boot_ms() + 10, 9, 9, 9, 1, 1, 1),
            m.MAVLink_heartbeat_message(6, 8, 128, 4, 4, 3),
            m.MAVLink_statustext_message(2, b"hello"),
            m.MAVLink_sys_status_message(0, 0, 0, 0, 1000, 0, 5, 0, 0, 0, 0, 0, 0),
        ):
            peer.send_bytes(bytes(message.pack(other)))
        link.poll(time())
        assert said(link) == before


def test_what_is_no_number_is_a_missing_message():
    with vehicle() as (peer, time, link):
        peer.send_state((1, 2, 3))
        time.run(link, 0.02)
        before = said(link, "heard_s")
        bad_before = link.status.bad_packets
        for value in (math.nan, math.inf, -math.inf, 1e30):
            for place in range(6):
                fields = [0.0] * 6
                fields[place] = value
                peer.now_s += 0.001
                peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), *fields))
            for place in range(7):
                fields = [1.0] + [0.0] * 6
                fields[place] = value
                peer.now_s += 0.001
                peer.send(m.MAVLink_attitude_quaternion_message(peer.boot_ms(), *fields))
        peer.send(m.MAVLink_attitude_quaternion_message(peer.boot_ms() + 1, 0, 0, 0, 0, 0, 0, 0))
        link.poll(time())
        assert said(link, "heard_s") == before
        assert link.status.bad_packets - bad_before == 4 * 13 + 1
        peer.send(m.MAVLink_param_value_message(b"GUID_TIMEOUT", math.nan, 9, 1, 0))
        time.run(link, 0.02)
    assert peer.parameters["GUID_TIMEOUT"][0] == 3.0


def test_another_place_does_not_take_a_link_over():
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
    probe.close()
    peer, thief = Peer(), Peer()
    peer.link = thief.link = ("127.0.0.1", port)
    thief.silent = True
    time = Time(peer, thief)
    link = open_link(f"udpin:127.0.0.1:{port}", LinkOptions(clock=time, sleep=time.sleep))
    try:
        link.open(5.0)
        link.prepare()
        link.poll(time())
        before = said(link)
        thief.custom_mode = 9
        thief.beat()
        thief.send_state((9, 9, 9))
        link.poll(time())
        assert said(link) == before
        assert link.status.bad_packets >= 3
        time.run(link, 0.5)
        assert not thief.heard
        peer.silent = True  # it moved: after a while another place may speak
        time.run(link, 4.0)
        thief.beat()
        time.run(link, 1.2)
        assert link.status.mode == "LAND"
        assert thief.of("HEARTBEAT")
    finally:
        thief.silent = False
        link.close()
        peer.close()
        thief.close()


def test_late_twice_and_old_packets_are_no_new_state():
    with vehicle() as (peer, time, link):
        for _ in range(20):
            time.sleep(0.01)
            peer.send_state((1, 2, 3))
            link.poll(time())
        first = peer.pack(m.MAVLink_local_position_ned_message(peer.boot_ms() + 10, 5, 5, 5, 0, 0, 0))
        time.sleep(0.02)
        peer.send_state((6, 6, 6))
        time.run(link, 0.01)
        before = said(link, "heard_s")
        peer.send_bytes(first)  # overtaken
        peer.send_bytes(first)
        link.poll(time())
        assert said(link, "heard_s") == before
        held = [peer.pack(m.MAVLink_local_position_ned_message(peer.boot_ms() + 5, 7, 7, 7, 0, 0, 0))]
        held += [peer.pack(m.MAVLink_attitude_quaternion_message(peer.boot_ms() + 5, 1, 0, 0, 0, 0, 0, 0))]
        time.sleep(0.4)
        for data in held:
            peer.send_bytes(data)
        link.poll(time())
        assert time() - link.state.received_s == pytest.approx(0.395, abs=0.01)  # old when it comes


def test_state_ages_as_soon_as_one_of_its_parts_stops():
    with vehicle() as (peer, time, link):

        def both():
            peer.send_state((1, 2, 3))

        def place():
            peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), 1, 2, 3, 0, 0, 0))

        def attitude():
            peer.send(m.MAVLink_attitude_quaternion_message(peer.boot_ms(), 1, 0, 0, 0, 0, 0, 0))

        for alone in (place, attitude):
            time.run(link, 0.2, each=both)
            assert time() - link.state.received_s < 0.011
            time.run(link, 0.3, each=alone)
            assert time() - link.state.received_s > 0.24


def test_the_older_part_is_carried_to_the_time_of_the_newer():
    with vehicle() as (peer, time, link):
        frame = link._options.frame
        peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), 1, 0, 0, 2.0, 0, 0))
        peer.send(m.MAVLink_attitude_quaternion_message(peer.boot_ms() + 30, 1, 0, 0, 0, 0, 0, 1.0))
        link.poll(time())
        assert frame.position_to_ned(link.state.position) == pytest.approx([1.06, 0, 0], abs=1e-6)
        peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms() + 40, 1, 0, 0, 2.0, 0, 0))
        link.poll(time())
        quat = frame.attitude_to_ned(link.state.attitude_wxyz)
        assert 2 * math.asin(quat[3]) == pytest.approx(0.01, abs=1e-6)
        assert frame.position_to_ned(link.state.position) == pytest.approx([1, 0, 0], abs=1e-6)


def test_odometry_is_one_state_and_taken_before_the_others():
    with vehicle() as (peer, time, link):
        half = math.sqrt(0.5)
        message = m.MAVLink_odometry_message(
            round((peer.now_s + 5) * 1e6),
            m.MAV_FRAME_LOCAL_NED,
            m.MAV_FRAME_BODY_FRD,
            *(1.0, 2.0, -3.0),
            [half, 0, 0, half],  # it looks east
            *(1.0, 0.0, 0.0),
            *(0.1, 0.2, 0.3),
            [0.0] * 21,
            [0.0] * 21,
        )
        peer.send(message)
        time.run(link, 0.02)
        frame = link._options.frame
        assert frame.position_to_ned(link.state.position) == pytest.approx([1, 2, -3], abs=1e-6)
        assert frame.vector_to_ned(link.state.velocity) == pytest.approx([0, 1, 0], abs=1e-6)
        assert link.state.omega == pytest.approx([0.1, -0.2, -0.3], abs=1e-6)
        before = said(link, "heard_s")
        peer.send_state((9, 9, 9))
        link.poll(time())
        assert said(link, "heard_s") == before


def test_euler_angles_do_where_there_is_nothing_better():
    with vehicle() as (peer, time, link):
        peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), 0, 0, 0, 0, 0, 0))
        peer.send(m.MAVLink_attitude_message(peer.boot_ms(), 0.1, 0.2, 0.3, 0, 0, 0))
        time.run(link, 0.02)
        from scipy.spatial.transform import Rotation

        quat = link._options.frame.attitude_to_ned(link.state.attitude_wxyz)
        expected = Rotation.from_euler("ZYX", [0.3, 0.2, 0.1])
        assert (Rotation.from_quat(np.roll(quat, -1)) * expected.inv()).magnitude() < 1e-6


def test_a_vehicle_that_starts_anew_is_noticed_and_its_old_state_dropped():
    with vehicle() as (peer, time, link):
        time.run(link, 0.3, each=lambda: peer.send_state((1, 2, 3)))
        assert link.status.clock_jumps == 0
        peer.boot_s = -time() + 2.0  # two seconds after boot
        peer.heard.clear()
        peer.send_state((0, 0, 0))
        time.run(link, 0.02)
        assert link.status.clock_jumps == 0  # one packet proves nothing
        time.run(link, 0.3, each=lambda: peer.send_state((4, 5, 6)))
        assert link.status.clock_jumps == 1
        assert any("started anew" in text for text in link.status.texts)
        assert time() - link.state.received_s < 0.02
        time.run(link, 4.0)
        assert peer.commands(m.MAV_CMD_SET_MESSAGE_INTERVAL)  # which it has forgotten


def test_a_clock_drifts_but_does_not_jump():
    clock = VehicleClock()
    for k in range(20000):
        now = 100.0 + k * 0.01
        arrival = clock.arrival(k * 0.01 * (1 + 5e-5) + 7.0, now)
        assert arrival is not None
        assert 0 <= now - arrival < 0.02
    assert clock.jumps == 0


def test_a_clock_that_stood_still_is_told_from_packets_that_are_late():
    with vehicle() as (peer, time, link):

        def state():
            peer.send_state((1, 2, 3))

        def age():
            return time() - link.state.received_s

        time.run(link, 1.0, each=state)
        assert age() < 0.012
        assert link.round_trip_s == pytest.approx(0.01, abs=0.011)
        peer.boot_s -= 0.3  # it stood still
        time.run(link, 0.1, each=state)
        assert age() > 0.0
        time.run(link, 1.0, each=state)
        assert age() < 0.03
        waiting = []

        def late():  # packets of both ways wait for 0.3 s
            waiting.append(peer.boot_ms())
            if len(waiting) > 30:
                stamp = waiting[-31]
                peer.send(m.MAVLink_local_position_ned_message(stamp, 1, 2, 3, 0, 0, 0))
                peer.send(m.MAVLink_attitude_quaternion_message(stamp, 1, 0, 0, 0, 0, 0, 0))

        time.run(link, 5.0, each=late)
        assert age() > 0.27
        assert link.status.clock_jumps == 0


def test_patience_ends_where_nobody_can_be_asked():
    clock = VehicleClock(patience_s=2.0)
    for k in range(1000):
        now = 10 + k * 0.01
        stamp = k * 0.01 - (0.2 if k > 200 else 0.0)
        arrival = clock.arrival(stamp, now)
        if k > 402:
            assert now - arrival < 0.01
        elif 221 < k < 400:
            assert now - arrival == pytest.approx(0.2, abs=0.01)


def test_silence_is_seen_and_what_was_said_long_ago_is_unknown():
    with vehicle() as (peer, time, link):
        peer.send(m.MAVLink_sys_status_message(0, 0, 0, 0, 15200, 0, 80, 0, 0, 0, 0, 0, 0))
        peer.send(m.MAVLink_ekf_status_report_message(1 | 2 | 4 | 8 | 16 | 32, 0, 0, 0, 0, 0))
        time.run(link, 1.5)
        status = link.status
        assert (status.battery_v, status.battery_share) == (pytest.approx(15.2), pytest.approx(0.8))
        assert status.is_estimator_ready is True
        assert status.landed is True
        peer.send(m.MAVLink_ekf_status_report_message(1 | 2 | 4 | 8 | 16 | 32 | 128, 0, 0, 0, 0, 0))
        time.run(link, 0.02)
        assert status.is_estimator_ready is False
        heard = status.heard_s
        peer.silent = True
        time.run(link, 11.0, step_s=0.05)
        assert status.heard_s == pytest.approx(heard, abs=1.1)
        assert (status.landed, status.armed, status.battery_share) == (None, None, None)
        assert status.is_estimator_ready is None
        assert not status.obeys


def test_lost_packets_are_counted_by_their_numbers():
    with vehicle() as (peer, time, link):
        before = link.status.lost_packets
        for _ in range(10):
            peer.pack(m.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))
        peer.send_state()
        time.run(link, 0.02)
        assert link.status.lost_packets - before == 10


def test_long_texts_are_joined_and_cannot_command_a_terminal():
    with vehicle() as (peer, time, link):
        link.status.texts.clear()
        text = b"PreArm: " + b"x" * 60 + b" end\x1b[2Jof text"
        pieces = [text[i : i + 50] for i in range(0, len(text), 50)]
        for order in (0, 1):
            peer.send(m.MAVLink_statustext_message(3, pieces[order], 7, order))
        time.run(link, 0.02)
        assert link.status.texts == ["PreArm: " + "x" * 60 + " end[2Jof text"]
        link.status.texts.clear()
        peer.send(m.MAVLink_statustext_message(3, b"y" * 50, 8, 1))
        time.run(link, 1.5)
        assert link.status.texts == ["..." + "y" * 50]


def sign(peer, key, stamp, message, link=0):
    mav = m.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.signing.secret_key, mav.signing.sign_outgoing = key, True
    mav.signing.link_id, mav.signing.timestamp = link, stamp
    return bytes(message.pack(mav))


def test_with_a_key_only_what_is_signed_with_it_and_new_gets_through(tmp_path):
    wall = 1.8e9
    now = round((wall - 1_420_070_400) * 1e5)
    signer = Signer(KEY, file=tmp_path / "stamp", clock=lambda: 5.0, wall_clock=lambda: wall)
    wire = Wire(255, 191, [m.MAVLINK_MSG_ID_HEARTBEAT], signer)
    beat = m.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)

    def passes(data):
        return [p for p in wire.take(data) if p.message is not None] != []

    assert not passes(bytes(beat.pack(m.MAVLink(None, srcSystem=1, srcComponent=1))))
    assert not passes(sign(None, bytes(32), now, beat))
    assert not passes(sign(None, bytes(32), now + 10**9, beat))  # and its stamp is not believed either
    good = sign(None, KEY, now + 10, beat)
    assert passes(good)
    assert not passes(good)
    assert not passes(sign(None, KEY, now + 9, beat))
    assert passes(sign(None, KEY, now + 11, beat))
    assert not passes(sign(None, KEY, now - 61 * 10**5, beat, link=1))
    assert passes(sign(None, KEY, now - 59 * 10**5, beat, link=2))
    unknown = bytearray(b"\xfd\x01\x00\x00\x00\x01\x01\xf0\xff\xff\x01\x00\x00")
    assert wire.take(bytes(unknown)) == []  # nor what nobody knows


def test_our_packets_are_signed_as_pymavlink_expects_it(tmp_path):
    signer = Signer(KEY, file=tmp_path / "stamp", clock=lambda: 5.0, wall_clock=lambda: 1.8e9, link=3)
    wire = Wire(255, 191, [], signer)
    reader = m.MAVLink(None)
    reader.signing.secret_key = KEY
    for _ in range(3):
        message = reader.decode(bytearray(wire.pack(m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))))
        assert message.get_signed()
        assert message.get_link_id() == 3


def test_stamps_grow_from_run_to_run_even_when_the_clock_is_set_back(tmp_path):
    file = tmp_path / "stamp"
    last = 0
    for wall in (1.8e9, 1.8e9 - 1000, 1.5e9, 1.8e9 + 5):
        signer = Signer(KEY, file=file, clock=lambda: 0.0, wall_clock=lambda wall=wall: wall)
        first = signer.next_stamp()
        assert first > last
        last = max(signer.next_stamp() for _ in range(100))
        if wall != 1.5e9:  # that run was killed: the file is ahead of what it used
            signer.save()
    file.write_text("soon\n")
    with pytest.raises(LinkError, match="holds no time stamp"):
        Signer(KEY, file=file, clock=lambda: 0.0, wall_clock=lambda: 1.8e9)


def test_a_key_has_32_bytes_and_needs_a_file_for_its_stamps(tmp_path):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    assert read_key(path) == KEY
    path.write_text(KEY.hex() + "\n")
    assert read_key(path) == KEY
    path.write_text("g" * 64)
    with pytest.raises(InputError, match="hexadecimal"):
        read_key(path)
    path.write_bytes(KEY[:-1])
    with pytest.raises(InputError, match="32 bytes"):
        read_key(path)
    with pytest.raises(InputError, match="No such file"):
        read_key(tmp_path / "none")
    with pytest.raises(LinkError, match="needs a file"):
        open_link("udpout:127.0.0.1:14550", LinkOptions(key=KEY))


def test_a_signed_conversation_from_end_to_end(tmp_path):
    peer = Peer()
    peer.mav.signing.secret_key, peer.mav.signing.sign_outgoing = KEY, True
    peer.mav.signing.timestamp = round((1.8e9 - 1_420_070_400) * 1e5)
    peer.reader.signing.secret_key = KEY
    options = {"key": KEY, "signing_file": tmp_path / "stamp", "wall_clock": lambda: 1.8e9}
    with vehicle(peer=peer, **options) as (peer, time, link):
        peer.send_state((1, 2, 3))
        time.run(link, 0.05)
        assert link.state is not None
        peer.mav.signing.sign_outgoing = False
        before = said(link)
        peer.send_state((9, 9, 9))
        link.poll(time())
        assert said(link) == before
        peer.mav.signing.sign_outgoing = True
    assert int((tmp_path / "stamp").read_text()) > 0


def test_a_serial_line_carries_the_same(tmp_path):
    ours, theirs = pty.openpty()
    name = os.ttyname(theirs)
    os.set_blocking(ours, False)
    peer = Peer()
    reader = m.MAVLink(None)
    reader.robust_parsing = True

    def send(data):
        os.write(ours, data)

    def tick(now):
        peer.now_s = now
        try:
            data = os.read(ours, 4096)
        except BlockingIOError:
            data = b""
        for message in reader.parse_buffer(data) or []:
            peer.heard.append(message)
            peer.answer(message)
        if now - peer._beat_s >= 1.0:
            peer._beat_s = now
            peer.beat()

    peer.send_bytes, peer.tick = send, tick
    time = Time(peer)
    link = open_link(f"serial:{name}:921600", LinkOptions(clock=time, sleep=time.sleep))
    try:
        assert link.open(5.0).startswith("ArduPilot 4.7.0")
        link.prepare()
        peer.send_state((1, 2, 3))
        time.run(link, 0.05)
        assert link.state is not None
    finally:
        link.close()
        os.close(ours)
        os.close(theirs)
        peer.close()


def test_tcp_carries_the_same_and_its_end_is_one_line():
    server = socket.create_server(("127.0.0.1", 0))
    peer = Peer()
    lines = []
    accepted = threading.Thread(target=lambda: lines.append(server.accept()[0]))
    accepted.start()
    reader = m.MAVLink(None)

    def send(data):
        lines[0].sendall(data)

    def tick(now):
        accepted.join()
        lines[0].settimeout(0.002)
        peer.now_s = now
        try:
            data = lines[0].recv(65536)
        except TimeoutError:
            data = b""
        for message in reader.parse_buffer(data) or []:
            peer.answer(message)
        if now - peer._beat_s >= 1.0:
            peer._beat_s = now
            peer.beat()

    peer.send_bytes, peer.tick = send, tick
    time = Time(peer)
    port = server.getsockname()[1]
    link = open_link(f"tcp:127.0.0.1:{port}", LinkOptions(clock=time, sleep=time.sleep))
    try:
        link.open(5.0)
        lines[0].close()
        with pytest.raises(LinkError, match="line"):
            time.peers.clear() or [time.run(link, 0.1) for _ in range(10)]
    finally:
        link.close()
        server.close()
        peer.close()


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp:127.0.0.1:1", "refused"),
        ("udpin:no.such.host.invalid:14550", "udpin:no.such.host.invalid:14550: "),
        ("udpin:203.0.113.7:14550", "[Cc]annot assign"),
        ("serial:/dev/does-not-exist:921600", "No such file"),
        ("serial:/dev/null:921600", "serial line"),
        ("serial:/dev/null:12345", "no rate"),
    ],
)
def test_a_line_that_cannot_be_opened_is_one_line(address, words):
    with pytest.raises(LinkError, match=words) as caught:
        open_link(address, LinkOptions(allow_remote=True)).open(0.2)
    assert "\n" not in str(caught.value)
