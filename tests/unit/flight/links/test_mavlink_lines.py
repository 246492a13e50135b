"""Signed packets, serial lines and TCP."""

from __future__ import annotations

import os
import pty
import socket
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from alula.schemas.artifacts.signing_key import read_key
from alula.schemas.errors import InputError, LinkError
from alula.stages.flight.links.addresses import parse_address
from alula.stages.flight.links.mavlink.session import Session
from alula.stages.flight.links.mavlink.signing import Signer
from alula.stages.flight.links.mavlink.wire import Wire
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from support.vehicles.mavlink_peer import ARDUPILOT, Peer, Time, m, said, vehicle
from support.vehicles.sim_vehicle_process import free_port

KEY = bytes(range(32))


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
    assert not passes(sign(None, bytes(32), now + 10**9, beat))  # and its time stamp is not used either
    good = sign(None, KEY, now + 10, beat)
    assert passes(good)
    assert not passes(good)
    assert not passes(sign(None, KEY, now + 9, beat))
    assert passes(sign(None, KEY, now + 11, beat))
    assert not passes(sign(None, KEY, now - 61 * 10**5, beat, link=1))
    assert passes(sign(None, KEY, now - 59 * 10**5, beat, link=2))
    unknown = bytearray(b"\xfd\x01\x00\x00\x00\x01\x01\xf0\xff\xff\x01\x00\x00")
    assert wire.take(bytes(unknown)) == []  # nor an unknown message


def test_packets_of_an_earlier_run_are_refused_and_the_vehicles_next_ones_are_not(tmp_path):
    file, beat = tmp_path / "stamp", m.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)
    now = round((1.8e9 - 1_420_070_400) * 1e5)

    def wire_at(wall):
        signer = Signer(KEY, file=file, clock=lambda: 5.0, wall_clock=lambda: wall)
        return signer, Wire(255, 191, [m.MAVLINK_MSG_ID_HEARTBEAT], signer)

    signer, wire = wire_at(1.8e9)
    recorded = [sign(None, KEY, now + k, beat) for k in range(5)]
    for data in recorded:
        assert wire.take(data, is_datagram=True)
    signer.keep_up()  # then the run is killed
    _, wire = wire_at(1.8e9 + 10)
    assert not any(wire.take(data, is_datagram=True) for data in recorded)
    assert not wire.take(sign(None, KEY, now + 4, beat), is_datagram=True)
    assert wire.take(sign(None, KEY, now + 5, beat), is_datagram=True)
    file.write_text("12\n1 1 0\n")
    with pytest.raises(LinkError, match="holds no time stamp"):
        wire_at(1.8e9)


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
        if wall != 1.5e9:  # that run was killed: the file is ahead of the stamps it used
            signer.save()
    file.write_text("soon\n")
    with pytest.raises(LinkError, match="holds no time stamp"):
        Signer(KEY, file=file, clock=lambda: 0.0, wall_clock=lambda: 1.8e9)


def test_runs_that_are_killed_do_not_lead_away_from_the_vehicles_time(tmp_path):
    file, wall, last = tmp_path / "stamp", 1.8e9, 0
    beat = m.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)
    for _ in range(10):  # each is killed after a second
        wall += 1
        signer = Signer(KEY, file=file, clock=lambda: 0.0, wall_clock=lambda at=wall: at)
        first = signer.next_stamp()
        assert first > last
        last = [signer.next_stamp() for _ in range(200)][-1]
        wire = Wire(255, 191, [m.MAVLINK_MSG_ID_HEARTBEAT], signer)
        assert wire.take(sign(None, KEY, round((wall - 1_420_070_400) * 1e5), beat))
    old = sign(None, KEY, round((wall - 1_420_070_400 - 130) * 1e5), beat)
    signer = Signer(
        KEY, file=file, clock=lambda: 0.0, wall_clock=lambda: 1.5e9
    )  # nor is a wrong one accepted
    assert not Wire(255, 191, [m.MAVLINK_MSG_ID_HEARTBEAT], signer).take(old)


def test_a_key_has_32_bytes_and_needs_a_file_for_its_stamps(tmp_path):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    assert read_key(path) == KEY
    for digits in (KEY.hex(), KEY.hex().upper(), KEY.hex(" ")):
        path.write_text(digits + "\n")
        assert read_key(path) == KEY
    path.write_text("g" * 64)
    with pytest.raises(InputError, match="hexadecimal"):
        read_key(path)
    path.write_bytes(b"\xff" * 64)
    with pytest.raises(InputError, match="a signing key is 32 bytes, or 64 hexadecimal digits"):
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
    assert int((tmp_path / "stamp").read_text().split()[0]) > 0


