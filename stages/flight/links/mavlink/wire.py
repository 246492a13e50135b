"""Frames of MAVLink: from bytes to messages and back.

pymavlink's `mavutil` connections block, reconnect and print by themselves, and its parser throws away a whole
frame's length after a damaged one, passes messages that it does not know before it has looked at their
signature, and remembers time stamps of signatures that turn out to be wrong. So frames are found and checked
here, from any bytes and without waiting; pymavlink packs and unpacks the fields.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.generator.mavcrc import x25crc

from alula.stages.flight.links.mavlink.signing import SIGNATURE_BYTES, Signer

_V1, _V2 = 0xFE, 0xFD
_HEADER = {_V1: 6, _V2: 10}
_CRC = 2
_SIGNED = 1  # the only incompatibility flag there is
_MOST_BAD = 32  # frames per call, after which the rest of the bytes is given up


class Packet(NamedTuple):
    """A frame; `message` is None for those that nobody asked for.

    Of a message without a definition the checksum cannot be checked: it may be from anybody.
    """

    system: int
    component: int
    sequence: int
    message: Any
    is_checked: bool = True


class Wire:
    """One end of a link; takes any bytes and never raises for them.

    Attributes:
        bad: frames, and runs of other bytes, that were refused.
        is_signed: whether a frame that was not refused had a signature.
    """

    def __init__(
        self, system: int, component: int, wanted: Iterable[int], signer: Signer | None = None
    ) -> None:
        self.bad = 0
        self.is_signed = False
        self._wanted = frozenset(wanted)
        self._signer = signer
        self._rest = b""
        self._reader = dialect.MAVLink(None)
        self._writer = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        if signer is not None:
            signing = self._writer.signing
            signing.secret_key, signing.link_id, signing.sign_outgoing = signer.key, signer.link, True

    def pack(self, message: Any) -> bytes:
        """The next frame, MAVLink 2, signed if there is a key."""
        if self._signer is not None:
            self._writer.signing.timestamp = self._signer.next_stamp()
        frame = bytes(message.pack(self._writer))
        self._writer.seq = (self._writer.seq + 1) % 256
        return frame

    def forget(self) -> None:
        """Drop what began and did not end: the bytes that follow come from elsewhere."""
        self._rest = b""

    def take(self, data: bytes, *, is_datagram: bool = False) -> list[Packet]:
        """All valid frames; what begins a further one is kept for the next call.

        In a datagram with anything bad before it such a beginning is more likely none, and is dropped: it
        would hold up the next datagram.
        """
        buffer = self._rest + data
        self._rest = b""
        packets: list[Packet] = []
        at, bad_before = 0, self.bad
        while at < len(buffer):
            start = _next_frame(buffer, at)
            if start > at:
                self.bad += 1
            if self.bad - bad_before > _MOST_BAD or start == len(buffer):
                break
            length = _frame_length(buffer, start)
            if length is None or start + length > len(buffer):
                if not is_datagram or self.bad == bad_before:
                    self._rest = buffer[start:]
                break
            packet = self._check(buffer[start : start + length], buffer[start + length : start + length + 1])
            if packet is None:
                self.bad += 1
                at = start + 1
                # The byte after a refused one that began nothing is no second fault.
                at = _next_frame(buffer, at)
            else:
                packets.append(packet)
                at = start + length
        return packets

    def _check(self, frame: bytes, following: bytes) -> Packet | None:
        header = _HEADER[frame[0]]
        signed = frame[0] == _V2 and frame[2] & _SIGNED
        if frame[0] == _V2:
            if frame[2] & ~_SIGNED:
                return None
            sequence, system, component = frame[4:7]
            number = int.from_bytes(frame[7:10], "little")
        else:
            sequence, system, component, number = frame[2:6]
        kind = dialect.mavlink_map.get(number)
        end = header + frame[1]
        if kind is not None:
            crc = x25crc(frame[1:end] + bytes([kind.crc_extra])).crc
            if crc != int.from_bytes(frame[end : end + _CRC], "little"):
                return None
        elif following and following[0] not in _HEADER:  # all that tells of a message without a definition
            return None
        if self._signer is not None and not (signed and self._signer.accepts(frame, system, component)):
            return None
        self.is_signed = self.is_signed or bool(signed)
        if number not in self._wanted:
            return Packet(system, component, sequence, None, kind is not None)
        try:
            message = self._reader.decode(bytearray(frame))
        except dialect.MAVError:
            return None
        return Packet(system, component, sequence, message)


def _next_frame(buffer: bytes, at: int) -> int:
    places = [place for place in (buffer.find(_V2, at), buffer.find(_V1, at)) if place >= 0]
    return min(places, default=len(buffer))


def _frame_length(buffer: bytes, start: int) -> int | None:
    """None while it cannot be known."""
    if len(buffer) - start < 3:
        return None
    signature = SIGNATURE_BYTES if buffer[start] == _V2 and buffer[start + 2] & _SIGNED else 0
    return _HEADER[buffer[start]] + buffer[start + 1] + _CRC + signature
