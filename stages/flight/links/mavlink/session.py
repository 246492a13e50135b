"""MAVLink session with one vehicle: packets in both directions, heartbeats, requests with answers."""

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
from alula.stages.flight.links.protocol import Place

GROUND_STATION = 255  # autopilots monitor the heartbeats of this system by default
COMPONENT = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
AUTOPILOT_COMPONENT = dialect.MAV_COMP_ID_AUTOPILOT1

_MAX_READS = 64  # in one poll
_MAX_BYTES = 1 << 15
# ArduPilot lands half a second after the last one in flights by body rates, and in all later flights, too, if
# such a flight was killed: its FS_GCS_TIMEOUT stays.
_HEARTBEAT_S = 0.1
_WAIT_S = 0.005
_NOWHERE = Place(None, "")
_DESERTED_S = 3.0  # after this time without packets another address may take the vehicle's place

WANTED = (
    "HEARTBEAT SYS_STATUS PARAM_VALUE ATTITUDE ATTITUDE_QUATERNION LOCAL_POSITION_NED COMMAND_ACK "
    "GPS_GLOBAL_ORIGIN AUTOPILOT_VERSION ODOMETRY EKF_STATUS_REPORT ESTIMATOR_STATUS EXTENDED_SYS_STATE "
    "STATUSTEXT TIMESYNC GPS_RAW_INT GPS2_RAW ATTITUDE_TARGET"
)


class Session:
    """MAVLink session with one vehicle, from received bytes to its messages.

    Anybody may write to an open socket. The session accepts only packets with the system of the vehicle and
    the component of its autopilot, and with a key only signed ones. The first valid heartbeat of an
    autopilot determines the system and the address to answer to. Packets from another address are accepted
    only after 3 s of silence.

    Args:
        address: the parsed address; options `system` (of the vehicle) and `source` (of this program).
        take: called with each message of the vehicle and the time [s].

    Attributes:
        vehicle: system of the vehicle; None until its first heartbeat.
        others: systems of other autopilots that send heartbeats.
        heard_s: when the last packet of the vehicle arrived.
        source: system of this program.
        start_s: start of the session, zero of the times in messages.
        lost: number of packets that are missing by the sequence numbers.
        unsent: number of packets dropped because the line's buffer was full.

    Raises:
        LinkError: a key without a file for its time stamps, or a system number is wrong.
        UsageError: the address has another option.
    """

    def __init__(self, address: Address, options: LinkOptions, take: Callable[[Any, float], None]) -> None:
        address.only("system", "source")
        self.options = options
        self._address, self._take = address, take
        self.vehicle: int | None = _number(address, "system")
        source = _number(address, "source")
        self._is_given = self.vehicle is not None
        self.others: set[int] = set()
        self._unselected: set[int] = set()  # other autopilots than the one that the address selects
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
                raise LinkError("signing needs a file that stores its time stamps between runs")
            self.signer = Signer(
                options.key, file=options.signing_file, clock=options.clock, wall_clock=options.wall_clock
            )
        wanted = [getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in WANTED.split()]
        self.source = GROUND_STATION if source is None else source
        self._wire = Wire(self.source, COMPONENT, wanted, self.signer)

    @property
    def bad(self) -> int:
        """Number of frames that were refused."""
        return self._wire.bad + self._strangers

    @property
    def name(self) -> str:
        """The address without its options."""
        return f"{self._address.scheme}:{self._address.place}"

    @property
    def is_signed(self) -> bool:
        """Return whether packets of the vehicle were signed although this session has no key."""
        return self.signer is None and self._wire.is_signed

    def refused(self) -> str:
        """Number of refused frames and a possible cause, as the end of an error message."""
        if self._unselected:
            return f": only system {', '.join(map(str, sorted(self._unselected)))}, not {self.vehicle}"
        if not self.bad:
            return ": nothing was received"
        guess = "do both ends have the same signing key?" if self.signer else "is it MAVLink, at this speed?"
        return f": {self.bad} bad packets were received; {guess}"

    @property
    def target(self) -> tuple[int, int]:
        """System and component of the autopilot."""
        assert self.vehicle is not None
        return self.vehicle, AUTOPILOT_COMPONENT

    def time_ms(self, now_s: float) -> int:
        """Time stamp for messages: time since the session began [ms], modulo 2^32."""
        return round((now_s - self.start_s) * 1e3) & 0xFFFFFFFF

    def open(self, timeout_s: float) -> None:
        """Open the line.

        Raises:
            LinkError: it cannot be opened.
        """
        self._transport = open_transport(self._address, timeout_s, self.options.clock)

    def poll(self, now_s: float) -> None:
        """Receive what has arrived, at most about 32 KiB, and send a heartbeat if it is due."""
        assert self._transport is not None
        size = 0
        for _ in range(_MAX_READS):
            received = self._transport.receive()
            if received is None:
                break
            data, peer = received
            size += len(data)
            self._receive(data, peer, now_s)
            if size > _MAX_BYTES:
                break
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self.send(_heartbeat())
            if self.signer is not None:
                self.signer.keep_up()

    def send(self, message: Any) -> None:
        """Send a message.

        Raises:
            LinkError: the connection is lost.
        """
        assert self._transport is not None
        if not self._transport.send(self._wire.pack(message)):
            self.unsent += 1

    @property
    def place(self) -> Place:
        """Where the vehicle is reached."""
        return _NOWHERE if self._transport is None else self._transport.place

    def parts(self, *commands: tuple[int, tuple[float, ...]]) -> list[tuple[int, int, bytes]]:
        """A heartbeat, and COMMAND_LONGs by number and parameters, for frames of another process."""
        messages = (_heartbeat(), *(self.command(*each) for each in commands))
        return [self._wire.parts(message) for message in messages]

    def command(self, number: int, values: tuple[float, ...], confirmation: int = 0) -> Any:
        """A COMMAND_LONG to the vehicle.

        Args:
            number: MAV_CMD.
            values: its first parameters; the others are 0.
        """
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
        """Poll until a condition holds or the time is over; returns whether it holds."""
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
        """Close the line and save the signature time stamp; never raises."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()
        if self.signer is not None:
            try:
                self.signer.save()
            except LinkError:  # the file still holds an earlier stamp with a reserve
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
        if self._peer is None and self.signer is not None and self.signer.has_heard_late:
            self._transport.use(peer)  # a vehicle without a clock takes the time of a signed heartbeat

    def _is_of_vehicle(self, packet: Packet) -> bool:
        if packet.component != AUTOPILOT_COMPONENT or packet.system == 0:
            return False
        if packet.system == self.vehicle:
            return True
        if _is_autopilot(packet):
            if self.vehicle is None:
                self.vehicle = packet.system
                return True
            (self._unselected if self._is_given else self.others).add(packet.system)  # a byte: at most 255
        return False

    def _count(self, sequence: int) -> None:
        if self._sequence is not None:
            gap = (sequence - self._sequence - 1) % 256
            if gap >= 128:  # late or repeated
                return
            self.lost += gap
        self._sequence = sequence


def _heartbeat() -> Any:
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER,
        dialect.MAV_AUTOPILOT_INVALID,
        0,
        0,
        dialect.MAV_STATE_ACTIVE,
        3,
    )


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
