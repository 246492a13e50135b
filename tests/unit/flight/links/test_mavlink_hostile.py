"""Input to a MAVLink link that must change nothing: damaged, foreign, absurd packets."""

from __future__ import annotations

import dataclasses
import math
import os
import socket
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.stages.flight.links.mavlink.assembler import StateAssembler
from alula.stages.flight.links.mavlink.session import WANTED
from alula.stages.flight.links.mavlink.wire import Wire
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.vehicles.frames import LocalFrame
from support.effort import examples
from support.vehicles.mavlink_peer import Peer, Time, m, said, vehicle


def test_random_bytes_raise_nothing_and_change_nothing():
    prefix = st.sampled_from([b"", b"\xfd", b"\xfe", b"\xfd\x10\x00\x00\x00\x01\x01\x20\x00\x00"])

    @settings(deadline=None, max_examples=examples(300))
    @given(st.lists(st.tuples(prefix, st.binary(max_size=600)), max_size=4))
    def check(parts):
        before = said(link)
        for head, data in parts:
            peer.send_bytes(head + data)
        link.poll(time())
        assert said(link) == before
        peer.send_bytes(b"\0" * 300)  # completes any frame that was begun
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
        assert said(link) != before  # and it still receives


@pytest.mark.slow
def test_of_a_real_log_all_that_pymavlink_reads_is_read_and_the_restart_in_it_is_found():
    folder = os.environ.get("ALULA_DATA")
    if not folder:
        pytest.skip("ALULA_DATA is not set")
    data = (Path(folder) / "flight-logs" / "dronekit-flight.tlog").read_bytes()
    at, frames = 0, []
    while at < len(data):  # a time stamp, then a frame of MAVLink 1
        length = 8 + data[at + 9]
        frames.append((int.from_bytes(data[at : at + 8], "big") * 1e-6, data[at + 8 : at + 8 + length]))
        at += 8 + length
    wire, reference = Wire(255, 191, m.mavlink_map), m.MAVLink(None)
    estimate = StateAssembler(LocalFrame())
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
    """A frame with a valid checksum and any content."""
    kind = m.mavlink_map[number]
    head = bytes([len(payload), 0, 0, peer.mav.seq, 1, 1]) + number.to_bytes(3, "little")
    crc = m.x25crc(head + payload + bytes([kind.crc_extra])).crc
    peer.mav.seq = (peer.mav.seq + 1) % 256
    return b"\xfd" + head + payload + crc.to_bytes(2, "little")


@pytest.mark.parametrize("autopilot", [m.MAV_AUTOPILOT_ARDUPILOTMEGA, m.MAV_AUTOPILOT_PX4])
def test_whatever_the_vehicle_itself_says_raises_nothing_and_states_stay_finite(autopilot):
    numbers = sorted({getattr(m, f"MAVLINK_MSG_ID_{name}") for name in WANTED.split()})
    message = st.tuples(st.sampled_from(numbers), st.binary(min_size=1, max_size=255))

    @settings(deadline=None, max_examples=examples(300))
    @given(st.lists(message, min_size=1, max_size=6))
    def check(messages):
        time.now_s += 0.01
        for number, payload in messages:
            peer.send_bytes(framed(peer, number, payload))
        link.poll(time())
        if link.state is not None:
            for each in dataclasses.fields(link.state):
                values = getattr(link.state, each.name)  # the latency is NaN until it is measured
                assert np.isfinite(values).all() or (each.name == "latency_s" and np.isnan(values))
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
        assert link.status.bad_packets == before  # such frames are valid


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
        peer.silent = True  # it moved: after a while another address is accepted
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