def test_a_vehicle_without_a_clock_is_told_the_time_before_it_is_believed(tmp_path):
    """The time stamps of PX4 begin at the one that was stored with its key, which may be years old."""
    port, taken = free_port(), []
    options = LinkOptions(key=KEY, signing_file=tmp_path / "stamp", wall_clock=lambda: 1.8e9)
    session = Session(parse_address(f"udpin:127.0.0.1:{port}"), options, lambda *each: taken.append(each))
    session.open(1.0)
    mav = m.MAVLink(None, 1, 1)
    mav.signing.secret_key, mav.signing.sign_outgoing = KEY, True
    beat = m.MAVLink_heartbeat_message(2, m.MAV_AUTOPILOT_PX4, 81, 0, 3, 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.settimeout(1.0)
        line.sendto(bytes(beat.pack(mav)), ("127.0.0.1", port))
        session.poll(0.0)
        assert not taken
        assert mav.parse_buffer(line.recv(4096))[0].get_type() == "HEARTBEAT"
        line.sendto(bytes(beat.pack(mav)), ("127.0.0.1", port))
        session.poll(0.1)
    assert session.vehicle == 1
    assert len(taken) == 1
    session.close()


@pytest.mark.parametrize(
    ("key", "said"),
    [
        (None, "it signs its packets"),
        (bytes(32), "bad packets were received; do both ends have the same signing key"),
    ],
)
def test_who_has_no_key_or_another_is_told_so(tmp_path, key, said):
    peer = Peer()
    peer.mav.signing.secret_key, peer.mav.signing.sign_outgoing = KEY, True
    peer.mav.signing.timestamp = round((1.8e9 - 1_420_070_400) * 1e5)
    peer.answer = lambda message: None  # as it does to packets that are not signed with its key
    options = {"key": key, "signing_file": None if key is None else tmp_path / "stamp"}
    with pytest.raises(LinkError, match=said), vehicle(peer=peer, wall_clock=lambda: 1.8e9, **options):
        pass


def test_of_other_systems_than_the_one_that_was_asked_for_it_says_which():
    words = "no vehicle heartbeat within 5 s: only system 1, not 2"
    with pytest.raises(LinkError, match=words), vehicle(address="?system=2"):
        pass


def test_where_nothing_comes_from_is_named():
    peer = Peer()
    peer.beat = lambda: None
    words = rf"udpout:127.0.0.1:{peer.port}: no vehicle heartbeat .*: nothing"
    with pytest.raises(LinkError, match=words), vehicle(peer=peer):
        pass


class SerialPeer(Peer):
    """Peer at the far end of a serial line that can be unplugged; `device` is its name."""

    def __init__(self, device):
        super().__init__()
        self.device, self.ours, self.theirs = device, None, None
        self.bytes = m.MAVLink(None)
        self.bytes.robust_parsing = True
        self.put_in()

    def put_in(self):
        self.ours, self.theirs = pty.openpty()
        os.set_blocking(self.ours, False)
        self.device.unlink(missing_ok=True)
        self.device.symlink_to(os.ttyname(self.theirs))

    def pull_out(self):
        os.close(self.ours)
        os.close(self.theirs)
        self.ours = None
        self.device.unlink()

    def send_bytes(self, data):
        os.write(self.ours, data)

    def tick(self, now):
        self.now_s = now
        if self.ours is None:
            return
        try:
            data = os.read(self.ours, 4096)
        except OSError:
            data = b""
        for message in self.bytes.parse_buffer(data) or []:
            self.heard.append(message)
            self.answer(message)
        if now - self._beat_s >= 1.0:
            self._beat_s = now
            self.beat()

    def close(self):
        super().close()
        self.pull_out()


def test_a_serial_line_carries_the_same_and_comes_back(tmp_path):
    peer = SerialPeer(tmp_path / "tty")
    time = Time(peer)
    link = open_link(f"serial:{peer.device}:921600", LinkOptions(clock=time, sleep=time.sleep))
    try:
        assert link.open(5.0).startswith("ArduPilot 4.7.0")
        link.prepare()
        peer.send_state((1, 2, 3))
        time.run(link, 0.05)
        assert link.state is not None
        files = len(list(Path("/proc/self/fd").iterdir()))
        for _ in range(3):
            peer.pull_out()
            heard_s, errors = link.status.heard_s, 0
            for _ in range(200):
                time.sleep(0.01)
                with suppress(LinkError):
                    link.poll(time())
                    errors -= 1
                errors += 1
            assert errors >= 199
            assert link.status.heard_s == heard_s
            peer.put_in()
            time.sleep(0.6)
            time.run(link, 1.5)
            assert link.status.heard_s > heard_s + 2
            link.order(Order.LAND, time())
            time.run(link, 0.3)
            assert link.status.mode == "LAND"
            peer.custom_mode = 0
            link.order(Order.NOTHING, time())
            time.run(link, 1.1)
        assert len(list(Path("/proc/self/fd").iterdir())) == files
    finally:
        link.close()
        peer.close()
    assert peer.parameters == ARDUPILOT


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
        with pytest.raises(LinkError, match="connection"):
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
        ("serial:/dev/null:12345", "does not support 12345 baud"),
    ],
)
def test_a_line_that_cannot_be_opened_is_one_line(address, words):
    with pytest.raises(LinkError, match=words) as caught:
        open_link(address, LinkOptions(allow_remote=True)).open(0.2)
    assert "\n" not in str(caught.value)
