"""A scripted vehicle on loopback for tests of the MAVLink link, on a clock that only tests move."""

from __future__ import annotations

import dataclasses
import socket
import struct
from contextlib import contextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as m

from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.vehicles.frames import LocalFrame

FRAME = LocalFrame(yaw_rad=0.7, origin_enu_m=(1.0, -2.0, 0.5))

ARDUPILOT = {
    "GUID_OPTIONS": (1.0, m.MAV_PARAM_TYPE_INT32),
    "ATC_ANGLE_BOOST": (1.0, m.MAV_PARAM_TYPE_INT8),
    "GUID_TIMEOUT": (3.0, m.MAV_PARAM_TYPE_REAL32),
    "FS_GCS_ENABLE": (0.0, m.MAV_PARAM_TYPE_INT8),
    "MOT_THST_HOVER": (0.35, m.MAV_PARAM_TYPE_REAL32),
    "SYSID_MYGCS": (255.0, m.MAV_PARAM_TYPE_INT16),
}
PX4 = {
    "COM_OF_LOSS_T": (1.0, m.MAV_PARAM_TYPE_REAL32),
    "COM_OBL_RC_ACT": (0.0, m.MAV_PARAM_TYPE_INT32),
    "COM_RCL_EXCEPT": (0.0, m.MAV_PARAM_TYPE_INT32),
    "COM_RC_OVERRIDE": (1.0, m.MAV_PARAM_TYPE_INT32),
    "MPC_THR_HOVER": (0.5, m.MAV_PARAM_TYPE_REAL32),
}
ARDUPILOT_CAPABILITIES = 64 | 128 | 8192


