"""A MAVLink conversation with one vehicle: packets to and from it, heartbeats, and questions with answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.errors import LinkError
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.mavlink.signing import Signer
from alula.stages.flight.links.mavlink.transport import Transport, open_transport
from alula.stages.flight.links.mavlink.wire import Packet, Wire
from alula.stages.flight.links.options import LinkOptions

GROUND_STATION = 255  # the system whose heartbeats autopilots watch, unless told otherwise
COMPONENT = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT = dialect.MAV_COMP_ID_AUTOPILOT1

_MOST_READS = 64  # of one poll
_MOST_BYTES = 1 << 15
_HEARTBEAT_S = 1.0
_WAIT_S = 0.005
_DESERTED_S = 3.0  # without its packets another place may speak for the vehicle

WANTED = (
    "HEARTBEAT SYS_STATUS PARAM_VALUE ATTITUDE ATTITUDE_QUATERNION LOCAL_POSITION_NED COMMAND_ACK "
    "GPS_GLOBAL_ORIGIN AUTOPILOT_VERSION ODOMETRY EKF_STATUS_REPORT ESTIMATOR_STATUS EXTENDED_SYS_STATE "
    "STATUSTEXT TIMESYNC"
)


class Session:
    """Everything between bytes and meaning.

    Of an open socket anybody may write to, only packets with the system of the vehicle and the component of
    its autopilot get through, and with a key only signed ones. The first valid heartbeat of an autopilot says
    which system that is, and where to answer; another place is believed only after 3 s of silence.

    Args:
        take: called with each message of the vehicle.

    Attributes:
        vehicle: system of the vehicle; None until its first heartbeat.
        others: systems of other autopilots that were heard.
        heard_s: when a packet of the vehicle came last.
        source: our own system.
        start_s: when it began; times in messages count from there.
        lost, bad: packets that the numbers of others show missing, and that were refused.
        unsent: packets that the line had no room for.
    """

    def __init__(self, address: Address, options: LinkOptions, take: Callable[[Any, float], None]) -> None:
        address.only("system", "source")
        self.options = options
        self._address, self._take = address, take
        self.vehicle: int | None = _number(address, "system")
        source = _number(address, "source")
        self._is_given = self.vehicle is not None
        self.others: set[int] = set()
        self._unasked: set[int] = set()  # beside the one that was
        self.heard_s: float | None = None
        self.lost = self.unsent = 0
        self._strangers = 0
        self._transport: Transport | None = None
        self._peer: Any = None
        self._sequence: int | None = None
        self._beat_s = -math.inf
        self.start_s = options.clock()
        self.signer: Signer | None = None
        if options.key is not None:
            if options.signing_file is None:
                raise LinkError("signing needs a file that keeps its time stamps from run to run")
            self.signer = Signer(
                options.key, file=options.signing_file, clock=options.clock, wall_clock=options.wall_clock
            )
        wanted = [getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in WANTED.split()]
        self.source = GROUND_STATION if source is None else source
        self._wire = Wire(self.source, COMPONENT, wanted, self.signer)

    @property
    def bad(self) -> int:
        """Frames that were refused."""
        return self._wire.bad + self._strangers

    @property
    def name(self) -> str:
        """The address, as it was given."""
        return f"{self._address.scheme}:{self._address.place}"

    @property
    def is_signed(self) -> bool:
        """Whether packets of the vehicle were signed although we have no key."""
        return self.signer is None and self._wire.is_signed

    def refused(self) -> str:
        """How many frames were refused, and what may be the matter: the end of a sentence."""
        if self._unasked:
            return f": only system {', '.join(map(str, sorted(self._unasked)))}, not {self.vehicle}"
        if not self.bad:
            return ": nothing came"
        guess = "do both ends have the same signing key?" if self.signer else "is it MAVLink, at this speed?"
        return f": {self.bad} bad packets came; {guess}"

    @property
    def target(self) -> tuple[int, int]:
        """System and component of the autopilot."""
        assert self.vehicle is not None
        return self.vehicle, AUTOPILOT_COMPONENT

    def time_ms(self, now_s: float) -> int:
        """Since this session began, as messages carry it."""
        return round((now_s - self.start_s) * 1e3) & 0xFFFFFFFF

    def open(self, timeout_s: float) -> None:
        """Open the line.

        Raises:
            LinkError: it cannot be.
        """
        self._transport = open_transport(self._address, timeout_s, self.options.clock)

    def poll(self, now_s: float) -> None:
        """Take in what has come, at most some 32 KiB, and send a heartbeat when it is due."""
        assert self._transport is not None
        size = 0
        for _ in range(_MOST_READS):
            came = self._transport.receive()
            if came is None:
                break
            data, peer = came
            size += len(data)
            self._receive(data, peer, now_s)
            if size > _MOST_BYTES:
                break
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self.send(
                dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                    dialect.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    dialect.MAV_STATE_ACTIVE,
                    3,
                )
            )
            if self.signer is not None:
                self.signer.keep_up()

    def send(self, message: Any) -> None:
        """Send a message.

        Raises:
            LinkError: the line is gone.
        """
        assert self._transport is not None
        if not self._transport.send(self._wire.pack(message)):
            self.unsent += 1

    def command(self, number: int, values: tuple[float, ...], confirmation: int = 0) -> Any:
        """A COMMAND_LONG to the vehicle; parameters that are left out are 0."""
        filled = (*values, *((0.0,) * (7 - len(values))))
        return dialect.MAVLink_command_long_message(*self.target, number, min(confirmation, 255), *filled)

    def wait(
        self,
        is_done: Callable[[], bool],
        timeout_s: float,
        *,
        again: Callable[[], None] | None = None,
        every_s: float = 0.5,
    ) -> bool:
        """Poll until something holds; `again` is called at once and then every so often. Whether it holds."""
        clock = self.options.clock
        end_s, next_s = clock() + timeout_s, -math.inf
        while True:
            now_s = clock()
            if again is not None and now_s >= next_s:
                next_s = now_s + every_s
                again()
            self.poll(now_s)
            if is_done():
                return True
            if now_s >= end_s:
                return False
            self.options.sleep(_WAIT_S)

    def close(self) -> None:
        """Let go of the line, and keep the time stamp of signatures; never raises."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()
        if self.signer is not None:
            try:
                self.signer.save()
            except LinkError:  # the file still holds an earlier one with a reserve
                return

    def _receive(self, data: bytes, peer: Any, now_s: float) -> None:
        assert self._transport is not None
        is_stranger = self._peer is not None and peer != self._peer
        if is_stranger and self.heard_s is not None and now_s - self.heard_s < _DESERTED_S:
            self._strangers += 1
            return
        if is_stranger or self._peer is None:
            self._wire.forget()
        for packet in self._wire.take(data, is_datagram=self._transport.is_datagram):
            if not self._is_of_vehicle(packet):
                continue
            if peer is not None and peer != self._peer:
                if not _is_autopilot(packet):
                    continue
                self._peer = peer
                self._transport.use(peer)
            self._count(packet.sequence)
            if packet.is_checked:
                self.heard_s = now_s
            if packet.message is not None:
                self._take(packet.message, now_s)

    def _is_of_vehicle(self, packet: Packet) -> bool:
        if packet.component != AUTOPILOT_COMPONENT or packet.system == 0:
            return False
        if packet.system == self.vehicle:
            return True
        if _is_autopilot(packet):
            if self.vehicle is None:
                self.vehicle = packet.system
                return True
            (self._unasked if self._is_given else self.others).add(packet.system)  # a byte: 255 at most
        return False

    def _count(self, sequence: int) -> None:
        if self._sequence is not None:
            gap = (sequence - self._sequence - 1) % 256
            if gap >= 128:  # late, or twice
                return
            self.lost += gap
        self._sequence = sequence


def _is_autopilot(packet: Packet) -> bool:
    message = packet.message
    return (
        message is not None
        and message.get_type() == "HEARTBEAT"
        and message.autopilot != dialect.MAV_AUTOPILOT_INVALID
        and message.type != dialect.MAV_TYPE_GCS
    )


def _number(address: Address, name: str) -> int | None:
    text = address.options.get(name)
    if text is None:
        return None
    if not text.isascii() or not text.isdigit() or not 0 < int(text) < 256:
        raise LinkError(f"{address.scheme}: {name}={text}: a system is a number from 1 to 255")
    return int(text)