class Peer:
    """Answers as an autopilot would; every answer can be switched off or changed by a test."""

    def __init__(self, *, autopilot: int = m.MAV_AUTOPILOT_ARDUPILOTMEGA, system: int = 1, port: int = 0):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.link: Any = None
        self.mav = m.MAVLink(None, srcSystem=system, srcComponent=1)
        self.reader = m.MAVLink(None)
        self.reader.robust_parsing = True
        self.autopilot = autopilot
        self.is_px4 = autopilot == m.MAV_AUTOPILOT_PX4
        self.kind = m.MAV_TYPE_QUADROTOR
        self.parameters = dict(PX4 if self.is_px4 else ARDUPILOT)
        self.deaf_to: set[str] = set()  # parameters that it does not take
        self.silent = False
        self.results: dict[int, int] = {}
        self.capabilities = ARDUPILOT_CAPABILITIES
        self.custom_mode = 0
        self.armed = False
        self.landed = m.MAV_LANDED_STATE_ON_GROUND
        self.takes_modes = True
        self.heard: list[Any] = []
        self.now_s = 0.0
        self.boot_s = 100.0
        self._beat_s = -1.0
        self.own_messages = True
        self.answers_time = True
        self.up_s = self.down_s = 0.0  # delays of the line to the vehicle and from it
        self._ways: tuple[list[tuple[float, Any]], list[tuple[float, Any]]] = ([], [])

    def close(self) -> None:
        self.socket.close()

    def commands(self, number: int) -> list[Any]:
        return [e for e in self.heard if e.get_type() == "COMMAND_LONG" and e.command == number]

    def of(self, kind: str) -> list[Any]:
        return [e for e in self.heard if e.get_type() == kind]

    def boot_ms(self) -> int:
        return round((self.now_s + self.boot_s) * 1e3)

    def pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return data

    def send(self, message: Any) -> None:
        self.send_bytes(self.pack(message))

    def send_bytes(self, data: bytes) -> None:
        if self.down_s > 0:
            self._ways[1].append((self.now_s + self.down_s, data))
        elif self.link is not None:
            self.socket.sendto(data, self.link)

    def send_state(self, position=(0, 0, 0), velocity=(0, 0, 0), quat=(1, 0, 0, 0), rates=(0, 0, 0)) -> None:
        self.send(m.MAVLink_local_position_ned_message(self.boot_ms(), *position, *velocity))
        self.send(m.MAVLink_attitude_quaternion_message(self.boot_ms(), *quat, *rates))

    def tick(self, now_s: float) -> None:
        self.now_s = now_s
        while True:
            try:
                data, peer = self.socket.recvfrom(4096)
            except BlockingIOError:
                break
            self.link = self.link or peer
            for message in self.reader.parse_buffer(data) or []:
                assert message.get_type() != "BAD_DATA", message
                self._ways[0].append((now_s + self.up_s, message))
        for message in self._due(self._ways[0]):
            self.heard.append(message)
            if not self.silent:
                self.answer(message)
        for data in self._due(self._ways[1]):
            if self.link is not None:
                self.socket.sendto(data, self.link)
        if not self.silent and self.own_messages and now_s - self._beat_s >= 1.0:
            self._beat_s = now_s
            self.beat()

    def _due(self, way: list[tuple[float, Any]]) -> list[Any]:
        due = [what for at_s, what in way if at_s <= self.now_s]
        way[:] = [each for each in way if each[0] > self.now_s]
        return due

    def beat(self) -> None:
        base = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (m.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        state = m.MAV_STATE_ACTIVE if self.armed else m.MAV_STATE_STANDBY
        self.send(m.MAVLink_heartbeat_message(self.kind, self.autopilot, base, self.custom_mode, state, 3))
        self.send(m.MAVLink_extended_sys_state_message(0, self.landed))

    def answer(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "PARAM_REQUEST_READ":
            self.say_parameter(message.param_id)
        elif kind == "PARAM_SET" and message.param_id in self.parameters:
            name, value = message.param_id, message.param_value
            type_ = self.parameters[name][1]
            if self.is_px4 and type_ == m.MAV_PARAM_TYPE_INT32:
                (value,) = struct.unpack("<i", struct.pack("<f", value))
            if name not in self.deaf_to:
                self.parameters[name] = (float(value), type_)
            self.say_parameter(name)
        elif kind == "COMMAND_LONG":
            self.command(message)
        elif kind == "TIMESYNC" and message.tc1 == 0 and self.answers_time:
            self.send(m.MAVLink_timesync_message(round((self.now_s + self.boot_s) * 1e9), message.ts1))

    def say_parameter(self, name: str) -> None:
        if name not in self.parameters:
            return
        value, type_ = self.parameters[name]
        if self.is_px4 and type_ == m.MAV_PARAM_TYPE_INT32:
            (value,) = struct.unpack("<f", struct.pack("<i", int(value)))
        self.send(m.MAVLink_param_value_message(name.encode(), value, type_, len(self.parameters), 0))

    def command(self, message: Any) -> None:
        result = self.results.get(message.command, m.MAV_RESULT_ACCEPTED)
        if result == m.MAV_RESULT_ACCEPTED:
            if message.command == m.MAV_CMD_REQUEST_MESSAGE:
                self.send(
                    m.MAVLink_autopilot_version_message(
                        self.capabilities, 4 << 24 | 7 << 16, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
                    )
                )
            elif message.command == m.MAV_CMD_DO_SET_MODE and self.takes_modes:
                main, sub = int(message.param2), int(message.param3)
                self.custom_mode = main << 16 | sub << 24 if self.is_px4 else main
                self.beat()
            elif message.command == m.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = message.param1 == 1
                self.beat()
        self.send(m.MAVLink_command_ack_message(message.command, result))


class Time:
    """A clock that moves when somebody sleeps; peers live meanwhile."""

    def __init__(self, *peers: Peer, start_s: float = 1000.0):
        self.now_s = start_s
        self.peers = list(peers)

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        for peer in self.peers:
            peer.tick(self.now_s)

    def run(self, link: Any, seconds: float, step_s: float = 0.01, each: Any = None) -> None:
        """Poll a link for a while; `each` is called before each poll."""
        for _ in range(round(seconds / step_s)):
            self.sleep(step_s)
            if each is not None:
                each()
            link.poll(self.now_s)


@contextmanager
def vehicle(*, ready=True, address="", peer=None, frame=FRAME, **options):
    """A peer, its clock and an open, and if ready prepared, link."""
    peer = peer or Peer()
    time = Time(peer)
    given_options = LinkOptions(frame=frame, clock=time, sleep=time.sleep, **options)
    link = open_link(f"udpout:127.0.0.1:{peer.port}{address}", given_options)
    try:
        link.open(5.0)
        if ready:
            link.prepare()
        yield peer, time, link
    finally:
        link.close()
        peer.close()


_COUNTED = ("bad_packets", "lost_packets")


def said(link, *but):
    """All that a link says of its vehicle, but for counts of packets."""
    state = (
        None if link.state is None else [getattr(link.state, f.name) for f in dataclasses.fields(link.state)]
    )
    status = {k: v for k, v in dataclasses.asdict(link.status).items() if k not in (*_COUNTED, *but)}
    return repr(state), repr(status)
